"""What every figure says of itself: its section, its charts and its words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.pictures import Picture
    from cyclekit.report.tables import ReportTable


@dataclass(frozen=True)
class Chart:
    """A picture on the page.

    Attributes:
        picture: Drawn when the page shows it.
        caption: Below the picture.
        title: Heading above it; empty without one.
        numbers: The numbers of the picture, folded up below it.
        table: A table that is always open, below those.
        more: Further tables, folded up.
        half: Two such charts are printed side by side.
    """

    picture: Picture
    caption: str
    title: str = ""
    numbers: ReportTable | None = None
    table: ReportTable | None = None
    more: Sequence[ReportTable] = ()
    half: bool = False


@dataclass(frozen=True)
class Figure:
    """A figure of the page.

    Attributes:
        name: Short and unique.
        section: Section of the page: answer, where, why, helps or trust.
        charts: Makes its charts; none if there is nothing to show.
        words: Its texts, looked up as `NAME.key`, where they are not in `texts.toml`; templates can replace them.
    """

    name: str
    section: str
    charts: Callable[[PageInputs], Iterable[Chart]]
    words: Mapping[str, str] = field(default_factory=dict)
