"""Compares the response of the safety system read from logs with the true one, and cycle times that use it.

Each cell is simulated with a recovery (ramp up) of 5, 10, 25, 100 or 500 %/s, braking (ramp down) at 100 %/s and a
reaction time of 0, 0.1 or 0.3 s; the logs do not contain these. Levels are found in 10 Hz samples; ramps and reaction
time are read at the log's rate, reduced to `--rates` rows per second, or with `--percent` in whole percent. With
`--inferred` the scaling is not logged; everything is read by `ingest` from joint angles with the noise of a UR5.

    python benchmarks/response.py [--executions 30] [--scenes box-picking,...] [--recovery 0.1,...] [--rates 10,30]
    python benchmarks/response.py --inferred [--rates 0,30]
    python benchmarks/response.py --cycles --recovery 0.1 --latency 0.3 --executions 100

With `--cycles` the expected cycle times of sequences that were never logged are compared with fresh executions: by the
network, by `auto` (the rule of the same training, if there is one), and by history. `chance` is the mean error of the
mean of as many cycles as were logged. `luck`: the simulator runs the sequences with the operators of the logs. Its
error and coverage are those of a perfect method with these operators; `beyond luck` is the mean difference from it.
`--rule-alone` trains no network; `--recovery 0` has no response.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from cells import dataset_of, durations_of, fresh, logged, unseen_sequences

from cyclekit.dataset.cards import TrainingCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.rollout import estimate
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.labelling import staircase_of, with_commands
from cyclekit.learning.rules.of_dataset import rule_of
from cyclekit.learning.rules.safety import RuleSafety, predictor_of
from cyclekit.learning.windows import scaling_without_operator
from cyclekit.scaling.levels import find_staircase
from cyclekit.scaling.response import Changes, SafetyResponse, changes_of, read_response
from cyclekit_sim import SimulationOptions, simulate

if TYPE_CHECKING:
    from cyclekit.dataset.cards import DynamicsCard
    from cyclekit.estimate.robot.safety import SafetyModel

BRAKING = 1.0
GAP_S = 1.0
MEAN_OF_SIZE = (2 / np.pi) ** 0.5
"""Mean absolute value of a normal variable, standard deviations."""
XYZ = {who: [f"{who}_{axis}_m" for axis in "xyz"] for who in ("robot", "human")}


def options(recovery: float, latency_s: float) -> SimulationOptions:
    """Return the simulation options of one cell."""
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
    """Return the levels found in 10 Hz samples of the stretches."""
    values, run = [], []
    for t_s, scaling in (part for _, parts in found for part in parts):
        at = np.searchsorted(t_s, np.arange(t_s[0], t_s[-1], 0.1)).clip(max=len(t_s) - 1)
        values.append(scaling[at])
        run.append(np.full(len(at), len(run)))
    return find_staircase(np.concatenate(values), run=np.concatenate(run), rate_hz=10.0).levels


def read(logs: Path, rate_hz: float | None, *, percent: bool) -> tuple[np.ndarray, SafetyResponse]:
    """Return the levels and the response read from the logs."""
    found = sessions(logs, rate_hz, percent=percent)
    levels = levels_of(found)
    seen = []
    for samples, parts in found:
        changes = [change for t_s, scaling in parts for change in changes_of(t_s, scaling, levels.tolist())]
        robot, human = (samples.select(XYZ[who]).to_numpy().astype(float) for who in ("robot", "human"))
        seen.append(Changes.of(changes, samples["t_s"].to_numpy(), robot, human))
    return levels, read_response(seen)


def inferred(logs: Path, rate_hz: float | None) -> tuple[np.ndarray, DynamicsCard]:
    """Return the levels and the response that `ingest` reads from logs without a scaling."""
    with tempfile.TemporaryDirectory() as folder:
        thin = shutil.copytree(logs, Path(folder) / "logs")
        for file in thin.glob("session_*/robot.csv") if rate_hz else ():
            log = pl.read_csv(file, separator=" ")
            period_s = float(log["timestamp"].diff().median() or 0.0)  # type: ignore[arg-type]
            log.gather_every(max(1, round(1.0 / (rate_hz * period_s)))).write_csv(file, separator=" ")
        ingest([thin], Path(folder) / "dataset")
        dataset = Dataset.open(Path(folder) / "dataset")
        return np.array(dataset.levels), dataset.card.dynamics


def shown(value: float | None, digits: int, error: float | None = None) -> str:
    """Return a number of the table, with its standard error."""
    told = "" if error is None or error < 0.5 * 10.0**-digits else f" ± {error:.{digits}f}"
    return "not read" if value is None else f"{value:.{digits}f}{told}"


def responses(asked: argparse.Namespace, work: Path) -> None:
    """Print the response read in every cell."""
    print("| cell | rate | recovery | reaction time, s | levels | recovery found | braking found | reaction found, s |")
    print("|---|---|---|---|---|---|---|---|")
    for scene in asked.scenes:
        for recovery in asked.recovery:
            for latency_s in asked.latency:
                logs = work / f"{scene}-{recovery}-{BRAKING}-{latency_s}-{asked.executions}-{asked.seed}"
                given = options(recovery, latency_s)
                if asked.inferred:
                    given = replace(given, log_override=False, encoder_noise_rad=2e-5, delta_m=0.01)
                given = replace(given, robot_rate_hz=asked.log_rate)
                if not logs.is_dir():
                    simulate(scene, logs, executions=asked.executions, seed=asked.seed, options=given)
                response: SafetyResponse | DynamicsCard
                for rate_hz in asked.rates:
                    if asked.inferred:
                        levels, response = inferred(logs, rate_hz or None)
                    else:
                        levels, response = read(logs, rate_hz or None, percent=asked.percent)
                    print(
                        f"| {scene} | {rate_hz or asked.log_rate} | {recovery} | {latency_s} | {len(levels)} | "
                        f"{shown(response.ramp_up_per_s, 4, response.ramp_up_se_per_s)} | "
                        f"{shown(response.ramp_down_per_s, 3, response.ramp_down_se_per_s)} | "
                        f"{shown(response.latency_s, 2)} |",
                        flush=True,
                    )
                if asked.work is None:
                    shutil.rmtree(logs)


def models_of(
    asked: argparse.Namespace, work: Path, scene: str, given: SimulationOptions, kind: str, seed: int
) -> tuple[Dataset, dict[str, SafetyModel]]:
    """Return the dataset of a cell and its models: network and rule of one training, or the rule alone."""
    of_cell: dict[str, Any] = {"seed": seed, "options": given, "kind": kind}
    if not asked.rule_alone:
        cell = logged(work, scene, asked.executions, rules=True, **of_cell)
        return cell.dataset, {"network": cell.model, "auto": predictor_of(cell.model)}
    dataset = dataset_of(work, scene, asked.executions, **of_cell)
    frame = dataset.samples()
    levels = tuple(round(float(level), 6) for level in staircase_of(dataset, frame).levels)
    rule = rule_of(dataset, levels, keep_held_out=True).rule
    card = TrainingCard(scaling_without_operator=scaling_without_operator(with_commands(dataset, frame, levels)))
    return dataset, {} if rule is None else {"auto": RuleSafety(rule, card)}


def cycles(asked: argparse.Namespace, work: Path) -> None:
    """Print the errors of expected cycle times."""
    print(
        "| cell | executions | seed | recovery | reaction time, s | model | answers | mean error, % | bias, % "
        "| worst, % | 90 % coverage, % | luck: mean error, % | luck: bias, % | beyond luck, % | luck: coverage, % "
        "| chance, % |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|")
    for scene, recovery, latency_s, seed in product(asked.scenes, asked.recovery, asked.latency, asked.seeds):
        given = options(recovery, latency_s) if recovery else SimulationOptions()
        kind = f"{recovery}-{latency_s}" if recovery else "plain"
        dataset, models = models_of(asked, work, scene, given, kind, seed)
        wanted = unseen_sequences(dataset, scene, asked.sequences)
        took = {
            one.places: durations_of(fresh(work, scene, one.places, asked.fresh, kind=kind, options=given))
            for one in wanted
        }
        same = {
            one.places: durations_of(
                fresh(work, scene, one.places, asked.executions, kind=kind, options=given, logged_seed=seed)
            )
            for one in wanted
        }
        luck = {places: 100 * (each.mean() / took[places].mean() - 1) for places, each in same.items()}
        held = [
            holds_share(took[places], *np.quantile(each, (0.05, 0.95), method="weibull"))
            for places, each in same.items()
        ]
        of_luck = f"{np.abs(list(luck.values())).mean():.2f} | {np.mean(list(luck.values())):+.2f}"
        part = np.mean([each.std(ddof=1) / each.mean() for each in took.values()])
        chance = 100 * MEAN_OF_SIZE * part / asked.executions**0.5
        for name, model in {**models, "history": next(iter(models.values()))}.items():
            found = estimate(model, dataset, wanted, estimator="history" if name == "history" else None)
            errors = [100 * (one.expected_s / took[one.places].mean() - 1) for one in found]
            beyond = [error - luck[one.places] for error, one in zip(errors, found, strict=True)]
            inside = [holds_share(took[one.places], one.quantiles_s[0.05], one.quantiles_s[0.95]) for one in found]
            answers = model.rule.family if isinstance(model, RuleSafety) else "network"
            answers = "history" if name == "history" else answers
            print(
                f"| {scene} | {asked.executions} | {seed} | {recovery or 'none'} | {latency_s} | {name} | "
                f"{answers} | {np.abs(errors).mean():.2f} | {np.mean(errors):+.2f} | "
                f"{max(errors, key=abs):+.2f} | {100 * np.mean(inside):.1f} | {of_luck} | "
                f"{np.abs(beyond).mean():.2f} | {100 * np.mean(held):.1f} | {chance:.2f} |",
                flush=True,
            )


def holds_share(took_s: np.ndarray, low_s: float, high_s: float) -> float:
    """Return the share of durations (N,), s, in an interval."""
    return float(np.mean((took_s >= low_s) & (took_s <= high_s)))


def numbers(text: str) -> list[float]:
    """Return numbers separated by commas."""
    return [float(part) for part in text.split(",")]


def main() -> None:
    """Run the measurement."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument(
        "--scenes", type=lambda text: text.split(","), default=["box-picking", "laser-zones", "scanner-visits"]
    )
    parser.add_argument("--recovery", type=numbers, default=[0.05, 0.1, 0.25, 1.0, 5.0])
    parser.add_argument("--latency", type=numbers, default=[0.0, 0.1, 0.3])
    parser.add_argument("--rates", type=numbers, default=[0.0], help="rows per second; 0 = all of the log")
    parser.add_argument("--log-rate", type=int, default=125, choices=(125, 500), help="rows per second of the log")
    parser.add_argument("--inferred", action="store_true", help="the scaling is not logged")
    parser.add_argument("--percent", action="store_true", help="the scaling in whole percent")
    parser.add_argument("--executions", type=int, default=30)
    parser.add_argument("--fresh", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="seeds of the logs, with --cycles")
    parser.add_argument("--sequences", type=int, default=5, help="number of sequences, never logged, with --cycles")
    parser.add_argument("--cycles", action="store_true")
    parser.add_argument("--rule-alone", action="store_true", help="with --cycles: find the rule, train no network")
    parser.add_argument("--work", type=Path, help="folder for cells")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        (cycles if asked.cycles else responses)(asked, asked.work or Path(folder))


if __name__ == "__main__":
    main()
