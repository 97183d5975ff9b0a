"""The part of the page to play with: its tables as text, or why there is none."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

from cyclekit.errors import CyclekitError
from cyclekit.estimate.safety import SafetyModel
from cyclekit.report.play.both import played_together, tables_of_both
from cyclekit.report.play.lists import tables_of_lists
from cyclekit.report.play.packed import packed
from cyclekit.report.play.tables import playable, tables_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.dataset.cards.task_model import TaskModelCard
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.play.tables import Tables
    from cyclekit.report.texts import ReportTexts

MOST_BYTES = 2_000_000
"""A page with larger tables is too slow to open on a phone."""
Kind = Literal["robot", "both", "list"]
_COLOURS: dict[Kind, tuple[str, ...]] = {
    "robot": ("motion", "slow", "dwell", "wait"),
    "both": ("motion", "slow", "dwell", "person", "wait"),
    "list": ("task", "work", "wait"),
}


class PlayPart(NamedTuple):
    """What goes into the page.

    Attributes:
        data: The tables; None where the page cannot be played with.
        missing: What the page says is missing, one sentence or none.
        kind: `robot` beside operators who do not wait for it, `both` agents, or plans of task lists.
    """

    data: str | None
    missing: tuple[str, ...] = ()
    kind: Kind = "robot"

    @property
    def colours(self) -> tuple[str, ...]:
        """What its time chart shows, each by its colour."""
        return _COLOURS[self.kind]


def play_part(page: PageInputs) -> PlayPart:
    """Return the tables of a page's sequences; without any sequence there is nothing to play with."""
    if not page.ranked:
        return PlayPart(None)
    found = playable(page)
    if found == "waits" and isinstance(page.answers, SafetyModel):
        model = page.answers
        if not played_together(page):
            return PlayPart(None, (page.texts("play.told"),))
        return _part(page.texts, "both", lambda: tables_of_both(page, model))
    if isinstance(found, str):
        return PlayPart(None, (page.texts(f"play.{found}"),))
    return _part(page.texts, "robot", lambda: tables_of(page, found))


def play_lists(
    texts: ReportTexts, card: TaskModelCard, found: Sequence[CycleEstimate], takt_s: float | None
) -> PlayPart:
    """Return the tables of plans of task lists; without any plan there is nothing to play with."""
    if not found:
        return PlayPart(None)
    return _part(texts, "list", lambda: tables_of_lists(card, found, takt_s))


def _part(texts: ReportTexts, kind: Kind, make: Callable[[], Tables]) -> PlayPart:
    try:
        facts, arrays = make()
    except CyclekitError as error:  # the estimates were made in another process, on other tracks
        return PlayPart(None, (texts("play.failed", why=error.seen),))
    data = packed({**facts, "words": texts.section("play")}, arrays)
    if len(data) > MOST_BYTES:
        return PlayPart(None, (texts("play.too_large", size=f"{len(data) / 1e6:.1f}"),))
    return PlayPart(data, (), kind)
