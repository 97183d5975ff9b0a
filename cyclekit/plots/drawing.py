"""A figure that a notebook shows as it is, without pyplot; imported late, as matplotlib takes long to import."""

from __future__ import annotations

from io import BytesIO

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


class Drawing(Figure):
    """A matplotlib figure on white paper; `savefig` writes it."""

    def __init__(self, width_in: float, height_in: float) -> None:
        """Begin a figure of this size, inches."""
        super().__init__(figsize=(width_in, height_in), layout="constrained", facecolor="white")
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        """Return the picture for a notebook."""
        content = BytesIO()
        self.savefig(content, format="png", dpi=110)
        return content.getvalue()
