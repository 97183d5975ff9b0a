"""Rows of table SKELETONS: every joint of every body, stored only on request.

The adapters name the joints and assign them to bodies.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.schema import SKELETONS, conform, empty

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray


def joint_rows(
    t_s: pl.Series,
    person: pl.Series | str,
    joints: Sequence[str],
    points_m: NDArray[np.float64],
    source_row: pl.Series,
) -> pl.DataFrame:
    """Return one row per body and joint, in the order of the bodies.

    Args:
        t_s: Time of each body, shape (N,), s.
        person: Person of each body, shape (N,), or one person for all.
        joints: J names.
        points_m: Positions, shape (N, J, 3), m, NaN = not seen.
        source_row: Row of each body, shape (N,).
    """
    count, width = len(t_s), len(joints)
    body = np.repeat(np.arange(count), width)
    names = pl.Series(joints, dtype=pl.String()).gather(np.tile(np.arange(width), count))
    flat = points_m.reshape(count * width, 3)
    seen = np.isfinite(flat).all(axis=1)
    places = {f"{axis}_m": pl.Series(np.where(seen, flat[:, i], np.nan)).fill_nan(None) for i, axis in enumerate("xyz")}
    who = pl.lit(person) if isinstance(person, str) else person.gather(body)
    frame = pl.DataFrame({"t_s": t_s.gather(body), "joint": names, **places, "source_row": source_row.gather(body)})
    return conform(frame.with_columns(person=who), SKELETONS)


def all_joints(tables: Iterable[pl.DataFrame]) -> pl.DataFrame:
    """Concatenate the rows of several bodies, in the order of the log."""
    return pl.concat([empty(SKELETONS), *tables]).sort("source_row", maintain_order=True)


def points_of(frame: pl.DataFrame, columns: Sequence[str]) -> NDArray[np.float64]:
    """Return N rows of columns x, y, z, x, y, z, ... as an array (N, J, 3), NaN where null."""
    flat = frame.select(columns).to_numpy().astype(np.float64, copy=False)
    return flat.reshape(len(frame), len(columns) // 3, 3)


def without_zeros(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions (N, J, 3) with NaN for (0, 0, 0), which some trackers write for a point not seen."""
    return np.where((points == 0.0).all(axis=2, keepdims=True), np.nan, points)
