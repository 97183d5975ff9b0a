"""How far tracks that start at any instant may replace logged tracks: the validation's evidence, and its limits.

What was logged is that an operator's track begins where its execution does. If his habits do not depend on that, tracks
may start anywhere on the logs, and every second of these meets every part of a program: less is left to chance. But few
executions cannot show that he keeps no time with the cycle; a test that does not reject shows only that they are few.
So the difference is measured where it counts, in cycle times, for logged orders and for their first halves (whole ones
meet all of a log in any case, and hide what only its beginning has). As little of it is adopted as is known of it: the
estimate departs from that of the logged tracks by at most one standard error of the difference (a positive-part
James-Stein weight), and the interval of the mean covers both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.statistics.resample import TOGETHER, resampled, resampled_alike
from cyclekit.text.numbers import signed, signed_percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.schema import Vector

LEAST = 1 / 8
"""Least share of tracks that start at any instant: fewer are less than one per execution (`tracks.ENTRIES`)."""


@dataclass(frozen=True)
class OperatorModel:
    """Difference between cycles with tracks that start at any instant and cycles with the logged tracks.

    Attributes:
        bias: Mean difference, as a share of the cycle, of logged orders or of their first halves: the clearer one.
        z: The difference in standard errors, from resampled executions.
    """

    bias: float
    z: float

    @property
    def anywhere(self) -> float:
        """Share of the tracks that start at any instant."""
        share = 1.0 / max(self.z**2, 1.0)
        return share if share >= LEAST else 0.0

    @property
    def as_logged(self) -> bool:
        """Whether most tracks start where their executions do."""
        return self.anywhere < 0.5

    @property
    def departure(self) -> float:
        """How far cycles depart from those with logged tracks, as a share; the interval of the mean covers it."""
        return self.anywhere * abs(self.bias)

    @property
    def said(self) -> str | None:
        """The result in one sentence, if most tracks start where their executions do."""
        if not self.as_logged:
            return None
        return (
            f"starting logged operators at any instant changes cycle times by {signed_percent(self.bias, 1)} "
            f"({signed(self.z, 1)} standard errors): they start where their executions do"
        )

    def to_dict(self) -> dict[str, float | bool]:
        """Return plain JSON values."""
        return {"bias": self.bias, "z": self.z, "as_logged": self.as_logged, "anywhere": self.anywhere}


def operator_model(
    names: Sequence[str], cycles: Sequence[tuple[Vector, Vector]], tracks: OperatorTracks
) -> OperatorModel | None:
    """Compare the operator model with logged tracks; None if the model starts tracks only at their beginning.

    Args:
        names: The logged executions.
        cycles: For some parts of the logged orders: durations with the own operator track from its beginning, relative
            to those without safety loss, shape (E,), and relative durations with the later tracks, executions in turn,
            shape (K - beginnings,).
        tracks: The tracks of these executions, the beginnings first.
    """
    found = [_difference(names, own, later, tracks) for own, later in cycles if len(later)]
    return max(found, key=lambda one: abs(one.z), default=None)


def _difference(names: Sequence[str], own: Vector, later: Vector, tracks: OperatorTracks) -> OperatorModel:
    entered, together = tracks.executions[-len(later) :], TOGETHER if tracks.runs_on else 1
    weights = resampled_alike(entered, names, 0, together=together)
    means = weights @ own / np.maximum(weights.sum(axis=1), 1e-9)
    error = float((resampled(entered, 0, together=together) @ later - means).std())
    off = float(later.mean() - own.mean())
    return OperatorModel(off / float(own.mean()), off / max(error, 1e-9))
