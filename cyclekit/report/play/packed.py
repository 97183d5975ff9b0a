"""Arrays as text that a page can hold: one block, compressed, with a table of what lies where."""

from __future__ import annotations

import base64
import json
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

UNKNOWN, MAX_COORDINATE = -(2**31), 2**31 - 1
"""Code of an unknown coordinate; largest coordinate."""
FINEST = 100_000_000.0, 10_000_000.0, 1_000_000.0, 100_000.0, 10_000.0
"""Resolutions that are tried, units per metre."""
FEW_BYTES = 900_000
"""Maximum number of bytes of the coordinates when compressed, for which a resolution is taken that is not the last."""


def units_per_metre(*xyz_m: NDArray[np.floating[Any]]) -> float:
    """Return the resolution of coordinates in 32 bits, units per metre; the same for all, and as fine as fits."""
    farthest = max(float(np.nanmax(np.abs(some), initial=1.0)) for some in xyz_m)
    for finest in FINEST:
        unit = min(finest, float(np.floor(MAX_COORDINATE / farthest)))
        if sum(len(zlib.compress(in_steps(in_units(some, unit)).tobytes(), 1)) for some in xyz_m) <= FEW_BYTES:
            break
    return unit


def in_units(xyz_m: NDArray[np.floating[Any]], per_metre: float) -> NDArray[np.int32]:
    """Return coordinates in units; unknown ones are UNKNOWN."""
    found = np.round(xyz_m * per_metre)
    return np.where(np.isnan(found), UNKNOWN, found).astype(np.int32)


def in_steps(values: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the differences along axis -2 instead of the values: they are small, so they compress well."""
    return np.diff(values, axis=-2, prepend=np.zeros_like(values[..., :1, :]))  # it wraps, and so does the script


def each_once(rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the different rows (M, 3) in the order in which they first occur, and for each row (N, 3) its number."""
    frame = pl.from_numpy(rows, schema=["x", "y", "z"])
    found = frame.unique(maintain_order=True).with_row_index("number")
    numbered = frame.join(found, on=["x", "y", "z"], how="left", nulls_equal=True, maintain_order="left")
    return found.select("x", "y", "z").to_numpy(), numbered["number"].to_numpy().astype(np.int64)


def numbers_in_steps(numbers: NDArray[np.int64]) -> NDArray[np.uint16] | NDArray[np.int32]:
    """Return the differences along the last axis instead of the numbers, in as few bytes as hold them; they wrap."""
    kind = np.uint16 if numbers.max(initial=0) < 2**16 else np.int32
    flat = numbers.ravel().astype(kind)
    return np.diff(flat, prepend=flat[:1] * 0)


def packed(facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> str:
    """Return facts and arrays as JSON: `{"facts": ..., "arrays": {name: [type, offset, count]}, "block": base64}`.

    Every array begins at a multiple of 4 bytes, little-endian; `<` is escaped, so that no name ends the script.
    """
    block, table = b"", {}
    for name, array in arrays.items():
        block += b"\0" * (-len(block) % 4)
        table[name] = [array.dtype.name, len(block), array.size]
        block += np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
    zipped = base64.b64encode(zlib.compress(block, 9)).decode()
    text = json.dumps({"facts": facts, "arrays": table, "block": zipped}, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")
