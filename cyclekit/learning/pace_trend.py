"""A trend of paces over the executions, found beside people who differ by session and people who took over.

Three explanations of the same paces are weighed against each other (Bayes): no change, a steady change (linear or
exponential), and one or two steps, as of another person. In each, sessions scatter around it by an unknown amount, each
by itself (another day) or in turn (two or three people). Steady change within sessions and between them counts
together, so few sessions suffice where both agree. Neighbouring executions are correlated, so means of blocks are
compared; within a single session stints scatter as sessions do, as people may take turns in it.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Floats, Ints, Vector

MIN_EXECUTIONS = 30
"""Minimum number of executions."""
BLOCKS, MAX_SESSIONS = 24, 12
"""Number of blocks of executions; with more sessions than the second value, blocks of whole sessions."""
STINTS = 8
"""Number of parts of a single session that may differ as sessions do."""
BETWEEN, OF_BETWEEN = (0.0, 0.03, 0.06, 0.12, 0.24), (0.4, 0.15, 0.15, 0.15, 0.15)
"""Standard deviations of the log pace between sessions that are weighed, and their prior probabilities."""
IN_TURN = (2, 3)
"""Numbers of people who may take turns by session, each with a pace of his own; each comes at least twice."""
SURE_TURNS, OF_DAY = 0.95, 0.06
"""Minimum probability that people take turns for the error of the pace to be that given these people, and the standard
deviation between sessions of one of them that it then has at least."""
SCATTERS = tuple(np.geomspace(0.004, 0.3, 14).tolist())
"""Standard deviations of the mean log pace of a block."""
SPREAD = 0.2
"""Standard deviation of a change of the log pace before any log is seen."""
STEADY, STEPS = 0.3, 0.2
"""Prior probabilities of a steady change, and of steps."""


class ChangeShape(NamedTuple):
    """How a steady change may pass.

    Attributes:
        passed: Share of the change that has passed at each pace, shape (N,), relative to that at what it is compared
            with, plus `middle`.
        middle: Share that has passed on average.
    """

    passed: Vector
    middle: float


class PaceTrend(NamedTuple):
    """A steady change of the pace.

    Attributes:
        shape: Number of the most probable shape.
        change: Change of the log pace from the first execution to the last, in that shape.
        error: Standard error of the log pace at the last execution; of people who take turns, of their mean.
        probability: Probability of a steady change.
    """

    shape: int
    change: float
    error: float
    probability: float


class _Explained(NamedTuple):
    """A steady change: log of its probability, not normalised, the log pace at the end and its variance, and the slope.

    Each has one value for each scatter between sessions and of blocks, shape (V,).
    """

    log_weight: Vector
    level: Vector
    level_variance: Vector
    slope: Vector


def find_trend(off: Vector, session: Ints, shapes: Sequence[ChangeShape]) -> PaceTrend | None:
    """Return the steady change that explains paces best, however probable; None with too few executions.

    Args:
        off: Log pace of each execution, shape (N,), in their order.
        session: Number of the session of each, shape (N,); those of one session follow each other.
        shapes: How the change may pass, equally probable.
    """
    if len(off) < MIN_EXECUTIONS:
        return None
    blocks, group = _blocks(session)
    y = np.array([off[block].mean() for block in blocks])
    *covariances, of_people = _covariances(np.array([len(block) for block in blocks]), group)
    weigh = _Weigher(y, *covariances)
    others = [weigh.steps(0) + np.log(1.0 - STEADY - STEPS)]
    others += [weigh.steps(number) + np.log(STEPS / 2.0) for number in (1, 2)]
    left = np.array([1.0 - shape.middle for shape in shapes])
    columns = [np.array([shape.passed[block].mean() for block in blocks]) - 1.0 for shape in shapes]
    found = [weigh.steady(column) for column in columns]
    log_weight, level, variance, slope = (np.array(column) for column in zip(*found, strict=True))
    log_weight += np.log(STEADY / len(shapes))
    most = max(float(each.max()) for each in (*others, log_weight))
    weight = np.exp(log_weight - most)
    steady, other = float(weight.sum()), sum(float(np.exp(each - most).sum()) for each in others)
    weight /= steady
    best = int(weight.sum(axis=1).argmax())
    change = float((weight * slope * left[:, None]).sum() / left[best])
    mean = float((weight * level).sum())
    if weight[:, of_people > 0.0].sum() > SURE_TURNS:
        variance = np.maximum(variance - of_people, 0.0) + OF_DAY**2 / len(np.unique(group))
    error = float((weight * (variance + (level - mean) ** 2)).sum()) ** 0.5
    return PaceTrend(best, change, error, steady / (steady + other))


def _blocks(session: Ints) -> tuple[list[Ints], Ints]:
    """Return the executions of each block, and the session of each block; with many sessions each block has its own."""
    parts = np.split(np.arange(len(session)), np.flatnonzero(np.diff(session)) + 1)
    if len(parts) == 1:
        parts = np.array_split(parts[0], STINTS)
        session = np.repeat(np.arange(STINTS), [len(part) for part in parts])
    if len(parts) > MAX_SESSIONS:
        groups = np.array_split(np.arange(len(parts)), MAX_SESSIONS)
        return [np.concatenate([parts[n] for n in some]) for some in groups], np.arange(MAX_SESSIONS)
    wanted = [min(max(2, round(BLOCKS * len(part) / len(session))), len(part)) for part in parts]
    blocks = [block for part, number in zip(parts, wanted, strict=True) for block in np.array_split(part, number)]
    return blocks, np.array([session[block[0]] for block in blocks])


def _covariances(size: Ints, group: Ints) -> tuple[Vector, Floats, Vector, Vector]:
    """Return log prior, inverse (V, B, B) and log determinant of each covariance of the means of blocks.

    The last value is the variance of the mean of the people who take turns, less that of their unequal shares in the
    logs. They return, so it is no uncertainty of the pace at the end. It is 0 where each session is by itself.
    """
    number = np.unique(group, return_inverse=True)[1]
    count = int(number.max()) + 1
    several = 1 < count < len(group)
    who = [number, *(number % people for people in IN_TURN if several and count >= 2 * people)]
    own = np.diag(size.mean() / size)
    priors, covariances, of_people = [], [], []
    for sd, prior in zip(BETWEEN, OF_BETWEEN, strict=True) if several else [(0.0, 1.0)]:
        for person in who if sd else who[:1]:
            alike = person[:, None] == person
            for scatter in SCATTERS:
                priors.append(np.log(prior / (len(who) if sd else 1)))
                covariances.append(sd**2 * alike + scatter**2 * own)
                share = np.bincount(person, size) / size.sum()
                of_people.append(0.0 if person is number else sd**2 * (2.0 / len(share) - float(share @ share)))
    every = np.array(covariances)
    return np.array(priors), np.linalg.inv(every), np.linalg.slogdet(every)[1], np.array(of_people)


class _Weigher:
    """Weighs explanations of the means of blocks `y` (B,) under each covariance (V of them)."""

    def __init__(self, y: Vector, priors: Vector, inverse: Floats, log_det: Vector) -> None:
        self._inverse, self._y = inverse, inverse @ y
        self._fixed = priors - 0.5 * (log_det + self._y @ y)

    def steps(self, number: int) -> Vector:
        """Return the log weights of all ways to place so many steps between blocks, equally probable before, (V,).

        A step is a column of zeros, then ones, and the constant is one at the first block: products of columns are sums
        over all later blocks.
        """
        pairs = self._inverse[:, ::-1, ::-1].cumsum(axis=1).cumsum(axis=2)[:, ::-1, ::-1]
        ends = self._y[:, ::-1].cumsum(axis=1)[:, ::-1]
        ways = list(combinations(range(1, ends.shape[1]), number))
        at = [np.zeros(len(ways), np.int64), *np.array(ways, np.int64).T]
        inner = [
            [pairs[:, one, other] + (SPREAD**-2 if one is other and k else 0.0) for other in at]
            for k, one in enumerate(at)
        ]
        found = _gained(inner, [ends[:, one] for one in at]) - number * np.log(SPREAD)
        return np.asarray(self._fixed + np.logaddexp.reduce(found, axis=1) - np.log(len(ways)))

    def steady(self, x: Vector) -> _Explained:
        """Return how well a line in `x` (B,) explains the paces; `x` is 0 at the end."""
        columns = np.stack([np.ones(len(x)), x])
        inner, sides = columns @ self._inverse @ columns.T, self._y @ columns.T
        inner[:, 1, 1] += 1.0 / SPREAD**2
        inverse = np.asarray(np.linalg.inv(inner), np.float64)
        theta = np.einsum("vqr,vr->vq", inverse, sides)
        gained = 0.5 * ((sides * theta).sum(axis=1) - np.linalg.slogdet(inner)[1])
        return _Explained(self._fixed + gained - np.log(SPREAD), theta[:, 0], inverse[:, 0, 0], theta[:, 1])


def _gained(inner: list[list[Floats]], sides: list[Floats]) -> Floats:
    """Return half of sides . inverse(inner) . sides less the log determinant of inner, by elimination.

    Args:
        inner: Positive definite matrices by row and column, of any shape each; changed.
        sides: Vectors by row; changed.
    """
    found = np.zeros(sides[0].shape)
    for k, (row, side) in enumerate(zip(inner, sides, strict=True)):
        found += 0.5 * (side * side / row[k] - np.log(row[k]))
        for later in range(k + 1, len(sides)):
            share = inner[later][k] / row[k]
            sides[later] = sides[later] - share * side
            for column in range(k + 1, len(sides)):
                inner[later][column] = inner[later][column] - share * row[column]
    return found
