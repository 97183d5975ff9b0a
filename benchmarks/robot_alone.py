"""Robot log alone against history in many sets of logs: parts of one long log, ingested once.

One log holds `--sets` times `--executions` executions, each part with a file of its own. Tracker, events and digital
inputs are removed, and of the robot's rows every fifth is kept (25 Hz). The model of an unseen operator is learned from
each part alone, and `--orders` orders that were never logged are estimated. Both the estimate and history (sum of the
logged mean durations of the same tasks) know the same operators, so their difference is hardly affected by the luck of
these; it is printed with its standard error over the sets. Reaction time, ramps and levels are those of the long log.

    python benchmarks/robot_alone.py --scenes scanner-fields --sets 20 --executions 60 --seed 701 --work FOLDER
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from cells import durations_of, fresh, unseen_sequences
from no_tracker_estimates import OF_PEOPLE, of_robot
from rich.console import Console
from rich.table import Table

from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.validation.history import TaskTimes
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.unseen.fit import learn_unseen
from cyclekit_sim import SimulationOptions, simulate

if TYPE_CHECKING:
    from cyclekit.config.sequences import TaskSequence

OUT = Console(width=190)
EVERY = 5
"""Of the rows of the robot's log at 125 Hz, every so many-th is kept."""
INPUTS = "actual_digital_input_bits"
HEAD = ("cell", "executions", "sets", "robot log alone", "history", "bias", "history, bias", "difference", "better in",
        "worst set", "history, worst", "90 % coverage", "sets below 85 %", "CI coverage")  # fmt: skip


def long_log(work: Path, scene: str, executions: int, sets: int, seed: int) -> Dataset:
    """Return the dataset of a robot's log without people, with one file for each set; made once."""
    folder = work / f"{scene}-{executions}-{sets}-{seed}-alone"
    if not (folder / "dataset" / "dataset.json").is_file():
        logs = folder / "logs"
        options = SimulationOptions(executions_per_session=executions)
        simulate(scene, logs, executions=sets * executions, seed=seed, options=options)
        for pattern in OF_PEOPLE:
            for path in [*logs.rglob(pattern)]:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        for file in logs.rglob("robot.csv"):
            _thin(file)
        (logs / "cell.toml").write_text(of_robot((logs / "cell.toml").read_text()))
        ingest([logs], folder / "dataset")
        shutil.rmtree(logs)
    return Dataset.open(folder / "dataset")


def _thin(file: Path) -> None:
    """Remove the digital inputs and most of the rows."""
    head, *rows = (line.split(" ") for line in file.read_text().splitlines())
    kept = [number for number, name in enumerate(head) if name != INPUTS]
    file.write_text("".join(" ".join(row[k] for k in kept) + "\n" for row in (head, *rows[::EVERY])))


def one_set(part: Dataset, wanted: list[TaskSequence], took: dict[str, np.ndarray]) -> np.ndarray:
    """Return rows of relative error, that of history, coverage, and whether the interval of the mean holds, (4, N)."""
    alone = {one.name: one for one in estimate(learn_unseen(part), part, wanted)}
    sums = {one.name: TaskTimes(part).sum_s(one.tasks) for one in wanted}
    rows = []
    for name, fresh_s in took.items():
        one, mean_s = alone[name], fresh_s.mean()
        inside = np.mean((fresh_s >= one.quantiles_s[0.05]) & (fresh_s <= one.quantiles_s[0.95]))
        held = one.expected_low_s <= mean_s <= one.expected_high_s
        rows.append((one.expected_s / mean_s - 1, sums[name] / mean_s - 1, inside, held))
    return np.array(rows).T


def main() -> None:
    """Run the measurement."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=["scanner-fields"])
    parser.add_argument("--executions", type=int, default=60)
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--seed", type=int, default=701)
    parser.add_argument("--orders", type=int, default=5, help="orders that were never logged")
    parser.add_argument("--fresh", type=int, default=1000, help="fresh executions of each order")
    parser.add_argument("--work", type=Path)
    asked = parser.parse_args()
    table = Table(*HEAD, title="mean errors, %")
    with tempfile.TemporaryDirectory() as folder:
        work = asked.work or Path(folder)
        for scene in asked.scenes:
            dataset = long_log(work, scene, asked.executions, asked.sets, asked.seed)
            wanted = unseen_sequences(dataset, scene, asked.orders)
            took = {one.name: durations_of(fresh(work, scene, one.places, asked.fresh, kind="plain")) for one in wanted}
            names = [one.execution for one in dataset.card.executions]
            cuts = range(0, len(names) - asked.executions + 1, asked.executions)
            parts = [dataset.only(tuple(names[first : first + asked.executions])) for first in cuts]
            every = {task for one in wanted for task in one.tasks}
            parts = [part for part in parts if every.issubset(part.tasks()["task"])]  # few logs may lack a task
            found = np.array([one_set(part, wanted, took) for part in parts])
            table.add_row(scene, str(asked.executions), str(len(parts)), *_told(found))
    OUT.print(table)


def _told(found: np.ndarray) -> list[str]:
    """Return the row of some sets, shape (sets, 4, orders)."""
    sizes = 100 * np.abs(found[:, :2]).mean(axis=2)
    apart, inside = sizes[:, 0] - sizes[:, 1], found[:, 2].mean(axis=1)
    error = apart.std(ddof=1) / len(apart) ** 0.5
    means, biases, worst = sizes.mean(axis=0), 100 * found[:, :2].mean(axis=(0, 2)), sizes.max(axis=0)
    return [
        *(f"{each:.2f}" for each in means),
        *(f"{each:+.2f}" for each in biases),
        f"{apart.mean():+.2f} ± {error:.2f}",
        f"{int((apart < 0).sum())} of {len(apart)}",
        *(f"{each:.2f}" for each in worst),
        f"{inside.mean():.1%}",
        f"{int((inside < 0.85).sum())}",
        f"{found[:, 3].mean():.1%}",
    ]


if __name__ == "__main__":
    main()
