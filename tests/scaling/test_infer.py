"""The estimator behind the inferred override, against motions whose scaling is known because it was made here."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from tcp_speed import tcp_speed

from cyclekit.scaling.infer.limits import limits_along
from cyclekit.scaling.infer.override import infer_overrides
from cyclekit.scaling.infer.path import match_to_path, path_of
from cyclekit.scaling.infer.rate_along_path import rate_along_path
from cyclekit.scaling.infer.reference import _tcp_peak as tcp_peak
from cyclekit.segmentation.executions import Execution, Visit
from cyclekit.segmentation.motion import NEVER_FULL, NO_REFERENCE, OTHER_PATH, PAUSED, ProgramStop, RobotRun

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Vector = NDArray[np.float64]
    Points = NDArray[np.float64]

PERIOD_S = 0.008
NOISE_M = 2e-5


def arc(nominal_s: Vector) -> Points:
    """A quarter of a circle of 1 m radius, minimum jerk, in 2 s."""
    u = np.clip(nominal_s / 2.0, 0.0, 1.0)
    angle = 0.5 * np.pi * (10 * u**3 - 15 * u**4 + 6 * u**5)
    return np.column_stack([np.cos(angle), np.sin(angle), 0.3 * angle])


def straight(nominal_s: Vector) -> Points:
    """The chord of that arc."""
    u = np.clip(nominal_s / 2.0, 0.0, 1.0)
    share = (10 * u**3 - 15 * u**4 + 6 * u**5)[:, None]
    return arc(np.zeros(1)) + share * (arc(np.full(1, 2.0)) - arc(np.zeros(1)))


def run(
    scaling: Callable[[float], float], *, seed: int = 0, noise: float = NOISE_M, path: Callable[[Vector], Points] = arc
) -> tuple[RobotRun, Vector]:
    """A motion at a scaling that is a function of nominal time (or of time where that stands); and the true scaling."""
    nominal, s, t = [0.0], list[float](), 0.0
    while nominal[-1] < 2.0:
        s.append(scaling(t))
        nominal.append(nominal[-1] + s[-1] * PERIOD_S)
        t += PERIOD_S
    t_s = np.arange(len(nominal)) * PERIOD_S
    xyz = path(np.array(nominal)) + np.random.default_rng(seed).normal(0.0, noise, (len(t_s), 3))
    return RobotRun(t_s, xyz, tcp_speed(t_s, xyz), np.full(len(t_s), np.nan)), np.array([*s, s[-1]])


def inferred(runs: list[RobotRun], alone: tuple[int, ...] = ()) -> list[RobotRun]:
    executions = [
        Execution(number, (Visit("a", 0, 0), Visit("b", one.rows - 1, one.rows - 1)), complete=True)
        for number, one in enumerate(runs)
    ]
    parts, _ = infer_overrides(runs, executions, alone)
    return [one.with_scaling(found) for one, found in zip(runs, parts, strict=True)]


def steps(t_s: float) -> float:
    return 1.0 if t_s < 0.6 else 0.25 if t_s < 1.8 else 0.0 if t_s < 2.6 else 0.75


@pytest.mark.parametrize("rate", [0.2, 0.5, 0.75, 1.0])
def test_a_motion_drawn_out_evenly_has_that_one_scaling_all_along(rate: float):
    found = inferred([run(lambda _: 1.0)[0], run(lambda _: rate, seed=1)[0]], alone=(0,))[1].scaling
    known = np.isfinite(found)
    assert known.mean() > 0.95
    assert np.abs(found[known] - rate).mean() < 0.002
    assert np.abs(found[known] - rate).max() < 0.12


def test_edges_stay_sharp_and_a_halt_in_mid_motion_is_zero():
    one, true = run(steps, seed=1)
    found = inferred([run(lambda _: 1.0)[0], one], alone=(0,))[1]
    known = np.isfinite(found.scaling)
    error = np.abs(found.scaling - true)[known]
    assert known.mean() > 0.95
    assert error.mean() < 0.004
    assert (error < 0.05).mean() > 0.99
    halted = known & (true == 0.0)
    assert np.abs(found.scaling[halted]).max() < 0.02


def around_a_corner(nominal_s: Vector) -> Points:
    """Two straight ways of 1 s, each by acceleration and braking of 1.6 m/s²: it stops in the corner for no time."""
    u = np.clip(nominal_s, 0.0, 2.0) % 1.0
    part = np.where(u < 0.5, 2.0 * u**2, 1.0 - 2.0 * (1.0 - u) ** 2) * 0.4
    second = nominal_s >= 1.0
    ends = np.where(nominal_s >= 2.0, 0.4, np.where(second, part, 0.0))
    return np.column_stack([np.where(second, 0.4, part), ends, np.zeros_like(part)])


def test_a_log_of_few_rows_around_a_stop_in_a_corner_tells_the_scaling_there_too(monkeypatch: pytest.MonkeyPatch):
    # between two rows near rest the path is bent: what is read there by place alone is wrong by a row or more
    monkeypatch.setitem(globals(), "PERIOD_S", 0.02)
    rates = [1.0, 1.0, 1.0, 1.0, 0.7, 0.7, 0.3, 0.45]
    slowed = [run(lambda _, s=s: s, noise=3e-6, seed=k, path=around_a_corner) for k, s in enumerate(rates)]
    errors = []
    for one, (_, true) in zip(inferred([one for one, _ in slowed]), slowed, strict=True):
        known = np.isfinite(one.scaling)
        assert known.mean() > 0.9
        errors.append(np.abs(one.scaling - true)[known])
    assert float(np.concatenate(errors).mean()) < 0.0022


def test_the_stated_deviation_is_about_the_error():
    errors = []
    for seed in range(1, 9):
        one, true = run(lambda _: 0.6, seed=seed)
        found = inferred([run(lambda _: 1.0)[0], one], alone=(0,))[1]
        middle = slice(20, -20)
        assert found.deviation is not None
        errors.append((found.scaling - true)[middle] / found.deviation[middle])
    assert 0.3 < float(np.std(np.concatenate(errors))) < 2.0


def test_without_an_empty_run_the_fastest_pace_at_each_place_is_the_reference():
    how = [lambda t: 0.5 if t < 0.7 else 1.0, lambda t: 1.0 if t < 0.9 else 0.25]
    how += [lambda t: 0.25 if t < 1.2 else 1.0, lambda t: 1.0 if t < 0.8 else 0.5]
    slowed = [run(scaling, seed=seed) for seed, scaling in enumerate([*how, *how])]
    found = inferred([one for one, _ in slowed])
    for one, (_, true) in zip(found, slowed, strict=True):
        known = np.isfinite(one.scaling)
        assert known.mean() > 0.85
        assert np.abs(one.scaling - true)[known].mean() < 0.01


def half_midway(t_s: float) -> float:
    return 0.5 if 0.8 <= t_s < 1.6 else 1.0


@pytest.mark.parametrize("slowed_at_first", [False, True])
def test_a_limit_that_every_repetition_has_at_the_same_place_is_no_full_speed(slowed_at_first: bool):
    """Half of full speed on a fifth of the path; the repetitions may also be slowed elsewhere."""
    first = [(lambda t: 0.25 if t < 0.4 else half_midway(t - 0.3)) if slowed_at_first else half_midway] * 2
    slowed = [run(scaling, seed=seed) for seed, scaling in enumerate([*first, *[half_midway] * 4])]
    for found, (_, true) in zip(inferred([one for one, _ in slowed]), slowed, strict=True):
        known = np.isfinite(found.scaling)
        assert known.mean() > 0.85
        error = np.abs(found.scaling - true)[known]
        assert error.mean() < 0.02
        assert (error < 0.03).mean() > 0.93


def test_a_program_that_slows_down_gently_midway_is_at_full_speed_there():
    def gentle(nominal_s: Vector) -> Points:
        return arc(nominal_s + 0.12 * np.sin(np.pi * nominal_s))

    for found in inferred([run(lambda _: 1.0, seed=seed, path=gentle)[0] for seed in range(5)]):
        assert np.nanmin(found.scaling[20:-20]) > 0.97


def test_no_edge_is_seen_in_a_log_of_few_rows_a_second():
    nominal_s = np.arange(20) / 10.0
    place = np.where(nominal_s < 1.0, nominal_s, 1.0 + 0.5 * (nominal_s - 1.0))
    assert_allclose(limits_along(nominal_s, place[:, None]), 1.0)


def test_a_waypoint_passed_with_a_blend_is_no_limit_of_the_path():
    """Another joint takes over, three times as fast; a limit leaves the direction as it is."""
    t = np.arange(0.0, 3.0, PERIOD_S)
    speed = np.clip(np.minimum(t, 3.0 - t) / 0.4, 0.0, 1.0)
    over = np.clip((t - 1.5) / 0.06 + 0.5, 0.0, 1.0)
    lift, pan = (np.cumsum(rate) * PERIOD_S / NOISE_M for rate in (speed * (1.0 - over), 3.0 * speed * over))
    assert limits_along(t, np.column_stack([lift + pan, 0.5 * (lift + pan)]))[0] == pytest.approx(1 / 3, abs=0.02)
    assert_allclose(limits_along(t, np.column_stack([lift, pan])), 1.0)


def test_while_the_program_is_paused_the_scaling_is_unknown():
    runs = [run(lambda _: 1.0, seed=seed)[0] for seed in range(3)]
    held, _ = run(lambda t: 0.0 if 0.8 <= t < 1.6 else 1.0, seed=4)
    pause = ProgramStop(100, 199, PAUSED)
    found = inferred([*runs, replace(held, halts=(pause,))])[3]
    assert np.isnan(found.scaling[100:200]).all()
    assert found.gap is not None
    assert set(found.gap[100:200].tolist()) == {PAUSED}
    assert np.isfinite(inferred([*runs, held])[3].scaling[110:190]).all()


def test_a_pace_that_one_repetition_alone_has_reached_is_not_believed():
    fast, slow = run(lambda _: 1.0)[0], run(lambda _: 0.5, seed=1)[0]
    for one in inferred([fast, slow]):
        assert one.gap is not None
        assert np.isnan(one.scaling).all()
        assert set(one.gap.tolist()) == {NO_REFERENCE}


def test_a_motion_that_took_another_path_is_unknown():
    runs = [run(lambda _: 1.0, seed=seed)[0] for seed in range(3)]
    other = run(lambda _: 0.5, path=straight)[0]
    found = inferred([*runs, other])
    assert np.isnan(found[3].scaling).all()
    assert set(found[3].gap.tolist()) == {OTHER_PATH}  # type: ignore[union-attr]
    assert np.nanmean(found[0].scaling) == pytest.approx(1.0, abs=0.01)


def test_two_paths_between_the_same_places_have_a_reference_each():
    runs = [run(lambda _: 1.0, seed=seed)[0] for seed in range(3)]
    runs += [run(lambda _: 1.0, seed=seed, path=straight)[0] for seed in range(3)]
    halved = run(lambda _: 0.5, seed=9, path=straight)[0]
    assert np.nanmean(inferred([*runs, halved])[6].scaling) == pytest.approx(0.5, abs=0.02)


def test_a_motion_never_run_at_full_speed_gives_itself_away_by_its_dynamics():
    """Speed goes with the scaling, acceleration with its square."""

    def legs(runs: list[tuple[str, RobotRun]]) -> tuple[list[RobotRun], list[Execution]]:
        executions = [
            Execution(n, (Visit("a", 0, 0), Visit(goal, one.rows - 1, one.rows - 1)), complete=True)
            for n, (goal, one) in enumerate(runs)
        ]
        return [one for _, one in runs], executions

    named = [("b", run(lambda _: 1.0, seed=seed)[0]) for seed in range(3)]
    named += [("c", run(lambda _: 1.0, seed=seed)[0]) for seed in range(3)]
    named += [("d", run(lambda _: 0.5, seed=seed)[0]) for seed in range(3)]
    runs, executions = legs(named)
    parts, references = infer_overrides(runs, executions)
    assert references["a->d"][0].slowed == pytest.approx(0.5, abs=0.05)
    assert references["a->b"][0].slowed == 1.0
    assert set(parts[8][0].gap.tolist()) == {NEVER_FULL}
    assert np.isnan(parts[8][0].scaling).all()
    assert np.nanmean(parts[0][0].scaling) == pytest.approx(1.0, abs=0.01)


def elbow(nominal_s: Vector, x_m: float, y_m: float, way_m: tuple[float, float]) -> tuple[Points, Points]:
    """TCP and joints of an arm of two links of 0.5 m that goes straight from a place, minimum jerk, in 2 s."""
    u = np.clip(nominal_s / 2.0, 0.0, 1.0)
    tcp = np.array([x_m, y_m]) + (10 * u**3 - 15 * u**4 + 6 * u**5)[:, None] * np.array(way_m)
    bend = np.arccos(np.clip((tcp**2).sum(axis=1) / 0.5 - 1.0, -1.0, 1.0))
    return np.column_stack([tcp, 0.0 * u]), np.column_stack([np.arctan2(tcp[:, 1], tcp[:, 0]) - bend / 2, bend])


def slowed_of(motions: list[Callable[[Vector], tuple[Points, Points]]], rates: list[float]) -> list[float]:
    """The share of full speed that is told of motions to as many places, three times each at its rate."""
    runs, executions = list[RobotRun](), list[Execution]()
    for number, (motion, rate) in enumerate(zip(motions, rates, strict=True)):
        for seed in range(3):
            t_s = np.arange(int(2.0 / rate / PERIOD_S) + 1) * PERIOD_S
            tcp, joints = motion(rate * t_s)
            q_rad = joints + np.random.default_rng(10 * number + seed).normal(0.0, NOISE_M, joints.shape)
            runs.append(RobotRun(t_s, tcp, tcp_speed(t_s, tcp), np.full(len(t_s), np.nan), q_rad=q_rad))
            visits = Visit("a", 0, 0), Visit(f"b{number}", len(t_s) - 1, len(t_s) - 1)
            executions.append(Execution(len(runs) - 1, visits, complete=True))
    _, references = infer_overrides(runs, executions)
    return [references[f"a->b{number}"][0].slowed for number in range(len(motions))]


STRAIGHT = [partial(elbow, x_m=x_m, y_m=-0.2, way_m=(0.0, 0.4)) for x_m in (0.38, 0.4, 0.44, 0.45, 0.6, 0.8)]
"""Equal speeds of the TCP; what the joints do differs by where it goes."""


def test_straight_motions_at_full_speed_are_not_taken_for_slowed_by_what_their_joints_do():
    assert slowed_of(STRAIGHT, [1.0] * 6) == [1.0] * 6


def test_a_straight_motion_never_run_at_full_speed_still_gives_itself_away():
    assert slowed_of(STRAIGHT, [1.0, 1.0, 1.0, 0.5, 1.0, 0.75]) == pytest.approx([1, 1, 1, 0.5, 1, 0.75], abs=0.03)


def test_a_joint_that_only_trembles_proves_no_full_speed():
    """The second joint holds still: its greatest speed is noise, alike in all motions however slow."""

    def turning(nominal_s: Vector, reach: float) -> tuple[Points, Points]:
        tcp = arc(nominal_s)
        return tcp, np.column_stack([reach * np.arctan2(tcp[:, 1], tcp[:, 0]), 0.0 * nominal_s])

    motions = [partial(turning, reach=reach) for reach in (1.0, -1.0, 1.0, -1.0)]
    assert slowed_of(motions, [1.0, 1.0, 0.5, 1.0]) == pytest.approx([1.0, 1.0, 0.5, 1.0], abs=0.05)


@pytest.mark.parametrize("moving", [2, 3, 4, 6, 9])
@pytest.mark.parametrize("tcp_known", [True, False])
def test_motions_of_a_few_rows_are_looked_at_as_well(moving: int, tcp_known: bool):
    """And logs of joint angles whose TCP is not known."""
    way = np.concatenate([np.linspace(0.0, 0.5, moving), np.full(4, 0.5)])
    rows = len(way)
    t_s = 0.3 * np.arange(rows)
    tcp = np.column_stack([way, np.zeros(rows), np.zeros(rows)])
    xyz = tcp if tcp_known else np.full_like(tcp, np.nan)
    runs = [RobotRun(t_s, xyz, tcp_speed(t_s, tcp), np.full(rows, np.nan), q_rad=tcp) for _ in range(4)]
    for one in inferred(runs):
        assert one.gap is not None
        assert (one.gap != NEVER_FULL).all()
        assert (one.scaling[np.isfinite(one.scaling)] > 0.9).all()


@pytest.mark.parametrize("rows", [2, 3, 4])
def test_a_path_of_very_few_rows_has_no_peak(rows: int):
    t_s = 0.3 * np.arange(rows)
    tcp = np.column_stack([t_s, t_s, t_s])
    assert np.isnan(tcp_peak(path_of(t_s, tcp / NOISE_M), np.ones(rows), tcp)).all()


def test_rows_that_a_recorder_wrote_twice_do_not_look_like_halts():
    one, _ = run(lambda _: 0.5, seed=1)
    twice = np.repeat(np.arange(one.rows), 2)
    t_s = np.arange(len(twice)) * PERIOD_S / 2
    doubled = RobotRun(t_s, one.xyz_m[twice], one.speed_m_s[twice], np.full(len(twice), np.nan))
    found = inferred([run(lambda _: 1.0)[0], doubled], alone=(0,))[1].scaling
    known = np.isfinite(found)
    assert known.mean() > 0.9
    assert np.abs(found[known] - 0.5).max() < 0.05


def test_a_reference_at_another_rate_serves_as_well():
    fine, _ = run(lambda _: 1.0)
    coarse = RobotRun(fine.t_s[::4], fine.xyz_m[::4], fine.speed_m_s[::4], fine.scaling[::4])
    found = inferred([coarse, run(lambda _: 0.5, seed=1)[0]], alone=(0,))[1].scaling
    assert np.abs(found[np.isfinite(found)] - 0.5).mean() < 0.01


def test_a_log_without_joint_angles_among_others_with_them_is_unknown():
    runs = [run(lambda _, at=rate: at, seed=seed)[0] for seed, rate in enumerate((1.0, 1.0, 1.0, 0.5))]
    with_joints = [replace(one, q_rad=np.column_stack([one.xyz_m, one.xyz_m])) for one in runs]
    found = inferred([*with_joints, run(lambda _: 1.0, seed=9)[0]])
    known = found[3].scaling[np.isfinite(found[3].scaling)]
    assert np.abs(known - 0.5).mean() < 0.02
    assert not np.isfinite(found[4].scaling).any()


def test_what_the_slider_took_is_not_taken_for_safety():
    one, _ = run(lambda _: 0.5, seed=1)
    slid = RobotRun(one.t_s, one.xyz_m, one.speed_m_s, one.scaling, slider=np.full(one.rows, 0.5))
    found = inferred([run(lambda _: 1.0)[0], slid], alone=(0,))[1].scaling
    assert_allclose(found[np.isfinite(found)], 1.0, atol=0.03)


def test_runs_that_know_their_scaling_are_references_for_those_that_do_not():
    known, true = run(lambda t: 0.5 if t < 1.0 else 1.0)
    logged = RobotRun(known.t_s, known.xyz_m, known.speed_m_s, true)
    silent, expected = run(lambda t: 1.0 if t < 1.0 else 0.25, seed=1)
    parts, _ = infer_overrides(
        [logged, silent],
        [Execution(n, (Visit("a", 0, 0), Visit("b", r - 1, r - 1)), complete=True)
         for n, r in enumerate((logged.rows, silent.rows))],
    )  # fmt: skip
    assert parts[0] == []
    found = parts[1][0].scaling
    seen = np.isfinite(found)
    assert seen.mean() > 0.9
    assert np.abs(found - expected)[seen].mean() < 0.01


@at_most(60)
@given(st.floats(0.02, 1.0), st.integers(3, 300), st.floats(0.0, 1e4))
def test_a_line_without_noise_has_its_slope_whatever_the_length(rate: float, rows: int, start: float):
    t = start + np.arange(rows) * PERIOD_S
    found, deviation = rate_along_path(t, 5.0 + rate * (t - start), np.full(rows, 1e-8))
    assert_allclose(found, rate, atol=1e-6)
    assert (deviation > 0).all()


def test_where_nothing_is_known_the_deviation_is_infinite():
    t = np.arange(50) * PERIOD_S
    found, deviation = rate_along_path(t, t, np.full(50, np.inf))
    assert np.isinf(deviation).all()
    assert np.isfinite(found).all()


@at_most(30)
@given(st.integers(0, 10_000), st.floats(0.2, 1.0))
def test_a_repetition_is_found_where_it_is_on_the_path(seed: int, rate: float):
    reference, _ = run(lambda _: 1.0, noise=0.0)
    path = path_of(reference.t_s, reference.xyz_m / NOISE_M)
    one, _ = run(lambda _: rate, seed=seed)
    place = match_to_path(path, one.t_s, one.xyz_m / NOISE_M)
    true = np.minimum(one.t_s * rate, 2.0)
    clear = np.isfinite(place.variance_s2)
    assert clear.mean() > 0.8
    assert (np.abs(place.own_s - true)[clear] < 6 * np.sqrt(place.variance_s2[clear]) + 1e-4).all()
