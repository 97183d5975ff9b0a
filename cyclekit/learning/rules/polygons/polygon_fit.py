"""How well a polygon on the floor explains samples, and random walks over polygons that explain them.

The error of the reaction time, one number for all samples, and the spread of the time of single changes are unknown
too: without them a few milliseconds would look like another corner.
"""

from __future__ import annotations

from math import cos, sin
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import ndtr

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.schema import Floats, Vector

MAX_SIDES = 6
NEAR_M = 0.25
"""Maximum distance, m, of samples from the fitted polygon."""
WRONG = 0.001
"""Prior probability that a sample's level is wrong."""
NEAR_FIT = 0.1
"""Prior standard deviation of a side from the fitted one, rad and m: samples may hardly show it."""
LATE = 0.3
"""Prior standard deviation of the error of the reaction time, samples."""
JITTER = (0.01, 0.5)
"""Range of the standard deviation of the time of a single sample, samples; each order of magnitude is as likely."""
_STEP, _ANY_SIZE = 1.7, 0.3
"""Size of a step, in standard deviations of the side; share of steps of any size."""
_MOST, _DECADES = 0.1, 2.5
"""Largest such step, rad and m, and decades of smaller ones."""
_BAND, _MANY = 9.0, 200
"""Standard deviations beyond which the likelihood no longer changes, in double precision, and the number of samples
from which those beyond are left out."""
_NEVER = float(np.log(WRONG))
"""Log-likelihood of samples beyond on the wrong side; on the right side it is 0."""
_LATE_STEP, _JITTER_STEP = 0.03, 0.3


class PolygonSamples(NamedTuple):
    """K samples near a polygon.

    Attributes:
        floor_m: Positions of the operator, (K, 2), m.
        side: 1 = inside, -1 = outside, (K,).
        spread_m: Standard deviation of the positions, (K,), m.
        pace_m: Way from one 10 Hz sample to the next, (K, 2), m.
    """

    floor_m: Floats
    side: Vector
    spread_m: Vector
    pace_m: Floats

    def blurred(self, by_m: float) -> PolygonSamples:
        """Return the samples with a standard deviation larger by `by_m`, which makes the fit smoother."""
        return self._replace(spread_m=np.hypot(self.spread_m, by_m))

    def at_time(self, late: float) -> Floats:
        """Return the positions at the time corrected by `late` samples, (K, 2), m."""
        return self.floor_m - late * self.pace_m

    def spread_with(self, jitter: float) -> Vector:
        """Return the standard deviations with that of the time, samples, (K,), m."""
        return np.asarray(np.hypot(self.spread_m, jitter * np.hypot(*self.pace_m.T)))


class PolygonState(NamedTuple):
    """S sides and the times of the samples.

    Attributes:
        angle_rad: Angle of each side's outward normal, (S,), rad.
        through_m: A point on each side about which it turns, (S, 2), m.
        late: Error of the reaction time, samples.
        jitter: Standard deviation of the time of a single sample, samples.
    """

    angle_rad: Vector
    through_m: Floats
    late: float = 0.0
    jitter: float = 0.03

    def moved(self, turn_rad: Vector, move_m: Vector) -> PolygonState:
        """Return the sides turned, and moved along their new normals."""
        angle = self.angle_rad + turn_rad
        return self._replace(angle_rad=angle, through_m=self.through_m + normals(angle) * move_m[:, None])

    def about(self, middle_m: Vector) -> PolygonState:
        """Return the same sides, turning about the points nearest to the middle of the polygon, (2,), m."""
        normal = normals(self.angle_rad)
        return self._replace(through_m=middle_m + normal * (self.out_m - normal @ middle_m)[:, None])

    def without(self, side: int) -> PolygonState:
        """Return all sides but one."""
        angle, through = (np.delete(each, side, axis=0) for each in (self.angle_rad, self.through_m))
        return self._replace(angle_rad=angle, through_m=through)

    @property
    def out_m(self) -> Vector:
        """Distance of each side from the origin along its normal, (S,), m."""
        return np.asarray(np.einsum("sk,sk->s", normals(self.angle_rad), self.through_m))


class Walk(NamedTuple):
    """D polygons, one per sweep: turn, rad, and move, m, of each side, (D, S), and the last state with its fit."""

    turn_rad: Floats
    move_m: Floats
    last: PolygonState
    fit: float


def normals(angle_rad: Vector) -> Floats:
    """Return the outward normals of sides, (S, 2)."""
    found = np.empty((len(angle_rad), 2))  # quicker than column_stack: this is asked for in every step of a walk
    found[:, 0], found[:, 1] = np.cos(angle_rad), np.sin(angle_rad)
    return found


def depths_of(state: PolygonState, samples: PolygonSamples) -> Floats:
    """Return how far each sample lies within each side, (S, K), m, at the time corrected by `late`."""
    return _depths(state, samples.at_time(state.late))


def _depths(state: PolygonState, floor_m: Floats) -> Floats:
    return np.asarray(state.out_m[:, None] - normals(state.angle_rad) @ floor_m.T)


def fit_of(state: PolygonState, samples: PolygonSamples) -> float:
    """Return the log-likelihood of the samples."""
    depth = depths_of(state, samples).min(axis=0)
    return float(terms_of(depth, samples.side * samples.spread_with(state.jitter)).sum())


def terms_of(depth_m: Vector, spread_m: Vector) -> Vector:
    """Return the log-likelihood of each sample, (K,).

    Args:
        depth_m: How far each sample lies within the polygon, (K,), m.
        spread_m: Standard deviation of the positions, m, times 1 or -1 for samples inside or outside, (K,).
    """
    z = depth_m / spread_m
    if len(z) < _MANY:
        return _logs(z)
    found = np.asarray((z < 0.0) * _NEVER, np.float64)
    near = (np.abs(z) < _BAND).nonzero()[0]
    found[near] = _logs(z[near])
    return found


def _logs(z: Vector) -> Vector:
    """Return the log-likelihood of samples that lie z standard deviations within the polygon."""
    return np.asarray(np.log(WRONG + (1.0 - WRONG) * ndtr(z)))


def terms_with(terms: Vector, depth_m: Vector, tried_m: Vector, spread_m: Vector) -> Vector:
    """Return the log-likelihood of each sample, (K,), with depths of which few differ from those of `terms`.

    Args:
        terms: As `terms_of` gives them for `depth_m`, (K,).
        depth_m: Depths before, (K,), m.
        tried_m: Depths now, (K,), m.
        spread_m: As in `terms_of`.
    """
    changed = (tried_m != depth_m).nonzero()[0]
    found = terms.copy()
    found[changed] = terms_of(tried_m[changed], spread_m[changed])
    return found


def climbed(
    state: PolygonState, samples: PolygonSamples, rng: np.random.Generator, sweeps: int, blur_m: Sequence[float]
) -> tuple[PolygonState, float]:
    """Return the polygon with the best fit near `state`, and its log-likelihood.

    Args:
        state: Polygon to start from.
        samples: Samples to explain.
        rng: Source of the random steps.
        sweeps: Number of times that each side is moved, for each of `blur_m`.
        blur_m: Added to the samples' standard deviations, one after another, the last one 0: from far away only a
            smooth fit shows the direction.
    """
    for by_m in blur_m:
        state = walk(state, samples.blurred(by_m), rng, sweeps, only_better=True).last
    return state, fit_of(state, samples)


def walk(
    begin: PolygonState,
    samples: PolygonSamples,
    rng: np.random.Generator,
    sweeps: int,
    *,
    adapt: int | None = None,
    only_better: bool = False,
) -> Walk:
    """Return a random walk by the Metropolis method.

    Args:
        begin: Polygon to start from.
        samples: Samples to explain.
        rng: Source of the random steps.
        sweeps: Number of times that each side is moved.
        adapt: Sweep from which steps have the size by which each side varied before; None: never.
        only_better: Accept only steps to a better fit.
    """
    turn, move = np.zeros_like(begin.angle_rad), np.zeros_like(begin.angle_rad)
    late, jitter = begin.late, begin.jitter
    # kept: most steps are not accepted, and one side changes the depth of few samples
    angles, through = begin.angle_rad.tolist(), begin.through_m.tolist()
    still = not samples.pace_m.any()  # the time of the samples changes nothing
    speed = np.hypot(*samples.pace_m.T)
    floor, spread = samples.at_time(late).T, samples.side * samples.spread_with(jitter)
    every = begin.out_m[:, None] - normals(begin.angle_rad) @ floor
    depth = every.min(axis=0)
    terms = terms_of(depth, spread)
    fit = float(terms.sum())
    normal = np.empty((1, 2))
    drawn: list[Floats] = []
    scales: Floats | None = None

    def accepts(new: float, prior: float) -> bool:
        return new > fit if only_better else bool(np.log(rng.random()) < new - fit + prior)

    for sweep in range(sweeps):
        scales = _scales(drawn) if sweep == adapt else scales
        for side, (angle, (x, y)) in enumerate(zip(angles, through, strict=True)):
            by_turn, by_move = _step(None if scales is None else scales[side], rng).tolist()
            was_turn, was_move = float(turn[side]), float(move[side])
            to_turn, to_move = was_turn + by_turn, was_move + by_move
            normal[0] = u, v = cos(angle + to_turn), sin(angle + to_turn)
            before = every[side].copy()
            np.subtract(u * (x + u * to_move) + v * (y + v * to_move), (normal @ floor)[0], out=every[side])
            tried = every.min(axis=0)
            tried_terms = terms_with(terms, depth, tried, spread)
            new = float(tried_terms.sum())
            less = was_turn * was_turn + was_move * was_move - (to_turn * to_turn + to_move * to_move)
            if accepts(new, less / (2 * NEAR_FIT**2)):
                depth, terms, fit = tried, tried_terms, new
                turn[side], move[side] = to_turn, to_move
            else:
                every[side] = before
        here = begin.moved(turn, move)
        tried_late = late + _LATE_STEP * rng.normal()
        tried_floor = floor if still else samples.at_time(tried_late).T
        tried_every = here.out_m[:, None] - normals(here.angle_rad) @ tried_floor
        tried = tried_every.min(axis=0)
        tried_terms = terms_of(tried, spread)
        if accepts(new := float(tried_terms.sum()), (late**2 - tried_late**2) / (2 * LATE**2)):
            floor, every, depth, terms, fit, late = tried_floor, tried_every, tried, tried_terms, new, tried_late
        tried_jitter = min(max(float(jitter * np.exp(_JITTER_STEP * rng.normal())), JITTER[0]), JITTER[1])
        tried_spread = spread if still else samples.side * np.hypot(samples.spread_m, tried_jitter * speed)
        tried_terms = terms if still else terms_of(depth, tried_spread)
        if accepts(new := fit if still else float(tried_terms.sum()), 0.0):
            spread, terms, fit, jitter = tried_spread, tried_terms, new, tried_jitter
        drawn.append(np.array([turn, move]))
    turns, moves = np.array(drawn).swapaxes(0, 1)
    return Walk(turns, moves, begin.moved(turn, move)._replace(late=late, jitter=jitter), fit)


def _scales(drawn: Sequence[Floats]) -> Floats:
    """Return how turn and move of each side vary in the last draws, as a factor of their covariance, (S, 2, 2)."""
    each = np.array(drawn[len(drawn) // 2 :]).transpose(2, 1, 0)
    return np.array([np.linalg.cholesky(np.cov(one) + 1e-10 * np.eye(2)) for one in each])


def _step(scale: Floats | None, rng: np.random.Generator) -> Vector:
    """Return a random turn, rad, and move, m, of a side: of any size, or mostly as the side varies."""
    if scale is None or rng.random() < _ANY_SIZE:
        return np.asarray(_MOST * 10.0 ** -rng.uniform(0.0, _DECADES, 2) * rng.normal(size=2))
    return np.asarray(_STEP * scale @ rng.normal(size=2))
