"""The simulation of many sequences as tasks of an engine; a task has as many programs as one process simulates at once.

So the numbers are equal to the last bit, in one process or many. A task gets the place of the dataset and the names of
the sequences; each worker reads the logs once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.cycle.walk import ROWS, Rolled, roll_all
from cyclekit.estimate.operator.tracks import OperatorTracks, operator_tracks
from cyclekit.estimate.robot.nominal import NominalTask, nominal_tasks
from cyclekit.estimate.robot.program import lay_out
from cyclekit.estimate.robot.safety import Dynamics, Logged, OnStates, SafetyModel, holds_everywhere
from cyclekit.estimate.robot.support import Support
from cyclekit.parallel.one_thread import one_thread

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.parallel.engine import Engine


@dataclass(frozen=True)
class RolloutInputs:
    """Common inputs of all tasks.

    Attributes:
        dataset: Place of the dataset.
        executions: Executions to use; None = all.
        operator: Order of the operator's tasks; None = any.
        horizon_s: Length of the tracks, s.
    """

    model: SafetyModel
    dataset: str
    executions: tuple[str, ...] | None
    operator: tuple[str, ...] | None
    horizon_s: float
    seed: int


def roll_spread(
    engine: Engine, inputs: RolloutInputs, sequences: Sequence[TaskSequence], tracks: int
) -> Iterator[Rolled]:
    """Yield the cycles of the sequences in order, simulated by the workers of an engine; `tracks`: number of tracks."""
    at_once = max(1, ROWS // tracks)
    plain = [replace(sequence, file=None) for sequence in sequences]
    parts = [tuple(plain[first : first + at_once]) for first in range(0, len(plain), at_once)]
    found: dict[int, list[Rolled]] = {}
    turn = 0
    for done in engine.map(partial(_simulate, inputs), parts):
        found[done.number] = done.get()
        while turn in found:
            yield from found.pop(turn)
            turn += 1


@one_thread()
def _simulate(inputs: RolloutInputs, sequences: Sequence[TaskSequence]) -> list[Rolled]:
    on_states = inputs.model if isinstance(inputs.model, OnStates) else None
    logs, nominal, tracks, support = _of_logs(
        inputs.dataset, inputs.executions, inputs.operator, inputs.horizon_s, on_states
    )
    programs = [lay_out(sequence, nominal, logs) for sequence in sequences]
    dynamics = Dynamics.of(logs.card.dynamics, inputs.model)
    near = None if holds_everywhere(inputs.model) else support
    return list(roll_all(inputs.model, programs, tracks, near, seed=inputs.seed, dynamics=dynamics))


@lru_cache(maxsize=1)
def _of_logs(
    dataset: str,
    executions: tuple[str, ...] | None,
    operator: tuple[str, ...] | None,
    horizon_s: float,
    on_states: OnStates | None,
) -> tuple[Dataset, Mapping[str, NominalTask], OperatorTracks, Logged]:
    logs = Dataset.open(dataset)
    logs = logs if executions is None else logs.only(executions)
    tracks = operator_tracks(logs, horizon_s=horizon_s, operator=operator, model=on_states)
    return logs, nominal_tasks(logs), tracks, on_states or logged_support(logs)


def logged_support(dataset: Dataset) -> Support:
    """Return the support: cells of robot and operator positions that were logged."""
    robots, humans = ([f"{who}_{axis}_m" for axis in "xyz"] for who in ("robot", "human"))
    samples = dataset.samples(columns=[*robots, *humans])
    robot, human = (samples.select(names).to_numpy() for names in (robots, humans))
    return Support(robot, human)
