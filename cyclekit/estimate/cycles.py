"""The cycles of all sequences by the chosen estimator, with operator tracks long enough for the slowest cycle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.cycle.estimators import ESTIMATORS
from cyclekit.estimate.cycle.spread import RolloutInputs, logged_support, roll_spread
from cyclekit.estimate.cycle.transit import transit_table
from cyclekit.estimate.cycle.walk import Rolled, roll_all
from cyclekit.estimate.operator.tracks import OperatorTracks, operator_tracks
from cyclekit.estimate.robot.safety import Dynamics, Logged, OnStates, holds_everywhere

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.estimate.robot.program import Program
    from cyclekit.estimate.validation.question import Question
    from cyclekit.schema import Progress

MANY = 50
"""More sequences than this are estimated from the table of arrivals; of these, only the best MANY are simulated."""


def cycles_of(
    ask: Question, sequences: Sequence[TaskSequence], programs: Sequence[Program], tell: Progress
) -> tuple[list[Rolled], OperatorTracks | None, float]:
    """Return the cycles of every sequence, their operator tracks (None without any), and the length of these, s.

    A cycle that does not end within its track has duration inf.
    """
    estimator = ESTIMATORS[ask.estimator]
    if estimator.alone is not None:
        return [estimator.alone(ask.dataset, program, ask.seed) for program in programs], None, np.inf
    horizon = 2.5 * max(program.length_s for program in programs)
    rolled: list[Rolled] = []
    for last in (False, False, False, True):  # tracks must be long enough for the slowest cycle; speed 0 % prolongs it
        operator = sequences[0].operator
        tracks = operator_tracks(
            ask.dataset,
            horizon_s=horizon,
            operator=operator,
            goals=estimator.goals,
            model=ask.model,
        )
        if ask.altered is not None:
            tracks = ask.altered.tracks(tracks, {task.task: task for program in programs for task in program.tasks})
        rolled = []
        for number, cycles in enumerate(_rolled(ask, _Round(sequences, programs, tracks, horizon))):
            rolled.append(cycles)
            tell(number / len(programs), f"rolling out {sequences[number].name}")
            if not last and not np.isfinite(cycles.duration_s).all():
                break
        else:
            break
        horizon *= 2.0
    return rolled, tracks, horizon


@dataclass(frozen=True)
class _Round:
    """Sequences with their programs that are simulated together, with tracks of one length."""

    sequences: Sequence[TaskSequence]
    programs: Sequence[Program]
    tracks: OperatorTracks
    horizon_s: float


def _rolled(ask: Question, turn: _Round) -> Iterator[Rolled]:
    programs, tracks = turn.programs, turn.tracks
    if (beside := ESTIMATORS[ask.estimator].beside) is not None:
        return (beside(ask.model, program, tracks, ask.seed) for program in programs)
    if len(programs) <= MANY or not _dynamics(ask).none or isinstance(ask.model, OnStates):
        return _walked(ask, turn)
    return _looked_up(ask, turn)


def _walked(ask: Question, turn: _Round) -> Iterator[Rolled]:
    programs, tracks = turn.programs, turn.tracks
    if ask.altered is None and not ask.engine.stays_here(len(programs)):
        operator = turn.sequences[0].operator
        some = tuple(ask.dataset.executions["execution"]) if ask.dataset.is_part else None
        inputs = RolloutInputs(ask.model, ask.dataset.place, some, operator, turn.horizon_s, ask.seed)
        return roll_spread(ask.engine, inputs, turn.sequences, len(tracks.executions))
    support: Logged | None = ask.model if isinstance(ask.model, OnStates) else None
    if support is None and not holds_everywhere(ask.model):
        support = logged_support(ask.dataset)
    return roll_all(ask.model, programs, tracks, support, seed=ask.seed, dynamics=_dynamics(ask))


def _dynamics(ask: Question) -> Dynamics:
    return ask.altered.dynamics if ask.altered is not None else Dynamics.of(ask.dataset.card.dynamics, ask.model)


def _looked_up(ask: Question, turn: _Round) -> Iterator[Rolled]:
    """Estimate many sequences from the table of arrivals, and simulate the best of them."""
    programs, tracks = turn.programs, turn.tracks
    tasks = {task.key: task for program in programs for task in program.tasks}
    table = transit_table(ask.model, tasks, tracks)
    found = [table.rolled([task.key for task in program.tasks], seed=ask.seed) for program in programs]
    best = np.argsort([float(cycles.duration_s.mean()) for cycles in found])[:MANY].tolist()
    some = replace(turn, sequences=[turn.sequences[i] for i in best], programs=[programs[i] for i in best])
    walked = _walked(ask, some)
    for i, cycles in zip(best, walked, strict=True):
        found[i] = cycles
    return iter(found)
