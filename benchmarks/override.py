"""Compares the inferred speed override, and those of rival estimators, with the simulator's true one.

    python benchmarks/override.py [--executions 40] [--rates 125,500] [--scenes box-picking,...]

Each scene is simulated with ramps (2.5/s), a reaction time (0.1 s) and the encoder noise of a real UR5, once with the
override in the log, which is the ground truth, and once without. The second log is ingested with a reference run
without operator, and again without one. The 10 Hz samples of moving robots are compared with the row of the first log
at the same time.

The rivals have more information than cyclekit: the true start and end of every motion, and the logged TCP velocity.
They divide it by that of the reference run at equal arc length (`raw`), take the median of the ratio over 0.2 s
(`smoothed`), fit it by total variation (`tv`; exact, by the taut string), or by change points (`pelt`; optimal
partitioning into piecewise constants).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import SCENES, SimulationOptions, simulate

SEED = 11
FLOOR_M_S = 0.02


def cell(folder: Path, scene: str, count: int, rate: int, *, logged: bool, alone: bool = False) -> Path:
    """Simulate a cell."""
    options = SimulationOptions(
        robot_rate_hz=rate, ramp_down_per_s=2.5, ramp_up_per_s=2.5, latency_s=0.1, encoder_noise_rad=2e-5,
        log_override=logged, with_operator=not alone,
    )  # fmt: skip
    return simulate(scene, folder, executions=count, seed=SEED + alone, options=options)


def told(logs: Path) -> dict[str, pl.DataFrame]:
    """Return the logged override by session."""
    found = {}
    for file in sorted(logs.glob("session_*/robot.csv")):
        log = pl.read_csv(file, separator=" ")
        found[file.parent.name] = log.with_columns(t_s=pl.col("timestamp") - log["timestamp"][0])
    return found


def errors(dataset: Dataset, truth: dict[str, pl.DataFrame]) -> tuple[np.ndarray, int]:
    """Return the errors at samples of moving robots with an inferred override, and the number of all such samples."""
    parts, count = [], 0
    samples = dataset.samples().filter("robot_moving")
    for name, log in truth.items():
        mine = samples.filter(pl.col("execution").str.starts_with(f"{name}.")).sort("t_s")
        both = mine.join_asof(
            log.select("t_s", true="speed_scaling"), on="t_s", strategy="nearest", tolerance=0.001
        ).filter(pl.col("true").is_not_null())
        count += both.height
        parts.append((both["scaling"] - both["true"]).drop_nulls().to_numpy())
    return np.concatenate(parts), count


def shown(name: str, found: np.ndarray, count: int, seconds: float | None = None) -> str:
    """Return one row of the table."""
    sizes = np.sort(np.abs(found))
    best = sizes[: int(0.95 * count)] if len(sizes) >= 0.95 * count else sizes
    last = "" if seconds is None else f"{seconds:.1f}"
    return (
        f"| {name} | {len(found) / count:.3f} | {np.abs(found).mean():.4f} | {(sizes < 0.05).mean():.4f} | "
        f"{best.mean():.4f} | {last} |"
    )


def legs(
    logs: Path, truth: dict[str, pl.DataFrame]
) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Return task, time, arc length, TCP speed and true scaling of every motion."""
    tasks = pl.read_parquet(logs / "truth" / "tasks.parquet")
    tasks = tasks.join(
        pl.read_parquet(logs / "truth" / "executions.parquet").select("execution", "session"), on="execution"
    )
    found = []
    for row in tasks.iter_rows(named=True):
        log = truth[row["session"]]
        end = row["start_s"] + row["nominal_s"] + row["safety_loss_s"]
        part = log.filter(pl.col("timestamp").is_between(row["start_s"], end))
        xyz = part.select("actual_TCP_pose_0", "actual_TCP_pose_1", "actual_TCP_pose_2").to_numpy()
        speed = np.linalg.norm(
            part.select("actual_TCP_speed_0", "actual_TCP_speed_1", "actual_TCP_speed_2").to_numpy(), axis=1
        )
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xyz, axis=0), axis=1))])
        found.append(
            (
                f"{row['start_place']}->{row['goal_place']}",
                part["t_s"].to_numpy(),
                arc,
                speed,
                part["speed_scaling"].to_numpy(),
            )
        )
    return found


def rivals(motions: list, reference: list, rate: int) -> dict[str, tuple[np.ndarray, int]]:
    """Return the errors of each rival at 10 Hz, and the number of samples."""
    at_full = {task: (arc / arc[-1], speed) for task, _, arc, speed, _ in reference}
    found: dict[str, list[np.ndarray]] = {"raw": [], "smoothed": [], "tv": [], "pelt": []}
    count, step = 0, rate // 10
    for task, _, arc, speed, true in motions:
        if task not in at_full or len(true) < 5:
            continue
        phase, full = at_full[task]
        v = np.interp(arc / max(arc[-1], 1e-9), phase, full)
        known = v > FLOOR_M_S
        ratio = np.clip(np.where(known, speed / np.maximum(v, 1e-9), 0.0), 0.0, 1.0)[known]
        count += len(true[::step])
        if not len(ratio):
            continue
        picked = np.flatnonzero(known) % step == 0
        width = max(3, rate // 5) | 1
        padded = np.pad(ratio, width // 2, mode="edge")
        smooth = np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1)
        for name, values in (("raw", ratio), ("smoothed", smooth), ("tv", tv(ratio, 0.2)), ("pelt", pelt(ratio, 0.02))):
            found[name].append((values - true[known])[picked])
    return {name: (np.concatenate(parts), count) for name, parts in found.items()}


def tv(y: np.ndarray, weight: float) -> np.ndarray:
    """Return argmin 1/2 |x - y|^2 + weight |Dx|_1: the taut string through the tube around the cumulated sums of y."""
    total = np.concatenate([[0.0], np.cumsum(y)])
    low, high = total - weight, total + weight
    low[0] = high[0] = total[0]
    low[-1] = high[-1] = total[-1]
    n, knots, at = len(total), [(0, total[0])], 0
    while at < n - 1:
        x0, y0 = knots[-1]
        top, bottom, top_at, bottom_at = np.inf, -np.inf, at, at
        for k in range(at + 1, n):
            up, down = (high[k] - y0) / (k - x0), (low[k] - y0) / (k - x0)
            if down > top:
                knots.append((top_at, high[top_at]))
                break
            if up < bottom:
                knots.append((bottom_at, low[bottom_at]))
                break
            if up <= top:
                top, top_at = up, k
            if down >= bottom:
                bottom, bottom_at = down, k
        else:
            knots.append((n - 1, total[-1]))
        at = knots[-1][0]
    where, value = np.array(knots).T
    return np.diff(np.interp(np.arange(n), where, value))


def pelt(y: np.ndarray, penalty: float) -> np.ndarray:
    """Return the piecewise constant least-squares fit with a penalty per piece (Killick et al. 2012)."""
    s1, s2 = np.concatenate([[0.0], np.cumsum(y)]), np.concatenate([[0.0], np.cumsum(y * y)])
    best, last = np.zeros(len(y) + 1), np.zeros(len(y) + 1, int)
    best[0], open_ = -penalty, np.array([0])
    for k in range(1, len(y) + 1):
        cost = best[open_] + s2[k] - s2[open_] - (s1[k] - s1[open_]) ** 2 / (k - open_)
        best[k], last[k] = cost.min() + penalty, open_[cost.argmin()]
        open_ = np.append(open_[cost <= best[k]], k)
    found, k = np.empty(len(y)), len(y)
    while k > 0:
        found[last[k] : k] = (s1[k] - s1[last[k]]) / (k - last[k])
        k = last[k]
    return found


def main() -> None:
    """Print one table per scene and rate."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("--executions", type=int, default=40)
    ask.add_argument("--rates", default="125,500")
    ask.add_argument("--reference", type=int, default=0, help="executions of the reference run; default: a quarter")
    ask.add_argument("--scenes", default=",".join(SCENES))
    given = ask.parse_args()
    for scene in given.scenes.split(","):
        for rate in map(int, given.rates.split(",")):
            with tempfile.TemporaryDirectory() as scratch:
                compare(Path(scratch), scene, given.executions, rate, given.reference or max(4, given.executions // 4))


def compare(folder: Path, scene: str, count: int, rate: int, reference: int) -> None:
    """Print the table of one scene at one rate; `reference`: number of executions of the reference run."""
    logged = cell(folder / "logged", scene, count, rate, logged=True)
    silent = cell(folder / "logs", scene, count, rate, logged=False)
    empty = cell(folder / "empty", scene, reference, rate, logged=False, alone=True)
    truth = told(logged)
    print(f"\n{scene}, {rate} Hz, {count} executions, {sum(log.height for log in truth.values())} rows\n")
    print(
        "| estimator | answered | mean error | within 0.05 | mean error of the best 95 % | ingest s |\n"
        "|---|---|---|---|---|---|"
    )
    began = time.perf_counter()
    dataset = Dataset.open(ingest([silent], folder / "alone").dataset)
    took = time.perf_counter() - began
    found = errors(dataset, truth)
    both = folder / "both"
    both.mkdir()
    for path in (*silent.glob("session_*"), silent / "cell.toml"):
        path.rename(both / path.name)
    (empty / "session_000").rename(both / "empty_cell")
    text = (both / "cell.toml").read_text(encoding="utf-8")
    (both / "cell.toml").write_text('reference = ["empty_cell/robot.csv"]\n' + text, encoding="utf-8")
    began = time.perf_counter()
    with_reference = Dataset.open(ingest([both], folder / "with").dataset)
    print(shown("cyclekit, reference run", *errors(with_reference, truth), time.perf_counter() - began))
    print(shown("cyclekit, none: fastest repetitions", *found, took))
    alone = cell(folder / "told", scene, reference, rate, logged=True, alone=True)
    for name, (error, samples) in rivals(legs(logged, truth), legs(alone, told(alone)), rate).items():
        print(shown(f"velocity ratio, {name}", error, samples), flush=True)


if __name__ == "__main__":
    main()
