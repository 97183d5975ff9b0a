"""Sampling error of logged signal courses alone: errors of means with them, without logs and learning.

    python benchmarks/signal_luck.py --scenes light-curtain,scanner-fields --sets 16 --executions 60 --seeds 779 780

The simulator's safety function of fields and its response are known exactly, and so are the courses of the bits for the
duration of their executions. For each set of courses, an order half as long, as long and twice as long as these
executions is simulated, with the starting times and continuations of `estimate` (`signals`), or only from their starts
(`one entry`); `history` is the sum of the mean task durations in these executions. Ground truth is the mean over 2000
courses that continue. Chance is the error of a mean of as many independent cycles of that order as were logged.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from any_length import OUT, orders
from cells import dataset_of
from rich.table import Table

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import TrainingCard
from cyclekit.estimate.cycle.walk import Rolled, roll_all
from cyclekit.estimate.operator.continuation import Stretch
from cyclekit.estimate.operator.courses import continue_courses
from cyclekit.estimate.operator.tracks import PHASES, OperatorTracks, _instants
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.robot.program import lay_out
from cyclekit.estimate.robot.safety import Dynamics
from cyclekit_sim import random_sequence
from cyclekit_sim.choices import FRESH, OPERATOR, operator_legs, stream
from cyclekit_sim.fields import on_of
from cyclekit_sim.rules import in_polygon
from cyclekit_sim.scenes import BUILT_IN
from cyclekit_sim.walking import WalkedTrack

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.robot.program import Program

STEP_S, LENGTH, TRUTH, TRUTH_SEED, LOGGED_ORDERS = 0.1, 2200, 2000, 777, 24
MEAN_OF_SIZE = (2 / np.pi) ** 0.5


class TrueFields:
    """Simulator's safety function of a scene's fields, as a function of which of them are on."""

    problem, card, fast, unseen_error, doubts, limits, why = "now", TrainingCard(), True, 0.0, (), (), ""

    def __init__(self, scene: str) -> None:
        """Read the fields of a scene."""
        self._fields = BUILT_IN[scene].fields
        self.states = tuple(str(number) for number in range(1 << len(self._fields)))

    def predict(self, x: np.ndarray) -> np.ndarray:
        """Raise an error: the function does not depend on positions."""
        raise NotImplementedError

    def near_logged(self, robot_m: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Return True for every state."""
        return np.ones(len(state), dtype=np.bool_)

    def logged_states(self, dataset: object) -> Mapping[str, tuple[np.ndarray, np.ndarray]]:
        """Return an empty mapping: there are no logs."""
        return {}

    def scaling_in(self, robot_m: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Return the scaling for TCP positions (N, 3), m, and states (N, 1)."""
        found = np.ones(len(state))
        for k, field in enumerate(self._fields):
            on = state[:, 0].astype(np.int64) >> k & 1 == 1
            if field.robot_polygon_m:
                on &= in_polygon(field.robot_polygon_m, robot_m, 0.0)
            found[on] = np.minimum(found[on], field.scaling)
        return found


def courses(scene: str, count: int, seed: int) -> np.ndarray:
    """Return which fields are on for `count` operators, shape (count, LENGTH)."""
    cell, at_s, found = BUILT_IN[scene], np.arange(LENGTH) * STEP_S, np.empty((count, LENGTH), np.int64)
    for k in range(count):
        rng = stream(seed, cell, OPERATOR, k, domain=FRESH)
        track = WalkedTrack(operator_legs(cell, rng), skip_s=float(rng.uniform(60.0, 120.0)))
        found[k] = on_of(cell.fields, track.at(at_s))
    return found


def rolled(
    scene: str,
    programs: Sequence[Program],
    states: np.ndarray,
    seed: int = 0,
    *,
    owner: Sequence[int] | None = None,
    logged: np.ndarray | None = None,
) -> list[Rolled]:
    """Return the cycles of programs with courses, shape (K, T); `owner`: operator of each, `logged`: logged samples."""
    cell, model, count = BUILT_IN[scene], TrueFields(scene), len(states)
    names = tuple(f"{k:06}" for k in (range(count) if owner is None else owner))
    all_of_it = np.full(count, states.shape[1]) if logged is None else logged
    where, state = np.zeros((*states.shape, 3)), states[..., None].astype(np.float64)
    people = OperatorTracks(where, states, model.states, all_of_it, names, STEP_S, state=state)
    response = Dynamics(cell.latency_s, cell.ramp_down_per_s, cell.ramp_up_per_s)
    return list(roll_all(model, programs, people, None, dynamics=response, seed=seed))


def entered(logs: Sequence[np.ndarray], phases: int) -> tuple[np.ndarray, list[int], np.ndarray]:
    """Return continued courses from several starting times, shape (K, LENGTH), their operators and logged samples."""
    pool = [Stretch(np.zeros((len(log), 3)), log) for log in logs]
    instants = _instants([len(log) for log in logs])[:phases]
    begun = [Stretch(log.where[at:], log.activity[at:]) for at in instants for log in pool]
    logged = np.array([len(one.activity) for one in begun])
    return continue_courses(begun, pool, LENGTH)[1], [*range(len(pool))] * len(instants), logged


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=["light-curtain", "scanner-fields"])
    parser.add_argument("--sets", type=int, default=16)
    parser.add_argument("--executions", type=int, default=60)
    parser.add_argument("--seeds", type=int, nargs="+", default=[779, 780])
    parser.add_argument("--work", type=Path)
    asked = parser.parse_args()
    table = Table("scene", "seed", "length", "way", "mean |error|, %", "bias, %", "deviation, %", "chance, %")
    with tempfile.TemporaryDirectory() as folder:
        for scene in asked.scenes:
            dataset = dataset_of(asked.work or Path(folder), scene, 12, seed=3)
            nominal = nominal_tasks(dataset)
            wanted = {name: some[0] for name, some in orders(scene, set(nominal), 1).items()}
            programs = [lay_out(one, nominal, dataset) for one in wanted.values()]
            true = courses(scene, TRUTH, TRUTH_SEED)
            true_s = np.array([one.duration_s for one in rolled(scene, programs, true)])
            chance = MEAN_OF_SIZE * true_s.std(axis=1) / true_s.mean(axis=1) / asked.executions**0.5
            for seed in asked.seeds:
                found = of_seed(scene, asked, seed, dataset, list(wanted.values()))
                for way, means_s in found.items():
                    off = 100 * (means_s / true_s.mean(axis=1) - 1)
                    for n, name in enumerate(wanted):
                        told = np.abs(off[:, n]).mean(), off[:, n].mean(), off[:, n].std(ddof=1), 100 * chance[n]
                        table.add_row(scene, str(seed), name, way, *(f"{each:.2f}" for each in told))
    OUT.print(table)


def of_seed(
    scene: str, asked: argparse.Namespace, seed: int, dataset: Dataset, wanted: Sequence[TaskSequence]
) -> dict[str, np.ndarray]:
    """Return the mean cycle times by way, shape (sets, orders), s."""
    nominal, size = nominal_tasks(dataset), asked.executions
    followed: list[TaskSequence] = []
    number = 10
    while len(followed) < LOGGED_ORDERS:
        sequence = TaskSequence(str(number), tuple(random_sequence(scene, number)))
        number += 1
        followed += [sequence] if set(nominal).issuperset(sequence.tasks) else []
    states = courses(scene, asked.sets * size, seed)
    which = np.arange(len(states)) % LOGGED_ORDERS
    logs, took = [np.empty(0, np.int64)] * len(states), [Counter[str]()] * len(states)
    for order, sequence in enumerate(followed[: len(states)]):  # fewer operators do not follow all orders
        mine = np.flatnonzero(which == order)
        cycles = rolled(scene, [lay_out(sequence, nominal, dataset)], states[mine], seed=order)[0]
        motion_s = np.array([nominal[task].nominal_s for task in sequence.tasks])
        for row, k in enumerate(mine.tolist()):
            logs[k] = states[k, : int(np.ceil(cycles.duration_s[row] / STEP_S))]
            took[k] = Counter()
            for task, s in zip(sequence.tasks, motion_s + cycles.standstill_s[row] + cycles.safety_s[row], strict=True):
                took[k][task] += s
    programs = [lay_out(one, nominal, dataset) for one in wanted]
    found: dict[str, list[list[float]]] = {"one entry": [], "signals": [], "history": []}
    for first in range(0, len(states), size):
        some = range(first, first + size)
        for way, phases in (("one entry", 1), ("signals", PHASES)):
            courses_of, _, _ = entered([logs[k] for k in some], phases)
            found[way].append([float(one.duration_s.mean()) for one in rolled(scene, programs, courses_of)])
        total, count = Counter[str](), Counter[str]()
        for k in some:
            total.update(took[k])
            count.update(followed[which[k]].tasks)
        found["history"].append([sum(total[task] / count[task] for task in one.tasks) for one in wanted])
    return {way: np.array(means_s) for way, means_s in found.items()}


if __name__ == "__main__":
    main()
