"""A user-defined safety function that replaces the scene's: limits, each with its conditions, or the ISO law.

A limit caps the scaling while all its conditions hold; the lowest applicable limit counts. With hysteresis, every
boundary is farther out until the limit is released. The law is that of speed and separation monitoring (ISO/TS 15066):
the highest robot speed v at which the protective separation distance does not exceed the distance, where

    S_p = v_h (T_r + v / a) + v T_r + v^2 / (2 a) + C

with the person's speed v_h, the reaction time T_r, the robot's deceleration a, and the constant C.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import msgspec
import numpy as np
from numpy.typing import NDArray

from cyclekit_sim.arm import Array
from cyclekit_sim.safety import ABSENT_M, SafetyInputs

Bools = NDArray[np.bool_]
Points = tuple[tuple[float, float], ...]

DISTANCES = ("tcp", "tcp-floor", "base", "link")
"""Distances of the operator: to the TCP, to the TCP on the floor, to the base on the floor, to the nearest link."""
_SLACK_M = 1e-6


class Rectangle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A rectangle on the floor: ranges along its axes, m, rotated about the base, degrees counterclockwise."""

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    turned_deg: float = 0.0

    def holds(self, point_m: Array, margin_m: float) -> Bools:
        """Return a mask of points (B, 3) inside, with its edges moved outwards by `margin_m`."""
        along, across = point_m[:, 0], point_m[:, 1]
        if self.turned_deg:
            turn = np.deg2rad(self.turned_deg)
            along, across = along * np.cos(turn) + across * np.sin(turn), across * np.cos(turn) - along * np.sin(turn)
        inside = (along >= self.x_m[0] - margin_m) & (along <= self.x_m[1] + margin_m)
        return np.asarray(inside & (across >= self.y_m[0] - margin_m) & (across <= self.y_m[1] + margin_m))

    def corners(self, by_m: float = 0.0) -> Points:
        """Return its corners, base frame, m, counterclockwise, with its edges moved outwards by `by_m`."""
        turn = np.deg2rad(self.turned_deg)
        (left, right), (near, far) = ((low - by_m, high + by_m) for low, high in (self.x_m, self.y_m))
        frame = [(left, near), (right, near), (right, far), (left, far)]
        return tuple(
            (float(u * np.cos(turn) - v * np.sin(turn)), float(u * np.sin(turn) + v * np.cos(turn))) for u, v in frame
        )


class Limit(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A cap of the scaling while all its conditions hold.

    Attributes:
        scaling: Cap, 0 to below 1.
        present: A person is in the cell.
        distance: One of DISTANCES is at most `below_m`.
        rectangle: The operator is in it.
        polygon_m: The operator is in this polygon, corners x and y in order.
        robot_polygon_m: The TCP is above this polygon.
    """

    scaling: float
    present: bool = False
    distance: str = ""
    below_m: float | None = None
    rectangle: Rectangle | None = None
    polygon_m: Points = ()
    robot_polygon_m: Points = ()

    def __post_init__(self) -> None:
        """Refuse a limit without conditions, or with impossible ones.

        Raises:
            ValueError: The limit is invalid.
        """
        if not 0 <= self.scaling < 1:
            raise ValueError(f"scaling is {self.scaling}: use 0 to below 1")
        if self.distance not in ("", *DISTANCES):
            raise ValueError(f"distance is {self.distance!r}: use one of {', '.join(DISTANCES)}")
        if bool(self.distance) != (self.below_m is not None and self.below_m > 0):
            raise ValueError(f"distance is {self.distance!r}, below_m is {self.below_m}: give both, below_m > 0")
        for name, points in (("polygon_m", self.polygon_m), ("robot_polygon_m", self.robot_polygon_m)):
            if points and (len(points) < 3 or any(len(point) != 2 for point in points)):
                raise ValueError(f"{name} has {len(points)} corners: use [x, y] of three or more")
        if not (self.present or self.distance or self.rectangle or self.polygon_m or self.robot_polygon_m):
            raise ValueError("a limit without a condition: give present, distance, rectangle or a polygon")

    def applies(self, at: SafetyInputs, margin_m: float) -> Bools:
        """Return a mask of where it applies (B,), with its boundaries moved outwards."""
        found = np.ones(len(at.person_m), np.bool_)
        if self.present:
            found &= at.person_m[:, 0] < ABSENT_M
        if self.below_m is not None:
            found &= apart(self.distance, at) <= self.below_m + margin_m
        if self.rectangle is not None:
            found &= self.rectangle.holds(at.person_m, margin_m)
        for polygon, point_m in ((self.polygon_m, at.person_m), (self.robot_polygon_m, at.tcp_m)):
            if polygon and found.any():  # polygons are slow: only where all other conditions hold
                found[found] = in_polygon(polygon, point_m[found], margin_m)
        return found


class IsoLaw(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The continuous law in the module's docstring; the scaling is that speed over the programmed one, 0 to 1.

    Attributes:
        distance: One of DISTANCES.
        person_m_s: v_h.
        reaction_s: T_r of the safety system.
        deceleration_m_s2: a of the robot.
        constant_m: C: intrusion distance, uncertainties of positions.
        programmed_m_s: The robot's programmed speed: scaling 1.
        lowest: Minimum scaling; 0 stops the robot.
    """

    distance: str = "tcp"
    person_m_s: float = 1.6
    reaction_s: float = 0.1
    deceleration_m_s2: float = 2.5
    constant_m: float = 0.2
    programmed_m_s: float = 1.0
    lowest: float = 0.0

    def __post_init__(self) -> None:
        """Refuse impossible parameters.

        Raises:
            ValueError: A parameter is invalid.
        """
        if self.distance not in DISTANCES:
            raise ValueError(f"distance is {self.distance!r}: use one of {', '.join(DISTANCES)}")
        if min(self.deceleration_m_s2, self.programmed_m_s) <= 0 or min(self.person_m_s, self.reaction_s) < 0:
            raise ValueError(
                "deceleration_m_s2 and programmed_m_s must be more than 0, person_m_s and reaction_s not negative"
            )
        if not 0 <= self.lowest < 1:
            raise ValueError(f"lowest is {self.lowest}: use 0 to below 1")

    def distance_m(self, scaling: float) -> float:
        """Return the protective separation distance at a scaling, m."""
        v, a = scaling * self.programmed_m_s, self.deceleration_m_s2
        return self.person_m_s * (self.reaction_s + v / a) + v * self.reaction_s + v**2 / (2 * a) + self.constant_m

    def allowed(self, at: SafetyInputs, margin_m: float) -> Array:
        """Return the scaling that the law allows (B,), with the distance shortened by `margin_m`."""
        left_m = apart(self.distance, at) - margin_m - self.distance_m(0.0)
        a = self.deceleration_m_s2
        b = self.person_m_s + a * self.reaction_s
        v = np.sqrt(b**2 + 2 * a * np.maximum(left_m, 0.0)) - b
        return np.asarray(np.clip(v / self.programmed_m_s, self.lowest, 1.0))


class Line(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A scaling that is `lowest` up to the distance `near_m`, 1 from `far_m` on, and linear in between.

    Attributes:
        near_m, far_m: The distances, `near_m` < `far_m`.
        distance: One of DISTANCES.
        lowest: Minimum scaling; 0 stops the robot.
    """

    near_m: float
    far_m: float
    distance: str = "tcp"
    lowest: float = 0.0

    def __post_init__(self) -> None:
        """Refuse impossible parameters.

        Raises:
            ValueError: A parameter is invalid.
        """
        if self.distance not in DISTANCES:
            raise ValueError(f"distance is {self.distance!r}: use one of {', '.join(DISTANCES)}")
        if not (self.near_m < self.far_m and 0 <= self.lowest < 1):
            raise ValueError("near_m must be below far_m, and lowest 0 to below 1")

    def allowed(self, at: SafetyInputs, margin_m: float) -> Array:
        """Return the scaling on the line (B,), with the distance shortened by `margin_m`."""
        share = (apart(self.distance, at) - margin_m - self.near_m) / (self.far_m - self.near_m)
        return np.asarray(np.clip(share, self.lowest, 1.0))


class Rule(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Safety function that replaces the scene's: the lowest of all limits, the law and the line."""

    limits: tuple[Limit, ...] = ()
    law: IsoLaw | None = None
    line: Line | None = None

    def __post_init__(self) -> None:
        """Refuse an empty rule.

        Raises:
            ValueError: There is neither a limit nor a law nor a line.
        """
        if not self.limits and self.law is None and self.line is None:
            raise ValueError("an empty rule: give [[limits]], a [law] or a [line]")

    @property
    def levels(self) -> tuple[float, ...]:
        """The scalings of its limits and 1, ascending."""
        return (*sorted({limit.scaling for limit in self.limits}), 1.0)

    def allowed(self, at: SafetyInputs, margin_m: float) -> Array:
        """Return the scaling that the rule allows (B,), with boundaries moved outwards by `margin_m`."""
        found = np.ones(len(at.person_m))
        for one in (self.law, self.line):
            found = found if one is None else np.minimum(found, one.allowed(at, margin_m))
        for limit in self.limits:
            found = np.where(limit.applies(at, margin_m), np.minimum(found, limit.scaling), found)
        return found


def apart(distance: str, at: SafetyInputs) -> Array:
    """Return the distance of this name (B,), m."""
    if distance == "link":
        return _to_links(at.links_m(), at.person_m)
    way = at.person_m if distance == "base" else at.tcp_m - at.person_m
    return np.asarray(np.linalg.norm(way if distance == "tcp" else way[:, :2], axis=1))


def in_polygon(corners: Points, point_m: Array, margin_m: float) -> Bools:
    """Return a mask of points (B, 3) inside a polygon on the floor, or at most `margin_m` outside of it."""
    edges = _edges(corners)
    low, high = edges.low_m - margin_m, edges.high_m + margin_m
    near = ((point_m[:, :2] >= low) & (point_m[:, :2] <= high)).all(axis=1)
    if near.any():
        inside = edges.around(point_m[near])
        if not inside.all():
            inside |= edges.beside_m(point_m[near]) <= margin_m
        near[near] = inside
    return np.asarray(near)


class _Edges:
    """Edges of a polygon, arrays (E, 1), m, and its bounding box with a small margin."""

    def __init__(self, corners: Points) -> None:
        pairs = list(pairwise((*corners, corners[0])))
        self._from, self._to = (np.array([pair[end] for pair in pairs]).T[..., None] for end in (0, 1))
        self._square = np.array([max((bx - ax) ** 2 + (by - ay) ** 2, 1e-12) for (ax, ay), (bx, by) in pairs])[:, None]
        self.low_m, self.high_m = np.min(corners, axis=0) - _SLACK_M, np.max(corners, axis=0) + _SLACK_M

    def around(self, point_m: Array) -> Bools:
        """Return a mask of points (B, 3) inside."""
        (ax, ay), (bx, by), x, y = self._from, self._to, point_m[:, 0], point_m[:, 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            crossed = ((ay > y) != (by > y)) & (x < (bx - ax) * (y - ay) / (by - ay) + ax)
        return np.asarray(np.logical_xor.reduce(crossed, axis=0))

    def beside_m(self, point_m: Array) -> Array:
        """Return the distance of points (B, 3) from the nearest edge, m."""
        (ax, ay), (bx, by), x, y = self._from, self._to, point_m[:, 0], point_m[:, 1]
        part = np.clip(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / self._square, 0.0, 1.0)
        return np.asarray(np.hypot(x - ax - part * (bx - ax), y - ay - part * (by - ay)).min(axis=0))


@lru_cache(maxsize=64)
def _edges(corners: Points) -> _Edges:
    return _Edges(corners)


def _to_links(points_m: Array, person_m: Array) -> Array:
    """Return the distance to the nearest link between joints (B, J, 3)."""
    start, way = points_m[:, :-1], np.diff(points_m, axis=1)
    to_person = person_m[:, None] - start
    part = (to_person * way).sum(axis=2) / np.maximum((way**2).sum(axis=2), 1e-12)
    away = to_person - np.clip(part, 0.0, 1.0)[..., None] * way
    return np.asarray(np.linalg.norm(away, axis=2).min(axis=1))
