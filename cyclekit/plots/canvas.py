"""Writes a figure atomically, without a screen; the same data give the same bytes."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from cyclekit.errors import ConfigError
from cyclekit.plots.style import plain_style
from cyclekit.storage.atomic import replaced

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

KINDS = (".svg", ".png", ".pdf")


@contextmanager
def canvas(path: Path, width_in: float, height_in: float) -> Iterator[Axes]:
    """Yield the axes of a new figure, and write it to `path` if the block ends without an error.

    Args:
        path: File to write; its suffix sets the format.
        width_in: Width of the figure, inches.
        height_in: Height, inches.

    Raises:
        ConfigError: The suffix is of no kind that can be drawn.
    """
    from cyclekit.plots.drawing import Drawing

    _check(path)
    with plain_style():
        figure = Drawing(width_in, height_in)
        yield figure.subplots()
        write_figure(path, figure)


def write_figure(path: Path, figure: Figure) -> None:
    """Write a figure to `path`; its suffix sets the format.

    Raises:
        ConfigError: The suffix is of no kind that can be drawn.
    """
    from io import BytesIO

    _check(path)
    content = BytesIO()
    with plain_style():
        kind = path.suffix[1:].lower()
        about: dict[str, str | None] = {"Software" if kind == "png" else "Creator": "written by cyclekit"}
        about |= {"Date": None} if kind == "svg" else {}
        figure.savefig(content, format=kind, dpi=120, metadata=about, facecolor="white")
    with replaced(path) as staging:
        staging.write_bytes(content.getvalue())


def _check(path: Path) -> None:
    if path.suffix.lower() not in KINDS:
        msg = f"{path}: a picture of kind {path.suffix!r} cannot be drawn"
        raise ConfigError(msg, cure=f"End its name in one of {', '.join(KINDS)}.")
