"""Common style of all figures: fonts, colours, tooltips; independent of the caller's matplotlib settings."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

INK, MUTED, RULE = "#1c232b", "#55606c", "#d9dee4"

STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "cyclekit",
    "text.parse_math": False,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.5,
    "text.color": INK,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
}


def tip(figure: Figure, artist: Artist, text: str, row: str = "") -> None:
    """Give `artist` the tooltip `text`; `row` is the key for the page's filter."""
    tips: list[tuple[str, str]] = figure.__dict__.setdefault("cyclekit_tips", [])
    artist.set_gid(f"tip{len(tips)}")
    tips.append((text, row))


@contextmanager
def plain_style() -> Iterator[None]:
    """Use this style inside the block."""
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(STYLE)  # type: ignore[arg-type]  # typed as literal keys
        yield
