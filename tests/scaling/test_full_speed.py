"""Motions that few repetitions show at full speed, beside others that tell the limits of the robot."""

from __future__ import annotations

import numpy as np

from cyclekit.scaling.infer.override import infer_overrides
from cyclekit.segmentation.executions import Execution, Visit
from cyclekit.segmentation.motion import RobotRun

PERIOD_S, NOISE_M = 0.008, 1e-5
SPEED, ACCELERATION = 1.0, 1.4


def trapezoid(t_s: np.ndarray, way_m: float) -> np.ndarray:
    """The way along a line at the robot's limits of speed and acceleration."""
    gains_s = SPEED / ACCELERATION
    lasts_s = way_m / SPEED + gains_s
    t = np.clip(t_s, 0.0, lasts_s)
    back = lasts_s - t
    begin, end = 0.5 * ACCELERATION * np.minimum(t, gains_s) ** 2, 0.5 * ACCELERATION * np.minimum(back, gains_s) ** 2
    middle = SPEED * np.clip(t - gains_s, 0.0, lasts_s - 2 * gains_s)
    return np.asarray(np.where(t > lasts_s - gains_s, way_m - end, begin + middle))


def passed(way_m: float, scaling: float, seed: int, *, y_m: float) -> RobotRun:
    """A pass of a straight motion at one scaling."""
    lasts_s = (way_m / SPEED + SPEED / ACCELERATION) / scaling
    t_s = np.arange(round(lasts_s / PERIOD_S) + 1) * PERIOD_S
    x = trapezoid(t_s * scaling, way_m)
    xyz = np.column_stack([x, np.full(len(t_s), y_m), np.zeros(len(t_s))])
    xyz += np.random.default_rng(seed).normal(0.0, NOISE_M, xyz.shape)
    return RobotRun(t_s, xyz, np.abs(np.gradient(x, t_s)), np.full(len(t_s), np.nan))


def inferred(rare: list[float]) -> list[np.ndarray]:
    """Return the scaling of the passes of a rare motion, beside three common ones that are seen at full speed."""
    ways = {"a->b": 1.4, "b->a": 1.6, "a->c": 1.9}
    passes = [(task, passed(way, 1.0, k, y_m=0.0)) for task, way in ways.items() for k in range(4)]
    passes += [("c->d", passed(1.7, scaling, 50 + k, y_m=1.0)) for k, scaling in enumerate(rare)]
    executions = [
        Execution(n, (Visit(task[0], 0, 0), Visit(task[-1], run.rows - 1, run.rows - 1)), complete=True)
        for n, (task, run) in enumerate(passes)
    ]
    parts, _ = infer_overrides([run for _, run in passes], executions)
    return [part[0].scaling for part in parts[-len(rare) :]]


def test_one_pass_that_reaches_the_limits_of_other_motions_was_at_full_speed():
    slow, full = inferred([0.5, 1.0])
    assert np.isfinite(full).mean() > 0.8
    assert np.nanmin(full[10:-10]) > 0.97
    assert np.isfinite(slow).mean() > 0.8
    assert abs(float(np.nanmedian(slow)) - 0.5) < 0.01


def test_passes_that_reach_no_limit_tell_no_full_speed():
    for found in inferred([0.75, 0.75]):
        assert not np.isfinite(found).any()
