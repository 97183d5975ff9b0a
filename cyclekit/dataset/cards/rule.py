"""A rule of the safety function as data: which level holds where, with intervals.

A rule is a list of limits. Each allows at most its level of the speed scaling while the operator is in its region:
anywhere in the cell, nearer than a distance, within a rectangle or polygon on the floor, or in any of these; or while a
signal has a value. A region may hold only while the TCP is in a rectangle of its own. The slowest limit holds; where
none does, the speed is the fastest level.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, field

from cyclekit.dataset.cards.quantities import Card, Count, Duration, Fraction, Metres, Point, Scaling, ascending

_TO = "distance (TCP to operator( on the floor)?|robot base to operator on the floor|nearest link to operator)"
DistanceName = Annotated[str, Meta(pattern=f"^{_TO}$")]
"""By what the operator is near; `cyclekit.learning.rules.distances` measures them."""
Angle = Annotated[float, Meta(ge=-7.0, le=7.0)]
"""An angle, rad."""
Rate = Annotated[float, Meta(gt=0.0, le=1e6)]
"""A change of the scaling per second."""


class MetresCard(Card, frozen=True, kw_only=True):
    """A length or coordinate with its 95 % confidence interval, m; a bound that nobody knows is None."""

    value: Metres
    low: Metres | None = None
    high: Metres | None = None


class NearerCard(Card, frozen=True, kw_only=True):
    """The operator is nearer than this by that distance."""

    distance: DistanceName
    metres: MetresCard


class RectangleCard(Card, frozen=True, kw_only=True):
    """The operator stands in a rectangle on the floor, base frame.

    Attributes:
        angle_rad: By which the rectangle is turned about the robot's base, counterclockwise.
        along, across: Its edges in that turned frame: from, to; None where the operator was never seen to cross it.
    """

    angle_rad: Angle = 0.0
    along: tuple[MetresCard | None, MetresCard | None]
    across: tuple[MetresCard | None, MetresCard | None]


class SideCard(Card, frozen=True, kw_only=True):
    """A side of a polygon: its outward normal, counterclockwise from x, and how far the side lies along that."""

    angle_rad: Angle
    metres: MetresCard


class PolygonCard(Card, frozen=True, kw_only=True):
    """The operator stands in a convex polygon on the floor, base frame: within all its sides, ascending by angle.

    Sides that the operator was never seen to cross are left out.
    """

    sides: Annotated[tuple[SideCard, ...], Meta(min_length=1, max_length=8)]


class SignalCard(Card, frozen=True, kw_only=True):
    """A signal has this value.

    Attributes:
        signal: Its name.
        value: The value, as text.
        delay_s: The commanded level answers this much later than that of the rule's latency.
        robot: It counts only while the TCP is in this rectangle on the floor; None: wherever the TCP is.
    """

    signal: str
    value: str
    delay_s: Duration = 0.0
    robot: RectangleCard | None = None


class RegionCard(Card, frozen=True, kw_only=True):
    """When a limit holds: any of these is so.

    Attributes:
        anywhere: Somebody is present.
        nearer, rectangles, polygons: Where the operator is.
        signals: What a signal says.
        robot: The rest holds only while the TCP is in this rectangle on the floor; alone, whenever it is.
    """

    anywhere: bool = False
    nearer: Annotated[tuple[NearerCard, ...], Meta(max_length=8)] = ()
    rectangles: Annotated[tuple[RectangleCard, ...], Meta(max_length=8)] = ()
    polygons: Annotated[tuple[PolygonCard, ...], Meta(max_length=8)] = ()
    signals: Annotated[tuple[SignalCard, ...], Meta(max_length=8)] = ()
    robot: RectangleCard | None = None


class LimitCard(Card, frozen=True, kw_only=True):
    """The speed is at most this level from when the operator enters `within` until he has left `until`.

    `until` is None where both are the same: there is no hysteresis.
    """

    scaling: Scaling
    within: RegionCard
    until: RegionCard | None = None


class LawCard(Card, frozen=True, kw_only=True):
    """Speed and separation monitoring without levels: the highest scaling s that the distance allows.

    stop + linear s + square s^2 <= distance. In terms of ISO/TS 15066: stop = C + v_h T_r, linear = v_p (T_r + v_h /
    a), square = v_p^2 / (2 a), with the programmed speed v_p and the deceleration a.

    Attributes:
        distance: Which distance.
        stop, linear, square: The three lengths.
        lowest: The scaling does not fall below it; 0 also where the logs do not show it.
        latency_s, ramp_down_per_s, ramp_up_per_s: The response through which the law was seen; None: at once.
    """

    distance: DistanceName
    stop: MetresCard
    linear: MetresCard
    square: MetresCard
    lowest: Scaling = 0.0
    latency_s: Duration = 0.0
    ramp_down_per_s: Rate | None = None
    ramp_up_per_s: Rate | None = None

    def __post_init__(self) -> None:
        """Refuse a scaling that would fall with distance.

        Raises:
            ValueError: It would.
        """
        if min(self.linear.value, self.square.value) < 0.0:
            msg = "linear and square must not be negative"
            raise ValueError(msg)


class PoseCard(Card, frozen=True, kw_only=True):
    """Where the arm is at one position of the TCP: its joints from the base on, base frame, m."""

    tcp_m: Point
    joints_m: Annotated[tuple[Point, ...], Meta(min_length=1, max_length=16)]


class RuleCard(Card, frozen=True, kw_only=True):
    """The simplest rule that explains the commanded level.

    Attributes:
        family: Which kind of rule, one of `rules.families.FAMILIES`.
        hysteresis: Speed comes back farther out than it was taken.
        levels: Of the speed scaling, ascending.
        limits: The slowest first; a level that never holds by itself has none. Empty where there is a law.
        law: The continuous law, in place of limits; `levels` are then the ends of its scaling.
        latency_s: By which the commanded level was taken to answer to the positions.
        explained: Part of the held-out samples whose commanded level the rule names.
        network: The same of the network; None = not asked.
        others: The same of the other kinds of rule that were fitted, in the order they were tried.
        rows, executions: What it was fitted to, with those held out for the choice.
        poses: Of the arm, over all logged positions of the TCP, for a rule on the nearest link; else empty.
    """

    family: str
    hysteresis: bool = False
    levels: Annotated[tuple[Scaling, ...], Meta(min_length=2, max_length=64)]
    limits: Annotated[tuple[LimitCard, ...], Meta(max_length=64)] = ()
    law: LawCard | None = None
    latency_s: Duration = 0.0
    explained: Fraction
    network: Fraction | None = None
    others: dict[str, Fraction] = field(default_factory=dict)
    rows: Count = 0
    executions: Count = 0
    poses: Annotated[tuple[PoseCard, ...], Meta(max_length=4096)] = ()

    def __post_init__(self) -> None:
        """Refuse levels and limits that are not ascending, and a rule of neither limits nor a law.

        Raises:
            ValueError: They are not, or it is one.
        """
        if bool(self.limits) == (self.law is not None):
            msg = "a rule needs either limits or a law"
            raise ValueError(msg)
        ascending(self.levels)
        ascending(tuple(limit.scaling for limit in self.limits))
