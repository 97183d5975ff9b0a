"""Visits of people that follow a task of the robot: they refill or empty a place soon after the robot has left it.

A rollout repeats the logged courses of the signals of people whatever the robot does. If people come because the robot
was at a place, an order with more such places per time meets more of them. The beginnings of visits are counted: those
within WINDOW_S after the robot left a place against all others, as Poisson processes with one rate each (Cox and Lewis,
The Statistical Analysis of Series of Events, 1966, chapter 9). Rates count only the time in which a visit can begin, so
a robot that people hold up does not look like one that calls them.

Few cells have such visits. They are used only where the likelihood gains far more than by chance and than with the
robot's times in another execution, and executions that were left out are predicted better. People who come at a time of
the cycle, wherever the robot was, follow another execution's robot as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Bools, Floats, Vector

WINDOW_S = 8.0
"""Time after the robot left a place in which visits may follow it, s."""
QUIET_S = 1.0
"""Minimum time without people before a visit, s: shorter ones are gaps in a visit."""
MIN_GAIN = 6.5
"""Minimum gain in log likelihood by a second rate."""
BEYOND = 1.0
"""Minimum gain in the log likelihood of executions left out, in standard errors."""
FOLDS = 5
"""Number of parts of the executions, each left out once."""
MIN_VISITS = 5
"""Minimum number of visits after the place, and of others."""
LAST = 0.5
"""Part of a visit that counts after the last place of an order: much of it lies between two executions."""
SHARE = 0.5
"""Weight beside the rollout, as that of `order_effect`."""


@dataclass(frozen=True)
class PeopleInExecution:
    """Visits in one logged execution.

    Attributes:
        places: Places the robot went to, in order.
        left_s: Time at which it left each, shape (N,), s.
        free_s: Duration of its tasks without safety loss, s.
        t_s: Times of T samples, s.
        people: Whether signals show people, shape (T,).
        lost_s: Time lost by each of the samples, shape (T,), s.
    """

    places: tuple[str, ...]
    left_s: Vector
    free_s: float
    t_s: Vector
    people: Bools
    lost_s: Vector

    def counted(self, place: str) -> float:
        """Return how often the robot left a place, see `departures`."""
        return departures(self.places, place)

    def starts(self) -> tuple[Bools, Vector, Vector]:
        """Return whether a visit begins at each sample, the time in which one may, s, and the losses until the next."""
        step_s = np.diff(self.t_s, append=self.t_s[-1:])
        last = np.maximum.accumulate(np.where(self.people, self.t_s, -np.inf))
        free = ~self.people & (self.t_s - last > QUIET_S)
        starts = np.zeros(len(self.people), dtype=np.bool_)
        starts[1:] = self.people[1:] & free[:-1]
        lost = np.zeros(len(starts))
        where = np.flatnonzero(starts)
        if len(where):
            lost[where] = np.add.reduceat(self.lost_s, where)
        return starts, step_s * free, lost

    def after(self, place: str, robot: PeopleInExecution | None = None) -> Bools:
        """Return whether a robot, its own unless given, left a place up to WINDOW_S before each sample, shape (T,)."""
        robot = robot or self
        left = np.array([when for name, when in zip(robot.places, robot.left_s, strict=True) if name == place])
        since = (self.t_s - self.t_s[0])[:, None] - (left - robot.t_s[0])
        return np.asarray(((since >= 0.0) & (since < WINDOW_S)).any(axis=1))


def departures(places: Sequence[str], place: str) -> float:
    """Return how often an order leaves a place; the last place before its end counts LAST.

    Args:
        places: Places the robot goes to, in order.
        place: The place.
    """
    last = len(places) > 1 and places[-2] == place
    return places[:-1].count(place) - (1.0 - LAST) * last


@dataclass(frozen=True)
class VisitEffect:
    """Losses by visits that follow a place, and by others.

    Attributes:
        place: The place.
        base: Loss by other visits, s per second of free time.
        each_s: Loss by visits that follow each departure from the place, s.
        logged: Departures per second of free time in the logs.
        error: Standard error of `each_s` relative to it.
    """

    place: str
    base: float
    each_s: float
    logged: float
    error: float

    def factor(self, places: Sequence[str], free_s: float) -> float:
        """Return the factor on the safety loss of an order, relative to visits at any time.

        Args:
            places: Places the robot goes to, in order.
            free_s: Duration of the order without safety loss, s.
        """
        return float(self._factors(places, free_s, np.ones(1))[0])

    def uncertain(self, places: Sequence[str], free_s: float, count: int) -> Vector:
        """Return `factor` for draws of `each_s`, the same draws for each order, shape (count,)."""
        draws = np.maximum(1.0 + self.error * np.random.default_rng(0).standard_normal(count), 0.0)
        return self._factors(places, free_s, draws)

    def _factors(self, places: Sequence[str], free_s: float, times: Vector) -> Vector:
        often = departures(places, self.place) / free_s
        each_s = self.each_s * times
        return np.asarray((self.base + each_s * often) / (self.base + each_s * self.logged))


def visit_effect(dataset: Dataset) -> VisitEffect | None:
    """Return the effect of the place that visits follow most clearly; None if the logs do not show one."""
    return visit_effect_of(_logged(dataset))


def visit_effect_of(logged: Sequence[PeopleInExecution]) -> VisitEffect | None:
    """Return the effect of the place that visits follow most clearly; None if the logs do not show one."""
    starts = [one.starts() for one in logged]
    turned = ([*logged[number:], *logged[:number]] for number in range(len(logged)))
    other_robots = [next((robot for robot in some if robot.places != some[0].places), some[0]) for some in turned]
    best, found = MIN_GAIN, None
    for place in dict.fromkeys(name for one in logged for name in one.places[:-1]):
        after = [one.after(place) for one in logged]
        counts = _counts(starts, after)
        mine, mine_s, others, others_s = counts.sum(axis=0)
        if min(mine, others) < MIN_VISITS or mine * others_s <= others * mine_s:
            continue
        another = _counts(starts, [one.after(place, robot) for one, robot in zip(logged, other_robots, strict=True)])
        gain = float(_gains(counts, counts).sum() - _gains(another, another).sum())
        if gain > best and _holds_elsewhere(counts):
            mine_lost = [lost[begun & here] for (begun, _, lost), here in zip(starts, after, strict=True)]
            others_lost = [lost[begun & ~here] for (begun, _, lost), here in zip(starts, after, strict=True)]
            effect = _effect(place, logged, counts, np.concatenate(mine_lost), np.concatenate(others_lost))
            best, found = (gain, effect) if effect is not None else (best, found)
    return found


def _counts(starts: Sequence[tuple[Bools, Vector, Vector]], after: Sequence[Bools]) -> Floats:
    """Return visits begun and free time after a place, and the same of the rest, shape (executions, 4)."""
    rows = [
        [(begun & here).sum(), (free_s * here).sum(), (begun & ~here).sum(), (free_s * ~here).sum()]
        for (begun, free_s, _), here in zip(starts, after, strict=True)
    ]
    return np.array(rows)


def _effect(
    place: str, logged: Sequence[PeopleInExecution], counts: Floats, mine_lost_s: Vector, others_lost_s: Vector
) -> VisitEffect | None:
    """Return the effect of a place from the visits after it and the others; None if either cost no time."""
    mine, mine_s, others, others_s = counts.sum(axis=0).tolist()
    times, free_s = sum(one.counted(place) for one in logged), sum(one.free_s for one in logged)
    expected = others / others_s * mine_s
    more, lost_s = mine - expected, float(mine_lost_s.mean())
    each_s = more * lost_s / max(times, LAST)
    base = (others + expected) * float(others_lost_s.mean()) / free_s
    if each_s <= 0.0 or base <= 0.0:
        return None
    of_number = np.hypot(mine**0.5, expected / others**0.5) / more
    of_loss = float(mine_lost_s.std(ddof=1)) / len(mine_lost_s) ** 0.5 / lost_s
    return VisitEffect(place, base, each_s, times / free_s, float(np.hypot(of_number, of_loss)))


def _gains(counts: Floats, known: Floats) -> Vector:
    """Return the gain in log likelihood of each row by two rates in place of one, with rates of `known`, shape (N,)."""
    mine, mine_s, others, others_s = known.sum(axis=0)
    usual = (mine + others) / (mine_s + others_s)
    gain = np.zeros(len(counts))
    for number, (visits, time_s) in enumerate(((mine, mine_s), (others, others_s))):
        rate = (visits + 0.5) / (time_s + 0.5 / usual)
        gain += counts[:, 2 * number] * np.log(rate / usual) - (rate - usual) * counts[:, 2 * number + 1]
    return gain


def _holds_elsewhere(counts: Floats) -> bool:
    """Return whether two rates predict executions that were left out better than one (cross-validation)."""
    fold = np.arange(len(counts)) % FOLDS
    gain = np.zeros(len(counts))
    for part in range(FOLDS):
        if counts[fold != part][:, [0, 2]].sum() > 0.0:
            gain[fold == part] = _gains(counts[fold == part], counts[fold != part])
    return float(gain.sum()) > BEYOND * float(np.sqrt((gain**2).sum()))


def _logged(dataset: Dataset) -> list[PeopleInExecution]:
    """Return the visits in complete, uninterrupted executions."""
    frame = dataset.samples(columns=["execution", "t_s", "human_signals", "scaling"]).drop_nulls("human_signals")
    if frame.is_empty():
        return []
    bits, scaling = frame["human_signals"].to_numpy(), frame["scaling"].cast(float).fill_null(np.nan).to_numpy()
    lost = np.nan_to_num(1.0 - scaling)
    slow = [bit for bit in np.unique(bits) if lost[bits == bit].mean() > lost.mean()]
    rows = dataset.whole_tasks().sort("execution", "index")
    parts = {str(name): part for (name,), part in rows.group_by(["execution"], maintain_order=True)}
    reference = {one.execution for one in dataset.card.executions if one.reference or not one.whole}
    found = []
    for (name,), samples in frame.group_by(["execution"], maintain_order=True):
        part = parts.get(str(name))
        if part is None or str(name) in reference or part["safety_loss_s"].null_count() or len(samples) < 2:
            continue
        t_s = samples["t_s"].to_numpy()
        slower = np.nan_to_num(1.0 - samples["scaling"].cast(float).fill_null(np.nan).to_numpy())
        people = np.isin(samples["human_signals"].to_numpy(), slow)
        left_s, took_s = part["end_s"].to_numpy(), (part["end_s"] - part["start_s"] - part["safety_loss_s"]).sum()
        step_s = np.diff(t_s, append=t_s[-1:])
        places = tuple(part["goal_place"].to_list())
        found.append(PeopleInExecution(places, left_s, float(took_s), t_s, people, slower * step_s))
    return found
