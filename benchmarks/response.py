"""The response of the safety system read from logs, beside the true one; and the cycle times that rest on it.

Each cell is simulated with a recovery (rise) of 5, 10, 25, 100 or 500 % a second, braking at 100 % a second and a
reaction time of 0, 0.1 or 0.3 s. Nothing of it is told. Levels are found in 10 Hz samples; rates and reaction time are
read at the log's own rate, of which `--rates` keeps so many rows a second, or with `--percent` in whole percents.

    python benchmarks/response.py [--executions 30] [--scenes box-picking,...] [--recovery 0.1,...] [--rates 10,30]
    python benchmarks/response.py --cycles --recovery 0.1 --latency 0.3 --executions 100

With `--cycles` the expected cycle times of sequences that were never logged are compared with fresh executions.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import polars as pl
from cells import durations_of, fresh, logged, unseen_sequences

from cyclekit.estimate.rollout import estimate
from cyclekit.scaling.levels import find_staircase
from cyclekit.scaling.response import Changes, SafetyResponse, changes_of, read_response
from cyclekit_sim import SimulationOptions, simulate

BRAKING = 1.0
GAP_S = 1.0
XYZ = {who: [f"{who}_{axis}_m" for axis in "xyz"] for who in ("robot", "human")}


def options(recovery: float, latency_s: float) -> SimulationOptions:
    """Return the response of one cell."""
    return SimulationOptions(ramp_up_per_s=recovery, ramp_down_per_s=BRAKING, latency_s=latency_s)


def sessions(logs: Path, rate_hz: float | None, *, percent: bool) -> list[tuple[pl.DataFrame, list[tuple]]]:
    """Return samples of each session, and time and scaling of its unbroken stretches."""
    executions = pl.read_parquet(logs / "truth" / "executions.parquet").select("execution", "session")
    samples = pl.read_parquet(logs / "truth" / "samples.parquet").join(executions, on="execution")
    found = []
    for number, file in enumerate(sorted(logs.glob("session_*/robot.csv"))):
        log = pl.read_csv(file, separator=" ")
        t_s, scaling = log["timestamp"].to_numpy(), log["speed_scaling"].to_numpy()
        if rate_hz is not None:
            at = np.searchsorted(t_s, np.arange(t_s[0], t_s[-1], 1 / rate_hz)).clip(max=len(t_s) - 1)
            t_s, scaling = t_s[np.unique(at)], scaling[np.unique(at)]
        scaling = np.floor(100 * scaling + 1e-6) / 100 if percent else scaling
        cuts = np.flatnonzero(np.diff(t_s) > GAP_S) + 1
        parts = list(zip(np.split(t_s, cuts), np.split(scaling, cuts), strict=True))
        mine = samples.filter(pl.col("session").cast(pl.String).str.extract(r"(\d+)$").cast(pl.Int64) == number)
        found.append((mine.sort("t_s"), parts))
    return found


def levels_of(found: list[tuple[pl.DataFrame, list[tuple]]]) -> np.ndarray:
    """Return the levels that are found in samples of the stretches, ten a second."""
    values, run = [], []
    for t_s, scaling in (part for _, parts in found for part in parts):
        at = np.searchsorted(t_s, np.arange(t_s[0], t_s[-1], 0.1)).clip(max=len(t_s) - 1)
        values.append(scaling[at])
        run.append(np.full(len(at), len(run)))
    return find_staircase(np.concatenate(values), run=np.concatenate(run), rate_hz=10.0).levels


def read(logs: Path, rate_hz: float | None, *, percent: bool) -> tuple[np.ndarray, SafetyResponse]:
    """Return the levels and the response that the logs show."""
    found = sessions(logs, rate_hz, percent=percent)
    levels = levels_of(found)
    seen = []
    for samples, parts in found:
        changes = [change for t_s, scaling in parts for change in changes_of(t_s, scaling, levels.tolist())]
        robot, human = (samples.select(XYZ[who]).to_numpy().astype(float) for who in ("robot", "human"))
        seen.append(Changes.of(changes, samples["t_s"].to_numpy(), robot, human))
    return levels, read_response(seen)


def shown(value: float | None, digits: int) -> str:
    """Return a number of the table."""
    return "not read" if value is None else f"{value:.{digits}f}"


def responses(asked: argparse.Namespace, work: Path) -> None:
    """Print what is read of every cell."""
    print(
        "| cell | rate | recovery | reaction time, s | levels | recovery read | braking read | reaction time read, s |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for scene in asked.scenes:
        for recovery in asked.recovery:
            for latency_s in asked.latency:
                logs = work / f"{scene}-{recovery}-{BRAKING}-{latency_s}-{asked.executions}-{asked.seed}"
                if not logs.is_dir():
                    given = options(recovery, latency_s)
                    simulate(scene, logs, executions=asked.executions, seed=asked.seed, options=given)
                for rate_hz in asked.rates:
                    levels, response = read(logs, rate_hz or None, percent=asked.percent)
                    print(
                        f"| {scene} | {rate_hz or 'own'} | {recovery} | {latency_s} | {len(levels)} | "
                        f"{shown(response.ramp_up_per_s, 4)} | {shown(response.ramp_down_per_s, 3)} | "
                        f"{shown(response.latency_s, 2)} |",
                        flush=True,
                    )


def cycles(asked: argparse.Namespace, work: Path) -> None:
    """Print the errors of expected cycle times."""
    print("| cell | executions | recovery | reaction time, s | mean error, % | worst, % | in the 90 % intervals, % |")
    print("|---|---|---|---|---|---|---|")
    for scene in asked.scenes:
        for recovery in asked.recovery:
            for latency_s in asked.latency:
                given, kind = options(recovery, latency_s), f"{recovery}-{latency_s}"
                cell = logged(work, scene, asked.executions, seed=asked.seed, options=given, kind=kind)
                errors, inside = [], []
                for result in estimate(cell.model, cell.dataset, unseen_sequences(cell.dataset, scene, 5)):
                    rows = fresh(work, scene, result.places, asked.fresh, kind=kind, options=given)
                    took_s = durations_of(rows)
                    errors.append(100 * (result.expected_s / took_s.mean() - 1))
                    low, high = result.quantiles_s[0.05], result.quantiles_s[0.95]
                    inside.append(100 * float(((took_s >= low) & (took_s <= high)).mean()))
                worst = max(errors, key=abs)
                print(
                    f"| {scene} | {asked.executions} | {recovery} | {latency_s} | {np.abs(errors).mean():.2f} | "
                    f"{worst:+.2f} | {np.mean(inside):.0f} |",
                    flush=True,
                )


def numbers(text: str) -> list[float]:
    """Return numbers separated by commas."""
    return [float(part) for part in text.split(",")]


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument(
        "--scenes", type=lambda text: text.split(","), default=["box-picking", "laser-zones", "scanner-visits"]
    )
    parser.add_argument("--recovery", type=numbers, default=[0.05, 0.1, 0.25, 1.0, 5.0])
    parser.add_argument("--latency", type=numbers, default=[0.0, 0.1, 0.3])
    parser.add_argument("--rates", type=numbers, default=[0.0], help="rows a second; 0: all of the log")
    parser.add_argument("--percent", action="store_true", help="the scaling in whole percents")
    parser.add_argument("--executions", type=int, default=30)
    parser.add_argument("--fresh", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cycles", action="store_true")
    parser.add_argument("--work", type=Path, help="folder in which cells are kept")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        (cycles if asked.cycles else responses)(asked, asked.work or Path(folder))


if __name__ == "__main__":
    main()
