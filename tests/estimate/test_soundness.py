"""What is known about the basis of a number: clock, pose, people, backtest and support, each as a light with a cure."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import ClockTest, DynamicsCard, note
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.finding import LEVELS, Finding, merged, worst
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.soundness import findings_of
from cyclekit.estimate.validation.check import Check

if TYPE_CHECKING:
    from collections.abc import Sequence

UNCONFIRMED = DynamicsCard(changes=300, spread_m=0.3)
"""No reaction time at which the places of the slow-downs agree."""


def with_clock(
    dataset: Dataset,
    method: str,
    dynamics: DynamicsCard,
    frame: str = "robot base",
    test: ClockTest | None = None,
    codes: Sequence[str] = (),
) -> Dataset:
    """The same logs with people on a clock, and in a frame, that were found in another way."""
    recordings = [
        msgspec.structs.replace(
            one,
            clock=msgspec.structs.replace(one.clock, method=method, test=test, warnings=tuple(map(note, codes))),
            frame=msgspec.structs.replace(one.frame, method=frame, xyz_m=None, rotation=None),
        )
        if "people" in one.tables
        else one
        for one in dataset.card.recordings
    ]
    card = msgspec.structs.replace(dataset.card, recordings=tuple(recordings), dynamics=dynamics)
    return Dataset(dataset.path, card)


def light_of(dataset: Dataset, model: Any, code: str) -> str:
    found = findings_of(model, None, dataset, executions=40, support=1.0)
    return next(one.level for one in found if one.code == code)


CERTAIN = ClockTest(lag_s=0.1, explained=0.9, next_best=0.2, here=0.9, certain=True)


@pytest.mark.parametrize(
    ("method", "test", "confirms", "codes", "level"),
    [
        ("cell-file", None, False, (), "amber"),
        ("cell-file", None, True, (), "green"),
        ("epoch", CERTAIN, False, (), "green"),
        ("epoch", CERTAIN, True, ("clock-contradicted",), "red"),
        ("epoch", None, True, ("clock-apart",), "red"),
        ("event-pairs", None, False, (), "green"),
        ("assumed-common-start", None, True, (), "green"),
        ("assumed-common-start", CERTAIN, False, (), "green"),
        ("assumed-common-start", msgspec.structs.replace(CERTAIN, certain=False), False, (), "red"),
        ("logs", CERTAIN, True, (), "amber"),
        ("logs", CERTAIN, True, ("clock-by-logs-unsure",), "red"),
    ],
)
def test_a_clock_is_green_only_where_the_logs_tested_it(
    logged: Dataset, staircase: Any, method: str, test: Any, confirms: bool, codes: Sequence[str], level: str
) -> None:
    response = DynamicsCard(latency_s=0.1, changes=300, spread_m=0.01) if confirms else UNCONFIRMED
    assert light_of(with_clock(logged, method, response, test=test, codes=codes), staircase, "clock") == level


def test_a_pose_that_is_only_assumed_is_red_unless_the_slow_downs_confirm_it(logged: Dataset, staircase: Any) -> None:
    assumed = with_clock(logged, "cell-file", UNCONFIRMED, "assumed base frame")
    assert light_of(assumed, staircase, "pose") == "red"
    confirmed = with_clock(logged, "cell-file", DynamicsCard(latency_s=0.1), "assumed base frame")
    assert light_of(confirmed, staircase, "pose") == "green"
    noted = Dataset(logged.path, msgspec.structs.replace(confirmed.card, warnings=(note("frame-assumed"),)))
    assert light_of(noted, staircase, "pose") == "red"


@pytest.mark.parametrize(("executions", "level"), [(16, "green"), (40, "red"), (200, "red")])
def test_intervals_that_hold_too_rarely_for_their_executions_are_red(executions: int, level: str) -> None:
    check = Check(executions, 0, 0.0, 0.001, 0.0, 0.0, (0.0,) * executions, 0.7, None, (0.05, 0.95))
    (found,) = [one for one in check.findings if one.code == "backtest"]
    assert found.level == level  # 11 of 16 inside: one in a hundred by chance
    assert found.blocks is (level == "red")


def test_an_estimate_carries_its_light_and_everything_shows_it(logged: Dataset, staircase: Any, routes: Any) -> None:
    assumed = with_clock(logged, "assumed-common-start", UNCONFIRMED)
    (found,) = estimate(staircase, assumed, [TaskSequence("A", routes[0])])
    assert found.level == "red"
    assert any("assumed to start together" in text and "--align-clocks" in text for text in found.doubts)
    values = found.to_dict()
    assert values["level"] == "red"
    assert {one["code"] for one in values["findings"]} >= {"clock", "pose", "people", "bias", "backtest", "support"}
    (sound,) = estimate(staircase, logged, [TaskSequence("A", routes[0])])
    assert {one.code for one in sound.findings if one.level != "green"} == {"people", "support"}  # sixteen executions


ONE = st.builds(Finding, st.sampled_from("ab"), st.sampled_from(LEVELS), st.sampled_from("xy"))


@given(st.lists(st.lists(ONE, max_size=4), max_size=4))
def test_findings_of_several_answers_are_each_said_once_and_the_worst_first(
    several: Sequence[Sequence[Finding]],
) -> None:
    found = merged(several)
    assert len(set(found)) == len(found)
    levels = [LEVELS.index(one.level) for one in found]
    assert levels == sorted(levels, reverse=True)
    assert worst(found) == worst(one for some in several for one in some)
    for code in {one.code for some in several for one in some}:
        mine = {one.level for one in found if one.code == code}
        assert mine == {"green"} or "green" not in mine


def test_the_bias_that_is_told_says_how_every_duration_is_corrected() -> None:
    check = Check(40, 8, 0.02, 0.001, 0.02, 0.0, tuple(np.full(40, 0.02)), 0.9, None, (0.05, 0.95))
    (found,) = [one for one in check.findings if one.code == "bias"]
    assert found.level == "amber"
    assert "every duration is corrected by -2.0 %" in found.text
    assert "cyclekit inspect" in found.cure
    assert [one.level for one in replace(check, own_bias=0.05).findings if one.code == "bias"] == ["red"]
