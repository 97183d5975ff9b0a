"""Matplotlib figures as inline SVG: text stays text, ids are unique on the page, no external references.

Every picture exists twice, for a wide screen and for a phone; the page shows the one that fits. `charts` and `maps`
draw them.
"""

from __future__ import annotations

import html
import io
import re
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from cyclekit.plots.style import plain_style
from cyclekit.text.plain_text import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure

WIDE_IN, NARROW_IN = 7.4, 3.7
"""Widths of the two versions, inches; text is 9.5 pt in both, so it stays readable on either."""


@dataclass(frozen=True)
class Picture:
    """One picture; drawn only when a page shows it (not for JSON, CSV or Markdown).

    Attributes:
        name: Short and unique on the page; ids inside the SVG start with it.
        alt: Alternative text for screen readers.
        draw: Makes the figure for a width in inches.
        paper: Make the parts that are printed instead, one below the other; empty: the whole picture is printed.
    """

    name: str
    alt: str
    draw: Callable[[float], Figure]
    paper: tuple[Callable[[float], Figure], ...] = ()

    @cached_property
    def wide(self) -> str:
        """SVG element for a wide screen."""
        return self._drawn(self.draw, WIDE_IN, "w")

    @cached_property
    def narrow(self) -> str:
        """SVG element for a phone."""
        return self._drawn(self.draw, NARROW_IN, "n")

    @cached_property
    def printed(self) -> tuple[str, ...]:
        """SVG elements for paper, as wide as for a wide screen."""
        return tuple(self._drawn(draw, WIDE_IN, f"p{number}") for number, draw in enumerate(self.paper))

    def _drawn(self, draw: Callable[[float], Figure], width_in: float, version: str) -> str:
        with plain_style():
            return _to_svg(draw(width_in), f"{self.name}-{version}", self.alt)


def _to_svg(figure: Figure, prefix: str, alt: str) -> str:
    """Write the figure as an SVG element without prolog, metadata, fixed size or common ids."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.StringIO()
    canvas: Any = FigureCanvasSVG(figure)
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", "Glyph"
        )  # the browser's font counts, and the warning would print a name unescaped
        canvas.print_svg(buffer, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = visible(buffer.getvalue())
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = _with_tips(text, figure.__dict__.get("cyclekit_tips", ()))
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", text)
    text = re.sub(r'xlink:href="#([^"]+)"', rf'xlink:href="#{prefix}-\1"', text)
    text = re.sub(r"font-family: [^;\"]*;? ?", "", text)  # the page's own font
    text = re.sub(r"<style.*?</style>", "", text, flags=re.DOTALL)
    text = re.sub(r"\s*\n\s*", "\n", text)
    label = f'role="img" aria-label="{html.escape(visible(alt), quote=True)}"'
    head = re.compile(r'^<svg([^>]*?) width="[^"]*"')
    return head.sub(lambda found: f"<svg{found[1]} {label}", _without_height(text), count=1)


def _with_tips(text: str, tips: Sequence[tuple[str, str]]) -> str:
    """Turn the groups that `tip` marked into ones with a title, which every browser shows without a script."""

    def group(found: re.Match[str]) -> str:
        words, row = map(visible, tips[int(found[1])])
        of_row = f' data-row="{html.escape(row, quote=True)}"' if row else ""
        return f'<g class="tip"{of_row}><title>{html.escape(words)}</title>'

    return re.sub(r'<g id="tip(\d+)">', group, text)


def _without_height(text: str) -> str:
    head, tag_end, rest = text.partition(">")
    head = re.sub(r' height="[^"]*"', "", head, count=1)
    return head + tag_end + rest
