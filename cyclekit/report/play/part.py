"""The part of the page to play with: its tables as text, or why there is none."""

from __future__ import annotations

import json
from functools import partial
from typing import TYPE_CHECKING, Literal, NamedTuple

from cyclekit.errors import CyclekitError
from cyclekit.estimate.joint.answer import waits_are_known
from cyclekit.report.play.both import played_together, tables_of_both
from cyclekit.report.play.lists import tables_of_lists
from cyclekit.report.play.packed import packed
from cyclekit.report.play.tables import playable, played_alone, tables_of
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.dataset.cards.task_model import TaskModelCard
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.play.tables import Tables
    from cyclekit.report.texts import ReportTexts

MAX_BYTES = 2_000_000
"""A page with larger tables is too slow to open on a phone."""
Kind = Literal["robot", "both", "list"]
_COLOURS: dict[Kind, tuple[str, ...]] = {
    "robot": ("motion", "slow", "dwell", "wait"),
    "both": ("motion", "slow", "dwell", "person", "wait"),
    "list": ("task", "work", "wait"),
}


class PlayPart(NamedTuple):
    """Tables of the part to play with, for the template.

    Attributes:
        data: The tables as JSON; None if the page cannot be played with.
        missing: What the page says is missing, one sentence each.
        kinds: Kinds of sequences that are played: `robot` with operators who do not wait for it, `both` agents, or
            plans of task lists (`list`).
    """

    data: str | None
    missing: tuple[str, ...] = ()
    kinds: tuple[Kind, ...] = ()

    @property
    def colours(self) -> dict[str, str]:
        """What the time chart shows, each with the kinds of sequences that have it, separated by spaces."""
        parts = dict.fromkeys(part for kind in self.kinds for part in _COLOURS[kind])
        return {part: " ".join(kind for kind in self.kinds if part in _COLOURS[kind]) for part in parts}


class _Made(NamedTuple):
    """Packed tables of sequences of one kind, or the sentence that says why there are none."""

    kind: Kind
    names: tuple[str, ...]
    data: str | None
    why: str = ""


def play_part(page: PageInputs) -> PlayPart:
    """Return the tables of a page's sequences; without any sequence there is nothing to play with."""
    if not page.ranked:
        return PlayPart(None)
    model = playable(page)
    if isinstance(model, str):
        return PlayPart(None, (page.texts(f"play.{model}"),))
    waits = waits_are_known(model)
    together = played_together(page, waits=waits)
    alone = [] if waits else played_alone(page)
    made = [_made(page.texts, "robot", each, partial(tables_of, page, model, each)) for each in alone]
    if together:
        made.append(_made(page.texts, "both", together, lambda: tables_of_both(page, model, together)))
    return _joined(page.texts, made) if made else PlayPart(None, (page.texts("play.nothing"),))


def play_lists(
    texts: ReportTexts, card: TaskModelCard, found: Sequence[CycleEstimate], takt_s: float | None
) -> PlayPart:
    """Return the tables of plans of task lists; without any plan there is nothing to play with."""
    if not found:
        return PlayPart(None)
    return _joined(texts, [_made(texts, "list", found, lambda: tables_of_lists(card, found, takt_s))])


def _made(texts: ReportTexts, kind: Kind, shown: Sequence[CycleEstimate], make: Callable[[], Tables]) -> _Made:
    names = tuple(each.name for each in shown)
    try:
        data = packed(*make())
    except CyclekitError as error:  # the estimates were made in another process, on other tracks
        return _Made(kind, names, None, texts("play.failed", why=error.seen))
    if len(data) > MAX_BYTES:
        return _Made(kind, names, None, texts("play.too_large", size=fixed(len(data) / 1e6, 1)))
    return _Made(kind, names, data)


def _joined(texts: ReportTexts, made: Sequence[_Made]) -> PlayPart:
    """Return one part of all kinds that fit into the page together; of the others, why they are missing."""
    kept, missing = list[_Made](), list[str]()
    for each in made:
        size = sum(len(other.data or "") for other in (*kept, each))
        why = each.why or (texts("play.too_large", size=fixed(size / 1e6, 1)) if size > MAX_BYTES else "")
        if not why:
            kept.append(each)
        else:
            missing.append(why if len(made) == 1 else texts("play.concerns", why=why, names=", ".join(each.names)))
    if not kept:
        return PlayPart(None, tuple(missing))
    words = json.dumps(texts.section("play"), separators=(",", ":")).replace("<", "\\u003c")
    data = f'{{"words":{words},"parts":[{",".join(str(each.data) for each in kept)}]}}'
    return PlayPart(data, tuple(missing), tuple(dict.fromkeys(each.kind for each in kept)))
