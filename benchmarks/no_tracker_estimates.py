"""Cycle times in cells without a tracker (robot's log alone, or signals of people), compared with a tracker.

A cell is simulated and ingested twice: with the tracker's log, and without it. Expected cycle times of sequences that
were never logged are compared with fresh executions. Also printed: history (sums of logged mean durations) and a Markov
chain of slow-downs from task to task.

    python benchmarks/no_tracker_estimates.py --scenes box-picking,scanner-visits --executions 60 --seeds 1 2
    python benchmarks/no_tracker_estimates.py --scenes scanner-fields,light-curtain --fresh 1000
    python benchmarks/no_tracker_estimates.py --scenes box-picking,pick-and-package --signals
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from cells import PLAIN, dataset_of, durations_of, fresh, logged, unseen_sequences
from order_rivals import markov_s

from cyclekit.api.given import model_of
from cyclekit.api.train import train_model
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.rollout import estimate
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.rules.safety import RuleSafety
from cyclekit_sim import SimulationOptions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.estimate.result import CycleEstimate

WITHOUT_TRACKER = ("scanner-fields", "light-curtain", "guard-door")
"""Scenes whose logs contain signals of people and no tracker."""
BY_SIGNALS = SimulationOptions(people="signals", latency_s=0.1, ramp_down_per_s=1.5, ramp_up_per_s=1.5)
"""Options of the other scenes with `--signals`."""
OF_PEOPLE = ("operator.csv", "events.csv", "truth")
MEAN_OF_SIZE = (2 / np.pi) ** 0.5


def robot_alone(cell: Path) -> Dataset:
    """Return the dataset of a cell from its robot's logs alone; made once."""
    if not (cell / "blind" / "dataset.json").is_file():
        logs = cell / "robot-logs"
        shutil.copytree(cell / "logs", logs, ignore=shutil.ignore_patterns(*OF_PEOPLE))
        (logs / "cell.toml").write_text(of_robot((logs / "cell.toml").read_text()))
        ingest([logs], cell / "blind")
        shutil.rmtree(logs)
    return Dataset.open(cell / "blind")


def of_robot(cell: str) -> str:
    """Return the text of a cell file with the robot's sources alone."""
    head, *sources = cell.split("[[sources]]")
    rest = sources[-1].partition("\n[places")
    robot = [f"[[sources]]{text.partition(chr(10) + '[places')[0]}" for text in sources if 'role = "robot"' in text]
    return "".join([head, *robot, *rest[1:]])


def row(name: str, found: Mapping[str, tuple[float, float, float]], took: Mapping[str, np.ndarray]) -> str:
    """Return the errors of expected cycle times and the coverage of their 90 % intervals, as one row."""
    errors = [100 * (found[one][0] / took[one].mean() - 1) for one in took]
    inside = [np.mean((took[one] >= found[one][1]) & (took[one] <= found[one][2])) for one in took]
    shown = "" if np.isnan([found[one][1] for one in took]).any() else f"{100 * np.mean(inside):.0f}"
    return f"{name} | {np.abs(errors).mean():.2f} | {np.mean(errors):+.2f} | {max(errors, key=abs):+.2f} | {shown}"


def of(found: list[CycleEstimate]) -> dict[str, tuple[float, float, float]]:
    """Return mean and 90 % interval of each sequence."""
    return {one.name: (one.expected_s, one.quantiles_s[0.05], one.quantiles_s[0.95]) for one in found}


def held(found: list[CycleEstimate], took: Mapping[str, np.ndarray]) -> str:
    """Return the number of 95 % intervals of the mean that contain the fresh mean."""
    inside = [one.expected_low_s <= took[one.name].mean() <= one.expected_high_s for one in found]
    return f"{sum(inside)} of {len(inside)}"


def compared(asked: argparse.Namespace, work: Path, scene: str, executions: int, seed: int) -> None:
    """Print the rows of one cell."""
    signals = scene in WITHOUT_TRACKER or asked.signals
    options, kind = (BY_SIGNALS, "signals") if asked.signals else (PLAIN, "plain")
    dataset = dataset_of(work, scene, executions, seed=seed, options=options, kind=kind)
    blind = dataset if signals else robot_alone(dataset.path.parent)
    wanted: list[TaskSequence] = unseen_sequences(blind, scene, asked.sequences)
    runs = {one.name: fresh(work, scene, one.places, asked.fresh, options=options, kind=kind) for one in wanted}
    took = {name: durations_of(run) for name, run in runs.items()}
    chance = 100 * MEAN_OF_SIZE * np.mean([x.std(ddof=1) / x.mean() for x in took.values()]) / executions**0.5
    spec = ModelSpec.of(epochs=asked.epochs)
    asked_of = model_of(train_model(blind, spec))
    told = "signals" if isinstance(asked_of, RuleSafety) else "signals, by the network"
    models = {told if signals else "robot log alone": (asked_of, blind)}
    if not signals and not asked.no_tracker:
        models["tracker"] = (model_of(logged(work, scene, executions, seed=seed, rules=True).model), dataset)
    cell = f"| {scene} | {executions} | {seed} |"
    for name, (model, data) in models.items():
        found = estimate(model, data, wanted)
        print(f"{cell} {row(name, of(found), took)} | {held(found, took)} | {chance:.2f} |", flush=True)
    found = estimate(model, blind, wanted, estimator="history")
    print(f"{cell} {row('history', of(found), took)} | {held(found, took)} | {chance:.2f} |", flush=True)
    chain = {one.name: (s, np.nan, np.nan) for one, s in zip(wanted, markov_s(blind, wanted), strict=True)}
    print(f"{cell} {row('Markov chain', chain, took)} | | {chance:.2f} |", flush=True)


def main() -> None:
    """Run the measurement."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=["box-picking", "scanner-visits"])
    parser.add_argument("--executions", type=int, nargs="+", default=[60])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--sequences", type=int, default=5, help="number of sequences, never logged")
    parser.add_argument("--fresh", type=int, default=500, help="fresh executions of each")
    parser.add_argument("--no-tracker", action="store_true", help="leave out the same cell with its tracker")
    parser.add_argument("--signals", action="store_true", help="bits of fields instead of the tracker")
    parser.add_argument("--epochs", type=int, help="epochs of the network; 1 is enough if a rule replaces it")
    parser.add_argument("--work", type=Path, help="folder for cells")
    asked = parser.parse_args()
    print("| cell | executions | seed | estimate | error, % | bias, % | worst, % | 90 % coverage, % "
          "| CI coverage | chance, % |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for scene in asked.scenes:
            for executions in asked.executions:
                for seed in asked.seeds:
                    compared(asked, asked.work or Path(folder), scene, executions, seed)


if __name__ == "__main__":
    main()
