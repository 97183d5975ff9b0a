"""Files of one source share one offset, and a start of the robot's log is used or refused."""

from __future__ import annotations

from typing import Any

import pytest
from log_cards import log_card

from cyclekit.alignment.recording_clocks import place_in_time
from cyclekit.config import Source
from cyclekit.dataset.cards import LogCard, RecordingCard
from cyclekit.dataset.sessions import LogGroup
from cyclekit.errors import ConfigError

pytestmark = pytest.mark.tests_clocks

EPOCH_S = 1_700_000_000.0
TRACKER = Source("take_*.csv", role="people")


def entry(name: str, kind: Any, first_s: float, *tables: Any, length_s: float = 600.0) -> LogCard:
    return log_card(f"{name}.csv", *tables, id=name, kind=kind, first_s=first_s, last_s=first_s + length_s)


def placed(*logs: LogCard, robot: Source | None = None, tracker: Source | None = TRACKER) -> list[RecordingCard]:
    known = {one.id: robot if "robot" in one.tables else tracker for one in logs}

    def nothing(*_: Any) -> None:
        return None

    return list(place_in_time(LogGroup("s", logs), known, nothing, nothing))


@pytest.mark.parametrize(("kind", "first_s"), [("epoch", EPOCH_S), ("uptime", 4000.0), ("relative", 0.0)])
def test_two_files_of_one_tracker_keep_the_time_between_them(kind: Any, first_s: float) -> None:
    robot = entry("r", "uptime", 150.0, "robot", length_s=4000.0)
    takes = [entry(f"take_{number}", kind, first_s + 2160.0 * number, "people") for number in (1, 0)]
    _, later, earlier = placed(robot, *takes)
    assert earlier.span_s == (0.0, 600.0)
    assert later.span_s == (2160.0, 2760.0)


def test_takes_that_all_begin_at_zero_start_with_the_robot() -> None:
    robot = entry("r", "uptime", 150.0, "robot")
    takes = [entry(f"take_{number}", "relative", 0.0, "people") for number in range(2)]
    assert [one.span_s for one in placed(robot, *takes)[1:]] == [(0.0, 600.0)] * 2


def test_the_start_of_a_robot_s_log_places_times_since_1970() -> None:
    robot, people = entry("r", "uptime", 150.0, "robot"), entry("p", "epoch", EPOCH_S + 7.0, "people")
    (_, one) = placed(robot, people, robot=Source("r.csv", role="robot", start="2023-11-14T23:13:20+01:00"))
    assert one.clock.method == "start-text"
    assert one.span_s == pytest.approx((7.0, 607.0))


@pytest.mark.parametrize(("kind", "cause"), [("uptime", "no other log of the session"), ("epoch", "count since 1970")])
def test_a_start_of_the_robot_s_log_that_relates_nothing_is_refused(kind: Any, cause: str) -> None:
    robot, people = entry("r", kind, EPOCH_S, "robot"), entry("p", "relative", 0.0, "people")
    with pytest.raises(ConfigError, match=cause):
        placed(robot, people, robot=Source("r.csv", role="robot", start="2023-11-14T23:13:20+01:00"))
