"""Compares tasks and executions found in logs with the simulator's; CPU time per row for growing logs.

    python benchmarks/segmentation.py [--executions 1000] [--scenes box-picking,...] [--rates 125,500] [--no-outputs]

Each scene is simulated with ramps (2.5/s), a reaction time (0.1 s) and the encoder noise of a real UR5, in one long log
(`--per-log 100`: one log per hundred executions), with and without the override, and with dwells longer than any
protective stop (`pick` 20 s). With `--no-outputs` the log has neither the gripper's output nor the register, so that
only the motion can be used. A true and a found task match if they have the same start and goal and overlap in time. An
unmatched true task is lost, an unmatched found one is invented. Boundaries are departure and arrival.

The second table ingests the numbers of executions of box-picking in `--growth`, in one log each, without the override,
and prints the CPU time per row.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import SCENES, SimulationOptions, simulate

if TYPE_CHECKING:
    from collections.abc import Callable

SEED = 31
HALTS_S = 20.0


def logs_of(
    folder: Path,
    scene: str,
    count: int,
    rate: int,
    *,
    logged: bool,
    outputs: bool = True,
    dwell_s: float | None = None,
    per_log: int | None = None,
) -> Path:
    """Simulate a cell, with a number of executions per log or all in one."""
    options = SimulationOptions(
        robot_rate_hz=rate, ramp_down_per_s=2.5, ramp_up_per_s=2.5, latency_s=0.1, encoder_noise_rad=2e-5,
        log_override=logged, log_outputs=outputs, executions_per_session=per_log or count, pick_s=dwell_s,
    )  # fmt: skip
    return simulate(scene, folder, executions=count, seed=SEED, options=options)


def truth_of(logs: Path) -> pl.DataFrame:
    """Return the true tasks in the dataset's time, which starts at the log's first row."""
    executions = pl.read_parquet(logs / "truth" / "executions.parquet").select("execution", "session")
    tasks = pl.read_parquet(logs / "truth" / "tasks.parquet").join(executions, on="execution")
    begins = {
        file.parent.name: float(pl.read_csv(file, separator=" ", n_rows=1, columns=["timestamp"])["timestamp"][0])
        for file in logs.glob("session_*/robot.csv")
    }
    begin = pl.col("session").replace_strict(begins, return_dtype=pl.Float64)
    moving = pl.col("nominal_s") + pl.col("safety_loss_s")
    return tasks.select(
        "session",
        task=pl.format("{}->{}", "start_place", "goal_place"),
        start_s=pl.col("start_s") - begin,
        arrival_s=pl.col("start_s") - begin + moving,
    ).sort("session", "start_s")


def compare(truth: pl.DataFrame, found: pl.DataFrame) -> tuple[int, int, np.ndarray]:
    """Return the numbers of lost and invented tasks, and the boundary errors of the others, shape (2 N,), s."""
    ours = found.select(
        "task", session=pl.col("execution").str.split(".").list.first(), start="start_s", arrival="arrival_s"
    ).with_row_index("ours")  # fmt: skip
    pairs = ours.join_where(
        truth.with_row_index("theirs"),
        pl.col("session") == pl.col("session_right"),
        pl.col("task") == pl.col("task_right"),
        pl.col("start") < pl.col("arrival_s"),
        pl.col("arrival") > pl.col("start_s"),
    ).with_columns(common_s=pl.min_horizontal("arrival", "arrival_s") - pl.max_horizontal("start", "start_s"))
    best = pairs.sort("common_s", descending=True).unique("ours", keep="first", maintain_order=True)
    both = best.unique("theirs", keep="first", maintain_order=True)
    errors = [(both["start"] - both["start_s"]).to_numpy(), (both["arrival"] - both["arrival_s"]).to_numpy()]
    return truth.height - both.height, found.height - both.height, np.concatenate(errors)


def measured(logs: Path, out: Path) -> tuple[Dataset, int, float]:
    """Ingest; return the dataset, the number of the robot's rows and the CPU time, s."""
    began = time.process_time()
    dataset = Dataset.open(ingest([logs], out).dataset)
    return dataset, sum(entry.rows.get("robot") or 0 for entry in dataset.recordings), time.process_time() - began


def row_of(name: str, scene: str, count: int, rate: int, simulated: Callable[[Path, str, int, int], Path]) -> str:
    """Simulate, ingest and compare one case; return its row of the table."""
    with tempfile.TemporaryDirectory() as scratch:
        logs = simulated(Path(scratch) / "logs", scene, count, rate)
        dataset, rows, seconds = measured(logs, Path(scratch) / "dataset")
        truth, cards = truth_of(logs), dataset.executions
        lost, invented, errors = compare(truth, dataset.tasks())
        size = np.abs(errors)
        return (
            f"| {scene} | {rate} | {name} | {len(cards)} of {count} | {truth.height} | {lost} | {invented} | "
            f"{(size <= 0.1).mean():.4f} | {np.median(size):.3f} | {size.max(initial=0.0):.3f} | "
            f"{1e6 * seconds / rows:.1f} |"
        )


def main() -> None:
    """Print the tables."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("--executions", type=int, default=1000)
    ask.add_argument("--scenes", default=",".join(SCENES))
    ask.add_argument("--rates", default="125,500")
    ask.add_argument("--cases", default="logged,inferred,logged and long dwells,inferred and long dwells")
    ask.add_argument("--growth", default="10,100,1000", help="executions of the second table; empty = no such table")
    ask.add_argument("--per-log", type=int, help="executions per log; default: all in one")
    ask.add_argument("--no-outputs", action="store_true")
    given = ask.parse_args()
    print(
        "| scene | Hz | override | executions | tasks | lost | invented | in 0.1 s | median s | worst s | us/row |\n"
        "|---|---|---|---|---|---|---|---|---|---|---|"
    )
    for scene in given.scenes.split(","):
        for rate in map(int, given.rates.split(",")):
            for case in given.cases.split(","):
                count = given.executions if rate == 125 else max(10, given.executions // 10)
                simulated = partial(
                    logs_of,
                    logged=case.startswith("logged"),
                    outputs=not given.no_outputs,
                    dwell_s=HALTS_S if case.endswith("long dwells") else None,
                    per_log=given.per_log,
                )
                print(row_of(case, scene, count, rate, simulated), flush=True)
    if given.growth:
        print("\n| scene | executions in one log | rows | CPU us per row |\n|---|---|---|---|")
        for count in map(int, given.growth.split(",")):
            with tempfile.TemporaryDirectory() as scratch:
                logs = logs_of(Path(scratch) / "logs", "box-picking", count, 125, logged=False)
                _, rows, seconds = measured(logs, Path(scratch) / "dataset")
                print(f"| box-picking | {count} | {rows} | {1e6 * seconds / rows:.1f} |", flush=True)


if __name__ == "__main__":
    main()
