"""What one call of `estimate` asks, and the altered cell that it may ask about."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cyclekit.dataset.cards import CouplingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.check import Check
    from cyclekit.estimate.nominal import NominalTask
    from cyclekit.estimate.safety import Dynamics, SafetyModel
    from cyclekit.estimate.tracks import OperatorTracks
    from cyclekit.parallel.engine import Engine


@dataclass(frozen=True)
class Altered:
    """Another cell than the one that was logged: tasks and tracks made of the logged ones, and how s follows there."""

    tasks: Callable[[Mapping[str, NominalTask]], Mapping[str, NominalTask]]
    tracks: Callable[[OperatorTracks, Mapping[str, NominalTask]], OperatorTracks]
    dynamics: Dynamics
    moved: Mapping[str, float] = field(default_factory=dict)
    """What logged durations moved the number of each sequence by in the cell that was logged, as a factor, by name."""
    coupling: CouplingCard | None = None
    """Who waits for whom there."""
    pace: float = 1.0
    """How many times as fast the operator walks and works there."""


@dataclass(frozen=True)
class Question:
    """Everything that one call asks with."""

    model: SafetyModel
    dataset: Dataset
    estimator: str
    quantiles: tuple[float, ...]
    takt_s: float | None
    seed: int
    extrapolate: bool
    check: Check | None
    altered: Altered | None
    engine: Engine

    @property
    def phases(self) -> int | None:
        """How often operator tracks are entered; None: as these logs allow."""
        return self.check.phases if self.check else None
