"""Compares estimates from few executions of an operator with the Cramer-Rao bound.

    python benchmarks/known_operator.py --scenes scanner-visits,scanner-fields --executions 20 45 60 200
    python benchmarks/known_operator.py --scenes scanner-fields --operators 8000 --sets 133 --seed 901

Only the operator is unknown: safety function and response are those of the simulator, and the operator's true states
are observed, with the age of the spell in which a log begins. The bound is the minimum standard deviation of an
unbiased estimate of the expected cycle time. It depends on which parameters of the operator are unknown:

`numbers`: only the mean time away and the share of operators who only walk by. `+ choices`: also the number of stations
per visit and the probability of each. `+ times`: also the distributions of times away and at stations, by hazards in
PARTS parts of each time. `+ order`: also the transition probabilities between stations, by the number of stations so
far.

The squared bound is g' I^-1 g / N, where I is the covariance of the scores of logged executions, and g the covariance
of the estimated cycle time and the score of its operator. The mean absolute error is 0.8 times the bound. `cycles of
the order`: the same for a mean of as many cycles of that order. `own cycles`: its measured error with the operators of
each set, that is, their luck. `estimate` and `history`: measured errors of cyclekit and of the sum of logged task
durations. `correlation`: of the errors of estimate and own cycles. Last, the coverage of the estimate's 95 % interval
of the mean (for the logged operators alone).
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import operator_luck as visits
import signal_luck as fields
from any_length import HARD, OUT, orders
from cells import PLAIN, dataset_of
from rich.table import Table

from cyclekit.config.sequences import TaskSequence
from cyclekit.estimate.operator.circles import start_tracks
from cyclekit.estimate.operator.continuation import Stretch
from cyclekit.estimate.operator.tracks import PHASES, entries_of
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.robot.program import lay_out
from cyclekit.estimate.statistics.resample import interval_of_mean, resampled
from cyclekit_sim import random_sequence
from cyclekit_sim.choices import FRESH, OPERATOR, operator_legs, stream
from cyclekit_sim.fields import on_of
from cyclekit_sim.scenes import BUILT_IN, Scene
from cyclekit_sim.walking import Leg, WalkedTrack

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.estimate.cycle.walk import Rolled
    from cyclekit.estimate.robot.program import Program

STEP_S, SPAN, LOGGED_ORDERS, PARTS, SEED, FIRST_ORDER = 0.1, 1700, 24, 6, 900, 10
ONWARDS = (2 / 3, 1 / 2)
"""Probabilities that the simulated operator goes to another station after the first and the second one."""
KNOWN = {
    "numbers": ("rate", "passes"),
    "+ choices": ("rate", "passes", "onwards", "chosen"),
    "+ times": ("hazard", "passes", "onwards", "chosen"),
    "+ order": ("hazard", "passes", "next"),
}


@dataclass(frozen=True)
class Spells:
    """Consecutive spells of an operator.

    Kinds ("" = away, else the station), whether the operator walks there, start and end, s since the start of the log.
    """

    kinds: tuple[str, ...]
    walks: tuple[bool, ...]
    begin_s: np.ndarray
    end_s: np.ndarray


def drawn(scene: Scene, count: int, seed: int = SEED) -> tuple[np.ndarray, np.ndarray, list[Spells]]:
    """Return x_h, shape (count, SPAN, 3), m, the index of the last station (-1 = away), and all spells."""
    at_s, names = np.arange(SPAN) * STEP_S, {name: n for n, name in enumerate(scene.stations)}
    xyz_m, doing, spells = np.empty((count, SPAN, 3)), np.full((count, SPAN), -1), []
    for k in range(count):
        rng = stream(seed, scene, OPERATOR, k, domain=FRESH)
        kept: list[Leg] = []
        skip_s = float(rng.uniform(60.0, 120.0))
        track = WalkedTrack(_kept(operator_legs(scene, rng), kept), skip_s=skip_s)
        xyz_m[k] = track.at(at_s)
        for press in track.presses(at_s[-1]):
            doing[k, int(press.t_s / STEP_S) :] = names[press.goal]
        spells.append(_spells(kept, skip_s))
    doing[np.isnan(xyz_m[..., 0])] = -1
    return xyz_m, doing, spells


def _kept(legs: Iterator[Leg], kept: list[Leg]) -> Iterator[Leg]:
    for leg in legs:
        kept.append(leg)
        yield leg


def _spells(legs: Sequence[Leg], skip_s: float) -> Spells:
    kinds, walks, name = [], [], ""
    for leg in legs:
        name = "" if np.isnan(leg.xyz_m[0, 0]) else leg.press.goal if leg.press else name
        kinds.append(name)
        walks.append(len(leg.t_s) > 2)
    end_s = np.cumsum([leg.t_s[-1] for leg in legs]) - skip_s
    return Spells(tuple(kinds), tuple(walks), np.concatenate([[-skip_s], end_s[:-1]]), end_s)


Score = defaultdict[tuple[str, ...], float]


def score_of(scene: Scene, one: Spells, from_s: float, until_s: float) -> Score:
    """Return the score (derivatives of the log-likelihood by parameter) of an operator between two times."""
    found: Score = defaultdict(float)
    names = [name for name in scene.stations if name not in ("door", "exit")]
    visit: list[str] = []
    for n, (kind, walks) in enumerate(zip(one.kinds, one.walks, strict=True)):
        begin_s, end_s = float(one.begin_s[n]), float(one.end_s[n])
        if begin_s >= until_s:
            break
        visit = [] if not kind else visit
        if not walks and end_s > from_s:
            ages_s = max(from_s - begin_s, 0.0), min(end_s, until_s) - begin_s
            _add_spell(found, scene, kind, ages_s, ended=end_s <= until_s)
        elif walks and begin_s > from_s:
            _add_choice(found, scene, kind, visit, names)
        visit += [kind] if walks and kind in names else []
    return found


def _add_spell(found: Score, scene: Scene, kind: str, ages_s: tuple[float, float], *, ended: bool) -> None:
    """Add a spell observed between two ages: by log-rates of its hazard in PARTS parts of equal probability."""
    low_s, high_s = scene.stations[kind].dwell_s if kind else (scene.away_s[0], sum(scene.away_s))
    if kind:
        share = [min(max((age - low_s) / (high_s - low_s), 0.0), 1.0 - 1e-9) for age in ages_s]
    else:
        share = [1.0 - float(np.exp(-max(age - low_s, 0.0) / (scene.away_s[1] - low_s))) for age in ages_s]
        found["rate",] += ended + float(np.log1p(-share[1]) - np.log1p(-share[0]))
    for part in range(PARTS):
        edges = part / PARTS, min((part + 1) / PARTS, 1.0 - 1e-9)
        first, last = (min(max(each, edges[0]), edges[1]) for each in share)
        here = ended and edges[0] <= share[1] < (part + 1) / PARTS
        found["hazard", kind, str(part)] += here + float(np.log1p(-last) - np.log1p(-first))


def _add_choice(found: Score, scene: Scene, kind: str, visit: list[str], names: list[str]) -> None:
    """Add the choice of the next station."""
    left = [name for name in names if name not in visit]
    on = ONWARDS[len(visit) - 1] if 1 <= len(visit) <= len(ONWARDS) else float(not visit)
    if not visit:
        if scene.passing:
            found["passes",] += (kind == "exit") - scene.passing
        if kind == "exit":
            return
    elif on:
        found["onwards", str(len(visit))] += (kind != "door") - on
    if on and kind != "door":
        for name in left:
            found["chosen", name] += (kind == name) - 1.0 / len(left)
    context = f"{len(visit)} {visit[-1] if visit else ''}"
    for name in left if on else []:
        found["next", context, name] += (kind == name) - on / len(left)


def bound(logged: Sequence[Score], cycles: Sequence[Score], took_s: np.ndarray, known: Sequence[str]) -> float:
    """Return the bound of the standard deviation of the mean of `took_s` for one logged execution, relative to it."""
    keys = sorted({key for one in (*logged, *cycles) for key in one if key[0] in known})
    seen, whole = (np.array([[one.get(key, 0.0) for key in keys] for one in some]) for some in (logged, cycles))
    slope = whole.T @ (took_s - took_s.mean()) / len(took_s)
    information = seen.T @ seen / len(seen)
    return float(slope @ np.linalg.pinv(information, rcond=1e-6) @ slope) ** 0.5 / float(took_s.mean())


class Cell:
    """A scene with known safety function and response."""

    def __init__(self, name: str, work: Path) -> None:
        """Open a scene; its nominal motions are those of a small dataset in a folder."""
        self.scene, self.name, self.by_fields = BUILT_IN[name], name, not BUILT_IN[name].tracked
        kind = {"options": PLAIN, "seed": 3} if self.by_fields else {"options": HARD, "kind": "visits"}
        self.dataset = dataset_of(work, name, 12 if self.by_fields else 20, **kind)
        self.nominal = nominal_tasks(self.dataset)
        self.asked = {length: some[0] for length, some in orders(name, set(self.nominal), 1).items()}
        self.programs = [lay_out(one, self.nominal, self.dataset) for one in self.asked.values()]

    def rolled(self, programs: Sequence[Program], logs: Sequence[Stretch]) -> list[Rolled]:
        """Return the cycles of programs with operators whose tracks have equal length."""
        if self.by_fields:
            return fields.rolled(self.name, programs, np.array([log.activity for log in logs]))
        every = range(len(logs))
        return visits.rolled(programs, logs, every, np.full(len(logs), len(logs[0].where)))

    def stretches(self, xyz_m: np.ndarray, doing: np.ndarray) -> list[Stretch]:
        """Return operators as cyclekit represents them."""
        if self.by_fields:
            doing = np.array([on_of(self.scene.fields, one) for one in xyz_m])
            xyz_m = np.zeros_like(xyz_m)
        return [Stretch(where, what) for where, what in zip(xyz_m, doing, strict=True)]

    def estimate(self, logs: Sequence[Stretch]) -> list[tuple[float, float, float]]:
        """Return cyclekit's mean of each order from these logs, and its 95 % interval, s."""
        if self.by_fields:
            states, owner, logged = fields.entered([log.activity for log in logs], PHASES)
            cycles = fields.rolled(self.name, self.programs, states, owner=owner, logged=logged)
        else:
            entered = start_tracks(logs, STEP_S, entries=entries_of(len(logs)), length=SPAN - 1)
            tracks = [Stretch(*pair) for pair in zip(entered.where, entered.activity, strict=True)]
            owner = entered.owner.tolist()
            cycles = visits.rolled(self.programs, tracks, owner, entered.logged)
        weights = resampled([f"{k:05}" for k in owner], 0)
        within = [interval_of_mean(one.resampled_means(weights), model_error=0.0, seed=0) for one in cycles]
        return [(float(one.duration_s.mean()), *pair) for one, pair in zip(cycles, within, strict=True)]


@dataclass(frozen=True)
class LoggedSets:
    """Logged executions: each operator until the end of the execution, the spells, and durations of tasks."""

    logs: list[Stretch]
    until_s: list[float]
    spells: list[Spells]
    took_s: list[Counter[str]]
    orders: list[TaskSequence]
    true_s: np.ndarray


def logged_sets(cell: Cell, count: int, seed: int = SEED) -> LoggedSets:
    """Return `count` executions of LOGGED_ORDERS orders in turn, and the judged orders with all these operators."""
    followed: list[TaskSequence] = []
    number = FIRST_ORDER
    while len(followed) < LOGGED_ORDERS:
        sequence = TaskSequence(str(number), tuple(random_sequence(cell.name, number)))
        number += 1
        followed += [sequence] if set(cell.nominal).issuperset(sequence.tasks) else []
    xyz_m, doing, spells = drawn(cell.scene, count, seed)
    every, which = cell.stretches(xyz_m, doing), np.arange(count) % LOGGED_ORDERS
    logs, until_s, took_s = list(every), [0.0] * count, [Counter[str]()] * count
    for order, sequence in enumerate(followed[:count]):  # fewer operators do not follow all orders
        mine = np.flatnonzero(which == order).tolist()
        cycles = cell.rolled([lay_out(sequence, cell.nominal, cell.dataset)], [every[k] for k in mine])[0]
        motion_s = np.array([cell.nominal[task].nominal_s for task in sequence.tasks])
        for row, k in enumerate(mine):
            until_s[k] = float(cycles.duration_s[row])
            end = int(np.ceil(until_s[k] / STEP_S))
            logs[k] = Stretch(every[k].where[:end], every[k].activity[:end])
            took_s[k] = Counter()
            for task, s in zip(sequence.tasks, motion_s + cycles.standstill_s[row] + cycles.safety_s[row], strict=True):
                took_s[k][task] += float(s)
    true_s = np.array([one.duration_s for one in cell.rolled(cell.programs, every)])
    return LoggedSets(logs, until_s, spells, took_s, [followed[n] for n in which], true_s)


def history_s(cell: Cell, sets: LoggedSets, some: range) -> np.ndarray:
    """Return the sums of logged mean durations of the judged orders, s."""
    total, count = Counter[str](), Counter[str]()
    for k in some:
        total.update(sets.took_s[k])
        count.update(sets.orders[k].tasks)
    return np.array([sum(total[task] / count[task] for task in one.tasks) for one in cell.asked.values()])


def bounds_of(cell: Cell, sets: LoggedSets) -> dict[str, list[float]]:
    """Return the bounds of each order for one execution by unknown parameters; the last is that of a mean of cycles."""
    logged = [score_of(cell.scene, one, 0.0, until) for one, until in zip(sets.spells, sets.until_s, strict=True)]
    found: dict[str, list[float]] = {known: [] for known in (*KNOWN, "cycles of the order")}
    for took_s in sets.true_s:
        cycles = [score_of(cell.scene, one, -1e9, s) for one, s in zip(sets.spells, took_s.tolist(), strict=True)]
        for known, kinds in KNOWN.items():
            found[known].append(bound(logged, cycles, took_s, kinds))
        found["cycles of the order"].append(float(took_s.std() / took_s.mean()))
    return found


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=["scanner-visits", "scanner-fields"])
    parser.add_argument("--executions", type=int, nargs="+", default=[20, 45, 60, 200])
    parser.add_argument("--operators", type=int, default=8000)
    parser.add_argument("--sets", type=int, default=120, help="maximum number of sets")
    parser.add_argument("--seed", type=int, default=SEED, help="random seed of the operators")
    parser.add_argument("--work", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name in asked.scenes:
            cell = Cell(name, asked.work or Path(folder))
            sets = logged_sets(cell, asked.operators, asked.seed)
            bounds = bounds_of(cell, sets)
            measured = [text for name in ("own cycles", "estimate", "history") for text in (name, "+-", "bias")]
            columns = (*bounds, *measured, "correlation", "CI of the mean holds")
            table = Table("executions", "sets", "length", *columns, title=f"{name}: mean error, %")
            for size in asked.executions:
                add_rows(table, cell, sets, bounds, size, min(asked.sets, asked.operators // size))
            OUT.print(table)


def add_rows(table: Table, cell: Cell, sets: LoggedSets, bounds: dict[str, list[float]], size: int, count: int) -> None:
    """Add one row per length."""
    true_s = sets.true_s.mean(axis=1)
    parts = [range(first, first + size) for first in range(0, size * count, size)]
    found = np.array([cell.estimate([sets.logs[k] for k in some]) for some in parts]) / true_s[:, None]
    history = np.array([history_s(cell, sets, some) for some in parts]) / true_s
    own = np.array([sets.true_s[:, some].mean(axis=1) for some in map(list, parts)]) / true_s
    for number, length in enumerate(cell.asked):
        least = [f"{100 * fields.MEAN_OF_SIZE * one[number] / size**0.5:.2f}" for one in bounds.values()]
        mean, low, high = found[:, number].T
        told = [text for ratio in (own[:, number], mean, history[:, number]) for text in _sizes(ratio - 1)]
        told.append(f"{np.corrcoef(own[:, number], mean)[0, 1]:.2f}")
        held = f"{np.mean((low <= 1) & (high >= 1)):.1%}"
        table.add_row(str(size), str(count), length, *least, *told, held)


def _sizes(off: np.ndarray) -> list[str]:
    """Return mean absolute error, its standard error, and bias, %."""
    sizes = np.abs(off).mean(), np.abs(off).std(ddof=1) / len(off) ** 0.5, off.mean()
    return [f"{100 * each:.2f}" for each in sizes]


if __name__ == "__main__":
    main()
