"""Sampling error of the logged operators alone: errors of means with them, by the starting times on their tracks.

    python benchmarks/operator_luck.py --operators 1200 --executions 20 60 --work FOLDER

No logs are read and nothing is learned: the simulator's safety function of `scanner-visits` and its response are known
exactly, and so are the operators for the duration of their executions. For each set of operators, orders half as long,
as long and twice as long as those executions are simulated. `beginning`: each track from its start. `estimate`: all
logs joined into loops, with evenly spaced starting times, as in `estimate`. `itself`: each log joined to its own start,
with 8 starting times. Ground truth is the mean over all operators, with four starting times on tracks that continue.
Chance is the mean absolute error of a mean of as many cycles of the logged length as were logged.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from any_length import HARD, OUT, SCENE, orders, true_function
from cells import FRESH_SEED, dataset_of
from rich.table import Table

from cyclekit.estimate.cycle.walk import Rolled, roll_all
from cyclekit.estimate.operator.circles import start_tracks
from cyclekit.estimate.operator.continuation import Continuation, Stretch
from cyclekit.estimate.operator.tracks import OperatorTracks, entries_of
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.robot.program import lay_out
from cyclekit.estimate.robot.safety import Dynamics
from cyclekit.estimate.statistics.resample import interval_of_mean, resampled
from cyclekit_sim.choices import FRESH, OPERATOR, operator_legs, stream
from cyclekit_sim.scenes import BUILT_IN
from cyclekit_sim.walking import WalkedTrack

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.robot.program import Program

STEP_S, LENGTH, SPAN, LATER, TURNS = 0.1, 2200, 1600, (0, 200, 400, 600), 8
MEAN_OF_SIZE = (2 / np.pi) ** 0.5
SAFETY = true_function(SCENE)
RESPONSE = Dynamics(HARD.latency_s, HARD.ramp_down_per_s, HARD.ramp_up_per_s, HARD.hysteresis_m)


def operators(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return x_h, shape (count, LENGTH, 3), m, and the activities, shape (count, LENGTH); -1 = away or unknown."""
    scene, at_s = BUILT_IN[SCENE], np.arange(LENGTH) * STEP_S
    names = {name: number for number, name in enumerate(scene.stations)}
    xyz_m, doing = np.empty((count, LENGTH, 3)), np.full((count, LENGTH), -1)
    for k in range(count):
        rng = stream(FRESH_SEED, scene, OPERATOR, k, domain=FRESH)
        track = WalkedTrack(operator_legs(scene, rng), skip_s=float(rng.uniform(60.0, 120.0)))
        xyz_m[k] = track.at(at_s)
        for press in track.presses(at_s[-1]):
            doing[k, int(press.t_s / STEP_S) :] = names[press.goal]
    doing[np.isnan(xyz_m[..., 0])] = -1
    return xyz_m, doing


def rolled(
    programs: Sequence[Program], tracks: Sequence[Stretch], owner: Sequence[int], logged: np.ndarray
) -> list[Rolled]:
    """Return the cycles of programs with tracks of equal length; `owner`: their operators, `logged`: logged samples."""
    where, doing = (np.array(part) for part in zip(*((each.where, each.activity) for each in tracks), strict=True))
    names, kinds = tuple(f"{k:05}" for k in owner), tuple(BUILT_IN[SCENE].stations)
    people = OperatorTracks(where, doing, kinds, logged, names, STEP_S)
    return list(roll_all(SAFETY, programs, people, None, dynamics=RESPONSE))


def of_set(programs: Sequence[Program], logs: Sequence[Stretch]) -> dict[str, tuple[list[Rolled], np.ndarray]]:
    """Return by way of entering the cycles of programs with these operators, and the weights of bootstrap samples."""
    lengths, own = [len(log.where) for log in logs], list(range(len(logs)))
    found = {}
    where, doing = Continuation(logs, STEP_S).extend(logs, own, LENGTH - 1)
    tracks = [Stretch(*pair) for pair in zip(where, doing, strict=True)]
    found["beginning"] = rolled(programs, tracks, own, np.array(lengths)), resampled([f"{k:05}" for k in own], 0)
    entered = start_tracks(logs, STEP_S, entries=entries_of(len(logs)), length=LENGTH - 1)
    tracks = [Stretch(*pair) for pair in zip(entered.where, entered.activity, strict=True)]
    owner = entered.owner.tolist()
    found["estimate"] = rolled(programs, tracks, owner, entered.logged), resampled([f"{k:05}" for k in owner], 0)
    at = np.arange(LENGTH - 1)
    turned = [(at + turn * lengths[k] // TURNS) % lengths[k] for turn in range(TURNS) for k in own]
    tracks = [Stretch(logs[k].where[at], logs[k].activity[at]) for at, k in zip(turned, own * TURNS, strict=True)]
    cycles = rolled(programs, tracks, own * TURNS, np.full(len(tracks), LENGTH))
    found["itself"] = cycles, resampled([f"{k:05}" for k in own * TURNS], 0)
    return found


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--operators", type=int, default=1200)
    parser.add_argument("--executions", type=int, nargs="+", default=[20, 60])
    parser.add_argument("--work", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        dataset = dataset_of(asked.work or Path(folder), SCENE, 20, seed=1, options=HARD, kind="visits")
    nominal = nominal_tasks(dataset)
    wanted = orders(SCENE, set(dataset.tasks()["task"]), 2)
    programs = [lay_out(wanted[name][0], nominal, dataset) for name in wanted]
    xyz_m, doing = operators(asked.operators)
    everyone = range(asked.operators)
    spans = [
        rolled(programs, [Stretch(xyz_m[k, at : at + SPAN], doing[k, at : at + SPAN]) for k in everyone], everyone,
               np.full(asked.operators, SPAN))
        for at in LATER
    ]  # fmt: skip
    true_s = [np.mean([one[n].duration_s.mean() for one in spans]) for n in range(len(programs))]
    cycle_s = rolled([lay_out(wanted["same"][1], nominal, dataset)], [Stretch(xyz_m[k], doing[k]) for k in everyone],
                     everyone, np.full(asked.operators, LENGTH))[0].duration_s  # fmt: skip
    logs = [Stretch(xyz_m[k, :end], doing[k, :end]) for k, end in enumerate(np.ceil(cycle_s / STEP_S).astype(int))]
    spread = float(spans[0][1].duration_s.std() / true_s[1])
    table = Table("executions", "sets", "length", "start", "mean |error|, %", "deviation, %", "chance, %",
                  "CI coverage")  # fmt: skip
    for count in asked.executions:
        sets = [of_set(programs, logs[first : first + count]) for first in range(0, len(logs) - count + 1, count)]
        for number, name in enumerate(wanted):
            for way in sets[0]:
                cycles = [(one[way][0][number], one[way][1]) for one in sets]
                off = np.array([each.duration_s.mean() / true_s[number] - 1 for each, _ in cycles])
                bounds = [interval_of_mean(each.resampled_means(w), model_error=0.0, seed=0) for each, w in cycles]
                held = np.mean([low <= true_s[number] <= high for low, high in bounds])
                sizes = np.abs(off).mean(), off.std(ddof=1), MEAN_OF_SIZE * spread / count**0.5
                told = [f"{100 * each:.2f}" for each in sizes]
                table.add_row(str(count), str(len(sets)), name, way, *told, f"{held:.0%}")
    OUT.print(table)


if __name__ == "__main__":
    main()
