"""Test of the operator model on logged executions: does it slow the robot as much as the logged operators did?

If the operator's habits do not depend on the phase of the cycle (`tracks.phase_is_free`), cycles are rolled out with
tracks that start anywhere on the circles of the logs. That test compares positions, and has little power with few
executions. The cycle time is what counts: logged executions are rolled out with their own operator track from its
beginning, and in turn with tracks that start anywhere. If the operator starts with the cycle, or is in step with it,
the cycle times differ; his tracks are then used as logged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.statistics.resample import TOGETHER, resampled, resampled_alike

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.schema import Vector

CHANCE_Z = 2.6
"""Threshold, standard errors, of the difference between model and logged tracks (one in a hundred by chance)."""


@dataclass(frozen=True)
class OperatorModel:
    """Difference between cycles with tracks that start at any instant and cycles with the logged tracks.

    Attributes:
        bias: Mean difference, as a share of the cycle; logged executions in the same orders.
        z: The difference in standard errors, from resampled executions.
    """

    bias: float
    z: float

    @property
    def as_logged(self) -> bool:
        """Whether logged tracks are used from their beginning: the model's cycles differ significantly."""
        return abs(self.z) > CHANCE_Z

    @property
    def said(self) -> str | None:
        """The result in one sentence, if logged tracks are used from their beginning."""
        if not self.as_logged:
            return None
        return (
            f"starting logged operators at any instant changes logged cycle times by {self.bias:+.1%} "
            f"({self.z:+.1f} standard errors): they start where their executions do"
        )

    def to_dict(self) -> dict[str, float | bool]:
        """Return plain JSON values."""
        return {"bias": self.bias, "z": self.z, "as_logged": self.as_logged}


def operator_model(names: Sequence[str], own: Vector, later: Vector, tracks: OperatorTracks) -> OperatorModel | None:
    """Compare the operator model with logged tracks; None if the model starts tracks only at their beginning.

    Args:
        names: The logged executions.
        own: Duration with the own operator track from its beginning, relative to that without safety loss, shape (E,).
        later: Relative durations with the later tracks, executions in turn, shape (K - beginnings,).
        tracks: The tracks of these executions, the beginnings first.
    """
    if not len(later):
        return None
    entered, together = tracks.executions[-len(later) :], TOGETHER if tracks.runs_on else 1
    weights = resampled_alike(entered, names, 0, together=together)
    means = weights @ own / np.maximum(weights.sum(axis=1), 1e-9)
    error = float((resampled(entered, 0, together=together) @ later - means).std())
    off = float(later.mean() - own.mean())
    return OperatorModel(off / float(own.mean()), off / max(error, 1e-9))
