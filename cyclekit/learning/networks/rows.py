"""Samples as standardised tensors on the device, for batches."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from cyclekit.learning.out_of_core import filled
from cyclekit.learning.windows import GROUPS, Samples

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.schema import Bools, Floats, Singles

    Standard = tuple[Floats, Floats]

_HUMAN = GROUPS["human"]
DISTANCE_M = 2.0
"""Offset subtracted from a distance, m; also the distance assumed for an absent operator."""
DISTANCE_1_M = 4.0
"""Factor on a distance, 1/m. A threshold is a sharp edge, and a network learns it sooner in a finer unit: on 1000
executions 1.1e-4 after 3000 steps, against 1.6e-4 in metres."""
_BLOCK_ROWS, _BLOCKS = 4096, 256
"""Consecutive rows read as one block (7 minutes of log), and number of blocks shuffled together."""
_AT_ONCE = 1 << 22
_STILL_M = 1e-6
"""Minimum standard deviation of an input, m; below, it is constant, and scaling it would amplify noise."""


@dataclass(frozen=True)
class TrainingRows:
    """N rows on the device.

    Attributes:
        table: Standardised inputs, shape (M, F + groups); a row's own input is `table[before[row, -1]]`.
        before: Rows of `table` that each row sees, shape (N, K); None if it sees only itself (M = N).
        scaling: Targets, shape (N, 1).
        step: Levels, shape (N,); -1 = none.
        weight: Shape (N,).
        noise_scale: 1/standard deviation of the operator's coordinates, shape (3,), 1/m.
        ahead: Standardised position of the operator after the horizon, shape (N, 3); None unless it is forecast.
        ahead_known: Whether that is known, shape (N,).
        presence: Column of `table` that indicates the operator's presence; None if he is always present.
        apart: Constants that convert inputs to the distance, which is then an additional input; None without one.
        in_blocks: Whether the rows may exceed memory and are read in blocks.
    """

    table: torch.Tensor
    before: torch.Tensor | None
    scaling: torch.Tensor
    step: torch.Tensor
    weight: torch.Tensor
    noise_scale: torch.Tensor
    ahead: torch.Tensor | None
    ahead_known: torch.Tensor
    presence: int | None
    apart: tuple[torch.Tensor, ...] | None = None
    in_blocks: bool = False

    def __len__(self) -> int:
        """Return N."""
        return len(self.scaling)

    def batches(self, count: int) -> Iterator[torch.Tensor]:
        """Yield every row number once, in `count` batches in random order.

        Rows read in blocks are shuffled within groups of _BLOCKS random blocks.
        """
        if not self.in_blocks:
            yield from torch.randperm(len(self)).to(self.scaling.device).tensor_split(count)
            return
        starts = torch.randperm(math.ceil(len(self) / _BLOCK_ROWS)) * _BLOCK_ROWS
        size = math.ceil(len(self) / count)
        for some in torch.split(starts, _BLOCKS):
            rows = torch.cat([torch.arange(at, min(at + _BLOCK_ROWS, len(self))) for at in some.tolist()])
            yield from rows[torch.randperm(len(rows))].tensor_split(max(round(len(rows) / size), 1))

    def inputs(self, part: torch.Tensor, noise_m: float) -> torch.Tensor:
        """Return the inputs of some rows, (B, F + groups) or (B, K, F + groups), with new noise on the operator."""
        x = self.table[part] if self.before is None else self.table[self.before[part]]
        if noise_m > 0:
            noise = torch.randn((*x.shape[:-1], 3)).to(x.device) * (noise_m * self.noise_scale)
            if self.presence is not None:
                noise = noise * x[..., self.presence : self.presence + 1]
            x[..., _HUMAN] += noise
        if self.apart is None:
            return x
        between, of_robot, of_human = self.apart
        way = x[..., :3] * of_robot - x[..., _HUMAN] * of_human + between
        metres = torch.linalg.vector_norm(way, dim=-1, keepdim=True)
        if self.presence is not None:
            there = x[..., self.presence : self.presence + 1]
            metres = metres * there + DISTANCE_M * (1 - there)
        return torch.cat([x, (metres - DISTANCE_M) * DISTANCE_1_M], dim=-1)


def standardisation(X: Singles) -> Standard:
    """Return mean and 1/deviation of every input over its known rows, shape (F,); 0 for a constant input."""
    blocks = [X[first : first + _AT_ONCE] for first in range(0, len(X), _AT_ONCE)]
    count = np.maximum(sum(np.isfinite(block).sum(axis=0) for block in blocks), 1)
    mean = sum(np.where(np.isfinite(b), b, 0.0).sum(axis=0, dtype=np.float64) for b in blocks) / count
    squares = [(np.where(np.isfinite(b), b - mean, 0.0) ** 2).sum(axis=0, dtype=np.float64) for b in blocks]
    deviation = np.sqrt(sum(squares) / count)
    varies = deviation > _STILL_M
    return mean, np.where(varies, 1 / np.where(varies, deviation, 1.0), 0.0)


def rows_on(
    device: torch.device, rows: Samples, spec: ModelSpec, standard: Standard, known: Sequence[str]
) -> TrainingRows:
    """Move rows to the device."""
    raw = rows.X if rows.table is None else rows.table
    if rows.in_files:
        folder, shape = Path(rows.X.filename).parent, (len(raw), raw.shape[1] + len(known))  # type: ignore[attr-defined]
        table = filled(folder / "standardised", shape, lambda part: _standardised(raw[part], standard, known))
    else:
        table = _standardised(raw, standard, known)
    ahead: torch.Tensor | None = None
    seen: Bools = np.zeros(len(rows), np.bool_)
    if spec.kind.forecasts and rows.table is not None and rows.ahead is not None:
        ahead = torch.from_numpy(table[rows.ahead][:, _HUMAN]).to(device)
        seen = np.asarray(np.isfinite(rows.table[rows.ahead][:, _HUMAN]).all(axis=1))
    return TrainingRows(
        torch.from_numpy(table).to(device),
        None if rows.before is None else torch.from_numpy(rows.before).to(device),
        torch.from_numpy(rows.scaling.astype(np.float32, copy=False))[:, None].to(device),
        torch.from_numpy(rows.step.astype(np.int64, copy=False)).to(device),
        torch.from_numpy(rows.weight).to(device),
        torch.from_numpy(standard[1][_HUMAN].astype(np.float32)).to(device),
        ahead,
        torch.from_numpy(seen).to(device),
        rows.X.shape[1] + list(known).index("human") if "human" in known else None,
        _apart(device, standard) if spec.features == "distance" else None,
        rows.in_files,
    )


def _apart(device: torch.device, standard: Standard) -> tuple[torch.Tensor, ...]:
    """Return the difference of the means and the deviations, which convert standardised positions to metres."""
    mean, scale = standard
    spread = np.where(scale > 0, 1 / np.where(scale > 0, scale, 1.0), 0.0)
    parts = (mean[:3] - mean[_HUMAN], spread[:3], spread[_HUMAN])
    return tuple(torch.from_numpy(part.astype(np.float32)).to(device) for part in parts)


def _standardised(X: Singles, standard: Standard, known: Sequence[str]) -> Singles:
    """Return the standardised inputs, with unknown values 0, followed by one flag per group: 1 = known."""
    mean, scale = standard
    flags = [np.asarray(np.isfinite(X[:, GROUPS[group]]).all(axis=1), np.float32)[:, None] for group in known]
    values = np.empty(X.shape, np.float32)
    values[...] = (X - mean) * scale
    values[np.isnan(values)] = 0.0
    for flag, group in zip(flags, known, strict=True):
        values[:, GROUPS[group]] *= flag
    return np.ascontiguousarray(np.concatenate([values, *flags], axis=1))
