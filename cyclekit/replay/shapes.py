"""Draws shapes used for robot and operator: trails and goals, in the colours of the scaling.

Data are written by column. Unknown values are empty lists, so that the shape disappears instead of keeping its last
position.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from cyclekit.plots import colours

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclekit.replay.sink import Sink

TRAIL_S = 4.0


def pack(rgb: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Return red, green, blue (N, 3) as one 0xRRGGBBAA each (N,)."""
    wide = rgb.astype(np.uint32)
    return np.asarray((wide[:, 0] << 24) | (wide[:, 1] << 16) | (wide[:, 2] << 8) | np.uint32(255))


def goals(sink: Sink, path: str, positions: NDArray[np.float64], colour: str) -> None:
    """Draw a flat disc at the goal of the motion, positions (T, 3), m; written only when it changes."""
    filled = np.nan_to_num(positions, nan=1e9)
    changed = np.append(True, np.any(np.diff(filled, axis=0) != 0, axis=1))[: len(positions)]
    some = positions[changed]
    known = np.isfinite(some).all(axis=1)
    if not known.any():
        return
    paint = [colours.to_rgb(colour)]
    sink.static(path, rr.Ellipsoids3D.from_fields(half_sizes=[(0.14, 0.14, 0.006)], colors=paint, fill_mode="solid"))
    columns = rr.Ellipsoids3D.columns(centers=some[known])
    sink.columns(path, sink.run.t_s[changed], columns.partition(known.astype(int).tolist()))


def trail(sink: Sink, path: str, positions: NDArray[np.float64], paint: NDArray[np.uint8], radius_m: float) -> None:
    """Draw the path of the last seconds, positions (T, 3), m: one strip per colour, not across unknown positions."""
    t_s = sink.run.t_s
    pieces = _pieces(positions, paint)
    first = np.searchsorted(t_s, t_s - TRAIL_S)
    strips: list[NDArray[np.float32]] = []
    shades: list[NDArray[np.uint8]] = []
    counts = []
    starts, stops = (np.array([piece[end] for piece in pieces]) for end in (0, 1))
    for now, oldest in enumerate(first.tolist()):
        before = len(strips)
        for piece in range(int(np.searchsorted(stops, oldest, "right")), int(np.searchsorted(starts, now))):
            low, high = max(int(starts[piece]), oldest), min(int(stops[piece]), now)
            strips.append(positions[low : high + 1].astype(np.float32))
            shades.append(paint[high])
        counts.append(len(strips) - before)
    if not strips:
        return
    sink.static(path, rr.LineStrips3D.from_fields(radii=[radius_m]))
    columns = rr.LineStrips3D.columns(strips=strips, colors=pack(np.array(shades)))
    sink.columns(path, t_s, columns.partition(counts))


def _pieces(positions: NDArray[np.float64], paint: NDArray[np.uint8]) -> list[tuple[int, int]]:
    """Return first and last index of each stretch of one colour; each starts where the previous one ends."""
    known = [bool(row.all()) for row in np.isfinite(positions)]
    shades = paint.tolist()
    pieces: list[tuple[int, int]] = []
    for now in range(1, len(known)):
        if not (known[now] and known[now - 1]):
            continue
        start, end = pieces[-1] if pieces else (-1, -1)
        if end == now - 1 and shades[now] == shades[now - 1] and start < end:
            pieces[-1] = (start, now)
        else:
            pieces.append((now - 1, now))
    return pieces
