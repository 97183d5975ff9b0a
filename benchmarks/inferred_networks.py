"""Effect of a missing override: networks and cycle times from inferred instead of logged scaling.

    python benchmarks/inferred_networks.py [--executions 100] [--scenes box-picking,...] [--seeds 3]

The same executions (ramps 2.5/s, reaction time 0.1 s, encoder noise of a real UR5) are logged with and without the
override. The same network is trained on both datasets, and evaluated on other executions with a logged override and on
expected cycle times of sequences that were never logged: means over the seeds, and the spread between seeds.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from cells import Logged, logged, unseen_sequences

from cyclekit.config.sequences import TaskSequence
from cyclekit.errors import EstimateError
from cyclekit.estimate.rollout import estimate
from cyclekit.learning.evaluation.evaluate import evaluate
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import train
from cyclekit_sim import SCENES, SimulationOptions

REAL = SimulationOptions(ramp_down_per_s=2.5, ramp_up_per_s=2.5, latency_s=0.1, encoder_noise_rad=2e-5)


def networks(cell: Logged, seeds: int) -> list[TrainedModel]:
    """Return one network per seed."""
    return [train(cell.dataset, ModelSpec.of(problem="now", seed=seed)) for seed in range(seeds)]


def errors(models: list[TrainedModel], judge: Logged) -> list[float]:
    """Return the one-step MSE of each network on the executions of `judge`."""
    return [evaluate(model, judge.dataset, boosting=False).metrics.mse_mean for model in models]


def expected_s(model: TrainedModel, cell: Logged, sequence: TaskSequence) -> float:
    """Return the expected cycle time of a sequence, s; NaN if it is refused."""
    try:
        return estimate(model, cell.dataset, [sequence])[0].expected_s
    except EstimateError:  # one of its tasks was never or too rarely observed at full speed
        return np.nan


def compare(work: Path, scene: str, count: int, seeds: int) -> str:
    """Return one row of the table."""
    told = logged(work, scene, count, options=REAL, kind="told")
    silent = logged(work, scene, count, options=replace(REAL, log_override=False), kind="silent")
    judge = logged(work, scene, 40, seed=5, options=REAL, kind="judge")
    both = [(cell, networks(cell, seeds)) for cell in (told, silent)]
    with_log, without = (errors(models, judge) for _, models in both)
    wanted = unseen_sequences(told.dataset, scene, 10)
    times = np.array([[[expected_s(m, cell, one) for one in wanted] for m in models] for cell, models in both])
    answered = np.isfinite(times).all(axis=(0, 1))
    means = times[:, :, answered].mean(axis=1)
    moved = 100 * (means[1] / means[0] - 1)
    by_seed = 100 * (times[0][:, answered].std(axis=0, ddof=1) / means[0]).mean() if seeds > 1 else np.nan
    change = 100 * (np.mean(without) / np.mean(with_log) - 1)
    spread = 100 * np.std(with_log) / np.mean(with_log)
    return (
        f"| {scene} | {count} | {1e4 * np.mean(with_log):.2f} | {1e4 * np.mean(without):.2f} | {change:+.1f} % | "
        f"{spread:.1f} % | {np.abs(moved).mean():.2f} % | {moved[np.abs(moved).argmax()]:+.2f} % | {by_seed:.2f} % | "
        f"{answered.sum()} of {len(wanted)} |"
    )


def main() -> None:
    """Print one row per scene."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("--executions", type=int, default=100)
    ask.add_argument("--scenes", default=",".join(SCENES))
    ask.add_argument("--seeds", type=int, default=3)
    given = ask.parse_args()
    print(
        "| scene | executions | MSE x1e4 | inferred | change | by seed | time change | worst | by seed | estimated |\n"
        "|---|---|---|---|---|---|---|---|---|---|"
    )
    for scene in given.scenes.split(","):
        with tempfile.TemporaryDirectory() as scratch:
            print(compare(Path(scratch), scene, given.executions, given.seeds), flush=True)


if __name__ == "__main__":
    main()
