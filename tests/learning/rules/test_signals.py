"""A signal is believed where the level follows it, always the same time later."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.learning.rules.ladder import find_rule
from cyclekit.learning.rules.samples.rows import RuleRows
from cyclekit.learning.rules.samples.signals import SignalChanges, fixed_delay, lags_after
from cyclekit.learning.rules.words import sentences

SEEN_S = np.arange(0.0, 600.0, 0.1)


def sampled(times_s: np.ndarray) -> np.ndarray:
    """When a level that changes at some times is seen to, ten times a second."""
    return (np.floor(times_s * 10) + 0.5) / 10


def bit(times_s: np.ndarray) -> SignalChanges:
    return SignalChanges(np.append(0.0, times_s), np.array([str(number % 2) for number in range(len(times_s) + 1)]))


@pytest.mark.parametrize("delay_s", [0.04, 0.15, 0.5])
def test_the_delay_of_a_cause_is_read(delay_s: float) -> None:
    field_s = np.cumsum(np.random.default_rng(0).uniform(2.0, 8.0, 80))
    found = fixed_delay(lags_after(bit(field_s), sampled(field_s + delay_s), SEEN_S))
    assert found == pytest.approx(delay_s, abs=0.02)


def test_what_the_robot_sets_itself_is_not_believed() -> None:
    rng = np.random.default_rng(0)
    level_s = np.cumsum(rng.uniform(2.0, 8.0, 80))
    gripper = bit(np.cumsum(rng.uniform(2.0, 8.0, 80)))
    for robots in (gripper, bit(level_s), bit(level_s + 0.05), bit(level_s - rng.uniform(0.0, 0.9, 80))):
        assert fixed_delay(lags_after(robots, sampled(level_s), SEEN_S)) is None


def test_changes_between_executions_tell_nothing() -> None:
    field_s = np.arange(5.0, 595.0, 3.37)
    seen = SEEN_S[(SEEN_S % 100) < 50]
    answers = sampled(field_s + 0.2)
    found = fixed_delay(lags_after(bit(field_s), answers[(answers % 100) < 50], seen))
    assert found == pytest.approx(0.2, abs=0.02)


def test_a_signal_is_named_where_no_position_tells_the_level() -> None:
    rng = np.random.default_rng(1)
    robot, human = rng.uniform(-1, 1, (3000, 3)), rng.uniform(-2, 2, (3000, 3))
    occupied = np.repeat(rng.integers(0, 2, 300), 10)
    rows = RuleRows.made(
        robot,
        human,
        np.where(occupied == 1, 0, 1),
        np.repeat(np.arange(10), 300),
        signals={
            ("door", 0.1): np.array(["open", "shut"])[(robot[:, 0] > 0).astype(int)],
            ("F1", 0.12): occupied.astype("U1"),
        },
    )
    found = find_rule(rows, (0.25, 1.0)).rule
    assert found is not None
    assert found.family == "signal"
    assert sentences(found) == [
        "speed 25 % when signal F1 is 1 (delay 0.12 s)",
        "speed 100 % otherwise",
    ]
