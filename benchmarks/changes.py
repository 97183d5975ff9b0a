"""What-if of changes of `scanner-visits` against simulating them: thresholds, rectangle, both, recovery, hysteresis.

    python benchmarks/changes.py --executions 60 --fresh 600 --seeds 1 2 3 --work FOLDER

What a change saves is told against simulating it twice: beside the very operators of the logs, entered at the same
instants as the estimate enters them, and beside fresh ones. The first difference is what the method is off, the second
is the luck of which operators were logged. `as it is` writes the true safety function down; it saves nothing.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from any_length import HARD, SCENE, TRUE
from cells import JUDGED_SEED, logged, unseen_sequences
from rich.console import Console
from rich.table import Table

from cyclekit.estimate.tracks import PHASES, SHORTEST
from cyclekit.estimate.whatif import Change, what_if
from cyclekit.estimate.whatif.change import Zone
from cyclekit_sim.choices import FRESH, LOGGED, OPERATOR, operator_legs, stream
from cyclekit_sim.engine import run
from cyclekit_sim.motion import plan_moves
from cyclekit_sim.plan import prepare, process_times
from cyclekit_sim.program import compile_program
from cyclekit_sim.safety import DistanceStaircase, FloorZone, FloorZones, SlowestOf
from cyclekit_sim.scenes import BUILT_IN
from cyclekit_sim.walking import WalkedTrack

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit_sim import SimulationOptions
    from cyclekit_sim.scenes import Scene

OUT = Console(width=150)
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


@dataclasses.dataclass(frozen=True)
class Operators:
    """Whom a cell is simulated beside: the first operators of a seed, each entered at every instant."""

    seed: int
    domain: int
    count: int
    instants_s: tuple[float, ...] = (0.0,)


def simulated(
    wanted: Sequence[TaskSequence], scene: Scene, options: SimulationOptions, sides: Sequence[Operators]
) -> list[np.ndarray]:
    """Return per side the mean duration of each sequence, shape (sequences,), s; all are simulated at once."""
    programs, tracks = [], []
    pairs = {pair for each in wanted for pair in pairwise(each.places)}
    table = plan_moves(scene.places, pairs)
    for side in sides:
        for each in wanted:
            work = prepare(scene, side.seed, options, executions=side.count, places=each.places)
            pick_s, place_s = process_times(work)
            for after_s in side.instants_s:
                programs += [compile_program([one], table, pick_s=pick_s, place_s=place_s) for one in work.executions]
                tracks += [operator_of(scene, side, index, after_s) for index in range(side.count)]
    took_s = np.array(
        [trace.duration_s for trace in run(programs, tracks, table=table, safety=scene.safety, options=options)]
    )
    parts = np.split(took_s, np.cumsum([len(wanted) * side.count * len(side.instants_s) for side in sides])[:-1])
    return [part.reshape(len(wanted), -1).mean(axis=1) for part in parts]


def operator_of(scene: Scene, side: Operators, index: int, after_s: float) -> WalkedTrack:
    """Return the operator of an execution as `plan` draws him, so long after its beginning."""
    rng = stream(side.seed, scene, OPERATOR, index, domain=side.domain)
    at_any_time = scene.operator == "visit" or (scene.continuous and side.domain == FRESH)
    skip_s = float(rng.uniform(60.0, 120.0)) if at_any_time else 0.0
    return WalkedTrack(operator_legs(scene, rng), skip_s=skip_s + after_s)


def of_set(work: Path, asked: argparse.Namespace, seed: int) -> list[np.ndarray]:
    """Return per case what it saves, as part of the cycle: told, beside logged operators, fresh; (3, sequences)."""
    cell = logged(work, SCENE, asked.executions, seed=seed, options=HARD, kind="visits")
    wanted = unseen_sequences(cell.dataset, SCENE, asked.sequences, first=JUDGED_SEED)
    found = what_if(cell.model, cell.dataset, wanted, [case[0] for case in CASES])
    took_s = cell.dataset.executions["duration_s"].to_numpy()
    within_s = float(np.quantile(took_s, SHORTEST, method="lower"))
    instants_s = tuple(within_s * phase / PHASES for phase in range(PHASES))
    sides = Operators(seed, LOGGED, len(took_s), instants_s), Operators(JUDGED_SEED, FRESH, asked.fresh)
    now, rows = None, []
    for change, thresholds_m, zone, options in CASES:
        mine = {entry.before.name: entry for entry in found if entry.change == change.name}
        told = [mine[each.name].saves_s[0] / mine[each.name].before.expected_s for each in wanted]
        then = simulated(wanted, scene_of(thresholds_m, zone), options, sides)
        now = now or then  # the first case is the cell as it is
        rows.append(np.array([told, *(1 - after_s / before_s for after_s, before_s in zip(then, now, strict=True))]))
        OUT.print(change.name, rows[-1].round(4).tolist(), soft_wrap=True)
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
        told, beside, fresh = 100 * np.concatenate([rows[number] for rows in sets], axis=1)
        off = told - beside
        table.add_row(
            change.name, f"{told.mean():.2f}", f"{beside.mean():.2f}",
            f"{off.mean():+.2f} / {off[np.abs(off).argmax()]:+.2f}", f"{fresh.mean():.2f}",
            f"{np.mean(beside - fresh):+.2f}",
        )  # fmt: skip
    OUT.print(table)


if __name__ == "__main__":
    main()
