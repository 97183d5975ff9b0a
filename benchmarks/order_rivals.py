"""Rivals of the estimate and of the plan from the literature; used by `answer.py`.

markov   Markov chain of slow-downs from task to task (the idea of Pellegrinelli and Pedrocchi 2017)
greedy   the next task is the feasible one with the least predicted slow-down (Faroni et al., arXiv 2512.17560), by the
average-scaling network with the logged operators at the elapsed time
monte    random continuations scored by that network; the next task is the first one of the best (same paper)
synergy  one coefficient per pair of simultaneous robot and operator tasks, which stretches nominal durations
(arXiv 2503.07238); orders are compared with the logged operators' tasks
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.config.sequences import TaskSequence
from cyclekit.estimate.cycle.estimators import by_average
from cyclekit.estimate.operator.tracks import operator_tracks
from cyclekit.estimate.plan.search import tasks_of
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.robot.program import lay_out

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.estimate.plan import Jobs
    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.learning.networks.saved import TrainedModel

STATES = 4
_NOMINAL: dict[str, dict[str, NominalTask]] = {}


def nominal_of(dataset: Dataset) -> dict[str, NominalTask]:
    """Return the nominal tasks, computed once per dataset."""
    if str(dataset.path) not in _NOMINAL:
        _NOMINAL[str(dataset.path)] = nominal_tasks(dataset)
    return _NOMINAL[str(dataset.path)]


def markov_s(dataset: Dataset, sequences: Sequence[TaskSequence]) -> list[float]:
    """Return the expected duration of each sequence by a chain over slow-down states, s.

    States are the quartiles of the logged slow-downs (duration of the motion over nominal). Each task has the share of
    each state and its mean slow-down; transitions are counted over all pairs of consecutive tasks, weighted by the
    ratio of the next task's shares to the average ones.
    """
    tasks = dataset.tasks().drop_nulls(["nominal_s", "safety_loss_s"]).sort("execution", "index")
    slow = 1 + (tasks["safety_loss_s"] / tasks["nominal_s"].clip(0.05)).to_numpy()
    edges = np.quantile(slow, np.arange(1, STATES) / STATES)
    state = np.searchsorted(edges, slow)
    follows = (tasks["execution"] == tasks["execution"].shift()).fill_null(value=False).to_numpy()
    moves = np.ones((STATES, STATES))
    np.add.at(moves, (state[:-1][follows[1:]], state[1:][follows[1:]]), 1)
    moves /= moves.sum(axis=1, keepdims=True)
    overall = np.bincount(state, minlength=STATES) / len(state)
    named = tasks["task"].to_numpy()
    nominal = nominal_of(dataset)
    found = []
    for sequence in sequences:
        total, now = 0.0, None
        for task in sequence.tasks:
            mine = named == task
            own = (np.bincount(state[mine], minlength=STATES) + overall) / (mine.sum() + 1)
            chance = own if now is None else (now @ moves) * own / np.maximum(overall, 1e-12)
            now = chance / chance.sum()
            means = [_mean(slow, mine & (state == k), state == k) for k in range(STATES)]
            entry = nominal[task]
            total += entry.nominal_s * float(now @ np.array(means)) + entry.dwell_s + entry.wait_s
        found.append(total)
    return found


def _mean(values: np.ndarray, here: np.ndarray, everywhere: np.ndarray) -> float:
    """Return the mean of values (N,) `here`, else `everywhere`; 0 without any, as the state is never reached."""
    some = values[here] if here.any() else values[everywhere]
    return float(some.mean()) if len(some) else 0.0


def greedy_by_average(model: TrainedModel, dataset: Dataset, jobs: Jobs) -> tuple[str, ...]:
    """Return the order of the greedy rule: the next visit is that with the least slow-down over its tasks."""
    tracks, done, left = _tracks(dataset, jobs), (), list(jobs.visit)
    while left:
        chosen = min(jobs.next_of(left), key=lambda name: _slowdown(model, dataset, jobs, tracks, done, name))
        done = (*done, chosen)
        left.remove(chosen)
    return done


def monte_carlo_by_average(
    model: TrainedModel, dataset: Dataset, jobs: Jobs, *, draws: int = 10, seed: int = 0
) -> tuple[str, ...]:
    """Return the order of the Monte Carlo rule: the next visit is the first one of the best random continuation."""
    from cyclekit.estimate.plan.search import random_order

    rng = np.random.default_rng(seed)
    tracks, done, left = _tracks(dataset, jobs), (), list(jobs.visit)
    while left:
        rest = type(jobs)(tuple(left), jobs.start, jobs.end, jobs.via) if len(left) > 1 else None
        orders = [(*done, *(random_order(rest, rng) if rest else left)) for _ in range(draws if rest else 1)]
        best = min(orders, key=lambda order: _mean_s(model, dataset, jobs, tracks, order))
        done = (*done, best[len(done)])
        left.remove(best[len(done) - 1])
    return done


def synergy_order(dataset: Dataset, jobs: Jobs, orders: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Return the fastest order by pairwise coefficients."""
    samples = dataset.samples().drop_nulls(["robot_task", "human_task", "scaling"]).filter("robot_moving")
    pairs = samples.group_by("robot_task", "human_task").agg(pl.col("scaling").mean())
    stretch = {(r, h): 1 / max(s, 0.05) for r, h, s in pairs.iter_rows()}
    usual = {r: 1 / max(s, 0.05) for r, s in samples.group_by("robot_task").agg(pl.col("scaling").mean()).iter_rows()}
    nominal, tracks = nominal_of(dataset), _tracks(dataset, jobs)
    every = np.arange(len(tracks.executions))

    def takes(order: tuple[str, ...]) -> float:
        time = np.zeros(len(every))
        for name in tasks_of(jobs.places(order)):
            at = np.minimum((time / tracks.step_s).astype(int), tracks.activity.shape[1] - 1)
            doing = [tracks.activities[i] if i >= 0 else "" for i in tracks.activity[every, at].tolist()]
            factor = np.array([stretch.get((name, activity), usual.get(name, 1.0)) for activity in doing])
            task = nominal[name]
            time += task.nominal_s * factor + task.dwell_s + task.wait_s
        return float(time.mean())

    return min(orders, key=takes)


def _tracks(dataset: Dataset, jobs: Jobs) -> OperatorTracks:
    nominal = nominal_of(dataset)
    longest = max(task.nominal_s + task.dwell_s + task.wait_s for task in nominal.values())
    return operator_tracks(dataset, horizon_s=3 * longest * (2 * len(jobs.visit) + 2), goals=True)


def _slowdown(
    model: TrainedModel, dataset: Dataset, jobs: Jobs, tracks: OperatorTracks, done: tuple[str, ...], name: str
) -> float:
    """Return the predicted duration of the next visit over its nominal time, after the visits done."""
    nominal = nominal_of(dataset)
    before, after = ((*jobs.places(order)[: -1 if jobs.end else None],) for order in (done or (name,), (*done, name)))
    through = lay_out(TaskSequence("next", tuple(after)), nominal, dataset)
    rolled = by_average(model, through, tracks)
    count = len(tasks_of(after)) - (len(tasks_of(before)) if done else 0)
    motion = sum(task.nominal_s for task in through.tasks[-count:])
    return float(rolled.safety_s[:, -count:].sum(axis=1).mean()) / motion


def _mean_s(model: TrainedModel, dataset: Dataset, jobs: Jobs, tracks: OperatorTracks, order: tuple[str, ...]) -> float:
    program = lay_out(TaskSequence("order", jobs.places(order)), nominal_of(dataset), dataset)
    return float(by_average(model, program, tracks).duration_s.mean())
