"""Does the operator model hinder the robot as much as the logged operators did? Logged executions tell.

Where the operator may begin at any instant (`tracks.phase_is_free`), a cycle is rolled out beside operators who enter
the circles of their logs anywhere. That test looks at where operators are, and few executions tell little. What counts
is the cycle time: logged executions are rolled out beside their own operators from the beginning, and in turns beside
the tracks that enter anywhere. An operator who starts with the cycle, or keeps time with it, gives other cycles then;
his tracks are used as they were logged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.resample import TOGETHER, resampled, resampled_alike

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.tracks import OperatorTracks
    from cyclekit.schema import Vector

CHANCE_Z = 2.6
"""So many standard errors between model and logged tracks are no chance (one in a hundred)."""


@dataclass(frozen=True)
class OperatorModel:
    """How cycles beside operators who are entered at any instant differ from those beside their logged tracks.

    Attributes:
        bias: Mean difference, as part of the cycle; logged executions in the same orders.
        z: It in standard errors, from resampling executions.
    """

    bias: float
    z: float

    @property
    def as_logged(self) -> bool:
        """Whether logged tracks are used from their beginning: beyond chance the model gives other cycles."""
        return abs(self.z) > CHANCE_Z

    @property
    def said(self) -> str | None:
        """That they are, in one sentence."""
        if not self.as_logged:
            return None
        return (
            f"entering operator tracks at any instant changes logged cycle times by {self.bias:+.1%} "
            f"({self.z:+.1f} standard errors): tracks are used from their beginning"
        )

    def to_dict(self) -> dict[str, float | bool]:
        """Return plain JSON values."""
        return {"bias": self.bias, "z": self.z, "as_logged": self.as_logged}


def operator_model(names: Sequence[str], own: Vector, later: Vector, tracks: OperatorTracks) -> OperatorModel | None:
    """Compare; None where the model enters tracks at their beginning alone.

    Args:
        names: The logged executions.
        own: How long each takes beside its own operator from the beginning, as part of it without safety loss, shape
            (E,).
        later: How long they take in turns beside the later tracks, so too, shape (K - beginnings,).
        tracks: Of these executions, the beginnings first.
    """
    if not len(later):
        return None
    entered, together = tracks.executions[-len(later) :], TOGETHER if tracks.runs_on else 1
    weights = resampled_alike(entered, names, 0, together=together)
    means = weights @ own / np.maximum(weights.sum(axis=1), 1e-9)
    error = float((resampled(entered, 0, together=together) @ later - means).std())
    off = float(later.mean() - own.mean())
    return OperatorModel(off / float(own.mean()), off / max(error, 1e-9))
