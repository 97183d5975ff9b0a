"""A figure that notebooks show without pyplot; imported late, because matplotlib takes long to import."""

from __future__ import annotations

import warnings
from io import BytesIO

from matplotlib.axes import Axes as Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


class Drawing(Figure):
    """A matplotlib figure on white paper; `savefig` writes it."""

    def __init__(self, width_in: float, height_in: float) -> None:
        """Make an empty figure of this size, inches."""
        super().__init__(figsize=(width_in, height_in), layout="constrained", facecolor="white")
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        """Return the figure as PNG for a notebook."""
        content = BytesIO()
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph")  # names from logs may contain characters that the font lacks
            self.savefig(content, format="png", dpi=110)
        return content.getvalue()
