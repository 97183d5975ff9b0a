"""A rule of the safety function as data: which level holds where, with intervals.

A rule is a list of limits. Each allows at most its level of the speed scaling while the operator is in its region:
anywhere in the cell, nearer than a distance, within a rectangle or polygon on the floor, or in any of these; or while a
signal has a value. A region may be restricted to times with the TCP in a rectangle. The slowest active limit holds;
without any, the speed is the fastest level.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, field

from cyclekit.dataset.cards.quantities import Card, Count, Delay, Fraction, Metres, Point, Ramp, Scaling, ascending

_TO = "distance (TCP to operator( on the floor)?|robot base to operator on the floor|nearest link to operator)"
DistanceName = Annotated[str, Meta(pattern=f"^{_TO}$")]
"""Names of distances to the operator; `cyclekit.learning.rules.samples.distances` computes them."""
Angle = Annotated[float, Meta(ge=-7.0, le=7.0)]
"""An angle, rad."""


class MetresCard(Card, frozen=True, kw_only=True):
    """A length or coordinate with its 95 % confidence interval, m; an unknown bound is None."""

    value: Metres
    low: Metres | None = None
    high: Metres | None = None


class NearerCard(Card, frozen=True, kw_only=True):
    """The operator is nearer than `metres`, by the named distance."""

    distance: DistanceName
    metres: MetresCard


class RectangleCard(Card, frozen=True, kw_only=True):
    """The operator is in a rectangle on the floor, base frame.

    Attributes:
        angle_rad: Rotation of the rectangle about the robot's base, counterclockwise.
        along, across: Its edges in the rotated frame: from, to; None if the operator was never seen to cross it.
    """

    angle_rad: Angle = 0.0
    along: tuple[MetresCard | None, MetresCard | None]
    across: tuple[MetresCard | None, MetresCard | None]


class SideCard(Card, frozen=True, kw_only=True):
    """A side of a polygon: angle of its outward normal, counterclockwise from x, and its distance along the normal."""

    angle_rad: Angle
    metres: MetresCard


class PolygonCard(Card, frozen=True, kw_only=True):
    """The operator is in a convex polygon on the floor, base frame: within all its sides, ascending by angle.

    Sides that the operator was never seen to cross are left out.
    """

    sides: Annotated[tuple[SideCard, ...], Meta(min_length=1, max_length=8)]


class SignalCard(Card, frozen=True, kw_only=True):
    """A signal has a value.

    Attributes:
        signal: Name of the signal.
        value: The value, as text.
        delay_s: Delay of the commanded level in addition to the rule's latency.
        robot: Rectangle on the floor; the signal counts only while the TCP is in it; None: always.
    """

    signal: str
    value: str
    delay_s: Delay = 0.0
    robot: RectangleCard | None = None


class RegionCard(Card, frozen=True, kw_only=True):
    """When a limit is active: if any of these holds.

    Attributes:
        anywhere: An operator is present.
        nearer, rectangles, polygons: The operator is in a region.
        signals: A signal has a value.
        robot: The others count only while the TCP is in this rectangle on the floor; alone, it holds whenever the TCP
            is.
    """

    anywhere: bool = False
    nearer: Annotated[tuple[NearerCard, ...], Meta(max_length=8)] = ()
    rectangles: Annotated[tuple[RectangleCard, ...], Meta(max_length=8)] = ()
    polygons: Annotated[tuple[PolygonCard, ...], Meta(max_length=8)] = ()
    signals: Annotated[tuple[SignalCard, ...], Meta(max_length=8)] = ()
    robot: RectangleCard | None = None


class LimitCard(Card, frozen=True, kw_only=True):
    """The speed is at most this level from when the operator enters `within` until he leaves `until`.

    `until` is None without hysteresis: both regions are the same.
    """

    scaling: Scaling
    within: RegionCard
    until: RegionCard | None = None


class LawCard(Card, frozen=True, kw_only=True):
    """Speed and separation monitoring without levels: the highest scaling s that the distance allows.

    stop + linear s + square s^2 <= distance. In terms of ISO/TS 15066: stop = C + v_h T_r, linear = v_p (T_r + v_h /
    a), square = v_p^2 / (2 a), with the programmed speed v_p and the deceleration a.

    Attributes:
        distance: The distance in the law.
        stop, linear, square: The three lengths.
        lowest: Minimum of the scaling; 0 also if the logs do not show it.
        latency_s, ramp_down_per_s, ramp_up_per_s: Response with which the law was fitted; None: no ramp.
    """

    distance: DistanceName
    stop: MetresCard
    linear: MetresCard
    square: MetresCard
    lowest: Scaling = 0.0
    latency_s: Delay = 0.0
    ramp_down_per_s: Ramp | None = None
    ramp_up_per_s: Ramp | None = None

    def __post_init__(self) -> None:
        """Refuse a scaling that would fall with distance.

        Raises:
            ValueError: `linear` or `square` is negative.
        """
        if min(self.linear.value, self.square.value) < 0.0:
            msg = "linear and square must not be negative"
            raise ValueError(msg)


class PoseCard(Card, frozen=True, kw_only=True):
    """The arm at one position of the TCP: its joints from the base on, base frame, m."""

    tcp_m: Point
    joints_m: Annotated[tuple[Point, ...], Meta(min_length=1, max_length=16)]


class RuleCard(Card, frozen=True, kw_only=True):
    """The simplest rule that explains the commanded level.

    Attributes:
        family: Kind of rule, one of `rules.families.FAMILIES`.
        hysteresis: Whether speed is restored farther out than it is reduced.
        levels: Levels of the speed scaling, ascending.
        limits: Limits, the slowest first; a level without a region of its own has none. Empty for a law.
        law: The continuous law, instead of limits; `levels` are then the ends of its scaling.
        latency_s: Assumed delay of the commanded level after the positions.
        explained: Share of held-out samples whose commanded level the rule predicts.
        network: The same share for the network; None = not evaluated.
        others: The same share for other kinds of rule that were fitted, in the order of fitting.
        rows, executions: Numbers of samples and executions in the fit, including those held out to choose the rule.
        poses: Poses of the arm over all logged TCP positions, for a rule on the nearest link; else empty.
    """

    family: str
    hysteresis: bool = False
    levels: Annotated[tuple[Scaling, ...], Meta(min_length=2, max_length=64)]
    limits: Annotated[tuple[LimitCard, ...], Meta(max_length=64)] = ()
    law: LawCard | None = None
    latency_s: Delay = 0.0
    explained: Fraction
    network: Fraction | None = None
    others: dict[str, Fraction] = field(default_factory=dict)
    rows: Count = 0
    executions: Count = 0
    poses: Annotated[tuple[PoseCard, ...], Meta(max_length=4096)] = ()

    def __post_init__(self) -> None:
        """Refuse levels and limits that are not ascending, and a rule without exactly one of limits and law.

        Raises:
            ValueError: They are not ascending, or the rule has both or neither of limits and law.
        """
        if bool(self.limits) == (self.law is not None):
            msg = "a rule needs either limits or a law"
            raise ValueError(msg)
        ascending(self.levels)
        ascending(tuple(limit.scaling for limit in self.limits))
