"""Figures of a model's error: true against predicted scaling, by distance, and reliability of its probabilities."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.plots import colours
from cyclekit.plots.canvas import canvas

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

_FEW = 20


def draw_heatmap(path: Path, rows: NDArray[np.int64]) -> None:
    """Draw a heatmap of the number of rows by true and predicted scaling, logarithmic.

    Args:
        path: File to write.
        rows: Counts, shape (B, B), first index true, second predicted, bins of equal width over [0, 1].
    """
    with canvas(path, 4.2, 3.8) as axes:
        image = axes.imshow(np.log10(rows.T + 1), origin="lower", extent=(0, 1, 0, 1), cmap="cividis", aspect="equal")
        axes.plot([0, 1], [0, 1], color="white", linewidth=0.7, linestyle="--")
        axes.set_xlabel("true")
        axes.set_ylabel("predicted")
        axes.figure.colorbar(image, ax=axes, label="log10(samples + 1)")


def draw_staircase(path: Path, result: Mapping[str, Any]) -> None:
    """Draw the mean true and predicted scaling over the distance between robot and operator.

    Args:
        path: File to write.
        result: `by_distance_true`, `by_distance_predicted` and `by_distance_rows`, for bins of 5 cm from 0 to 4 m.
    """
    rows = np.array(result["by_distance_rows"])[1:81]
    known = rows >= _FEW
    at = (np.arange(80) + 0.5) * 0.05
    with canvas(path, 5.2, 3.2) as axes:
        for name, colour in (("true", colours.NOMINAL), ("predicted", colours.SAFETY)):
            values = np.array(result[f"by_distance_{name}"])[1:81]
            axes.plot(at[known], values[known], ".-" if name == "predicted" else "-", color=colour, label=name)
        axes.set_xlabel("distance robot - operator, m")
        axes.set_ylabel("speed scaling")
        axes.legend(loc="lower right", frameon=False)


def draw_reliability(path: Path, found: Mapping[str, Any]) -> None:
    """Draw accuracy over confidence of a classifier; on the diagonal its probabilities are calibrated.

    Args:
        path: File to write.
        found: `confidence`, `accuracy` and `rows` of each bin, as `models.calibration.Reliability`.
    """
    with canvas(path, 3.8, 3.6) as axes:
        axes.plot([0, 1], [0, 1], color=colours.DWELL, linewidth=0.8)
        size = 10 + 60 * np.sqrt(np.array(found["rows"]) / max(found["rows"]))
        axes.scatter(found["confidence"], found["accuracy"], s=size, color=colours.NOMINAL)
        axes.set_xlabel("probability of the likeliest step")
        axes.set_ylabel("part that was right")
