"""Hidden rules: whether their kind is found, and the errors of thresholds and corners.

Each simulated cell has a safety function that is only in `truth/truth.json`, not in the logs. `find_rule` gets only the
dataset. A cell is correct if the kind of the rule is found, thresholds are within 1 cm and corners within 3 cm.

In the tenth rule the left edge of the rectangle is beyond the distance, where few operators cross it; in the eleventh
the rectangle is separate. Of a region of the robot, the edges crossed by the TCP count as corners. The sixteenth rule
depends on a bit in the events, which also contain a bit for reduced speed and one of a gripper. Four rules with a
reaction time follow, three of them with hysteresis, which has a similar effect.

The limits of the method were chosen on the unchanged scenes, with seed 3.

    python benchmarks/rules.py --work DIR --executions 60 --seed 11
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from rich.console import Console
from rich.table import Table

from cyclekit.dataset.cards.rule import LimitCard, MetresCard, PolygonCard, RegionCard, RuleCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.rules.of_dataset import rule_of
from cyclekit.learning.rules.samples.distances import TO_BASE, TO_LINK, TO_TCP, TO_TCP_FLAT
from cyclekit.learning.rules.samples.regions import corners, polygon_corners
from cyclekit.learning.rules.words import kind_of
from cyclekit_sim import SimulationOptions, simulate
from cyclekit_sim.rules import Limit, Rectangle, Rule

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

THRESHOLD_M, CORNER_M = 0.01, 0.03


@dataclass(frozen=True)
class Case:
    """One hidden rule in one scene."""

    scene: str
    family: str
    rule: Rule
    options: dict[str, float] = field(default_factory=dict)
    robot: Rectangle | None = None

    @property
    def kind(self) -> str:
        """True kind of the rule."""
        return f"{self.family}, with hysteresis" if "hysteresis_m" in self.options else self.family


def nearer(distance: str, *thresholds: tuple[float, float]) -> tuple[Limit, ...]:
    """Return limits on a distance from pairs of scaling and threshold, m."""
    return tuple(Limit(scaling, distance=distance, below_m=metres) for scaling, metres in thresholds)


def inside(scaling: float, rectangle: Rectangle) -> Limit:
    """Return the limit of a rectangle."""
    return Limit(scaling, rectangle=rectangle)


def with_signals(logs: Path, delay_s: float, seed: int) -> None:
    """Write events: the bit on which the speed depends, a bit set by the robot at reduced speed, and a gripper."""
    rng = np.random.default_rng(seed)
    for session in sorted(logs.glob("session_*")):
        robot = pl.read_csv(session / "robot.csv", separator=" ", columns=["timestamp", "speed_scaling"])
        times, slow = robot["timestamp"].to_numpy() - CLOCK_S, robot["speed_scaling"].to_numpy() < 0.9
        at = np.flatnonzero(slow[1:] != slow[:-1]) + 1
        every = np.sort(rng.uniform(times[0], times[-1], len(at)))
        signals = {"FIELD_1": times[at] - delay_s, "REDUCED": times[at] + 0.04, "GRIPPER": every}
        first = [f"{times[0]:.4f},{name},{int(slow[0])}" for name in signals]
        rows = [
            f"{t:.4f},{name},{int(slow[row])}"
            for name, each in signals.items()
            for t, row in zip(each, at, strict=True)
        ]
        with (session / "events.csv").open("a", encoding="utf-8") as file:
            file.writelines(f"{row}\n" for row in (*first, *rows))


def ring(x_m: float, y_m: float, radius_m: float) -> tuple[tuple[float, float], ...]:
    """Return the corners of an octagon about a point on the floor."""
    turn = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    return tuple((float(x_m + radius_m * np.cos(a)), float(y_m + radius_m * np.sin(a))) for a in turn)


BOX, TURNED = "rectangle on the floor", "turned rectangle on the floor"
WHILE = "while the robot is in a rectangle on the floor"
SIGNAL = "signal"
CLOCK_S = 147.512
"""Time of the robot's log minus time of the events, as written by the simulator, s."""
POLYGON = ((1.0, -0.3), (2.0, -0.6), (2.5, 0.2), (2.1, 1.0), (1.2, 0.9))
REGION = Rectangle((0.15, 1.5), (-1.0, 1.0))
FIELDS = (Limit(0.25, polygon_m=ring(1.75, 0.35, 0.6)), Limit(0.25, polygon_m=ring(2.2, -1.5, 0.6)))
"""Two fields that no single simple shape can cover."""
PANEL = Rectangle((1.25, 2.2), (-0.15, 0.8))
MIXED = nearer("tcp", (0.0, 0.83), (0.3, 1.17), (0.7, 1.74))
CASES = (
    Case("scanner-visits", "presence", Rule((Limit(0.35, present=True),))),
    Case("box-picking", TO_TCP, Rule(nearer("tcp", (0.0, 1.1), (0.3, 1.63), (0.7, 2.17)))),
    Case("scanner-visits", TO_TCP_FLAT, Rule(nearer("tcp-floor", (0.0, 0.75), (0.3, 1.14), (0.7, 1.88)))),
    Case("box-picking", TO_BASE, Rule(nearer("base", (0.0, 1.57), (0.4, 2.31)))),
    Case("scanner-visits", TO_LINK, Rule(nearer("link", (0.0, 0.85), (0.4, 1.42)))),
    Case("scanner-visits", BOX, Rule((inside(0.25, PANEL),))),
    Case("scanner-visits", TURNED, Rule((inside(0.25, Rectangle((1.3, 2.25), (-0.7, 0.2), 20.0)),))),
    Case("box-picking", TO_TCP, Rule(nearer("tcp", (0.0, 1.02), (0.4, 1.71))), {"hysteresis_m": 0.12}),
    Case("scanner-visits", BOX, Rule((inside(0.25, PANEL),)), {"hysteresis_m": 0.15}),
    Case(
        "scanner-visits",
        f"{TO_TCP}, or {BOX}",
        Rule((*MIXED, inside(0.3, PANEL))),
        {"hysteresis_m": 0.1, "latency_s": 0.08},
    ),
    Case(
        "scanner-visits",
        f"{TO_TCP}, or {BOX}",
        Rule((*MIXED, inside(0.3, Rectangle((2.25, 3.0), (0.75, 1.5))))),
    ),
    Case("scanner-visits", "polygon on the floor", Rule((Limit(0.25, polygon_m=POLYGON),))),
    Case(
        "scanner-visits",
        "robot in a rectangle on the floor",
        Rule((Limit(0.25, robot_polygon_m=REGION.corners()),)),
        robot=REGION,
    ),
    Case(
        "scanner-visits",
        f"presence {WHILE}",
        Rule((Limit(0.25, present=True, robot_polygon_m=REGION.corners()),)),
        robot=REGION,
    ),
    Case(
        "scanner-visits",
        f"{BOX} {WHILE}",
        Rule((Limit(0.25, rectangle=PANEL, robot_polygon_m=REGION.corners()),)),
        robot=REGION,
    ),
    Case("scanner-visits", SIGNAL, Rule(FIELDS), {"latency_s": 0.15}),
    Case("box-picking", TO_TCP, Rule(nearer("tcp", (0.0, 1.02), (0.4, 1.71))), {"hysteresis_m": 0.2, "latency_s": 0.2}),
    Case("scanner-visits", BOX, Rule((inside(0.25, PANEL),)), {"hysteresis_m": 0.15, "latency_s": 0.15}),
    Case("box-picking", TO_TCP, Rule(nearer("tcp", (0.0, 1.1), (0.3, 1.63), (0.7, 2.17))), {"latency_s": 0.25}),
    Case(
        "scanner-visits",
        f"{TO_TCP}, or {BOX}",
        Rule((*MIXED, inside(0.3, Rectangle((2.25, 3.0), (0.75, 1.5))))),
        {"hysteresis_m": 0.15, "latency_s": 0.25},
    ),
)


def main() -> None:
    """Simulate, find the rules, print one row per cell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--executions", type=int, default=60)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--cases", type=int, nargs="*", default=range(1, len(CASES) + 1))
    asked = parser.parse_args()
    shown = Table(
        "hidden rule",
        "scene",
        "kind found",
        "explained",
        "threshold error, m",
        "corner error, m",
        "interval coverage",
        "CPU s",
    )
    for number in asked.cases:
        case = CASES[number - 1]
        dataset = logged(case, asked.work / f"{number}-{asked.seed}-{asked.executions}-{asked.noise:g}", asked)
        shown.add_row(*_row(case, dataset))
    Console(width=200).print(shown)


def _row(case: Case, dataset: Dataset) -> list[str]:
    begin = time.process_time()
    found = rule_of(dataset, dataset.levels)
    took_s, rule = f"{time.process_time() - begin:.1f}", found.rule
    if rule is None:
        best = max(found.explained, key=lambda name: found.explained[name], default="")
        return [case.kind, case.scene, f"none ({best})", f"{found.explained.get(best, 0.0):.2%}", "", "", "", took_s]
    named = "yes" if kind_of(rule) == case.kind else kind_of(rule)
    worst = [threshold_off(case, rule), corner_off(case, rule)]
    off = ["none" if off == -np.inf else "missing" if off == np.inf else f"{off:.4f}" for off in worst]
    return [case.kind, case.scene, named, f"{rule.explained:.2%}", *off, intervals(case, rule), took_s]


def logged(case: Case, folder: Path, asked: argparse.Namespace) -> Dataset:
    """Return the logs of a hidden rule; made once per folder."""
    if not (folder / "dataset").is_dir():
        options = SimulationOptions(delta_m=asked.noise, rule=case.rule, **case.options)  # type: ignore[arg-type]
        simulate(case.scene, folder / "logs", executions=asked.executions, seed=asked.seed, options=options)
        if case.family == SIGNAL:
            with_signals(folder / "logs", case.options["latency_s"], asked.seed)
        ingest([folder / "logs"], folder / "dataset")
    return Dataset.open(folder / "dataset")


def threshold_off(case: Case, rule: RuleCard) -> float:
    """Return the maximum error of the thresholds, m; inf if one is missing, -inf if there are none."""
    margin_m, worst = case.options.get("hysteresis_m", 0.0), -np.inf
    for hidden in case.rule.limits:
        if hidden.below_m is None:
            continue
        limit = _limit(hidden, rule)
        regions = [] if limit is None else [(limit.within, 0.0), (limit.until, margin_m)]
        for region, by_m in regions:
            if region is not None:
                found = region.nearer[0].metres.value if region.nearer else np.inf
                worst = max(worst, abs(found - hidden.below_m - by_m))
    return worst


def corner_off(case: Case, rule: RuleCard) -> float:
    """Return the maximum error of the corners, m; inf and -inf as in `threshold_off`.

    Of a polygon, a corner too many counts by its distance from the nearest true one.
    """
    margin_m, worst = case.options.get("hysteresis_m", 0.0), -np.inf
    for hidden in case.rule.limits:
        if hidden.rectangle is None:
            continue
        limit = _limit(hidden, rule)
        for region, by_m in [] if limit is None else [(limit.within, 0.0), (limit.until, margin_m)]:
            if region is not None:
                found = corners(region.rectangles[0]) if region.rectangles else None
                worst = max(worst, _off(hidden.rectangle.corners(by_m), found))
    for hidden in case.rule.limits if case.family != SIGNAL else ():
        limit = _limit(hidden, rule)
        for polygon in () if limit is None or not hidden.polygon_m else limit.within.polygons:
            seen = polygon_corners(polygon)
            worst = max(worst, _off(hidden.polygon_m, seen), _off(seen or (), list(hidden.polygon_m)))
        region = None if limit is None else limit.within.robot
        if region is not None and case.robot is not None:
            truth = (*case.robot.x_m, *case.robot.y_m)
            for edge, at in zip((*region.along, *region.across), truth, strict=True):
                worst = max(worst, -np.inf if edge is None else abs(edge.value - at))
    return worst


def _off(truth: Iterable[tuple[float, float]], found: list[tuple[float, float]] | None) -> float:
    apart = (min((float(np.hypot(x - a, y - b)) for a, b in found or ()), default=np.inf) for x, y in truth)
    return max(apart, default=-np.inf)


def intervals(case: Case, rule: RuleCard) -> str:
    """Return the number of 95 % intervals of thresholds, axis-parallel edges and sides that contain the truth."""
    margin_m, hold = case.options.get("hysteresis_m", 0.0), list[bool]()
    for hidden in case.rule.limits:
        limit = _limit(hidden, rule)
        for region, by_m in [] if limit is None else [(limit.within, 0.0), (limit.until, margin_m)]:
            if region is None:
                continue
            if hidden.below_m is not None:
                pairs = [(near.metres, hidden.below_m + by_m) for near in region.nearer]
            elif hidden.polygon_m:
                pairs = [pair for polygon in region.polygons if not by_m for pair in _sides(hidden.polygon_m, polygon)]
            else:
                pairs = _edges(hidden.rectangle, region, by_m)
            hold += [(metres.low or -np.inf) <= at <= (metres.high or np.inf) for metres, at in pairs]
    return f"{sum(hold)} of {len(hold)}" if hold else "none"


def _edges(hidden: Rectangle | None, region: RegionCard, by_m: float) -> list[tuple[MetresCard, float]]:
    """Return axis-parallel edges with their true positions."""
    if hidden is None or hidden.turned_deg:
        return []
    truth = [at + by for at, by in zip((*hidden.x_m, *hidden.y_m), (-by_m, by_m, -by_m, by_m), strict=True)]
    return [
        (edge, at)
        for rectangle in region.rectangles
        for edge, at in zip((*rectangle.along, *rectangle.across), truth, strict=True)
        if edge is not None
    ]


def _sides(truth: Sequence[tuple[float, float]], polygon: PolygonCard) -> list[tuple[MetresCard, float]]:
    """Return the sides with their true positions: where the normal through the middle of a side meets the truth."""
    found = polygon_corners(polygon)
    pairs = []
    for number, side in enumerate(polygon.sides if found else ()):
        middle = np.mean([found[number - 1], found[number]], axis=0) if found else np.zeros(2)
        normal = np.array([np.cos(side.angle_rad), np.sin(side.angle_rad)])
        off = np.inf
        for one, other in pairwise(np.array([*truth, truth[0]])):
            way = other - one
            if abs(normal[0] * way[1] - normal[1] * way[0]) > 0.5 * np.linalg.norm(way):
                at = float(np.linalg.solve(np.column_stack([normal, -way]), one - middle)[0])
                off = min(off, at, key=abs)
        pairs.append((side.metres, side.metres.value + off))
    return pairs


def _limit(hidden: Limit, rule: RuleCard) -> LimitCard | None:
    return next((limit for limit in rule.limits if abs(limit.scaling - hidden.scaling) < 0.02), None)


if __name__ == "__main__":
    main()
