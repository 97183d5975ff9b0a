"""Error and coverage for orders shorter than, as long as and longer than the logs, with an operator who comes and goes.

    python benchmarks/any_length.py --executions 60 200 --seeds 1 2 3 --work FOLDER

The scene is `scanner-visits`: four levels with hysteresis, a scanner's rectangle that limits the speed, ramps, latency,
a tracker that writes no rows without an operator, one file per execution, places at whole centimetres. `box-picking`
has the same response. In `bench-crew` four people with habits of their own begin anew with each execution, far or away,
and come near; the robot answers at once. The model is that of `train --model auto`: the rule read from the logs (the
network, which is not used, is trained for one epoch); with `--written` it is the simulator's safety function, so that
only the operators must be learned. The orders were never logged; they are half as long, as long, twice and three times
as long as the logged ones. Ground truth is the mean of `--fresh` executions each, with other random streams than the
logs.

Also printed: the uncorrected rollout, history, the Markov chain, and chance, the error of a mean of as many independent
cycles of the logged length as were logged, or of the order's own length if it is shorter: logs begin once each, and
short cycles scatter more. `true function` is the rollout with the simulator's safety function and the
same logged operators: the error that remains if only the operators must be learned. The coverage of intervals of the
mean allows for the standard error of the fresh mean.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from cells import FRESH_SEED, dataset_of, durations_of, fresh, logged
from order_rivals import markov_s
from rich.console import Console
from rich.table import Table

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import TrainingCard
from cyclekit.dataset.cards.rule import LimitCard, MetresCard, NearerCard, RectangleCard, RegionCard, RuleCard
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.validation.check import check_rollout
from cyclekit.estimate.validation.history import Combined
from cyclekit.learning.rules.safety import RuleSafety, predictor_of
from cyclekit.learning.rules.samples.distances import TO_TCP
from cyclekit_sim import SimulationOptions, random_sequence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.result import CycleEstimate

OUT = Console(width=220)
HARD = SimulationOptions(
    latency_s=0.08, hysteresis_m=0.1, ramp_down_per_s=2.0, ramp_up_per_s=0.8, executions_per_session=1,
    silent_when_empty=True, delta_m=0.005,
)  # fmt: skip
TRUE = dataclasses.replace(HARD, delta_m=0.0)
CREW = SimulationOptions(executions_per_session=1, delta_m=0.005)
LENGTHS = {"half": 0.5, "same": 1.0, "twice": 2.0, "thrice": 3.0}
SCENE = "scanner-visits"
STAIRS = {
    "bench-crew": ((0.0, 0.8), (0.3, 1.2), (0.6, 1.7)),
    SCENE: ((0.0, 0.8), (0.3, 1.2), (0.6, 1.7)),
    "box-picking": ((0.0, 1.2), (0.25, 1.5), (0.5, 1.9), (0.75, 2.4)),
}
SCANNER = {SCENE: (0.3, (0.9, 2.3), (-0.6, 1.1))}
"""The simulator's safety functions by scene: thresholds, m, by level (STAIRS); level and edges, m, of a rectangle."""


def true_function(scene: str) -> RuleSafety:
    """Return the simulator's own safety function as a rule."""
    limits = []
    for level, metres in STAIRS[scene]:
        near = NearerCard(distance=TO_TCP, metres=MetresCard(value=metres))
        capped, *edges = SCANNER.get(scene, (None,))
        sides = [tuple(MetresCard(value=edge) for edge in pair) for pair in edges]
        box = (RectangleCard(along=sides[0], across=sides[1]),) if level == capped else ()
        limits.append(LimitCard(scaling=level, within=RegionCard(nearer=(near,), rectangles=box)))
    levels = (*(level for level, _ in STAIRS[scene]), 1.0)
    rule = RuleCard(family="written", levels=levels, limits=tuple(limits), explained=1.0)
    return RuleSafety(rule, TrainingCard(rule=rule)).with_hysteresis(options_of(scene).hysteresis_m)


def options_of(scene: str) -> SimulationOptions:
    """Return the options of the logs of a scene."""
    return CREW if scene == "bench-crew" else dataclasses.replace(HARD, silent_when_empty=scene == SCENE)


def orders(scene: str, known: set[str], count: int) -> dict[str, list[TaskSequence]]:
    """Return `count` orders of each length whose tasks were all logged."""
    found: dict[str, list[TaskSequence]] = {name: [] for name in LENGTHS}
    seed = FRESH_SEED
    while any(len(some) < count for some in found.values()):
        one, two, three = (random_sequence(scene, seed + further) for further in range(3))
        seed += 2
        middle = (len(one) - 2) // 2
        twice = [*one[:-1], *two[1:]]
        of_length = {
            "half": [*one[: 1 + middle], one[-1]],
            "same": one,
            "twice": twice,
            "thrice": [*twice[:-1], *three[1:]],
        }
        for name, places in of_length.items():
            sequence = TaskSequence(f"{name} {len(found[name]) + 1}", tuple(places))
            if len(found[name]) < count and known.issuperset(sequence.tasks):
                found[name].append(sequence)
    return found


@dataclasses.dataclass(frozen=True)
class Row:
    """Results of one order with one set of logs: relative errors of the expected cycle time, and coverage."""

    error: float
    rollout: float
    history: float
    markov: float
    known: float
    share: float
    held: bool
    inside: float
    below: float
    spread: float
    truth: float
    took_s: float


def row_of(found: CycleEstimate, others: Sequence[float], true_s: np.ndarray, took_s: float) -> Row:
    """Return the results of one order, given the durations of its fresh executions, shape (executions,), s.

    `others`: expected cycle times of history, the Markov chain and the true function, s.
    """
    mean, spread = float(true_s.mean()), float(true_s.std(ddof=1))
    both = found.combined or Combined(found.expected_s, others[0], 0.0)
    inside = (true_s >= found.quantiles_s[0.05]) & (true_s <= found.quantiles_s[0.95])
    return Row(
        *(value / mean - 1 for value in (found.expected_s, both.rollout_s, *others)),
        share=both.history_share,
        held=_holds(found, mean, spread / len(true_s) ** 0.5),
        inside=float(inside.mean()),
        below=float((true_s < found.quantiles_s[0.05]).mean()),
        spread=spread / mean,
        truth=spread / mean / len(true_s) ** 0.5,
        took_s=took_s,
    )


def _holds(found: CycleEstimate, true_s: float, error_s: float) -> bool:
    """Return whether the interval of the mean, widened by the standard error of the fresh mean, contains the latter."""
    expected_s, known_s = found.expected_s, 1.96 * error_s
    low_s = expected_s - np.hypot(expected_s - found.expected_low_s, known_s)
    high_s = expected_s + np.hypot(found.expected_high_s - expected_s, known_s)
    return bool(low_s <= true_s <= high_s)


def of_set(
    work: Path, scene: str, executions: int, seed: int, count: int, many: int, *, written: bool
) -> dict[str, list[Row]]:
    """Return the results of one set of logs by length of the order; print one line."""
    options = options_of(scene)
    true, how_logged = dataclasses.replace(options, delta_m=0.0), {"seed": seed, "options": options, "kind": "visits"}
    if written:
        dataset, model = dataset_of(work, scene, executions, **how_logged), true_function(scene)
    else:
        cell = logged(work, scene, executions, **how_logged, rules=True, epochs=1)
        dataset, model = cell.dataset, predictor_of(cell.model)
        if model is cell.model:
            raise SystemExit(f"{dataset.path}: no rule found")
    check = check_rollout(model, dataset)
    asked = orders(scene, set(dataset.tasks()["task"]), count)
    every = [sequence for some in asked.values() for sequence in some]
    began = time.perf_counter()
    answers = estimate(model, dataset, every, check=check, refused=lambda s, e: OUT.print(f"{s.name}: {e}"))
    took_s = (time.perf_counter() - began) / len(every)
    found = {entry.name: entry for entry in answers}
    known, history = (
        {entry.name: entry.expected_s for entry in estimate(other, dataset, every, **how)}
        for other, how in ((true_function(scene), {"validate": False}), (model, {"estimator": "history"}))
    )
    chain = dict(zip((s.name for s in every), markov_s(dataset, every), strict=True))
    rows = {
        length: [
            row_of(
                found[s.name],
                (history[s.name], chain[s.name], known[s.name]),
                durations_of(fresh(work, scene, s.places, many, kind="visits", options=true)),
                took_s,
            )
            for s in some
            if s.name in found
        ]
        for length, some in asked.items()
    }
    shown = ", ".join(
        f"{n} {100 * np.mean([r.error for r in rs]):+.2f} ({100 * np.mean([r.known for r in rs]):+.2f})"
        for n, rs in rows.items()
        if rs
    )
    off = f"backtest {100 * check.own_bias:+.2f} +- {100 * check.own_within:.2f} %"
    OUT.print(f"{executions} executions, seed {seed}: {off}, {shown}", soft_wrap=True)
    return rows


def size(errors: list[float]) -> str:
    """Return the mean absolute error, %."""
    return f"{100 * np.abs(errors).mean():.2f}"


def add_rows(table: Table, executions: int, sets: list[dict[str, list[Row]]]) -> None:
    """Add one row per length."""
    for name, length in LENGTHS.items():
        some = [row for rows in sets for row in rows[name]]
        spread = np.mean([row.spread for rows in sets for row in rows[name if length < 1.0 else "same"]])
        errors = [row.error for row in some]
        inside = [np.mean([row.inside for row in rows[name]]) for rows in sets if rows[name]]
        between = f"{100 * np.std(inside, ddof=1):.1f}" if len(inside) > 1 else "-"
        table.add_row(
            str(executions), name, str(len(sets)), size(errors), f"{100 * np.mean(errors):+.2f}",
            f"{100 * max(errors, key=abs):+.2f}", f"{np.mean([row.held for row in some]):.0%}",
            f"{np.mean(inside):.1%}", f"{np.mean([row.below for row in some]):.1%}", between,
            size([row.rollout for row in some]), size([row.known for row in some]),
            size([row.history for row in some]), size([row.markov for row in some]),
            f"{np.mean([row.share for row in some]):.0%}", f"{100 * 0.798 * spread / executions**0.5:.2f}",
            f"{100 * np.mean([row.truth for row in some]):.2f}", f"{np.mean([row.took_s for row in some]):.1f}",
        )  # fmt: skip


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--scene", choices=STAIRS, default=SCENE)
    parser.add_argument("--executions", type=int, nargs="+", default=[20, 60])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--orders", type=int, default=3)
    parser.add_argument("--fresh", type=int, default=1000)
    parser.add_argument("--written", action="store_true", help="use the simulator's safety function; train nothing")
    parser.add_argument("--work", type=Path)
    asked = parser.parse_args()
    table = Table(title=f"{asked.scene}: error of the expected cycle time, %")
    for column in ("executions", "length", "sets", "mean |error|", "bias", "worst", "CI coverage", "90 % coverage",
                   "below", "SD of coverage", "rollout", "true function", "history", "Markov chain",
                   "weight of history", "chance", "truth", "s per order"):  # fmt: skip
        table.add_column(column, justify="right")
    with tempfile.TemporaryDirectory() as folder:
        work = asked.work or Path(folder)
        for executions in asked.executions:
            some = (asked.scene, executions), (asked.orders, asked.fresh)
            sets = [of_set(work, *some[0], seed, *some[1], written=asked.written) for seed in asked.seeds]
            add_rows(table, executions, sets)
    OUT.print(table)


if __name__ == "__main__":
    main()
