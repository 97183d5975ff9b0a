"""A model of a cell in which no log shows people: the speed of the robot under an unseen operator."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from cyclekit.dataset.cards import TrainingCard, plain
from cyclekit.learning.labelling import commanded_in_time, follows_late, need_scaling, staircase_of, without_slider
from cyclekit.learning.unseen.hidden import Chain, LevelCourses, draw_states
from cyclekit.text.numbers import fixed, percent
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards.unseen import UnseenOperatorCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Bools, Floats, Ints, Points, Vector

XYZ = ["robot_x_m", "robot_y_m", "robot_z_m"]
NOBODY_SEEN = (
    "ROBOT LOG ALONE: no log shows people while a robot log runs; the operator's position is unknown, and so is most "
    "of the effect of the task order"
)
ONE_BIT = (
    "for narrower intervals, log one bit of a scanner, light curtain or door as an input of the robot: it shows when "
    "people come and go"
)
UNSEEN_ERROR = 0.4
"""Error from unknown positions of people when the task order changes, as a share of the standard deviation of logged
durations (less their mean per order). In cells where it is known it is up to this."""
SUPPORTED_S = 1.0
"""Minimum time in a state and region, s, at which the logs count as support."""


@dataclass(frozen=True)
class Course:
    """Robot's log of one execution, T samples.

    Attributes:
        t_s: Session time, shape (T,), s.
        robot_m: TCP, shape (T, 3), m.
        level: Index of the commanded level, shape (T,); -1 = unknown.
    """

    t_s: Vector
    robot_m: Points
    level: Ints


@dataclass(frozen=True, repr=False, eq=False)
class UnseenOperator(Result):
    """A hidden Markov chain of operator states, and the speed of the robot in each.

    Attributes:
        levels: Levels of the speed scaling, shape (P,), ascending.
        unseen: The chain.
        card: Training card.
        problem: `now`: it predicts the present scaling.
    """

    levels: tuple[float, ...]
    unseen: UnseenOperatorCard
    card: TrainingCard = field(default_factory=TrainingCard)
    problem: str = "now"

    @property
    def fast(self) -> bool:
        """Whether it is fast enough for every step of a rollout."""
        return True

    @property
    def unseen_error(self) -> float:
        """Error of expected durations, as a share of the standard deviation of logged durations."""
        return UNSEEN_ERROR

    @property
    def why(self) -> str:
        """Description of an estimate with this model."""
        return "simulation with the logged speed as that of an unseen operator"

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons to doubt every number from this model."""
        return (NOBODY_SEEN,)

    @property
    def limits(self) -> tuple[str, ...]:
        """Further limits of these numbers."""
        return (ONE_BIT,)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states, with the mean speed of the robot in each."""
        mean = (self._shares @ np.array(self.levels)).mean(axis=1)
        return tuple(f"hidden state {number + 1} (mean speed {percent(speed)})" for number, speed in enumerate(mean))

    def predict(self, X: NDArray[np.floating[Any]]) -> Vector:
        """Return the mean scaling for rows x_r, x_h, shape (N, 6), m; shape (N,). Only x_r is used."""
        weight = np.array(self.unseen.seen_s).sum(axis=1)
        mean = (self._shares @ np.array(self.levels)).T @ (weight / weight.sum())
        return np.asarray(mean[self.region_of(np.asarray(X[:, :3], np.float64))])

    def scaling_in(self, robot_m: Points, state: Floats) -> Vector:
        """Return the scaling for positions of the TCP and states, shape (N,).

        Args:
            robot_m: TCP, shape (N, 3), m.
            state: Number of the state, and quantile in [0, 1) of its levels, slowest first; shape (N, 2).
        """
        until = self._until[state[:, 0].astype(np.int64), self.region_of(robot_m)]
        return np.asarray(np.array(self.levels)[(state[:, 1:] >= until[:, :-1]).sum(axis=1)])

    def near_logged(self, robot_m: Points, state: Floats) -> Bools:
        """Return whether the logs show these states at these positions; arguments as of `scaling_in`, shape (N,)."""
        seen_s = np.array(self.unseen.seen_s)[state[:, 0].astype(np.int64), self.region_of(robot_m)]
        return np.asarray(seen_s >= SUPPORTED_S)

    def logged_states(self, dataset: Dataset) -> dict[str, tuple[Vector, Floats]]:
        """Return times (T,), s, and states (T, 2) of each execution: one random draw given its log."""
        _, courses = courses_of(dataset, self.levels)
        some = {name: one for name, one in courses.items() if (one.level >= 0).any()}
        drawn = self.drawn_states(list(some.values()), dataset.rate_hz)
        return {name: (one.t_s, state) for (name, one), state in zip(some.items(), drawn, strict=True)}

    def region_of(self, robot_m: Points) -> Ints:
        """Return the number of the region of each TCP position (N, 3)."""
        return nearest(robot_m, np.array(self.unseen.regions_m))

    def drawn_states(self, courses: Sequence[Course], rate_hz: float, *, seed: int = 0) -> list[Floats]:
        """Return a random draw of the states of each course given its log; (T, 2) each.

        With these states the model reproduces exactly the logged levels at the logged positions.
        """
        every = max(1, round(self.unseen.step_s * rate_hz))
        card = self.unseen
        chain = Chain(np.array(card.start), np.array(card.follows), self._shares, np.array(card.seen_s))
        drawn = draw_states(side_by_side(courses, np.array(card.regions_m), every), chain, seed=seed)
        rng = np.random.default_rng(seed)
        return [self._placed(one, np.repeat(mine, every)[: len(one.t_s)], rng)
                for one, mine in zip(courses, drawn, strict=True)]  # fmt: skip

    def _placed(self, course: Course, state: Ints, rng: np.random.Generator) -> Floats:
        """Return states with quantiles that give the logged levels; one random number per spell in a state."""
        spell = np.cumsum(np.diff(state, prepend=-1) != 0) - 1
        luck = rng.random(spell[-1] + 1)[spell]
        until = self._until[state, self.region_of(course.robot_m)]
        above = np.pad(until, ((0, 0), (1, 0)))
        known, row = course.level >= 0, np.arange(len(state))
        low, high = above[row, course.level], until[row, course.level]
        return np.stack([state, np.where(known, low + luck * (high - low), luck)], axis=1)

    @cached_property
    def _shares(self) -> Floats:
        return np.array(self.unseen.shares)

    @cached_property
    def _until(self) -> Floats:
        until = np.cumsum(self._shares, axis=2)
        until[..., -1] = 1.0
        return np.asarray(until)

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {"levels": list(self.levels), "unseen": plain(self.unseen), "card": self.card.to_dict()}

    def _frame_rows(self) -> Sequence[dict[str, object]]:
        shares = self._shares
        return [
            {"state": name, "region": region, "level": level, "probability": float(shares[number, region, at])}
            for number, name in enumerate(self.states)
            for region in range(shares.shape[1])
            for at, level in enumerate(self.levels)
        ]

    def _lines(self) -> list[str]:
        return said(self)


def said(model: UnseenOperator) -> list[str]:
    """Return a description of the model in sentences."""
    levels = ", ".join(fixed(level, 2) for level in model.levels)
    places = len(model.unseen.regions_m)
    where = f"by {places} regions of the robot" if places > 1 else "wherever the robot is"
    return [
        f"unseen operator for problem now, levels {levels}; {len(model.unseen.start)} hidden states, {where}",
        "the positions of people are unknown, and no network was trained: the logged speed alone shows when the robot "
        "is slowed",
    ]


def levels_of(dataset: Dataset, levels: Sequence[float] | None = None) -> tuple[tuple[float, ...], pl.DataFrame]:
    """Return the levels of the scaling, and samples with commanded levels: columns execution, t_s, XYZ, level.

    Args:
        dataset: Dataset with a robot's log.
        levels: Levels to use; None to find them.

    Raises:
        DatasetError: The scaling is unknown.
    """
    frame, _ = without_slider(dataset, dataset.samples())
    need_scaling(dataset, frame)
    found = staircase_of(dataset, frame)
    if levels is None:
        levels = tuple(round(float(level), 6) for level in found.levels)
    if follows_late(dataset.card.dynamics):
        level = commanded_in_time(dataset, frame, levels, dataset.card.dynamics)
    else:
        scaling = frame["scaling"].fill_null(np.nan).to_numpy()
        level = np.abs(np.nan_to_num(scaling)[:, None] - np.array(levels)).argmin(axis=1)
        level[np.isnan(scaling)] = -1
    return tuple(levels), frame.select("execution", "t_s", *XYZ).with_columns(level=pl.Series(level))


def courses_of(dataset: Dataset, levels: Sequence[float] | None = None) -> tuple[tuple[float, ...], dict[str, Course]]:
    """Return the levels, and the course of each execution by name."""
    levels, frame = levels_of(dataset, levels)
    parts = frame.partition_by("execution", maintain_order=True)
    return levels, {
        part["execution"][0]: Course(
            part["t_s"].to_numpy(), part.select(XYZ).to_numpy(), part["level"].to_numpy().astype(np.int64)
        )
        for part in parts
    }


def side_by_side(courses: Sequence[Course], centres_m: Points, every: int) -> LevelCourses:
    """Return every n-th sample of the courses as arrays, one row per course."""
    steps = np.array([len(one.t_s[::every]) for one in courses])
    level = np.full((len(courses), int(steps.max())), -1)
    region = np.zeros(level.shape, np.int64)
    for row, one in enumerate(courses):
        level[row, : steps[row]] = one.level[::every]
        region[row, : steps[row]] = nearest(one.robot_m[::every], centres_m)
    return LevelCourses(level, region, steps)


def nearest(xyz_m: Points, centres_m: Points) -> Ints:
    """Return the number of the centre (R, 3) nearest to each position (N, 3)."""
    if len(centres_m) == 1:
        return np.zeros(len(xyz_m), np.int64)
    squares = (centres_m**2).sum(axis=1) - 2.0 * xyz_m @ centres_m.T
    return np.asarray(squares.argmin(axis=1))
