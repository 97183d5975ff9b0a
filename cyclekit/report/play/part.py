"""The part of the page to play with: its tables as text, or why there is none."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from cyclekit.errors import CyclekitError
from cyclekit.report.play.packed import packed
from cyclekit.report.play.tables import playable, tables_of

if TYPE_CHECKING:
    from cyclekit.report.inputs import PageInputs

MOST_BYTES = 2_000_000
"""A page with larger tables is too slow to open on a phone."""


class PlayPart(NamedTuple):
    """What goes into the page, and what the page says is missing (one sentence or none)."""

    data: str | None
    missing: tuple[str, ...] = ()


def play_part(page: PageInputs) -> PlayPart:
    """Return the tables of a page's sequences; without any sequence there is nothing to play with."""
    if not page.ranked:
        return PlayPart(None)
    texts = page.texts
    if isinstance(model := playable(page), str):
        return PlayPart(None, (texts(f"play.{model}"),))
    try:
        facts, arrays = tables_of(page, model)
    except CyclekitError as error:  # the estimates were made in another process, on other tracks
        return PlayPart(None, (texts("play.failed", why=error.seen),))
    data = packed({**facts, "words": texts.section("play")}, arrays)
    if len(data) > MOST_BYTES:
        return PlayPart(None, (texts("play.too_large", size=f"{len(data) / 1e6:.1f}"),))
    return PlayPart(data)
