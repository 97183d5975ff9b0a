"""Hidden rules: is the kind named, and how far off are thresholds and corners?

Each cell of the simulator is given a safety function that no log tells; its truth lies beside the logs in
`truth/truth.json`. The logs are ingested as any logs, and `find_rule` sees the dataset alone. A cell counts where the
kind of rule is named, thresholds are within 1 cm and corners within 3 cm.

In the tenth the left edge of the rectangle lies behind the distance, where few operators show it; in the eleventh the
rectangle lies apart. Of a region of the robot the edges that the TCP crosses count as corners. The last goes by a bit
in the events, beside one by which the robot tells that it is slow, and one of a gripper.

The limits of the method were chosen on the scenes as they are, with seed 3.

    python benchmarks/rules.py --work DIR --executions 60 --seed 11
"""

from __future__ import annotations

import argparse
import time
from dataclasses import InitVar, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree

from cyclekit.dataset.cards.rule import RuleCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.rules.distances import TO_BASE, TO_LINK, TO_TCP, TO_TCP_FLAT, to_links
from cyclekit.learning.rules.of_dataset import rule_of
from cyclekit.learning.rules.regions import corners, polygon_corners
from cyclekit.learning.rules.words import kind_of
from cyclekit_sim import SimulationOptions, simulate
from cyclekit_sim.arm import link_frames
from cyclekit_sim.plan import prepare
from cyclekit_sim.scenes import BUILT_IN

if TYPE_CHECKING:
    from collections.abc import Iterable

Array = NDArray[np.float64]
Box = tuple[float, float, float, float, float]
"""From and to along, from and to across, m; and by how many degrees the rectangle is turned."""
THRESHOLD_M, CORNER_M = 0.01, 0.03


@dataclass(frozen=True)
class Hidden:
    """A safety function: thresholds on one distance, rectangles, both or mere presence; each level has at most one.

    Its last level but one may also hold in a polygon, and all of it only while the TCP is in a rectangle
    (`robot`), or whenever it is (`alone`).
    """

    levels: tuple[float, ...]
    distance: str = ""
    thresholds_m: dict[int, float] = field(default_factory=dict)
    boxes: dict[int, Box] = field(default_factory=dict)
    present: int | None = None
    polygon: tuple[tuple[float, float], ...] = ()
    robot: Box | None = None
    alone: bool = False

    def step(self, tcp_m: Array, person_m: Array, margin_m: float) -> NDArray[np.int64]:
        """Return the step of each pair, all boundaries moved outwards by `margin_m`."""
        found = np.full(len(person_m), len(self.levels) - 1)
        if self.present is not None:
            found[person_m[:, 0] < 1e5] = self.present
        apart = self.apart(tcp_m, person_m) if self.distance else np.full(len(person_m), np.inf)
        for step in reversed(range(len(self.levels) - 1)):
            slow = apart <= self.thresholds_m.get(step, -np.inf) + margin_m
            if step in self.boxes:
                slow |= _in(self.boxes[step], person_m, margin_m)
            found[slow] = np.minimum(found[slow], step)
        if self.polygon:
            found[_in_polygon(self.polygon, person_m)] = len(self.levels) - 2
        if self.robot is not None:
            there = _in(self.robot, tcp_m, 0.0)
            found = np.where(there, len(self.levels) - 2 if self.alone else found, len(self.levels) - 1)
        return found

    def apart(self, tcp_m: Array, person_m: Array) -> Array:
        """Return the distance that counts, (B,), m."""
        if self.distance == TO_BASE:
            return np.asarray(np.linalg.norm(person_m[:, :2], axis=1))
        way = tcp_m - person_m
        return np.asarray(np.linalg.norm(way[:, :2] if self.distance == TO_TCP_FLAT else way, axis=1))


class HiddenLinks:
    """The distance of the nearest link: joints are those of the planned motions at the same TCP."""

    def __init__(self, hidden: Hidden, scene: str, executions: int, seed: int) -> None:
        table = prepare(BUILT_IN[scene], seed, SimulationOptions(), executions=executions).table
        self._tree, self._q_rad, self.levels, self._hidden = cKDTree(table.tcp_m), table.q_rad, hidden.levels, hidden

    def step(self, tcp_m: Array, person_m: Array, margin_m: float) -> NDArray[np.int64]:
        """Return the step by the nearest link."""
        origins, _, _ = link_frames(self._q_rad[self._tree.query(tcp_m)[1]])
        apart = to_links(np.concatenate([origins.transpose(1, 0, 2), tcp_m[:, None]], axis=1), person_m)
        edges = np.array([self._hidden.thresholds_m[step] for step in range(len(self.levels) - 1)])
        return np.asarray(np.searchsorted(edges + margin_m, apart, side="left"))


@dataclass(frozen=True)
class Case:
    """One hidden rule in one scene."""

    scene: str
    family: str
    hidden: Hidden
    options: dict[str, float] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """The kind that is to be named."""
        return f"{self.family}, with hysteresis" if "hysteresis_m" in self.options else self.family


class HiddenSignal:
    """A level that no position tells in a simple way, but a bit in the events."""

    def __init__(self, hidden: Hidden) -> None:
        self.levels = hidden.levels

    def step(self, _tcp_m: Array, person_m: Array, _margin_m: float) -> NDArray[np.int64]:
        """Return the slow level in one of two fields that no straight line divides."""
        near = [np.linalg.norm(person_m[:, :2] - centre, axis=1) < 0.6 for centre in ((1.75, 0.35), (2.2, -1.5))]
        return np.where(near[0] | near[1], 0, 1)


def with_signals(logs: Path, delay_s: float, seed: int) -> None:
    """Write events: the bit that the speed answers to, one by which the robot tells that it is slow, and a gripper."""
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


BOX, TURNED = "rectangle on the floor", "turned rectangle on the floor"
WHILE = "while the robot is in a rectangle on the floor"
SIGNAL = "signal"
CLOCK_S = 147.512
"""The clock of the robot's log less that of the events', as the simulator writes them."""
REGION: Box = (0.15, 1.5, -1.0, 1.0, 0.0)
POLYGON = ((1.0, -0.3), (2.0, -0.6), (2.5, 0.2), (2.1, 1.0), (1.2, 0.9))
PANEL: Box = (1.25, 2.2, -0.15, 0.8, 0.0)
THREE, FOUR = (0.0, 0.4, 1.0), (0.0, 0.3, 0.7, 1.0)
CASES = (
    Case("scanner-visits", "presence", Hidden((0.35, 1.0), present=0)),
    Case("box-picking", TO_TCP, Hidden(FOUR, TO_TCP, {0: 1.1, 1: 1.63, 2: 2.17})),
    Case("scanner-visits", TO_TCP_FLAT, Hidden(FOUR, TO_TCP_FLAT, {0: 0.75, 1: 1.14, 2: 1.88})),
    Case("box-picking", TO_BASE, Hidden(THREE, TO_BASE, {0: 1.57, 1: 2.31})),
    Case("scanner-visits", TO_LINK, Hidden(THREE, TO_LINK, {0: 0.85, 1: 1.42})),
    Case("scanner-visits", BOX, Hidden((0.25, 1.0), boxes={0: PANEL})),
    Case("scanner-visits", TURNED, Hidden((0.25, 1.0), boxes={0: (1.3, 2.25, -0.7, 0.2, 20.0)})),
    Case("box-picking", TO_TCP, Hidden(THREE, TO_TCP, {0: 1.02, 1: 1.71}), {"hysteresis_m": 0.12}),
    Case("scanner-visits", BOX, Hidden((0.25, 1.0), boxes={0: PANEL}), {"hysteresis_m": 0.15}),
    Case(
        "scanner-visits",
        f"{TO_TCP}, or {BOX}",
        Hidden(FOUR, TO_TCP, {0: 0.83, 1: 1.17, 2: 1.74}, {1: PANEL}),
        {"hysteresis_m": 0.1, "latency_s": 0.08},
    ),
    Case(
        "scanner-visits",
        f"{TO_TCP}, or {BOX}",
        Hidden(FOUR, TO_TCP, {0: 0.83, 1: 1.17, 2: 1.74}, {1: (2.25, 3.0, 0.75, 1.5, 0.0)}),
    ),
    Case("scanner-visits", "polygon on the floor", Hidden((0.25, 1.0), polygon=POLYGON)),
    Case("scanner-visits", "robot in a rectangle on the floor", Hidden((0.25, 1.0), robot=REGION, alone=True)),
    Case("scanner-visits", f"presence {WHILE}", Hidden((0.25, 1.0), present=0, robot=REGION)),
    Case("scanner-visits", f"{BOX} {WHILE}", Hidden((0.25, 1.0), boxes={0: PANEL}, robot=REGION)),
    Case("scanner-visits", SIGNAL, Hidden((0.25, 1.0)), {"latency_s": 0.15}),
)


def main() -> None:
    """Simulate, find the rules, print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--executions", type=int, default=60)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--cases", type=int, nargs="*", default=range(1, len(CASES) + 1))
    asked = parser.parse_args()
    off = ("thresholds off, m", "corners off, m", "intervals that hold")
    shown = Table("hidden rule", "scene", "named", "explains", *off, "CPU s")
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
        safety: Any = case.hidden
        if case.hidden.distance == TO_LINK:
            safety = HiddenLinks(case.hidden, case.scene, asked.executions, asked.seed)
        if case.family == SIGNAL:
            safety = HiddenSignal(case.hidden)
        usual = BUILT_IN[case.scene]
        BUILT_IN[case.scene] = replace(usual, safety=_Kept(case.hidden, safety))
        try:
            options = SimulationOptions(delta_m=asked.noise, **case.options)  # type: ignore[arg-type]
            simulate(case.scene, folder / "logs", executions=asked.executions, seed=asked.seed, options=options)
            if case.family == SIGNAL:
                with_signals(folder / "logs", case.options["latency_s"], asked.seed)
        finally:
            BUILT_IN[case.scene] = usual
        ingest([folder / "logs"], folder / "dataset")
    return Dataset.open(folder / "dataset")


@dataclass(frozen=True)
class _Kept:
    """A safety function whose truth is written beside the logs."""

    hidden: Hidden
    function: InitVar[Any]

    def __post_init__(self, function: Any) -> None:  # noqa: ANN401
        """Keep the function where `asdict` does not look."""
        object.__setattr__(self, "_function", function)

    @property
    def levels(self) -> tuple[float, ...]:
        """As of the hidden one."""
        return self.hidden.levels

    def step(self, tcp_m: Array, person_m: Array, margin_m: float) -> NDArray[np.int64]:
        """Return the step by the function."""
        return np.asarray(
            self._function.step(  # type: ignore[attr-defined]
                tcp_m, person_m, margin_m
            )
        )


def threshold_off(case: Case, rule: RuleCard) -> float:
    """Return how far the worst threshold is off, m; infinite where one is missing, -inf where there is none."""
    margin_m, worst = case.options.get("hysteresis_m", 0.0), -np.inf
    for step, metres in case.hidden.thresholds_m.items():
        limit = _limit(case, rule, step)
        regions = [] if limit is None else [(limit.within, 0.0), (limit.until, margin_m)]
        for region, by_m in regions:
            if region is not None:
                found = region.nearer[0].metres.value if region.nearer else np.inf
                worst = max(worst, abs(found - metres - by_m))
    return worst


def corner_off(case: Case, rule: RuleCard) -> float:
    """Return how far the worst corner is off, m; as `threshold_off`."""
    margin_m, worst = case.options.get("hysteresis_m", 0.0), -np.inf
    for step, box in case.hidden.boxes.items():
        limit = _limit(case, rule, step)
        for region, by_m in [] if limit is None else [(limit.within, 0.0), (limit.until, margin_m)]:
            if region is not None:
                found = corners(region.rectangles[0]) if region.rectangles else None
                worst = max(worst, _off(_corners(box, by_m), found))
    if (hidden := case.hidden).polygon or hidden.robot:
        limit = _limit(case, rule, len(hidden.levels) - 2)
        for polygon in () if limit is None or not hidden.polygon else limit.within.polygons:
            worst = max(worst, _off(hidden.polygon, polygon_corners(polygon)))
        region = None if limit is None else limit.within.robot
        for edge, at in zip((*region.along, *region.across), hidden.robot or (), strict=False) if region else ():
            worst = max(worst, -np.inf if edge is None else abs(edge.value - at))
    return worst


def _off(truth: Iterable[tuple[float, float]], found: list[tuple[float, float]] | None) -> float:
    return max(min((float(np.hypot(x - a, y - b)) for a, b in found or ()), default=np.inf) for x, y in truth)


def intervals(case: Case, rule: RuleCard) -> str:
    """Count the 95 % intervals of thresholds, and of edges along the axes, that hold the truth."""
    margin_m, hold = case.options.get("hysteresis_m", 0.0), list[bool]()
    for step in range(len(case.hidden.levels) - 1):
        limit = _limit(case, rule, step)
        for region, by_m in [] if limit is None else [(limit.within, 0.0), (limit.until, margin_m)]:
            if region is None:
                continue
            pairs = [(near.metres, case.hidden.thresholds_m[step] + by_m) for near in region.nearer]
            for rectangle in region.rectangles if case.hidden.boxes.get(step, (1.0,))[-1] == 0.0 else ():
                grown = (-by_m, by_m, -by_m, by_m)
                truth = [at + by for at, by in zip(case.hidden.boxes[step], grown, strict=False)]
                pairs += [
                    (edge, at)
                    for edge, at in zip((*rectangle.along, *rectangle.across), truth, strict=True)
                    if edge is not None
                ]
            hold += [(metres.low or -np.inf) <= at <= (metres.high or np.inf) for metres, at in pairs]
    return f"{sum(hold)} of {len(hold)}" if hold else "none"


def _limit(case: Case, rule: RuleCard, step: int) -> Any:  # noqa: ANN401
    level = case.hidden.levels[step]
    return next((limit for limit in rule.limits if abs(limit.scaling - level) < 0.02), None)


def _in(box: Box, person_m: Array, margin_m: float) -> NDArray[np.bool_]:
    turn = np.deg2rad(box[4])
    along = person_m[:, 0] * np.cos(turn) + person_m[:, 1] * np.sin(turn)
    across = person_m[:, 1] * np.cos(turn) - person_m[:, 0] * np.sin(turn)
    inside = (along >= box[0] - margin_m) & (along <= box[1] + margin_m)
    return np.asarray(inside & (across >= box[2] - margin_m) & (across <= box[3] + margin_m))


def _in_polygon(corners_m: tuple[tuple[float, float], ...], person_m: Array) -> NDArray[np.bool_]:
    begin = np.array(corners_m)
    way, to = np.roll(begin, -1, axis=0) - begin, person_m[:, None, :2] - begin
    return np.asarray((way[:, 0] * to[..., 1] - way[:, 1] * to[..., 0] > 0).all(axis=1))


def _corners(box: Box, by_m: float) -> list[tuple[float, float]]:
    turn = np.deg2rad(box[4])
    left, right, near, far = box[0] - by_m, box[1] + by_m, box[2] - by_m, box[3] + by_m
    frame = [(left, near), (right, near), (right, far), (left, far)]
    return [(u * np.cos(turn) - v * np.sin(turn), u * np.sin(turn) + v * np.cos(turn)) for u, v in frame]


if __name__ == "__main__":
    main()
