"""What-if of changes of `scanner-visits` against simulating them: thresholds, rectangle, both, recovery, hysteresis.

    python benchmarks/changes.py --executions 60 --fresh 600 --work FOLDER

`saves` is told against simulation as well: the operators of one set of logs move both sides alike, so it is known
better than the cycle times themselves. `as it is` writes the true safety function down; it saves nothing.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from any_length import HARD, SCENE, TRUE
from cells import JUDGED_SEED, durations_of, logged, unseen_sequences
from rich.console import Console
from rich.table import Table

from cyclekit.estimate.whatif import Change, what_if
from cyclekit.estimate.whatif.change import Zone
from cyclekit_sim.plan import prepare, run_alone
from cyclekit_sim.safety import DistanceStaircase, FloorZone, FloorZones, SlowestOf
from cyclekit_sim.scenes import BUILT_IN
from cyclekit_sim.truth import task_rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit_sim import SimulationOptions

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


def simulated(
    places: Sequence[str], thresholds_m: tuple[float, ...], zone: bool, options: SimulationOptions, count: int
) -> float:
    """Return the mean duration of fresh executions beside the same operators, s."""
    stairs = DistanceStaircase(LEVELS, thresholds_m)
    scanner = FloorZones(LEVELS, (FloorZone("scanner", X_M, Y_M, 1),))
    safety = SlowestOf(LEVELS, (stairs, scanner)) if zone else stairs
    scene = dataclasses.replace(BUILT_IN[SCENE], safety=safety)
    run = prepare(scene, JUDGED_SEED, options, executions=count, places=places)
    rows = pl.DataFrame([row for trace in run_alone(run, run.executions) for row in task_rows(trace, 0.0)])
    return float(durations_of(rows.select("execution", s=pl.col("end_s") - pl.col("start_s"))).mean())


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--executions", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sequences", type=int, default=3)
    parser.add_argument("--fresh", type=int, default=600)
    parser.add_argument("--work", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        work = asked.work or Path(folder)
        cell = logged(work, SCENE, asked.executions, seed=asked.seed, options=HARD, kind="visits")
        wanted = unseen_sequences(cell.dataset, SCENE, asked.sequences, first=JUDGED_SEED)
        found = what_if(cell.model, cell.dataset, wanted, [case[0] for case in CASES])
        now = {each.name: simulated(each.places, *CASES[0][1:], asked.fresh) for each in wanted}
        table = Table("change", "error %", "saves s", "true s")
        for change, *cell_of in CASES:
            mine = [entry for entry in found if entry.change == change.name]
            true = [simulated(entry.before.places, *cell_of, asked.fresh) for entry in mine]
            off = [100 * (entry.after.expected_s / s - 1) for entry, s in zip(mine, true, strict=True)]
            saved = [now[entry.before.name] - s for entry, s in zip(mine, true, strict=True)]
            told = [entry.saves_s[0] for entry in mine]
            table.add_row(change.name, f"{np.mean(off):+.2f}", f"{np.mean(told):+.2f}", f"{np.mean(saved):+.2f}")
        Console(width=150).print(table)


if __name__ == "__main__":
    main()
