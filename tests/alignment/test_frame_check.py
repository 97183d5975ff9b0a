"""The check of a tracker's frame: people cross distances around a moving TCP, seen in a rotated and shifted frame."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.alignment.frame_check import ChangeRows, LevelRows, moved, propose_frame

LATE_S, STEP_S = (0.0, 0.1, 0.2), 0.02
POSE = np.array([np.radians(50.0), 1.6, -0.9, 0.4])


def scene(seed: int, *, in_space: bool = False, noise_m: float = 0.0) -> tuple[LevelRows, ChangeRows]:
    """A robot that is slow within 1.0 m of the operator and stops within 0.7 m, both 0.1 s late; base frame."""
    rng = np.random.default_rng(seed)
    tcp, human = _walk(rng, (-0.6, 0.9), 0.5, 0.3), _walk(rng, (-2.0, 2.4), 1.2, 0.0)
    human[:, 2] = 1.0
    apart = np.linalg.norm(human - tcp if in_space else (human - tcp)[:, :2], axis=1)
    level = np.roll((apart > 0.7).astype(int) + (apart > 1.0), round(0.1 / STEP_S))
    human += rng.normal(0.0, noise_m, human.shape)
    at = np.flatnonzero(np.diff(level)) + 1
    at = at[(at > 50) & (np.abs(level[at] - level[at - 1]) == 1)]
    kind = 2 * np.minimum(level[at], level[at - 1]) + (level[at] > level[at - 1])
    seen = [at - round(late / STEP_S) for late in LATE_S]
    changes = ChangeRows.of(np.stack([tcp[s] for s in seen]), np.stack([human[s][:, None] for s in seen]), kind)
    rows = slice(50, None, 40)
    return LevelRows(tcp[rows], human[rows][:, None], level[rows]), changes


def _walk(rng: np.random.Generator, within_m: tuple[float, float], speed_m_s: float, height_m: float) -> np.ndarray:
    """Positions every STEP_S on straight ways between random points, shape (T, 3), m."""
    points, at = [], np.array([0.0, 0.0, 0.5])
    while sum(map(len, points)) < 80_000:
        goal = np.array([*rng.uniform(*within_m, 2), 0.5 + height_m * rng.uniform(-1.0, 1.0)])
        count = max(2, int(np.linalg.norm(goal - at) / (speed_m_s * rng.uniform(0.7, 1.3)) / STEP_S))
        points.append(np.linspace(at, goal, count, endpoint=False))
        at = goal
    return np.concatenate(points)[:80_000]


def seen_from(pose: np.ndarray, people_m: np.ndarray) -> np.ndarray:
    """People in the tracker's own frame, when `pose` puts them into the base frame."""
    back = np.array([-pose[0], 0.0, 0.0, 0.0])
    return np.concatenate([moved(people_m[..., :2] - pose[1:3], back), people_m[..., 2:] - pose[3]], axis=-1)


def proposed(seed: int, pose: np.ndarray, **how: float):
    rows, changes = scene(seed, **how)
    rows = LevelRows(rows.tcp_m, seen_from(pose, rows.people_m), rows.level)
    return propose_frame(rows, ChangeRows(changes.tcp_m, seen_from(pose, changes.people_m), changes.kind))


@pytest.mark.parametrize(
    ("in_space", "noise_m"), [pytest.param(False, 0.0, marks=pytest.mark.slow), (False, 0.03), (True, 0.0)]
)
def test_a_forgotten_frame_is_proposed(in_space: bool, noise_m: float):
    found = proposed(1, POSE, in_space=in_space, noise_m=noise_m)
    assert found is not None
    assert found.yaw_deg == pytest.approx(50.0, abs=1.5)
    assert found.xyz_m == pytest.approx((1.6, -0.9, 0.4 if in_space else 0.0), abs=0.05)


def test_a_frame_is_proposed_of_a_tracker_without_heights():
    rows, changes = scene(1)
    here, then = (seen_from(POSE, one.people_m) for one in (rows, changes))
    here[..., 2] = then[..., 2] = np.nan
    without = LevelRows(rows.tcp_m, here, rows.level), ChangeRows(changes.tcp_m, then, changes.kind)
    found = propose_frame(*without)
    assert found is not None
    assert found.xyz_m[:2] == pytest.approx((1.6, -0.9), abs=0.05)


def test_the_right_frame_is_left_alone():
    assert proposed(1, np.zeros(4)) is None


def test_levels_that_ignore_the_tool_propose_no_frame():
    rows, changes = scene(2)
    at = changes.people_m[1, :, 0, :2]
    fixed = np.abs(changes.tcp_m - np.array([5.0, 0.0, 0.5]))  # a TCP that has nothing to do with the people
    level = (rows.people_m[:, 0, 0] > 0.3).astype(int) + (rows.people_m[:, 0, 1] > 0.0)
    assert len(at) > 60
    assert (
        propose_frame(LevelRows(rows.tcp_m, rows.people_m, level), ChangeRows(fixed, changes.people_m, changes.kind))
        is None
    )


def test_few_changes_propose_no_frame():
    rows, changes = scene(1)
    people = seen_from(POSE, rows.people_m)
    few = np.arange(len(changes.kind)) < 40
    part = ChangeRows(changes.tcp_m, seen_from(POSE, changes.people_m), changes.kind).some(few)
    assert propose_frame(LevelRows(rows.tcp_m, people, rows.level), part) is None


@pytest.mark.parametrize("each", [8, 9])
def test_the_spread_is_the_median_deviation_from_the_median_of_each_kind(each: int):
    rng = np.random.default_rng(each)
    tcp, people = rng.normal(size=(2, 2 * each, 3)), rng.normal(size=(2, 2 * each, 1, 3))
    changes = ChangeRows.of(tcp, people, np.arange(2 * each) % 2)
    apart = np.linalg.norm(people[:, :, 0] - tcp, axis=-1)
    kinds = np.stack([apart[:, ::2], apart[:, 1::2]])
    off = np.abs(kinds - np.median(kinds, axis=-1, keepdims=True))
    expected = np.median(np.concatenate([off[0], off[1]], axis=-1), axis=-1).min()
    assert changes.spread_m(np.zeros((1, 4)), in_space=True)[0] == pytest.approx(expected, rel=1e-12)
