"""Compares what-if estimates for `scanner-visits` with simulations: thresholds, rectangle, both, recovery, hysteresis.

    python benchmarks/changes.py --executions 60 --fresh 600 --seeds 1 2 3 --work FOLDER

The saved time of a change is compared with two simulations: with the same tracks of logged operators as the estimate,
and with fresh operators. The first difference is the error of the method, with its standard error over operators; the
second is the sampling error of the logged operators. `as it is` specifies the true safety function, which saves
nothing. The changes are made to the rule read from the logs.
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

from cyclekit.estimate.operator.tracks import operator_tracks
from cyclekit.estimate.whatif import Change, what_if
from cyclekit.estimate.whatif.change import Zone
from cyclekit.learning.rules.safety import predictor_of
from cyclekit_sim.choices import FRESH, OPERATOR, operator_legs, stream
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
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.estimate.whatif import WhatIf
    from cyclekit_sim import SimulationOptions
    from cyclekit_sim.scenes import Scene
    from cyclekit_sim.walking import Press, Track

OUT = Console(width=150)
LONG_S = 300.0
"""Duration of the operators' tracks, longer than any cycle, s."""
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
    """Operators of a simulation: the tracks of an estimate, or the first operators of a seed."""

    seed: int
    count: int
    tracks: OperatorTracks | None = None

    @property
    def entries(self) -> int:
        """Number of cycles, with different starting times, per operator."""
        return 1 if self.tracks is None else len(self.tracks.executions) // self.count


@dataclasses.dataclass(frozen=True)
class Followed:
    """Operator on a track of an estimate: x_h on a grid of time, shape (T, 3), m."""

    xyz_m: np.ndarray
    step_s: float

    def at(self, t_s: np.ndarray) -> np.ndarray:
        """Return positions (M, 3), m, at times (M,), s; NaN = no operator."""
        place = np.clip(t_s / self.step_s, 0.0, len(self.xyz_m) - 1.001)
        sample = place.astype(np.int64)
        here, after = self.xyz_m[sample], self.xyz_m[sample + 1]
        between = here + (after - here) * (place - sample)[:, None]
        return np.where(np.isnan(between), here, between)

    def presses(self, until_s: float) -> list[Press]:
        """Return an empty list: no button is pressed."""
        del until_s
        return []


def simulated(
    wanted: Sequence[TaskSequence], scene: Scene, options: SimulationOptions, sides: Sequence[Operators]
) -> list[np.ndarray]:
    """Return per side the mean duration of each sequence with each operator, shape (sequences, operators), s."""
    programs, tracks = [], []
    pairs = {pair for each in wanted for pair in pairwise(each.places)}
    table = plan_moves(scene.places, pairs)
    for side in sides:
        for each in wanted:
            work = prepare(scene, side.seed, options, executions=side.count, places=each.places)
            pick_s, place_s = process_times(work)
            for entry in range(side.entries):
                programs += [compile_program([one], table, pick_s=pick_s, place_s=place_s) for one in work.executions]
                tracks += [operator_of(scene, side, index, entry) for index in range(side.count)]
    took_s = np.array(
        [trace.duration_s for trace in run(programs, tracks, table=table, safety=scene.safety, options=options)]
    )
    parts = np.split(took_s, np.cumsum([len(wanted) * side.count * side.entries for side in sides])[:-1])
    shapes = [(len(wanted), side.entries, side.count) for side in sides]
    return [part.reshape(shape).mean(axis=1) for part, shape in zip(parts, shapes, strict=True)]


def operator_of(scene: Scene, side: Operators, index: int, entry: int) -> Track:
    """Return the operator of an execution from a starting time; a fresh one is drawn as by the simulator's `plan`."""
    if side.tracks is not None:
        return Followed(side.tracks.xyz_m[entry * side.count + index], side.tracks.step_s)
    rng = stream(side.seed, scene, OPERATOR, index, domain=FRESH)
    skip_s = float(rng.uniform(60.0, 120.0)) if scene.operator == "visit" or scene.continuous else 0.0
    return WalkedTrack(operator_legs(scene, rng), skip_s=skip_s)


def beside(dataset: Dataset, seed: int, fresh: int) -> tuple[Operators, Operators]:
    """Return the operators of an estimate from these logs, and `fresh` other ones."""
    tracks = operator_tracks(dataset, horizon_s=LONG_S)
    return Operators(seed, len(set(tracks.executions)), tracks), Operators(JUDGED_SEED, fresh)


def of_set(work: Path, asked: argparse.Namespace, seed: int) -> list[np.ndarray]:
    """Return per case the saved share of the cycle, shape (4, sequences).

    Rows: estimated, simulated with logged operators, simulated with fresh operators, and the standard error of the
    difference of the first two.
    """
    cell = logged(work, SCENE, asked.executions, seed=seed, options=HARD, kind="visits", rules=True, epochs=1)
    wanted = unseen_sequences(cell.dataset, SCENE, asked.sequences, first=JUDGED_SEED)
    model = predictor_of(cell.model)
    found = what_if(model, cell.dataset, wanted, [case[0] for case in CASES])
    sides = beside(cell.dataset, seed, asked.fresh)
    now, rows = None, []
    for change, thresholds_m, zone, options in CASES:
        mine = {entry.before.name: entry for entry in found if entry.change == change.name}
        told = np.array([_saved(mine[each.name], sides[0].count) for each in wanted])
        then = simulated(wanted, scene_of(thresholds_m, zone), options, sides)
        now = now or then  # the first case is the unchanged cell
        logs, fresh = (
            (before_s - after_s) / before_s.mean(axis=1, keepdims=True)
            for after_s, before_s in zip(then, now, strict=True)
        )
        error = (told - logs).std(axis=1, ddof=1) / sides[0].count ** 0.5
        rows.append(np.array([*(part.mean(axis=1) for part in (told, logs, fresh)), error]))
        OUT.print(change.name, rows[-1].round(4).tolist(), soft_wrap=True)
    return rows


def _saved(entry: WhatIf, operators: int) -> np.ndarray:
    """Return the estimated saved share of the cycle for each operator, shape (operators,)."""
    saved_s = np.array(entry.before.durations_s) - np.array(entry.after.durations_s)
    return np.asarray(saved_s.reshape(-1, operators).mean(axis=0) / entry.before.expected_s)


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
    table = Table(
        "change", "saved %", "logged operators %", "error: mean, worst", "+-", "fresh operators %", "difference"
    )
    for number, (change, *_) in enumerate(CASES):
        told, beside, fresh, error = 100 * np.concatenate([rows[number] for rows in sets], axis=1)
        off = told - beside
        table.add_row(
            change.name, f"{told.mean():.2f}", f"{beside.mean():.2f}",
            f"{off.mean():+.2f}, {off[np.abs(off).argmax()]:+.2f}", f"{error.mean():.2f}", f"{fresh.mean():.2f}",
            f"{np.mean(beside - fresh):+.2f}",
        )  # fmt: skip
    OUT.print(table)


if __name__ == "__main__":
    main()
