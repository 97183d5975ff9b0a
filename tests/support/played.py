"""Cells and orders that are played with: what a reader of the page may ask, and the library's answer to the same."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from msgspec import structs
from ruled import box, near, ruled

from cyclekit import estimate_cycles, write_report
from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards import TrainingCard
from cyclekit.dataset.cards.rule import PoseCard
from cyclekit.dataset.cards.task_model import InterludeCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.whatif.change import Change, LimitChange
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.networks.weights import Weights
from cyclekit.learning.rules.safety import RuleSafety

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from browser import Tab
    from numpy.typing import ArrayLike

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.learning.task_times.saved import TaskTimesModel
    from cyclekit.schema import Singles

SHORT = ("left_2", "right_3", "left_4")
LONG = ("right_1", "left_1", "right_2", "left_2", "left_5", "right_5")


def order(name: str, *slots: str) -> TaskSequence:
    """Return boxes from the conveyor to these slots, in this order."""
    return TaskSequence(name, ("home", *(place for slot in slots for place in ("conveyor", slot))))


ORDERS = [order("short", *SHORT), order("long", *LONG), order("turned", *LONG[::-1])]


def staircase() -> RuleSafety:
    """Return the thresholds of the paper; speed comes back where it was taken."""
    return ruled((0.0, near(1.2), None), (0.25, near(1.5), None), (0.5, near(1.9), None), (0.75, near(2.4), None))


def zoned() -> RuleSafety:
    """Return a threshold with hysteresis, on the floor, and a zone beside the table."""
    flat = "distance TCP to operator on the floor"
    return ruled(
        (0.0, near(1.03, flat), near(1.23, flat)),
        (0.3, box(-1.33, 1.42, -1.58, None), box(-1.43, 1.52, -1.68, None)),
        (0.6, near(2.2), near(2.5)),
    )


def linked() -> RuleSafety:
    """Return thresholds on the nearest link of an arm whose elbow is above the middle of base and TCP."""
    name = "distance nearest link to operator"
    found = ruled((0.25, near(0.9, name), near(1.1, name)), (0.6, near(1.4, name), None))
    tcp_m = np.round(np.random.default_rng(1).uniform([-0.4, -0.7, 0.0], [0.7, 0.7, 0.5], (60, 3)), 4)
    poses = tuple(
        PoseCard(tcp_m=(x, y, z), joints_m=((0.0, 0.0, 0.0), (0.0, 0.0, 0.4), (x / 2, y / 2, 0.6)))
        for x, y, z in tcp_m.tolist()
    )
    return replace(found, rule=structs.replace(found.rule, poses=poses))


def network() -> TrainedModel:
    """Return a regressor by which speed rises with the distance: 10 % up to 1.06 m, 100 % from 2.5 m on."""
    slope, begin_m = 1.0 / 1.6, 0.9
    rising = of_distance([slope, slope], [-begin_m * slope - 0.1, -begin_m * slope - 1.0])
    last = (np.array([[1.0], [-1.0]], np.float32), np.array([0.1], np.float32))
    return TrainedModel("now", "regressor", 0.0, (), Weights((rising, last), distance=9.0))


def classifier() -> TrainedModel:
    """Return a classifier with the paper's staircase, each step a few centimetres wide."""
    levels, thresholds_m, width_m = (0.0, 0.25, 0.5, 0.75, 1.0), [0.0, 1.2, 1.5, 1.9, 2.4], 0.01
    logits = of_distance(np.arange(5) / width_m, -np.cumsum(thresholds_m) / width_m)
    return TrainedModel("now", "classifier", 0.0, levels, Weights((logits,), softmax_after=0, distance=9.0))


def both(robot: tuple[str, ...], operator: tuple[str, ...], name: str) -> TaskSequence:
    """Return a plan for both agents."""
    goals = [PlannedTask("robot", f"{a}->{b}") for a, b in pairwise(robot)]
    return TaskSequence.of_plan(name, [*goals, *(PlannedTask("operator", place) for place in operator)])


def of_distance(weight: ArrayLike, bias: ArrayLike) -> tuple[Singles, Singles]:
    """Return a first layer that uses the distance alone, the last of seven inputs."""
    found = np.array(weight, np.float32)
    return np.vstack([np.zeros((6, found.size), np.float32), found]), np.array(bias, np.float32)


class Gate:
    """A safety function of two states: the operator is on the left, where the robot is slow, or not."""

    problem, network, fast = "now", "gate", True
    unseen_error, states, why, doubts, limits = 0.3, ("left", "elsewhere"), "simulation with a gate", (), ()

    def __init__(self) -> None:
        self.card = TrainingCard()

    def predict(self, positions: np.ndarray) -> np.ndarray:
        return np.full(len(positions), 0.7)

    def scaling_in(self, robot_m: np.ndarray, state: np.ndarray) -> np.ndarray:
        return np.where(state[:, 0] == 0, np.where(robot_m[:, 1] > 0.2, 0.25, 0.6), 1.0)

    def near_logged(self, robot_m: np.ndarray, state: np.ndarray) -> np.ndarray:
        return (state[:, 0] == 1) | (robot_m[:, 1] > -0.2)

    def logged_states(self, dataset: Dataset) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        frame = dataset.samples(columns=["execution", "t_s", "human_x_m"])
        return {
            name: (rows["t_s"].to_numpy(), (rows["human_x_m"].fill_null(9.0).to_numpy() > 0.3).astype(float)[:, None])
            for (name,), rows in frame.group_by(["execution"], maintain_order=True)
        }


STAIRS = {
    "threshold": ({"moved": [0.15, 0, 0, 0]}, Change("t", limits=(LimitChange(0.0, threshold_m=1.35),))),
    "two": (
        {"moved": [0, -0.2, 0, 0.3]},
        Change("w", limits=(LimitChange(0.25, threshold_m=1.3), LimitChange(0.75, threshold_m=2.7))),
    ),
    "ramp": ({"ramp": 0.2}, Change("r", dynamics={"ramp_up_per_s": 0.2})),
    "seldom": ({"frequency": 0.6}, Change("f", frequency=0.6)),
}
ZONED = {
    "zone": (
        {"moved": [0, 0.2, 0]},
        Change("z", limits=(LimitChange(0.3, x_m=(-1.53, 1.62), y_m=(-1.78, math.inf)),)),
    ),
    "at once": ({"ramp": math.inf}, Change("o", dynamics={"ramp_up_per_s": math.inf})),
    "all": (
        {"moved": [0.1, 0, -0.2], "ramp": 0.3, "frequency": 0.8},
        Change(
            "a",
            limits=(LimitChange(0.0, threshold_m=1.13), LimitChange(0.6, threshold_m=2.0)),
            dynamics={"ramp_up_per_s": 0.3},
            frequency=0.8,
        ),
    ),
}
LINKED = {
    "threshold": ({"moved": [0.1, 0]}, Change("t", limits=(LimitChange(0.25, threshold_m=1.0),))),
    **{name: STAIRS[name] for name in ("ramp", "seldom")},
}
WITHOUT_RULE = {name: STAIRS[name] for name in ("ramp", "seldom")}
"""What the script is asked with, and the same change in the library, by name."""


def ask(tab: Tab, played: object, changes: dict[str, object], takt_s: object = "null") -> dict[str, Any]:
    """Return the page's answer to what is played, with changes."""
    script = f"JSON.stringify(cyclekitPlay.answer({json.dumps(played)}, {json.dumps(changes)}, {takt_s}))"
    found: dict[str, Any] = json.loads(tab.ask(script))
    return found


def plans_are_the_same(
    tab: Tab, folder: Path, model: TaskTimesModel, sequences: Sequence[TaskSequence], *, within: float = 1e-5
) -> None:
    """Check the page's numbers of plans against the library's; `folder` holds the dataset of the task lists."""
    write_report(folder / "dataset", folder / "page.html", model=model, sequences=sequences[:1], takt_s=20.0)
    tab.events.clear()
    tab.show(folder / "page.html")
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    plans = {each.name: each.plan for each in sequences}
    for wanted in estimate_cycles(model, Dataset.open(folder / "dataset"), sequences, takt_s=20.0):
        played = [
            {"agent": task.agent, "asked": task.agent, "name": task.name, "after": task.after}
            | ({} if task.not_before_s is None else {"not_before_s": task.not_before_s})
            for task in plans[wanted.name]
        ]
        same(ask(tab, played, {}, 20.0), wanted, within=within)
    assert tab.said() == []


def same(found: dict[str, Any], wanted: CycleEstimate, *, within: float = 2e-3) -> None:
    """Check mean, intervals and quantiles, the takt, and every task's start, end and wait; part of the cycle time."""
    assert "unknown" not in found
    means = [wanted.expected_s, wanted.expected_low_s, wanted.expected_high_s, *wanted.quantiles_s.values()]
    assert [found[name] for name in ("expected_s", "low_s", "high_s")] + found["quantiles_s"] == pytest.approx(
        means, rel=within
    )
    if wanted.takt_probability is not None:
        assert found["takt"] == pytest.approx(list(wanted.takt_probability), abs=0.02)
    mine = [(task["name"], task["start_s"], task["end_s"], task["wait_s"], *task["ends_s"]) for task in found["tasks"]]
    theirs = [(t.task, t.start_s, t.end_s, t.wait_s, t.end_low_s, t.end_high_s) for t in wanted.plan]
    assert [task[0] for task in mine] == [task[0] for task in theirs]
    for one, other in zip(mine, theirs, strict=True):
        assert one[1:] == pytest.approx(other[1:], abs=2 * within * wanted.expected_s)


@pytest.fixture
def repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    """The logs of a cell repeat visits of the conveyor, and change tools before it."""
    found = [
        InterludeCard("robot", "conveyor", ("conveyor",), visits=40, times=12, took_s=4.0),
        InterludeCard("robot", "tools", ("nowhere", "conveyor"), visits=40, times=9, took_s=6.0),
        InterludeCard("robot", "nowhere", ("nowhere",), visits=9, times=9, took_s=9.0),
    ]
    for module in ("cyclekit.estimate.rollout", "cyclekit.report.play.tables"):
        monkeypatch.setattr(f"{module}.robot_interludes", lambda _: found)


@pytest.fixture(scope="module", autouse=True)
def some_deadlocks_are_left_out() -> Iterator[None]:
    """Answer orders of which up to half of the cycles end in a deadlock: these cells need things that rarely come."""
    with pytest.MonkeyPatch.context() as patch:
        for module in ("cyclekit.estimate.joint.roll", "cyclekit.report.play.both"):
            patch.setattr(f"{module}.LEFT_OUT", 0.5)
        yield
