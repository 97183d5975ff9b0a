"""Does the operator model hinder the robot as much as the logged operators did? Logged executions tell.

Where the operator may begin at any instant (`tracks.phase_is_free`), a cycle is rolled out beside operators who are
entered later than at the beginning of their logs, and continued by others. That test looks at where operators are, and
few executions tell little. What counts is the cycle time: each logged execution is rolled out beside its own operator
from the beginning, and again from the later instants. An operator who starts with the cycle, or keeps time with it,
gives other cycles then; his tracks are used as they were logged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.resample import TOGETHER, resampled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.estimate.tracks import OperatorTracks

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
            f"operators entered at any instant of their logs give cycles {self.bias:+.1%} beside their logged tracks "
            f"({self.z:+.1f} standard errors): logged tracks are used from their beginning"
        )

    def to_dict(self) -> dict[str, float | bool]:
        """Return plain JSON values."""
        return {"bias": self.bias, "z": self.z, "as_logged": self.as_logged}


def operator_model(names: Sequence[str], beside_s: NDArray[np.float64], tracks: OperatorTracks) -> OperatorModel | None:
    """Compare; None where the model enters tracks at their beginning alone.

    Args:
        names: The logged executions.
        beside_s: How long each takes beside its own operator from the beginning and from each later entry, shape
            (entries, E), s; inf: not within the track.
        tracks: Of these executions.
    """
    if len(beside_s) == 1:
        return None
    longest_s = tracks.step_s * tracks.xyz_m.shape[1]  # a cycle that does not end takes at least so long
    own_s, later_s = beside_s[0], np.minimum(beside_s[1:], longest_s).mean(axis=0)
    known = np.isfinite(own_s)
    off_s = later_s[known] - own_s[known]
    weights = resampled([str(name) for name in np.array(names)[known]], 0, together=TOGETHER if tracks.runs_on else 1)
    error_s = float((weights @ off_s).std())
    return OperatorModel(float(off_s.mean() / own_s[known].mean()), float(off_s.mean()) / max(error_s, 1e-9))
