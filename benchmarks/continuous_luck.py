"""Sampling error and bias of logged signal courses alone, in a cell whose executions follow each other without pauses.

    python benchmarks/continuous_luck.py --sets 40 --executions 60 --seeds 41 --work FOLDER

The scene is `pick-and-package` by signals. The simulator's safety function of fields and its response are known
exactly, and so are the courses of the bits during the executions. In each session the same operator roams through 60
consecutive executions of random orders, with 2 to 4 s between them. For each set, orders that were never logged are
simulated with the starting times and continuations of `estimate` (`signals`), from the starts of the logs alone (`one
entry`), and from the instants of `signals` with what people really did next, in the log or after it (`as it went on`).
`history` is the sum of the mean task durations in these executions. Ground truth is the mean over 2000 other operators
at a random time. Chance is the error of a mean of as many independent cycles of that order as were logged.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from any_length import OUT
from cells import dataset_of, unseen_sequences
from no_tracker_estimates import BY_SIGNALS, MEAN_OF_SIZE
from rich.table import Table
from signal_luck import STEP_S, TRUTH, TRUTH_SEED, TrueFields

from cyclekit.config.sequences import TaskSequence
from cyclekit.estimate.cycle.walk import roll_all, simulate
from cyclekit.estimate.operator.tracks import LoggedTrack, OperatorTracks, _continued, _instants
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.robot.program import lay_out
from cyclekit.estimate.robot.safety import Dynamics
from cyclekit_sim.choices import FRESH, LOGGED, OPERATOR, draw_places, operator_legs, stream
from cyclekit_sim.fields import on_of
from cyclekit_sim.scenes import BUILT_IN
from cyclekit_sim.walking import WalkedTrack

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.estimate.robot.program import Program

SCENE, PER_SESSION, SPAN, ORDERS = "pick-and-package", 60, 3200, 3
SESSION = PER_SESSION * 1900
"""Samples of the course of one session; SPAN: of one cycle, at most."""
RESPONSE = Dynamics(BY_SIGNALS.latency_s, BY_SIGNALS.ramp_down_per_s, BY_SIGNALS.ramp_up_per_s)


@dataclass(frozen=True)
class Session:
    """Course of the bits of one operator, and the executions in it: first sample, samples, task durations, s."""

    states: np.ndarray
    executions: list[tuple[int, int, list[tuple[str, float]]]]


def course(number: int, seed: int, length: int, *, fresh: bool) -> np.ndarray:
    """Return which fields are on, shape (length,): `fresh` at a random time, else from the start of a session."""
    cell = BUILT_IN[SCENE]
    rng = stream(seed, cell, OPERATOR, number, domain=FRESH if fresh else LOGGED)
    track = WalkedTrack(operator_legs(cell, rng), skip_s=float(rng.uniform(60.0, 120.0)) if fresh else 0.0)
    return on_of(cell.fields, track.at(np.arange(length) * STEP_S))


def people(states: np.ndarray) -> OperatorTracks:
    """Return courses, shape (K, T), as tracks."""
    names, state = tuple(map(str, range(len(states)))), states[..., None].astype(np.float64)
    logged = np.full(len(states), states.shape[1])
    kinds = TrueFields(SCENE).states
    return OperatorTracks(np.zeros((*states.shape, 3)), states, kinds, logged, names, STEP_S, state=state)


def means_s(programs: Sequence[Program], tracks: OperatorTracks) -> list[float]:
    """Return the mean cycle time of each program with these tracks, s."""
    cycles = roll_all(TrueFields(SCENE), programs, tracks, None, dynamics=RESPONSE)
    return [float(one.duration_s.mean()) for one in cycles]


def sessions_of(
    count: int, executions: int, seed: int, nominal: Mapping[str, NominalTask], dataset: Dataset
) -> list[Session]:
    """Return sessions of consecutive executions of random orders, all advanced together."""
    every = [Session(course(k, seed, SESSION, fresh=False), []) for k in range(count)]
    now_s = np.zeros(count)
    for number in range(executions):
        rngs = [np.random.default_rng([seed, k, number]) for k in range(count)]
        programs = [lay_out(known_order(rng, nominal), nominal, dataset) for rng in rngs]
        stands = [
            np.array([[max(rng.choice(task.standstill_s), 1e-3) for task in program.tasks]])
            for rng, program in zip(rngs, programs, strict=True)
        ]
        first = np.rint(now_s / STEP_S).astype(int)
        states = np.stack([one.states[at : at + SPAN] for one, at in zip(every, first, strict=True)])
        numbers = np.arange(count)
        done = simulate(TrueFields(SCENE), programs, numbers, numbers, stands, people(states), None, RESPONSE)
        for k, (one, program) in enumerate(zip(every, programs, strict=True)):
            parts = zip(program.tasks, stands[k][0], done.safety_s[k], strict=True)
            took = [(task.task, task.nominal_s + float(stand + lost)) for task, stand, lost in parts]
            one.executions.append((int(first[k]), int(np.ceil(done.duration_s[k] / STEP_S)), took))
            now_s[k] += done.duration_s[k] + rngs[k].uniform(2.0, 4.0)
    return every


def known_order(rng: np.random.Generator, nominal: Mapping[str, NominalTask]) -> TaskSequence:
    """Return a random order whose tasks are all known."""
    while True:
        sequence = TaskSequence("logged", tuple(draw_places(BUILT_IN[SCENE], rng)))
        if set(nominal).issuperset(sequence.tasks):
            return sequence


def of_set(sessions: Sequence[Session], wanted: Sequence[TaskSequence], programs: Sequence[Program]) -> dict[str, list]:
    """Return the mean cycle times by way, s, shape (orders,) each."""
    tracks, after, begins = {}, {}, []
    for s, session in enumerate(sessions):
        names = [f"{s} {number}" for number in range(len(session.executions))]
        after |= {name: names[k + 1 : k + 3] for k, name in enumerate(names)}
        for name, (first, samples, _) in zip(names, session.executions, strict=True):
            states = session.states[first : first + samples]
            where = np.column_stack([np.zeros((samples, 3)), states])
            times = first * STEP_S, (first + samples) * STEP_S
            tracks[name] = LoggedTrack(where, states, *times, seen=True, away=False, followed=True)
            begins.append((session, first))
    found, instants = {}, _instants([len(track.where) for track in tracks.values()])
    for way, some in (("one entry", instants[:1]), ("signals", instants)):
        starts = _continued(tracks, list(tracks), after, STEP_S, SPAN, some, states=True, free=True)
        found[way] = means_s(programs, people(starts.where[..., 3].astype(np.int64)))
    real = [one.states[first + at :][:SPAN] for at in instants for one, first in begins]
    found["as it went on"] = means_s(programs, people(np.array([one for one in real if len(one) == SPAN])))
    total, count = Counter[str](), Counter[str]()
    for task, took_s in (pair for one in sessions for *_, tasks in one.executions for pair in tasks):
        total[task] += took_s
        count[task] += 1
    found["history"] = [sum(total[task] / count[task] for task in one.tasks) for one in wanted]
    return found


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--sets", type=int, default=40)
    parser.add_argument("--executions", type=int, default=60, help="60 or fewer, or a multiple of 60")
    parser.add_argument("--seeds", type=int, nargs="+", default=[41])
    parser.add_argument("--work", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        dataset = dataset_of(asked.work or Path(folder), SCENE, 60, seed=21, options=BY_SIGNALS, kind="signals")
        nominal, wanted = nominal_tasks(dataset), unseen_sequences(dataset, SCENE, ORDERS)
    programs = [lay_out(one, nominal, dataset) for one in wanted]
    true = people(np.array([course(k, TRUTH_SEED, SPAN, fresh=True) for k in range(TRUTH)]))
    true_s = np.array([one.duration_s for one in roll_all(TrueFields(SCENE), programs, true, None, dynamics=RESPONSE)])
    chance = 100 * MEAN_OF_SIZE * np.mean(true_s.std(axis=1) / true_s.mean(axis=1)) / asked.executions**0.5
    apart_from = "less as it went on, %"
    table = Table(
        "seed", "way", "mean |error|, %", "bias, %", "deviation, %", apart_from, title=f"chance {chance:.2f} %"
    )
    each = -(-asked.executions // PER_SESSION)
    for seed in asked.seeds:
        size = min(asked.executions, PER_SESSION)
        every = sessions_of(asked.sets * each, size, seed, nominal, dataset)
        sets = [of_set(every[first : first + each], wanted, programs) for first in range(0, len(every), each)]
        for way in sets[0]:
            off = 100 * (np.array([one[way] for one in sets]) / true_s.mean(axis=1) - 1)
            apart = 100 * np.mean([np.divide(one[way], one["as it went on"]) - 1 for one in sets], axis=1)
            of_sets, root = off.mean(axis=1), len(sets) ** 0.5
            table.add_row(str(seed), way, f"{np.abs(off).mean():.2f}",
                          f"{off.mean():+.2f} +- {of_sets.std(ddof=1) / root:.2f}", f"{of_sets.std(ddof=1):.2f}",
                          f"{apart.mean():+.2f} +- {apart.std(ddof=1) / root:.2f}")  # fmt: skip
    OUT.print(table)


if __name__ == "__main__":
    main()
