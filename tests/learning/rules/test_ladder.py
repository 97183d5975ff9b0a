"""Hidden rules are found again from samples: their kind, their thresholds, their corners."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from cyclekit.dataset.cards.rule import RegionCard
from cyclekit.learning.rules.cuts import LimitRows
from cyclekit.learning.rules.families import FAMILIES
from cyclekit.learning.rules.families.robot import ROBOT
from cyclekit.learning.rules.ladder import find_rule
from cyclekit.learning.rules.polygons import polygons
from cyclekit.learning.rules.samples.distances import TO_LINK, TO_TCP, to_links
from cyclekit.learning.rules.samples.positions import Positions
from cyclekit.learning.rules.samples.quantities import quantities
from cyclekit.learning.rules.samples.regions import corners, polygon_corners
from cyclekit.learning.rules.samples.rows import RuleRows, hidden_for_long
from cyclekit.learning.rules.words import sentences, verdict

LEVELS = (0.0, 0.5, 1.0)
ROWS, EXECUTIONS = 400, 30

FEW = ("presence", TO_TCP, "rectangle on the floor", f"{TO_TCP}, or rectangle on the floor")
EVERY = pytest.param(tuple(FAMILIES), marks=pytest.mark.slow)
OF_KINDS = pytest.mark.parametrize("kinds", [FEW, EVERY], ids=["few", "all"])


def walks(*, away: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A robot and somebody who walks at up to 1.5 m/s, ten times a second: TCP and operator (N, 3), execution (N,)."""
    rng = np.random.default_rng(0)
    t = np.arange(ROWS) / 10
    robots, humans = [], []
    for _ in range(EXECUTIONS):
        phase = rng.uniform(0, 6.3, 6)
        robots.append(np.stack([0.5 * np.sin(t + phase[0]), 0.4 * np.sin(0.7 * t + phase[1]), 0.2 + 0 * t], axis=1))
        x = 0.6 + 1.6 * np.sin(0.5 * t + phase[2]) + 0.5 * np.sin(1.1 * t + phase[3])
        y = 1.4 * np.sin(0.45 * t + phase[4]) + 0.5 * np.sin(0.9 * t + phase[5])
        human = np.stack([x, y, 0.2 + 0 * t], axis=1)
        human[: ROWS // 4 if away else 0] = np.nan
        humans.append(human)
    return np.concatenate(robots), np.concatenate(humans), np.repeat(np.arange(EXECUTIONS), ROWS)


def rows_by(step: Any, *, margin_m: float = 0.0, noise_m: float = 0.0, away: bool = False) -> RuleRows:
    """Rows of which `step(robot, human, margin)` is the commanded level, with a hysteresis of `margin_m`."""
    robot, human, execution = walks(away=away)
    level = step(robot, human, 0.0)
    for part in np.split(np.arange(len(level)), np.flatnonzero(np.diff(execution)) + 1) if margin_m else ():
        last, held = int(level[part[0]]), []
        for inner, outer in zip(level[part].tolist(), step(robot[part], human[part], margin_m).tolist(), strict=True):
            last = min(max(last, outer), inner)
            held.append(last)
        level[part] = held
    noise = np.random.default_rng(1).normal(0.0, noise_m, human.shape)
    return RuleRows.made(robot, human + noise, level, execution)


def test_no_change_of_level_is_seen_across_a_ramp_that_hid_it_for_long():
    level = np.array([1, 1, -1, 2, 2, -1, -1, 1])
    t_s = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 1.5, 1.6])
    run = hidden_for_long(level >= 0, t_s)
    made = RuleRows.made(np.zeros((8, 3)), np.ones((8, 3)), level, np.zeros(8, np.int64), stretch=run)
    assert made.before.tolist() == [-1, 0, 1, 2, -1]


def apart(robot: np.ndarray, human: np.ndarray) -> np.ndarray:
    return np.asarray(np.nan_to_num(np.linalg.norm(robot - human, axis=1), nan=np.inf))


def by_distance(robot: np.ndarray, human: np.ndarray, margin_m: float) -> np.ndarray:
    return np.searchsorted(np.array([0.7, 1.2]) + margin_m, apart(robot, human), side="left")


def in_box(human: np.ndarray, margin_m: float, degrees: float = 0.0) -> np.ndarray:
    turn = np.deg2rad(degrees)
    u = human[:, 0] * np.cos(turn) + human[:, 1] * np.sin(turn)
    v = human[:, 1] * np.cos(turn) - human[:, 0] * np.sin(turn)
    inside = (u > 0.1 - margin_m) & (u < 1.3 + margin_m)
    return np.asarray(inside & (v > -0.6 - margin_m) & (v < 0.7 + margin_m))


def by_box(_robot: np.ndarray, human: np.ndarray, margin_m: float) -> np.ndarray:
    return np.where(in_box(human, margin_m), 1, 2)


def by_turned_box(_robot: np.ndarray, human: np.ndarray, margin_m: float) -> np.ndarray:
    return np.where(in_box(human, margin_m, 25.0), 0, 2)


def by_either(robot: np.ndarray, human: np.ndarray, margin_m: float) -> np.ndarray:
    return np.where(
        in_box(human, margin_m),
        np.minimum(1, by_distance(robot, human, margin_m)),
        np.where(apart(robot, human) < 0.7 + margin_m, 0, 2),
    )


def presence(_robot: np.ndarray, human: np.ndarray, _margin_m: float) -> np.ndarray:
    return np.where(np.isnan(human[:, 0]), 2, 1)


def thresholds(found: Any) -> list[float]:
    return [metres.value for metres in quantities(found.rule.limits).values()]


def test_presence_is_the_simplest_rule() -> None:
    found = find_rule(rows_by(presence, away=True), LEVELS)
    assert found.rule is not None
    assert (found.rule.family, found.rule.explained, list(found.explained)) == ("presence", 1.0, ["presence"])
    assert sentences(found.rule) == ["speed 50 % when the operator is in the cell", "speed 100 % otherwise"]


def test_a_distance_is_named_with_its_thresholds_and_intervals() -> None:
    found = find_rule(rows_by(by_distance), LEVELS)
    assert found.rule is not None
    assert (found.rule.family, found.rule.hysteresis) == (TO_TCP, False)
    assert thresholds(found) == pytest.approx([0.7, 1.2], abs=0.005)
    for metres, truth in zip(quantities(found.rule.limits).values(), (0.7, 1.2), strict=True):
        assert metres.low is not None
        assert metres.high is not None
        assert metres.low <= truth <= metres.high < metres.low + 0.02
    assert sentences(found.rule)[0].startswith("stop (speed 0 %) when the operator is nearer than 0.70")


def test_hysteresis_has_two_thresholds_and_not_their_middle() -> None:
    found = find_rule(rows_by(by_distance, margin_m=0.15), LEVELS)
    assert found.rule is not None
    assert (found.rule.family, found.rule.hysteresis) == (TO_TCP, True)
    assert thresholds(found) == pytest.approx([0.7, 0.85, 1.2, 1.35], abs=0.01)
    assert "; faster again when the operator is farther than 1.3" in sentences(found.rule)[1]


@pytest.mark.parametrize(
    ("step", "degrees", "margin_m"), [(by_box, 0.0, 0.0), (by_box, 0.0, 0.1), (by_turned_box, 25.0, 0.0)]
)
def test_a_rectangle_is_named_by_its_corners(step: Any, degrees: float, margin_m: float) -> None:
    found = find_rule(rows_by(step, margin_m=margin_m), LEVELS)
    assert found.rule is not None
    assert found.rule.family == ("turned rectangle on the floor" if degrees else "rectangle on the floor")
    assert found.rule.hysteresis == (margin_m > 0)
    (limit,) = found.rule.limits
    turn = np.deg2rad(degrees)
    for region, by_m in ((limit.within, 0.0), (limit.until, margin_m)):
        if region is None:
            continue
        frame = [
            (0.1 - by_m, -0.6 - by_m),
            (1.3 + by_m, -0.6 - by_m),
            (1.3 + by_m, 0.7 + by_m),
            (0.1 - by_m, 0.7 + by_m),
        ]
        truth = [(u * np.cos(turn) - v * np.sin(turn), u * np.sin(turn) + v * np.cos(turn)) for u, v in frame]
        seen = corners(region.rectangles[0])
        assert seen is not None
        assert max(min(np.hypot(x - a, y - b) for x, y in seen) for a, b in truth) < 0.03


def test_a_rectangle_and_a_distance_are_told_apart() -> None:
    found = find_rule(rows_by(by_either), LEVELS)
    assert found.rule is not None
    assert found.rule.family == f"{TO_TCP}, or rectangle on the floor"
    stop, half = found.rule.limits
    assert stop.within.nearer[0].metres.value == pytest.approx(0.7, abs=0.01)
    assert not stop.within.rectangles
    assert not half.within.nearer
    assert np.array(corners(half.within.rectangles[0])) == pytest.approx(
        np.array([(0.1, -0.6), (1.3, -0.6), (1.3, 0.7), (0.1, 0.7)]), abs=0.03
    )


FAR_BOX_M = np.array([(1.7, 2.4), (0.3, 1.2)])


def by_distance_or_far_box(robot: np.ndarray, human: np.ndarray, margin_m: float) -> np.ndarray:
    low, high = FAR_BOX_M.T + margin_m * np.array([[-1.0], [1.0]])
    far = ((human[:, :2] > low) & (human[:, :2] < high)).all(axis=1)
    return np.where(far, np.minimum(1, by_distance(robot, human, margin_m)), by_distance(robot, human, margin_m))


@OF_KINDS
def test_a_rectangle_that_slows_like_a_distance_with_hysteresis_is_told_apart_from_it(kinds: tuple[str, ...]) -> None:
    found = find_rule(rows_by(by_distance_or_far_box, margin_m=0.2, noise_m=0.02), LEVELS, kinds=kinds)
    assert found.rule is not None
    assert (found.rule.family, found.rule.hysteresis) == (f"{TO_TCP}, or rectangle on the floor", True)
    half = found.rule.limits[1]
    assert half.until is not None
    at_m = [region.nearer[0].metres.value for region in (half.within, half.until)]
    assert at_m == pytest.approx([1.2, 1.4], abs=0.02)
    edges = (*half.within.rectangles[0].along, *half.within.rectangles[0].across)
    assert [edge.value for edge in edges if edge is not None] == pytest.approx(FAR_BOX_M.ravel().tolist(), abs=0.05)


POLYGON_M = np.array([(-0.6, -0.7), (0.9, -0.9), (1.6, 0.1), (0.7, 0.9), (-0.5, 0.5)])


def in_polygon(human: np.ndarray) -> np.ndarray:
    way = np.roll(POLYGON_M, -1, axis=0) - POLYGON_M
    to = human[:, None, :2] - POLYGON_M
    return np.asarray((way[:, 0] * to[..., 1] - way[:, 1] * to[..., 0] > 0).all(axis=1))


def test_the_sides_of_a_polygon_are_looked_at_closely_only_where_it_explains_the_level(monkeypatch: Any) -> None:
    looked: list[int] = []
    monkeypatch.setattr(polygons, "needed", lambda state, *_: (looked.append(len(state.angle_rad)), state)[1])
    for slow_outside in (True, False):
        levels = (2, 1) if slow_outside else (1, 2)
        rows = rows_by(lambda _robot, human, _margin, levels=levels: np.where(in_polygon(human), *levels))
        find_rule(rows, LEVELS, kinds=["polygon on the floor"])
        assert bool(looked) is not slow_outside


def test_a_polygon_is_named_by_its_corners() -> None:
    found = find_rule(rows_by(lambda _robot, human, _margin: np.where(in_polygon(human), 1, 2)), LEVELS)
    assert found.rule is not None
    assert (found.rule.family, found.rule.hysteresis) == ("polygon on the floor", False)
    (polygon,) = found.rule.limits[0].within.polygons
    seen = np.array(polygon_corners(polygon))
    assert len(seen) == len(POLYGON_M)
    assert max(np.linalg.norm(seen - corner, axis=1).min() for corner in POLYGON_M) < 0.03
    assert "in the polygon with corners (" in sentences(found.rule)[0]


def in_robot_region(robot: np.ndarray) -> np.ndarray:
    return np.asarray((robot[:, 0] > 0.1) & (robot[:, 1] < 0.25))


@pytest.mark.parametrize(
    ("field", "family"),
    [
        (lambda human: np.ones(len(human), np.bool_), "robot in a rectangle on the floor"),
        (lambda human: np.isfinite(human[:, 0]), "presence while the robot is in a rectangle on the floor"),
        (lambda human: in_box(human, 0.0), "rectangle on the floor while the robot is in a rectangle on the floor"),
    ],
)
def test_a_region_of_the_robot_is_named_alone_and_beside_a_field(field: Any, family: str) -> None:
    def step(robot: np.ndarray, human: np.ndarray, _margin: float) -> np.ndarray:
        return np.where(in_robot_region(robot) & field(human), 1, 2)

    found = find_rule(rows_by(step, away=True), LEVELS)
    assert found.rule is not None
    assert found.rule.family == family
    region = found.rule.limits[0].within
    assert region.robot is not None
    assert region.robot.along[0] is not None
    assert region.robot.along[0].value == pytest.approx(0.1, abs=0.01)
    assert region.robot.across[1] is not None
    assert region.robot.across[1].value == pytest.approx(0.25, abs=0.01)
    assert "the TCP is in the rectangle x from 0." in sentences(found.rule)[0]


@pytest.mark.parametrize("everywhere", [False, True])
def test_no_rectangle_of_the_robot_is_kept_if_its_edges_explain_nothing(everywhere: bool) -> None:
    robot, human, _ = walks(away=True)
    there = np.isfinite(human[:, 0]) if everywhere else in_box(human, 0.0)
    rows = LimitRows(Positions({}, human[:, :2], robot[:, :2]), there, np.ones(len(human)))
    name = "presence" if everywhere else "rectangle on the floor"
    region = ROBOT[f"{name} while the robot is in a rectangle on the floor"].fit(rows, None)
    assert region.robot is None
    assert rows.wrong(region) == 0.0


def test_a_robot_that_is_always_slow_has_no_region() -> None:
    robot, human, _ = walks()
    rows = LimitRows(Positions({}, human[:, :2], robot[:, :2]), np.ones(len(human), np.bool_), np.ones(len(human)))
    assert ROBOT["robot in a rectangle on the floor"].fit(rows, None) == RegionCard()


@pytest.mark.slow
@pytest.mark.parametrize("step", [by_distance, by_box, by_either])
def test_labels_that_are_wrong_now_and_then_hide_no_rule(step: Any) -> None:
    robot, human, execution = walks()
    level, rng = step(robot, human, 0.0), np.random.default_rng(3)
    clean = find_rule(RuleRows.made(robot, human, level, execution), LEVELS).rule
    level = np.where(rng.random(len(level)) < 0.003, rng.integers(0, 3, len(level)), level)
    found = find_rule(RuleRows.made(robot, human, level, execution), LEVELS).rule
    assert clean is not None
    assert found is not None
    assert (found.family, found.hysteresis) == (clean.family, clean.hysteresis)
    truth, seen = quantities(clean.limits), quantities(found.limits)
    assert set(truth) == set(seen)
    assert max(abs(seen[place].value - metres.value) for place, metres in truth.items()) < 0.015


@OF_KINDS
def test_labels_that_are_wrong_together_in_one_execution_hide_no_rule(kinds: tuple[str, ...]) -> None:
    rows = rows_by(by_distance, noise_m=0.02)
    held_out = np.arange(6)
    at = np.flatnonzero((rows.execution == 2) & (rows.apart_m[TO_TCP] > 2.0))[:16]  # of 2400 that are judged: 0.7 %
    level = rows.level.copy()
    level[at] = 0
    found = find_rule(replace(rows, level=level), LEVELS, held_out=held_out, kinds=kinds)
    assert found.rule is not None
    assert found.rule.family == TO_TCP
    all_over = rows.level.copy()
    for number in held_out.tolist():  # as wrong in every execution: there is another cause
        all_over[np.flatnonzero((rows.execution == number) & (rows.apart_m[TO_TCP] > 2.0))[:16]] = 0
    assert find_rule(replace(rows, level=all_over), LEVELS, held_out=held_out, kinds=kinds).rule is None


@OF_KINDS
def test_a_rule_that_explains_not_all_answers_where_the_network_explains_far_less(kinds: tuple[str, ...]) -> None:
    """People whom the tracker misses stop the robot in every execution: no rule can know that."""
    rows, rng = rows_by(by_distance, noise_m=0.02), np.random.default_rng(5)
    level = rows.level.copy()
    level[(rows.apart_m[TO_TCP] > 1.6) & (rng.random(len(rows)) < 0.03)] = 0
    rows, draws = replace(rows, level=level), rng.random(len(rows))
    for wrong, family in ((0.08, TO_TCP), (0.005, None), (None, None)):
        network = None if wrong is None else np.where(draws < wrong, (level + 1) % 3, level)
        found = find_rule(rows, LEVELS, network=network, kinds=kinds).rule
        assert (None if found is None else found.family) == family


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_no_rule_is_named_where_the_level_follows_the_floor_smoothly(seed: int) -> None:
    robot, human, execution = walks()
    rng = np.random.default_rng(seed)
    waves = sum(np.cos(human[:, :2] @ rng.normal(0, 1.5, 2) + rng.uniform(0, 6.3)) for _ in range(30)) / 4
    level = np.searchsorted([-0.6, 0.3], waves)
    assert find_rule(RuleRows.made(robot, human, level, execution), LEVELS).rule is None


@pytest.mark.slow
def test_noise_is_no_hysteresis_and_moves_no_threshold() -> None:
    found = find_rule(rows_by(by_distance, noise_m=0.05), LEVELS)
    assert found.rule is not None
    assert (found.rule.family, found.rule.hysteresis) == (TO_TCP, False)
    assert found.rule.explained < 0.99
    assert thresholds(found) == pytest.approx([0.7, 1.2], abs=0.015)


@OF_KINDS
def test_a_hysteresis_of_a_centimetre_is_none(kinds: tuple[str, ...]) -> None:
    found = find_rule(rows_by(by_distance, margin_m=0.01), LEVELS, kinds=kinds)
    assert found.rule is not None
    assert (found.rule.family, found.rule.hysteresis) == (TO_TCP, False)


def test_what_no_rule_explains_is_left_to_the_network() -> None:
    rows = rows_by(lambda _robot, human, _margin: np.where(np.sin(4 * human[:, 0]) * np.sin(4 * human[:, 1]) > 0, 0, 2))
    found = find_rule(rows, LEVELS, network=rows.level)
    assert found.rule is None
    assert found.network == 1.0
    assert verdict(found).startswith("no simple rule explains the commanded level; best: ")


def test_the_nearest_link_is_as_far_as_its_nearest_point() -> None:
    points = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]] * 3)
    human = np.array([[0.5, 0.0, 1.5], [0.0, 2.0, 0.5], [3.0, 0.0, 1.0]])
    assert to_links(points, human).tolist() == pytest.approx([0.5, 2.0, 2.0])
    assert FAMILIES[TO_LINK].uses == (TO_LINK,)


def test_simpler_kinds_come_first() -> None:
    mixed = [family.mixed for family in FAMILIES.values()]
    assert all(first <= second for first, second in pairwise(mixed))
    assert next(iter(FAMILIES)) == "presence"


def test_what_a_rising_ramp_hides_moves_no_edge() -> None:
    margin_m, hidden = 0.1, 4
    rows = rows_by(by_box, margin_m=margin_m)
    level = rows.level.copy()
    rises = np.flatnonzero((rows.before >= 0) & (level > level[rows.before]))
    for row in rises.tolist():  # the box asks for level 1 of 3, and the ramp passes level 2 of 3 on its way
        level[row : row + hidden] = np.where(level[row : row + hidden] == 2, 1.5, level[row : row + hidden])
    seen = RuleRows.made(rows.at_m[:, :3], rows.at_m[:, 3:], level, rows.execution)
    found = find_rule(seen, LEVELS)
    assert found.rule is not None
    assert found.rule.family == "rectangle on the floor"
    edges_m = [m.value for place, m in quantities(found.rule.limits).items() if place.until]
    assert edges_m == pytest.approx([0.0, 1.4, -0.7, 0.8], abs=0.02)


@pytest.mark.parametrize(("wide_m", "found"), [(0.0, False), (0.1, True)])
def test_the_one_place_where_the_robot_is_slow_is_no_region(wide_m: float, found: bool) -> None:
    robot, human, _ = walks()
    robot = np.round(robot, 2)
    slow = np.abs(robot[:, 0] - np.median(robot[:, 0])) <= wide_m / 2.0
    rows = LimitRows(Positions({}, human[:, :2], robot[:, :2]), slow, np.ones(len(human)))
    assert (ROBOT["robot in a rectangle on the floor"].fit(rows, None) != RegionCard()) == found
