"""A robot's log alone: it trains a model of an unseen operator, which answers estimates, plans and changes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import polars as pl
import pytest

from cyclekit.api.estimate import estimate_cycles
from cyclekit.api.train import train_model
from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import note
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ModelError
from cyclekit.estimate.operator.tracks import operator_tracks
from cyclekit.estimate.plan.jobs import Jobs
from cyclekit.estimate.rollout import estimate
from cyclekit.learning.networks.saved import load_model
from cyclekit.learning.unseen.fit import learn_unseen
from cyclekit.learning.unseen.model import NOBODY_SEEN, UnseenOperator

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.estimate.result import CycleEstimate

HUMAN = [f"human_{part}{axis}_m" for part in ("", "goal_") for axis in "xyz"]


@pytest.fixture(scope="module")
def robot_alone(logged: Dataset) -> Iterator[Dataset]:
    """The logged cell, whose samples show nobody."""
    samples = Dataset.samples

    def nobody(self: Dataset, *args: Any, **named: Any) -> pl.DataFrame:
        found = samples(self, *args, **named)
        gone = [name for name in (*HUMAN, "human_task", "human_gap") if name in found.columns]
        return found.with_columns(pl.lit(None).cast(found.schema[name]).alias(name) for name in gone)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Dataset, "samples", nobody)
        yield logged


@pytest.fixture(scope="module")
def unseen(robot_alone: Dataset, tmp_path_factory: pytest.TempPathFactory) -> tuple[UnseenOperator, Path]:
    """Its model, and where it lies."""
    place = tmp_path_factory.mktemp("unseen") / "model"
    model = train_model(robot_alone, out=place)
    assert isinstance(model, UnseenOperator)
    return model, place


def test_a_cell_is_answered_from_the_robots_log_alone(
    robot_alone: Dataset, unseen: tuple[UnseenOperator, Path], routes: list[tuple[str, ...]]
) -> None:
    (found,) = estimate_cycles(unseen[1], robot_alone, TaskSequence("asked", routes[0]))
    durations = robot_alone.executions["duration_s"]
    assert found.expected_s == pytest.approx(durations.mean(), rel=0.15)
    assert NOBODY_SEEN in found.doubts
    assert any("log one bit" in text for text in found.warnings)
    assert not any("full speed assumed" in text for text in found.warnings)
    low, high = found.expected_low_s, found.expected_high_s
    assert found.check is not None
    assert found.check.unseen_error > 0.0
    assert (high - low) / 2 > 1.9 * found.check.unseen_error * 0.5 * found.expected_s


def test_people_of_another_time_are_named_and_make_the_clock_red(
    robot_alone: Dataset, unseen: tuple[UnseenOperator, Path], routes: list[tuple[str, ...]]
) -> None:
    apart = note("clock-apart", robot="robot.csv", outside=1.0, late="2 h 0 min later")
    recordings = [
        msgspec.structs.replace(one, clock=msgspec.structs.replace(one.clock, warnings=(apart,)))
        if "people" in one.tables
        else one
        for one in robot_alone.card.recordings
    ]
    card = msgspec.structs.replace(robot_alone.card, recordings=tuple(recordings))
    dataset = Dataset(robot_alone.path, card)
    said = [one.text for one in learn_unseen(dataset).card.warnings]
    assert not any("no log shows people" in text for text in said)
    assert any("nobody while a robot log runs" in text and "2 h 0 min later" in text for text in said)
    (found,) = estimate_cycles(unseen[1], dataset, TaskSequence("asked", routes[0]))
    assert [(one.level, "2 h 0 min" in one.text) for one in found.findings if one.code == "clock"] == [("red", True)]


def test_beside_its_own_states_each_execution_takes_as_long_as_logged(
    robot_alone: Dataset, unseen: tuple[UnseenOperator, Path], routes: list[tuple[str, ...]]
) -> None:
    (found,) = estimate_cycles(unseen[0], robot_alone, TaskSequence("asked", routes[0]))
    assert found.check is not None
    assert abs(found.check.own_bias) < 0.01


def test_estimates_have_the_level_of_the_logs(
    robot_alone: Dataset, unseen: tuple[UnseenOperator, Path], routes: list[tuple[str, ...]]
) -> None:
    orders = [TaskSequence(f"{number}", route) for number, route in enumerate(dict.fromkeys(routes))]
    found = estimate(unseen[0], robot_alone, orders)
    mean_s = np.mean([one.expected_s for one in found])
    assert mean_s == pytest.approx(robot_alone.executions["duration_s"].mean(), rel=0.005)
    check = found[0].check
    assert check is not None
    assert check.level is not None
    longer = replace(check.level, logged_s=tuple(1.05 * s for s in check.level.logged_s))
    moved = estimate(unseen[0], robot_alone, orders[:1], check=replace(check, level=longer))
    usual = estimate(unseen[0], robot_alone, orders[:1], check=check)
    assert moved[0].expected_s == pytest.approx(1.05 * usual[0].expected_s)
    assert moved[0].expected_high_s == pytest.approx(1.05 * usual[0].expected_high_s)


def test_a_rollout_with_the_level_of_the_logs_takes_no_part_of_history(
    robot_alone: Dataset, unseen: tuple[UnseenOperator, Path], routes: list[tuple[str, ...]]
) -> None:
    for found in estimate(unseen[0], robot_alone, [TaskSequence(f"{n}", route) for n, route in enumerate(routes[:3])]):
        assert found.combined is None
        assert "logged durations" not in found.why


def test_an_effect_of_the_places_before_has_half_of_the_weight(
    robot_alone: Dataset,
    unseen: tuple[UnseenOperator, Path],
    routes: list[tuple[str, ...]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    orders = [TaskSequence(f"{number}", route) for number, route in enumerate(dict.fromkeys(routes))][:2]
    before = {one.name: one for one in estimate(unseen[0], robot_alone, orders)}

    class Longer:
        def covers(self, tasks: tuple[str, ...]) -> bool:
            return tasks == orders[0].tasks

        def expected_s(self, _tasks: tuple[str, ...]) -> float:
            return 1.2 * before["0"].expected_s

        def uncertain(self, _tasks: tuple[str, ...]) -> Any:
            return 1.0 + 0.1 * np.random.default_rng(1).standard_normal(1000)

    monkeypatch.setattr("cyclekit.estimate.validation.means.order_effect", lambda _: Longer())
    found, other = sorted(estimate(unseen[0], robot_alone, orders), key=lambda one: one.name)
    assert other.expected_s == pytest.approx(before["1"].expected_s)
    assert found.expected_s == pytest.approx(1.1 * before["0"].expected_s)
    assert np.array(found.durations_s) == pytest.approx(1.1 * np.array(before["0"].durations_s))
    assert "weighted 50 % with the logged durations of the same tasks after the places before them" in found.why
    wide, narrow = (one.expected_high_s - one.expected_low_s for one in (found, before["0"]))
    assert wide > 1.15 * narrow


def test_tracks_hold_states_in_place_of_positions(robot_alone: Dataset, unseen: tuple[UnseenOperator, Path]) -> None:
    tracks = operator_tracks(robot_alone, horizon_s=100.0, model=unseen[0])
    assert tracks.state is not None
    assert tracks.state.shape[:2] == tracks.activity.shape
    assert np.array_equal(tracks.state[..., 0], tracks.activity)
    assert tracks.activities == unseen[0].states


def test_a_plan_and_a_change_of_the_ramps_are_answered(
    robot_alone: Dataset, unseen: tuple[UnseenOperator, Path], routes: list[tuple[str, ...]]
) -> None:
    from cyclekit.api.plan import plan_order
    from cyclekit.api.whatif import what_if
    from cyclekit.estimate.whatif.change import Change

    visit = tuple(dict.fromkeys(place for place in routes[0] if place not in {"home", "conveyor"}))[:2]
    jobs = Jobs(visit=visit, start="home", via="conveyor", end="home")
    assert set(plan_order(unseen[0], robot_alone, jobs, validate=False).order) == set(visit)
    slower = Change("slow", dynamics={"ramp_up_per_s": 0.1})
    moved = Change("moved", base_m=(0.1, 0.0, 0.0))
    found = what_if(unseen[0], robot_alone, TaskSequence("asked", routes[0]), [slower, moved], validate=False)
    (slow,) = found
    assert slow.after.expected_s > slow.before.expected_s
    assert [one.name for one in found.refused] == ["moved"]
    assert "needs the positions of people" in found.refused[0].error.seen


def test_who_needs_positions_of_people_is_told_so(unseen: tuple[UnseenOperator, Path]) -> None:
    with pytest.raises(ModelError, match="the robot's log alone") as told:
        load_model(unseen[1])
    assert "cyclekit estimate" in (told.value.cure or "")


def test_after_the_ends_of_the_logs_people_go_on_or_stay_as_they_are_there(
    robot_alone: Dataset,
    unseen: tuple[UnseenOperator, Path],
    routes: list[tuple[str, ...]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    long = [place for route in routes[:3] for place in route[1:]]
    orders = [TaskSequence("long", (routes[0][0], *long)), TaskSequence("logged", routes[0])]
    tracks = operator_tracks(robot_alone, horizon_s=300.0, model=unseen[0])
    assert tracks.stays is not None
    assert tracks.state is not None
    ends = {state[last - 1].tobytes() for state, last in zip(tracks.state, tracks.logged, strict=True)}
    for state, last, stays in zip(tracks.state, tracks.logged, tracks.stays, strict=True):
        assert ({each.tobytes() for each in state[last:]} <= ends) is bool(stays)
    assert tracks.stays.sum() == 1

    def answered(speed_of: dict[bool, float]) -> dict[str, CycleEstimate]:
        """The orders where people are after the ends of logs in the state with the next speed, by whether they stay."""
        speeds = np.array([float(name.split()[-2]) / 100.0 for name in unseen[0].states])

        def told(*args: Any, **named: Any) -> OperatorTracks:
            found = operator_tracks(*args, **named)
            assert found.stays is not None
            assert found.state is not None
            for state, last, stays in zip(found.state, found.logged, found.stays, strict=True):
                state[last:] = np.abs(speeds - speed_of[bool(stays)]).argmin(), 0.5
            return found

        monkeypatch.setattr("cyclekit.estimate.cycles.operator_tracks", told)
        return {each.name: each for each in estimate(unseen[0], robot_alone, orders, check=None, validate=False)}

    slow, fast, either = (answered({True: one, False: other}) for one, other in ((0.5, 0.5), (1.0, 1.0), (1.0, 0.5)))
    apart_s = slow["long"].expected_s - fast["long"].expected_s
    assert apart_s > 0.1 * fast["long"].expected_s
    assert either["long"].expected_low_s < fast["long"].expected_s
    assert either["long"].expected_s == pytest.approx(slow["long"].expected_s, rel=0.05)
    assert either["long"].expected_high_s > slow["long"].expected_s
    assert slow["long"].expected_high_s < slow["long"].expected_s + 0.5 * (
        slow["long"].expected_s - fast["long"].expected_s
    )
    assert fast["long"].expected_high_s < fast["long"].expected_s + 0.5 * apart_s
    assert either["logged"].expected_s == pytest.approx(fast["logged"].expected_s, rel=0.01)
    said = [any("after the end of each log" in text for text in each["long"].limits) for each in (slow, fast, either)]
    assert said == [False, False, True]
