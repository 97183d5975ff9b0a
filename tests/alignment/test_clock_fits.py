"""Clock fits on arrays: the line that is found is the true one, spurious events do not move it, and doubt is said."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from examples import at_most
from hypothesis import example, given
from hypothesis import strategies as st

import cyclekit
from cyclekit.alignment.clocks import Method, fit_events, fit_motion, fit_pairs, follow, lower_envelope
from cyclekit.dataset.cards import texts
from cyclekit.errors import ConfigError, ShapeError

pytestmark = pytest.mark.tests_clocks

OFFSET, RATE = -4321.125, 1 + 50e-6


def uneven(count: int, seed: int, *, length_s: float = 1800.0) -> np.ndarray:
    return np.sort(np.random.default_rng(seed).uniform(0.0, length_s, count))


def worst_s(fit: Any, t_s: np.ndarray, rate: float = RATE, offset: float = OFFSET) -> float:
    """How far the fit is from the true line, anywhere in the run."""
    return float(np.abs((fit.rate - rate) * t_s + fit.offset_s - offset).max())


@at_most(60)
@given(
    st.floats(-2e9, 2e9),
    st.floats(-3e-3, 3e-3),
    st.lists(st.floats(0, 3600), min_size=3, max_size=30, unique=True).filter(lambda t: max(t) - min(t) > 61),
)
def test_pairs_without_error_give_the_clock_whatever_it_counts_from(offset: float, drift: float, times: list[float]):
    t = np.array(times)
    fit = fit_pairs(t, (1 + drift) * t + offset)
    assert worst_s(fit, t, 1 + drift, offset) < 2e-5  # a double holds 2e9 s to 2.4e-7 s
    assert fit.events == len(t)


def test_the_residual_of_pairs_is_the_jitter_of_the_events():
    t = uneven(200, 1)
    noise = np.random.default_rng(2).normal(0.0, 0.004, 200)
    fit = fit_pairs(t, RATE * t + OFFSET + noise)
    assert fit.residual_s == pytest.approx(0.004, rel=0.15)
    assert worst_s(fit, t) < 0.002
    assert fit.warnings == ()


def test_wrong_pairs_among_right_ones_are_rejected_and_counted():
    t = uneven(20, 3)
    other = RATE * t + OFFSET + np.random.default_rng(4).normal(0.0, 0.002, 20)
    other[[2, 7, 11, 17]] += [3.0, -40.0, 0.4, 900.0]
    fit = fit_pairs(t, other)
    assert (fit.events, fit.events_rejected) == (16, 4)
    assert worst_s(fit, t) < 0.004


def test_no_rate_is_made_of_events_that_lie_close_together():
    t = np.array([10.0, 11.0, 12.5, 14.0])
    fit = fit_pairs(t, t + 3.0 + np.array([0.01, -0.01, 0.01, -0.01]))
    assert fit.rate == 1.0
    assert fit.offset_s == pytest.approx(3.0, abs=0.01)


def test_two_events_far_apart_give_a_rate_that_nothing_checks_and_this_is_said():
    t = np.array([0.0, 3600.0])
    fit = fit_pairs(t, RATE * t + OFFSET)
    assert fit.rate == pytest.approx(RATE, abs=1e-9)
    assert fit.residual_s is None
    assert "two" not in "; ".join(texts(fit.warnings))
    assert "three or more" in "; ".join(texts(fit.warnings))


def test_one_event_gives_an_offset_and_a_warning():
    fit = fit_pairs(np.array([5.0]), np.array([105.0]))
    assert (fit.offset_s, fit.rate, fit.events) == (100.0, 1.0, 1)
    assert "on 1 event(s)" in "; ".join(texts(fit.warnings))


def test_pairs_in_milliseconds_are_refused():
    t = uneven(10, 5)
    with pytest.raises(ConfigError):
        fit_pairs(t, 1000 * t)


def test_pairs_without_any_are_refused():
    with pytest.raises(ConfigError, match="0 and 0"):
        fit_pairs(np.empty(0), np.empty(0))


@pytest.mark.parametrize("seed", range(6))
def test_events_are_matched_though_each_log_holds_some_that_the_other_missed(seed: int):
    rng = np.random.default_rng(seed)
    t = uneven(60, seed)
    mine = np.concatenate([rng.permutation(t)[:48], rng.uniform(0, 1800, 15)])
    robot = RATE * (np.concatenate([rng.permutation(t)[:50], rng.uniform(0, 1800, 15)])) + OFFSET
    robot += rng.normal(0.0, 0.003, len(robot))
    fit = fit_events(mine, robot)
    assert worst_s(fit, t) < 0.005
    assert fit.residual_s == pytest.approx(0.003, rel=0.5)
    assert fit.warnings == ()
    assert fit.events is not None
    assert 35 <= fit.events <= 48


def test_events_at_even_intervals_are_said_to_fit_elsewhere_as_well():
    t = np.arange(0.0, 600.0, 12.0)
    fit = fit_events(t[:-1], t[1:] + 100.0)
    assert fit.second_best is not None
    assert fit.second_best > 0.9
    assert abs(abs(fit.second_best_s or 0.0) - 12.0) < 0.01
    assert "almost as well" in "; ".join(texts(fit.warnings))


def test_events_that_have_nothing_in_common_are_refused():
    with pytest.raises(ConfigError, match="match"):
        fit_events(np.array([0.0, 10.0, 25.0, 70.0]), np.array([0.0, 3.0, 44.0, 171.0]))
    with pytest.raises(ConfigError, match="0 events"):
        fit_events(np.empty(0), np.array([1.0]))


def going(seed: int, length_s: float) -> tuple[np.ndarray, np.ndarray]:
    """A point that goes from place to place, never twice alike: 125 Hz, half a second to two between places."""
    rng = np.random.default_rng(seed)
    legs = int(length_s)
    at = np.cumsum(rng.uniform(0.5, 2.0, legs))
    places = rng.uniform(-0.6, 0.6, (legs, 3))
    t = np.arange(0.0, length_s, 0.008)
    leg = np.clip(np.searchsorted(at, t), 1, legs - 1)
    u = np.clip((t - at[leg - 1]) / (at[leg] - at[leg - 1]), 0, 1)[:, None]
    ease = u * u * (3 - 2 * u)
    return t, places[leg - 1] + (places[leg] - places[leg - 1]) * ease


def seen_by_a_tracker(
    t: np.ndarray, xyz: np.ndarray, *, lost: float = 0.1, begin: float = 0.0, rate: float = RATE
) -> tuple[np.ndarray, np.ndarray]:
    """The same point at 100 Hz, turned, in another clock, with noise and lost frames."""
    rng = np.random.default_rng(9)
    frames = np.arange(begin, t[-1] - 1.0, 0.01)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    at = np.column_stack([np.interp(frames, t, xyz[:, k]) for k in range(3)]) @ turn + rng.normal(size=3)
    at += rng.normal(0.0, 0.001, at.shape)
    holes = np.repeat(rng.random(len(at) // 25 + 1) < lost, 25)[: len(at)]
    at[holes] = np.nan
    return (frames - OFFSET) / rate, at


def test_one_body_in_two_logs_gives_offset_and_drift_without_any_frame():
    t, xyz = going(1, 900.0)
    log_s, log_m = seen_by_a_tracker(t, xyz)
    fit = fit_motion(log_s, log_m, t, xyz)
    assert worst_s(fit, log_s) < 0.001
    assert fit.rate - 1 == pytest.approx(50e-6, abs=1e-6)
    assert fit.correlation is not None
    assert fit.correlation > 0.9
    assert fit.residual_s is not None
    assert fit.residual_s < 0.003
    assert fit.warnings == ()


@pytest.mark.parametrize(("drift", "length_s"), [(3e-3, 300.0), (3e-3, 900.0), (-1e-3, 900.0), (5e-5, 7200.0)])
def test_a_drift_that_blurs_the_whole_is_followed_and_taken_out(drift: float, length_s: float):
    t, xyz = going(8, length_s)
    log_s, log_m = seen_by_a_tracker(t, xyz, rate=1 + drift)
    fit = fit_motion(log_s, log_m, t, xyz)
    assert worst_s(fit, log_s, 1 + drift) < 0.001
    assert fit.correlation is not None
    assert fit.correlation > 0.99


def test_logs_that_begin_and_end_apart_are_placed_by_what_they_share():
    t, xyz = going(2, 300.0)
    log_s, log_m = seen_by_a_tracker(t, xyz, begin=100.0)
    assert worst_s(fit_motion(log_s, log_m, t, xyz), log_s) < 0.005


def test_a_short_run_gets_no_rate_because_none_can_be_seen():
    t, xyz = going(3, 60.0)
    log_s, log_m = seen_by_a_tracker(t, xyz)
    fit = fit_motion(log_s, log_m, t, xyz)
    assert fit.rate == 1.0
    assert worst_s(fit, log_s) < 0.005


def test_a_robot_that_repeats_itself_is_ambiguous_one_cycle_apart_and_this_is_said():
    t, once = going(4, 15.0)
    t, xyz = np.arange(0, 150.0, 0.008), np.tile(once, (10, 1))
    log_s, log_m = seen_by_a_tracker(t[: len(xyz)], xyz[: len(t)], lost=0.0)
    fit = fit_motion(log_s, log_m, t, xyz)
    assert fit.second_best is not None
    assert fit.second_best > 0.9
    assert abs(fit.second_best_s or 0.0) % 15.0 == pytest.approx(0.0, abs=0.1) or abs(
        fit.second_best_s or 0.0
    ) % 15.0 == pytest.approx(15.0, abs=0.1)
    assert "repeats its motion" in "; ".join(texts(fit.warnings))


def test_two_bodies_that_have_nothing_to_do_with_each_other_are_refused():
    t, xyz = going(5, 300.0)
    with pytest.raises(ConfigError, match="never agree"):
        fit_motion(*seen_by_a_tracker(*going(6, 300.0)), t, xyz)


def test_a_body_that_never_moves_is_refused():
    t, xyz = going(7, 60.0)
    with pytest.raises(ConfigError, match="less than 10 s"):
        fit_motion(t, np.zeros_like(xyz), t, xyz)


@pytest.mark.parametrize("seed", range(4))
def test_the_lower_envelope_finds_the_clock_under_delays_that_are_never_negative(seed: int):
    rng = np.random.default_rng(seed)
    device = np.sort(rng.uniform(0, 3600, 20000))
    host = RATE * device + 1.75e9 + 0.002 + rng.exponential(0.02, len(device))
    fit = lower_envelope(device, host)
    assert worst_s(fit, device, RATE, 1.75e9 + 0.002) < 0.0005  # the least delay, 2 ms, belongs to the offset
    assert fit.residual_s == pytest.approx(0.02 * np.log(2), rel=0.1)


def test_delays_that_grow_are_not_taken_for_a_rate_beyond_what_clocks_do():
    device = np.arange(0.0, 100.0, 0.01)
    fit = lower_envelope(device, device * 1.05, max_drift=2e-4)
    assert fit.rate == pytest.approx(1 + 2e-4)
    assert (device * 1.05 >= fit.rate * device + fit.offset_s - 1e-9).all()


def test_a_rate_beyond_what_clocks_do_is_followed_and_said_where_a_line_fits_and_is_no_fit_else():
    device = np.arange(0.0, 100.0, 0.01)
    late = np.random.default_rng(1).exponential(0.005, len(device))
    fit = follow(device, 1.0068 * device + 0.5 + late)
    assert fit is not None
    assert worst_s(fit, device, 1.0068, 0.5) < 0.001
    assert "0.9932 times" in "; ".join(texts(fit.warnings))
    assert follow(device, 1.002 * device + late).warnings == ()
    wandering = 0.3 * np.sin(device / 10.0)
    assert follow(device, 1.0068 * device + wandering + late) is None
    assert follow(device, 1.2 * device) is None


@given(st.lists(st.tuples(st.floats(0, 1e4), st.floats(0, 1)), min_size=2, max_size=60))
@example([(0.0, 0.0), (2.2250738585e-313, 1.0)])  # the slope between them is beyond all numbers
def test_no_message_arrives_before_the_envelope(stamps: list[tuple[float, float]]):
    device = np.array([t for t, _ in stamps])
    host = device + np.array([delay for _, delay in stamps])
    fit = lower_envelope(device, host)
    assert (host - (fit.rate * device + fit.offset_s)).min() >= -1e-6


@pytest.mark.parametrize("host", [np.zeros(3), np.array([0.0, np.nan])])
def test_stamps_that_do_not_fit_together_are_refused(host: np.ndarray):
    with pytest.raises(ShapeError):
        lower_envelope(np.zeros(2), host)


def test_no_method_is_compared_with_a_name_that_no_fit_has():
    compared = set()
    for file in Path(cyclekit.__file__).parent.rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "method" in text else ():
            if not isinstance(node, ast.Compare) or "method" not in ast.unparse(node.left):
                continue
            left = ast.unparse(node.left)
            if "clock" in left or (left.endswith(".method") and "frame" not in left):
                inside = (part for each in node.comparators for part in ast.walk(each))
                compared |= {part.value for part in inside if isinstance(part, ast.Constant) and part.value is not None}
    assert {"own", "lower-envelope"} <= compared
    assert compared <= set(get_args(Method))
