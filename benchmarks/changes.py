"""What-if of changes of `scanner-visits` against simulating them: thresholds, rectangle, both, recovery, hysteresis.

    python benchmarks/changes.py --executions 60 --fresh 600 --seeds 1 2 3 --work FOLDER

What a change saves is told against simulating it twice: beside the very operators of the logs, entered at the same
instants as the estimate enters them, and beside fresh ones. The first difference is what the method is off, the second
is the luck of which operators were logged. `as it is` writes the true safety function down; it saves nothing.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from any_length import HARD, SCENE, TRUE
from cells import JUDGED_SEED, Logged, durations_of, logged, unseen_sequences
from rich.console import Console
from rich.table import Table

from cyclekit.estimate.tracks import PHASES, SHORTEST
from cyclekit.estimate.whatif import Change, what_if
from cyclekit.estimate.whatif.change import Zone
from cyclekit_sim.choices import LOGGED, OPERATOR, operator_legs, stream
from cyclekit_sim.engine import run
from cyclekit_sim.plan import prepare, process_times, run_alone
from cyclekit_sim.program import compile_program
from cyclekit_sim.safety import DistanceStaircase, FloorZone, FloorZones, SlowestOf
from cyclekit_sim.scenes import BUILT_IN
from cyclekit_sim.truth import task_rows
from cyclekit_sim.walking import WalkedTrack

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit_sim import SimulationOptions
    from cyclekit_sim.plan import Work
    from cyclekit_sim.scenes import Scene

LEVELS = (0.0, 0.3, 0.6, 1.0)
NOW_M, NEARER_M = (0.8, 1.2, 1.7), (0.8, 1.2, 1.45)
X_M, Y_M = (0.9, 2.3), (-0.6, 1.1)
RECTANGLE = (Zone(X_M, Y_M, 0.3),)
QUICKER = {"ramp_up_per_s": 2.0}
AT_ONCE = {"hysteresis_m": 0.0}
CASES: tuple[tuple[Change, tuple[float, ...], bool, SimulationOptions], ...] = (
    (Change("as it is", LEVELS, NOW_M, RECTANGLE), NOW_M, True, TRUE),
    (Change("outer threshold", LEVELS, NEARER_M, RECTANGLE), NEARER_M, True, TRUE),
    (Change("no rectangle", LEVELS, NOW_M), NOW_M, False, TRUE),
    (Change("both", LEVELS, NEARER_M), NEARER_M, False, TRUE),
    (Change("recovery", dynamics=QUICKER), NOW_M, True, dataclasses.replace(TRUE, **QUICKER)),  # type: ignore[arg-type]
    (Change("no hysteresis", dynamics=AT_ONCE), NOW_M, True, dataclasses.replace(TRUE, **AT_ONCE)),  # type: ignore[arg-type]
)


def scene_of(thresholds_m: tuple[float, ...], zone: bool) -> Scene:
    """Return the scene with this safety function."""
    stairs = DistanceStaircase(LEVELS, thresholds_m)
    scanner = FloorZones(LEVELS, (FloorZone("scanner", X_M, Y_M, 1),))
    return dataclasses.replace(BUILT_IN[SCENE], safety=SlowestOf(LEVELS, (stairs, scanner)) if zone else stairs)


@functools.cache
def simulated(
    places: Sequence[str], thresholds_m: tuple[float, ...], zone: bool, options: SimulationOptions, count: int
) -> float:
    """Return the mean duration of fresh executions beside the same operators, s."""
    work = prepare(scene_of(thresholds_m, zone), JUDGED_SEED, options, executions=count, places=places)
    rows = pl.DataFrame([row for trace in run_alone(work, work.executions) for row in task_rows(trace, 0.0)])
    return float(durations_of(rows.select("execution", s=pl.col("end_s") - pl.col("start_s"))).mean())


def beside_logged(
    cell: Logged,
    seed: int,
    places: Sequence[str],
    thresholds_m: tuple[float, ...],
    zone: bool,
    options: SimulationOptions,
) -> float:
    """Return the mean duration beside the operators of the logs, entered where the estimate enters them, s."""
    took_s = cell.dataset.executions["duration_s"].to_numpy()
    within_s = float(np.quantile(took_s, SHORTEST, method="lower"))
    work = prepare(scene_of(thresholds_m, zone), seed, options, executions=len(took_s), places=places)
    pick_s, place_s = process_times(work)
    programs = [compile_program([one], work.table, pick_s=pick_s, place_s=place_s) for one in work.executions]
    found = [
        trace.duration_s
        for phase in range(PHASES)
        for trace in run(
            programs, [logged_operator(work, one.index, within_s * phase / PHASES) for one in work.executions],
            table=work.table, safety=work.scene.safety, options=options,
        )
    ]  # fmt: skip
    return float(np.mean(found))


def logged_operator(work: Work, index: int, after_s: float) -> WalkedTrack:
    """Return the operator of a logged execution as `plan` draws him, so long after its beginning."""
    rng = stream(work.seed, work.scene, OPERATOR, index, domain=LOGGED)
    return WalkedTrack(operator_legs(work.scene, rng), skip_s=float(rng.uniform(60.0, 120.0)) + after_s)


def of_set(work: Path, asked: argparse.Namespace, seed: int) -> list[list[tuple[float, ...]]]:
    """Return per case and sequence what the change saves, part of the cycle: told, beside logged operators, fresh."""
    cell = logged(work, SCENE, asked.executions, seed=seed, options=HARD, kind="visits")
    wanted = unseen_sequences(cell.dataset, SCENE, asked.sequences, first=JUDGED_SEED)
    found = what_if(cell.model, cell.dataset, wanted, [case[0] for case in CASES])
    now = {each.name: simulated(each.places, *CASES[0][1:], asked.fresh) for each in wanted}
    beside = {each.name: beside_logged(cell, seed, each.places, *CASES[0][1:]) for each in wanted}
    rows = []
    for change, *cell_of in CASES:
        mine = [entry for entry in found if entry.change == change.name]
        rows.append([
            (
                entry.saves_s[0] / entry.before.expected_s,
                1 - beside_logged(cell, seed, entry.before.places, *cell_of) / beside[entry.before.name],
                1 - simulated(entry.before.places, *cell_of, asked.fresh) / now[entry.before.name],
            )
            for entry in mine
        ])  # fmt: skip
    return rows


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--executions", type=int, default=60)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--sequences", type=int, default=3)
    parser.add_argument("--fresh", type=int, default=600)
    parser.add_argument("--work", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sets = [of_set(asked.work or Path(folder), asked, seed) for seed in asked.seeds]
    table = Table("change", "saves %", "beside logged operators %", "method off, mean / worst", "fresh %", "sampling")
    for number, (change, *_) in enumerate(CASES):
        told, beside, fresh = 100 * np.array([row for rows in sets for row in rows[number]]).T
        off = told - beside
        table.add_row(
            change.name, f"{told.mean():.2f}", f"{beside.mean():.2f}",
            f"{off.mean():+.2f} / {off[np.abs(off).argmax()]:+.2f}", f"{fresh.mean():.2f}",
            f"{np.mean(beside - fresh):+.2f}",
        )  # fmt: skip
    Console(width=150).print(table)


if __name__ == "__main__":
    main()
