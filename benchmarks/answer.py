"""Compares estimates with fresh simulated executions: sequences, orders, zones, what-if, harder logs, speed.

    python benchmarks/answer.py sequences --scene box-picking --executions 45 --seeds 111 112 113
    python benchmarks/answer.py plan      --scene laser-zones --executions 200
    python benchmarks/answer.py zones
    python benchmarks/answer.py whatif
    python benchmarks/answer.py hard
    python benchmarks/answer.py dynamics
    python benchmarks/answer.py drift
    python benchmarks/answer.py speed

Cells and fresh executions are stored in --work and reused. Ground truth: `--fresh` executions of each of `--sequences`
sequences that were never logged.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from cells import (
    HARD,
    JUDGED_SEED,
    average_model,
    durations_of,
    fresh,
    logged,
    means_by_task,
    newer_logs,
    unseen_sequences,
)
from msgspec import structs
from order_rivals import greedy_by_average, markov_s, monte_carlo_by_average, synergy_order
from rich.console import Console
from rich.table import Table

from cyclekit.dataset.cards import DynamicsCard, TrainingCard
from cyclekit.estimate.cycle.transit import transit_table
from cyclekit.estimate.cycle.walk import roll_out
from cyclekit.estimate.finding import worst
from cyclekit.estimate.operator.tracks import operator_tracks
from cyclekit.estimate.plan import Jobs, plan
from cyclekit.estimate.plan.search import every_order, random_order, tasks_of
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.robot.program import lay_out
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.validation.check import check_rollout
from cyclekit.estimate.validation.logged import logged_durations, logged_sequences, with_own_tracks
from cyclekit.estimate.whatif import Change, what_if
from cyclekit.learning.evaluation.drift import drift
from cyclekit.learning.safety_function import read_zones
from cyclekit_sim import SimulationOptions
from cyclekit_sim.scenes import BUILT_IN

if TYPE_CHECKING:
    import polars as pl

    from cyclekit.estimate.result import CycleEstimate

OUT = Console(width=150)
TRUE_THRESHOLDS = {"box-picking": (1.2, 1.5, 1.9, 2.4), "pick-and-package": (0.6, 0.8, 1.2, 1.6)}


def sequences(asked: argparse.Namespace) -> None:
    """Print the errors of every estimator for sequences that were never logged, over logs of several seeds."""
    found = [_of_logs(asked, seed) for seed in asked.seeds]
    for name in found[0]:
        every = np.array([errors[name] for errors in found])  # (sets of logs, sequences), %
        biases = every.mean(axis=1)
        spread = biases.std(ddof=1) / len(biases) ** 0.5 if len(biases) > 1 else float("nan")
        OUT.print(f"{name}, {len(found)} sets of logs: mean |error| {np.abs(every).mean():.2f} %, bias "
                  f"{biases.mean():+.2f} % (standard error over the sets {spread:.2f}), "
                  f"worst {every.ravel()[np.abs(every).argmax()]:+.2f} %")  # fmt: skip


def _of_logs(asked: argparse.Namespace, seed: int) -> dict[str, np.ndarray]:
    """Print the results of one set of logs; return the errors of each estimator by sequence, %."""
    cell = logged(asked.work, asked.scene, asked.executions, seed=seed)
    wanted = unseen_sequences(cell.dataset, asked.scene, asked.sequences, first=JUDGED_SEED)
    rows = [fresh(asked.work, asked.scene, s.places, asked.fresh) for s in wanted]
    truth = [durations_of(part) for part in rows]
    means = np.array([part.mean() for part in truth])
    known = np.array([part.std() / len(part) ** 0.5 for part in truth]) / means
    cycle = float(np.mean([part.std() / part.mean() for part in truth]))
    OUT.print(f"{asked.scene}, {asked.executions} logged (seed {seed}), {len(wanted)} sequences, {asked.fresh} fresh "
              f"each; standard errors: of a fresh mean {100 * known.mean():.2f} %, of the mean of as many independent "
              f"cycles as were logged {100 * cycle / asked.executions**0.5:.2f} %")  # fmt: skip
    began = time.process_time()
    check = check_rollout(cell.model, cell.dataset)
    OUT.print(f"check: {time.process_time() - began:.1f} s cpu; own {100 * check.own_bias:+.3f} % +- "
              f"{100 * check.own_error:.3f}, crossed {100 * check.crossed_bias:+.2f} %, z {check.reacts_z:.1f}, "
              f"coverage {check.coverage}, held out {check.coverage_held_out}, {worst(check.findings)}")  # fmt: skip

    def by(estimator: str, **more: object) -> list[CycleEstimate]:
        model = average_model(asked.work, cell) if estimator == "average" else cell.model
        found = estimate(model, cell.dataset, wanted, estimator=estimator, **more)
        return sorted(found, key=lambda entry: [s.name for s in wanted].index(entry.name))

    began = time.process_time()
    rolled = by("rollout", check=check)
    OUT.print(f"{len(wanted)} sequences with {rolled[0].tracks} tracks: {time.process_time() - began:.1f} s cpu")
    found = {"rollout": np.array([entry.expected_s for entry in rolled])}
    for name in ("history", "nominal", *(["average"] if asked.average else [])):
        found[name] = np.array([entry.expected_s for entry in by(name)])
    found["Markov chain"] = np.array(markov_s(cell.dataset, wanted))
    errors = {name: 100 * (values / means - 1) for name, values in found.items()}
    table = Table("estimator", "mean |error| %", "bias %", "worst %")
    for name, error in errors.items():
        table.add_row(name, *(f"{x:+.2f}" for x in (np.abs(error).mean(), error.mean(), error[np.abs(error).argmax()])))
    OUT.print(table)
    _intervals(rolled, by("rollout", validate=False), truth, means)
    _tasks(rolled, rows)
    return errors


def _intervals(
    rolled: list[CycleEstimate], raw: list[CycleEstimate], truth: list[np.ndarray], means: np.ndarray
) -> None:
    rng = np.random.default_rng(0)
    for name, entries in (("corrected", rolled), ("uncorrected", raw)):
        inside = [
            np.mean((part >= entry.quantiles_s[0.05]) & (part <= entry.quantiles_s[0.95]))
            for entry, part in zip(entries, truth, strict=True)
        ]
        OUT.print(f"{name}: 90 % intervals of cycles cover {100 * np.mean(inside):.1f} % "
                  f"({100 * min(inside):.0f} to {100 * max(inside):.0f} by sequence)")  # fmt: skip
        for p in (0.05, 0.5, 0.95):
            wrong = [
                100 * (e.quantiles_s[p] / np.quantile(part, p) - 1) for e, part in zip(entries, truth, strict=True)
            ]
            drawn = [np.quantile(rng.choice(part, (200, len(part))), p, axis=1).std() / part.mean() for part in truth]
            OUT.print(f"    quantile {p}: mean |error| {np.abs(wrong).mean():.2f} %, mean {np.mean(wrong):+.2f}, "
                      f"worst {max(wrong, key=abs):+.2f} %; standard error of the truth "
                      f"{100 * np.mean(drawn):.2f} %")  # fmt: skip
    held = [entry.expected_low_s <= m <= entry.expected_high_s for entry, m in zip(rolled, means, strict=True)]
    OUT.print(f"95 % intervals of the mean hold in {sum(held)} of {len(held)}")


def _tasks(rolled: list[CycleEstimate], rows: list[pl.DataFrame]) -> None:
    """Print the errors of expected task durations, with the standard error of the fresh means."""
    errors, known = [], []
    for entry, part in zip(rolled, rows, strict=True):
        true, off = means_by_task(part)
        errors += (100 * (np.array([task.expected_s for task in entry.tasks]) / true - 1)).tolist()
        known += (100 * off / true).tolist()
    OUT.print(f"per task ({len(errors)} tasks): mean |error| {np.abs(errors).mean():.2f} %, "
              f"mean {np.mean(errors):+.2f}, worst {max(errors, key=abs):+.2f} %; "
              f"standard error of the truth {np.mean(known):.2f} %")  # fmt: skip


def orders(asked: argparse.Namespace) -> None:
    """Compare the planned order with all orders (if few) and with the rivals' orders, on fresh executions."""
    cell = logged(asked.work, asked.scene, asked.executions, seed=asked.seeds[0])
    slots = list(BUILT_IN[asked.scene].slots)[:: 2 if asked.half else 1]
    jobs = Jobs(tuple(slots), "home", "home", "conveyor")
    began = time.process_time()
    found = plan(cell.model, cell.dataset, jobs)
    OUT.print(f"{asked.scene}: {found.searched}, {found.tried} orders, {time.process_time() - began:.1f} s cpu")
    OUT.print(f"expected {found.expected_s:.2f}, {found.against} {found.against_s:.2f}, saves {found.saves_s}, "
              f"on unseen operators {found.saves_unseen_s:.2f}")  # fmt: skip
    few = len(slots) <= 7
    rng = np.random.default_rng(1)
    some = list(every_order(jobs)) if few else [random_order(jobs, rng) for _ in range(2000)]
    chosen = {"plan": found.order}
    if not asked.alone:
        average = average_model(asked.work, cell)
        for name, rule in (
            ("greedy by average net", greedy_by_average),
            ("Monte Carlo by average net", monte_carlo_by_average),
        ):
            began = time.process_time()
            chosen[name] = rule(average, cell.dataset, jobs)
            OUT.print(f"{name}: {time.process_time() - began:.1f} s cpu")
        chosen["pairwise synergies"] = synergy_order(cell.dataset, jobs, some)
    if few:
        screened = sorted((_mean_s(asked, jobs, order, asked.screen), order) for order in some)
        best = [(_mean_s(asked, jobs, order, asked.fresh), order) for _, order in screened[:6]]
        chosen["best of all"] = min(best)[1]
        means = [mean for mean, _ in screened]
        OUT.print(f"all {len(some)} orders, {asked.screen} fresh executions each with the same operators: "
                  f"{means[0]:.2f} to {means[-1]:.2f} s, mean {np.mean(means):.2f}; the best 6 again "
                  f"by {asked.fresh}")  # fmt: skip
    table = Table("order by", "fresh mean s", "+- 95 %", "order")
    for name, order in chosen.items():
        places = jobs.places(order)
        part = durations_of(fresh(asked.work, asked.scene, places, asked.fresh, paired=True))
        table.add_row(name, f"{part.mean():.2f}", f"{1.96 * part.std() / len(part) ** 0.5:.2f}", " ".join(order))
    OUT.print(table)


def _mean_s(asked: argparse.Namespace, jobs: Jobs, order: tuple[str, ...], executions: int) -> float:
    part = fresh(asked.work, asked.scene, jobs.places(order), executions, paired=True)
    return float(durations_of(part).mean())


def zones(asked: argparse.Namespace) -> None:
    """Print the thresholds read back, without and with tracker noise."""
    table = Table("scene", "executions", "delta m", "rule", "explained", "thresholds m (95 %)", "worst error m")
    for scene, executions, delta in asked.cells:
        options = SimulationOptions(delta_m=delta)
        kind, seed = "plain" if delta == 0 else "noise", asked.seeds[0]
        cell = logged(asked.work, scene, executions, seed=seed, options=options, kind=kind)
        found = read_zones(cell.model, cell.dataset)
        shown = ", ".join(f"{t.metres:.3f} ({t.low:.3f}-{t.high:.3f})" for t in found.thresholds)
        true = TRUE_THRESHOLDS.get(scene)
        wrong = (
            "" if true is None else f"{max(abs(t.metres - m) for t, m in zip(found.thresholds, true, strict=True)):.4f}"
        )
        explained = ", ".join(f"{name} {share:.1%}" for name, share in found.explained.items())
        table.add_row(scene, str(executions), f"{delta}", found.rule, explained, shown, wrong)
    OUT.print(table)


def whatif(asked: argparse.Namespace) -> None:
    """Compare a what-if (the staircase of pick-and-package on logs of box-picking) with a simulation of that cell."""
    cell = logged(asked.work, "box-picking", asked.executions, seed=asked.seeds[0])
    wanted = unseen_sequences(cell.dataset, "box-picking", asked.sequences, first=JUDGED_SEED)
    change = Change("small", levels=(0.0, 0.25, 0.5, 0.75, 1.0), thresholds_m=TRUE_THRESHOLDS["pick-and-package"])
    found = {entry.after.name: entry.after for entry in what_if(cell.model, cell.dataset, wanted, [change])}
    scene = BUILT_IN["box-picking"]
    BUILT_IN["box-picking"] = dataclasses.replace(scene, safety=BUILT_IN["pick-and-package"].safety)
    table = Table("sequence", "fresh mean s", "what-if s", "error %")
    errors = []
    for sequence in wanted:
        part = durations_of(fresh(asked.work, "box-picking", sequence.places, asked.fresh, kind="small"))
        entry = found[sequence.name]
        errors.append(100 * (entry.expected_s / part.mean() - 1))
        table.add_row(sequence.name, f"{part.mean():.2f}", f"{entry.expected_s:.2f}", f"{errors[-1]:+.2f}")
    BUILT_IN["box-picking"] = scene
    OUT.print(table)
    OUT.print(f"mean |error| {np.abs(errors).mean():.2f} %, worst {max(errors, key=abs):+.2f} %")


def hard(asked: argparse.Namespace) -> None:
    """Compare logs with noise, dropouts, no logged scaling and clock error with clean logs of the same executions."""
    truth, wanted = None, None
    for kind, options in (("plain", SimulationOptions()), ("hard", HARD)):
        cell = logged(asked.work, "box-picking", asked.executions, seed=asked.seeds[0], options=options, kind=kind)
        wanted = wanted or unseen_sequences(cell.dataset, "box-picking", asked.sequences, first=JUDGED_SEED)
        truth = truth or [
            float(durations_of(fresh(asked.work, "box-picking", s.places, asked.fresh)).mean()) for s in wanted
        ]
        check = check_rollout(cell.model, cell.dataset)
        for name, used in (("uncorrected", None), ("corrected", check)):
            rolled = estimate(cell.model, cell.dataset, wanted, validate=False, check=used)
            found = {e.name: e.expected_s for e in rolled}
            error = 100 * np.array([found[s.name] / m - 1 for s, m in zip(wanted, truth, strict=True)])
            OUT.print(f"{kind}, {name} (by {100 * (check.factor - 1):+.2f} %): mean |error| "
                      f"{np.abs(error).mean():.2f} %, bias {error.mean():+.2f} %, "
                      f"worst {error[np.abs(error).argmax()]:+.2f} %")  # fmt: skip


class TrueStaircase:
    """True safety function of box-picking, with its thresholds in the middle of the hysteresis."""

    problem, card = "now", TrainingCard()

    def __init__(self, hysteresis_m: float) -> None:
        self._thresholds = np.array(TRUE_THRESHOLDS["box-picking"]) + hysteresis_m / 2

    def predict(self, X: np.ndarray) -> np.ndarray:
        """Return the scaling, shape (N,), for rows x_r, x_h, shape (N, 6), m."""
        apart = np.linalg.norm(X[:, :3].astype(float) - X[:, 3:6], axis=1)
        return np.array([0.0, 0.25, 0.5, 0.75, 1.0])[np.searchsorted(self._thresholds, apart)]


def dynamics(asked: argparse.Namespace) -> None:
    """Print the error of a rollout with each execution's own operator, with and without the known response."""
    true = {"latency_s": 0.3, "ramp_down_per_s": 2.0, "ramp_up_per_s": 0.5, "hysteresis_m": 0.15}
    cell = logged(asked.work, "box-picking", 60, options=SimulationOptions(**true), kind="dyn")
    nominal = nominal_tasks(cell.dataset)
    executions = logged_sequences(cell.dataset, nominal)
    tracks = operator_tracks(cell.dataset, horizon_s=300.0)
    took = logged_durations(cell.dataset, executions)
    for name, model in (("network", cell.model), ("true function", TrueStaircase(true["hysteresis_m"]))):
        for told in (False, True):
            cell.dataset.card = structs.replace(
                cell.dataset.card, dynamics=DynamicsCard(**true) if told else DynamicsCard()
            )
            own_s = with_own_tracks(model, cell.dataset, executions, nominal, tracks)
            off = 100 * (own_s / took - 1)
            OUT.print(f"{name}, response {'known' if told else 'unknown'}: mean |error| {np.abs(off).mean():.2f} %, "
                      f"mean {off.mean():+.2f} % +- {1.96 * off.std() / len(off) ** 0.5:.2f}")  # fmt: skip


def drifts(asked: argparse.Namespace) -> None:
    """Print the detected drift for newer logs of the same cell, and of cells with a moved outer threshold."""
    cell = logged(asked.work, "box-picking", 45)
    scene = BUILT_IN["box-picking"]
    for metres in (2.4, 2.5, 2.7):
        safety = dataclasses.replace(scene.safety, thresholds_m=(1.2, 1.5, 1.9, metres))  # type: ignore[type-var]
        BUILT_IN["box-picking"] = dataclasses.replace(scene, safety=safety)
        found = drift(cell.model, cell.dataset, newer_logs(asked.work, "box-picking", f"{metres}"))
        first = found.safety[0]
        OUT.print(f"outer threshold {metres} m: safety changed {found.safety_changed}, habits {found.habits_changed}; "
                  f"mean |error| {first.before:.4f} -> {first.after:.4f} ({first.z:+.1f} standard errors)")  # fmt: skip
    BUILT_IN["box-picking"] = scene


def speed(asked: argparse.Namespace) -> None:
    """Print wall and CPU time for one sequence with 1000 tracks, and for very many sequences."""
    cell = logged(asked.work, "box-picking", asked.executions, seed=asked.seeds[0])
    nominal = nominal_tasks(cell.dataset)
    wanted = unseen_sequences(cell.dataset, "box-picking", 1, first=JUDGED_SEED)[0]
    program = lay_out(wanted, nominal, cell.dataset)
    tracks = operator_tracks(cell.dataset, horizon_s=2.5 * program.length_s)
    for count in (250, 500, 1000):
        rows = np.arange(count) % len(tracks.executions)
        many = dataclasses.replace(
            tracks, **{n: getattr(tracks, n)[rows] for n in ("xyz_m", "activity", "logged")},
            executions=tuple(f"{tracks.executions[k]} {i}" for i, k in enumerate(rows.tolist())),
        )  # fmt: skip
        _timed(f"1 sequence, {count} tracks", lambda many=many: roll_out(cell.model, program, many, None))
    table = _timed("table of arrivals", lambda: transit_table(cell.model, nominal, tracks))
    jobs = Jobs(BUILT_IN["box-picking"].slots, "home", "home", "conveyor")
    rng = np.random.default_rng(0)
    for count in (1000, 10_000):
        tasks = [tasks_of(jobs.places(random_order(jobs, rng))) for _ in range(count)]
        _timed(f"{count} sequences, {len(tracks.executions)} tracks", lambda tasks=tasks: table.durations(tasks))


def _timed(what: str, call):  # noqa: ANN001, ANN202
    wall, cpu = time.perf_counter(), time.process_time()
    found = call()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    OUT.print(f"{what}: {wall:.2f} s, {cpu:.2f} s cpu (load {os.getloadavg()[0]:.1f})")
    return found


def main() -> None:
    """Run one measurement, or a small version of each."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    runs = {"sequences": sequences, "plan": orders, "zones": zones, "whatif": whatif, "hard": hard}
    runs |= {"dynamics": dynamics, "drift": drifts, "speed": speed}
    parser.add_argument("what", nargs="?", choices=[*runs, "all"], default="all")
    parser.add_argument("--scene", default="box-picking")
    parser.add_argument("--executions", type=int, help="logged executions; default 200, or 60 for all measurements")
    parser.add_argument("--sequences", type=int, help="default 20, or 4 for all measurements")
    parser.add_argument("--fresh", type=int, help="fresh executions of each; default 500, or 60 for all")
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[101], help="seeds of the logs; several only for `sequences`"
    )
    parser.add_argument("--screen", type=int, default=25, help="fresh executions per order when all are compared")
    parser.add_argument(
        "--half", action="store_true", help="plan only every other slot, so that all orders can be tried"
    )
    parser.add_argument("--alone", action="store_true", help="plan without the rivals")
    parser.add_argument("--average", action="store_true", help="also train and use the average-scaling network")
    parser.add_argument("--work", type=Path, help="folder for cells and fresh executions; else a temporary one")
    asked = parser.parse_args()
    usual = (60, 4, 60) if asked.what == "all" else (200, 20, 500)
    for name, value in zip(("executions", "sequences", "fresh"), usual, strict=True):
        setattr(asked, name, getattr(asked, name) or value)
    asked.half = asked.half or asked.what == "all"
    asked.cells = [("box-picking", asked.executions, 0.0), ("box-picking", asked.executions, 0.05)]
    asked.cells += [("pick-and-package", 46, 0.0), ("laser-zones", asked.executions, 0.0)]
    with tempfile.TemporaryDirectory() as folder:
        asked.work = asked.work or Path(folder)
        for name, run in runs.items():
            if asked.what in (name, "all"):
                OUT.rule(name)
                run(asked)


if __name__ == "__main__":
    main()
