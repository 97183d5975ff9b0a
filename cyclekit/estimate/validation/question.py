"""The question of one call of `estimate`, and the altered cell that it may ask about."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cyclekit.dataset.cards import CouplingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.estimate.robot.safety import Dynamics, SafetyModel
    from cyclekit.estimate.validation.check import Check
    from cyclekit.parallel.engine import Engine


LAID_OUT, VALIDATED, ROLLED = 0.08, 0.9, 0.93
"""Measured share of an estimate's work that is done when the sequences are laid out, when the model is validated and
orders are compared, and when cycles are rolled out; what lies between differs too much from cell to cell to be told.
Only the progress told rests on them: half or twice of what is left makes the rest seem as much shorter or longer."""


@dataclass(frozen=True)
class Altered:
    """A changed cell: functions that alter the logged tasks and tracks, and the dynamics of s."""

    tasks: Callable[[Mapping[str, NominalTask]], Mapping[str, NominalTask]]
    tracks: Callable[[OperatorTracks, Mapping[str, NominalTask]], OperatorTracks]
    dynamics: Dynamics
    moved: Mapping[str, float] = field(default_factory=dict)
    """Factor by which logged task durations changed the estimate of each sequence in the logged cell, by name."""
    coupling: CouplingCard | None = None
    """Wait conditions of robot and operator in the changed cell."""
    pace: float = 1.0
    """Speed of the operator relative to the logs, for walking and work."""


@dataclass(frozen=True)
class Question:
    """All inputs and options of one call."""

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
