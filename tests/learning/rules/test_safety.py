"""A rule beside a model answers in its place: stored as data, asked by rollout and what-if."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from msgspec import structs

from cyclekit.api.given import model_of
from cyclekit.dataset.cards import BadCard, TrainingCard, checked, plain
from cyclekit.dataset.cards.rule import (
    LimitCard,
    MetresCard,
    NearerCard,
    PoseCard,
    RectangleCard,
    RegionCard,
    RuleCard,
    SignalCard,
)
from cyclekit.errors import ModelError
from cyclekit.estimate.robot.safety import Dynamics, Follower, at_once, scaling_of
from cyclekit.estimate.whatif.alter import altered_safety
from cyclekit.estimate.whatif.change import Change
from cyclekit.learning.networks.saved import TrainedModel, load_model, save_model
from cyclekit.learning.networks.weights import Weights
from cyclekit.learning.rules.safety import RuleSafety, predictor_of
from cyclekit.learning.rules.samples.distances import TO_LINK, TO_TCP, to_links
from cyclekit.learning.rules.samples.links import ArmPoses, poses_of, to_nearest_link
from cyclekit.learning.rules.samples.quantities import quantities
from cyclekit.learning.training import with_rule

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.dataset.dataset import Dataset


def near(metres: float, distance: str = TO_TCP) -> RegionCard:
    return RegionCard(nearer=(NearerCard(distance=distance, metres=MetresCard(value=metres)),))


def box(from_x: float, to_x: float) -> RegionCard:
    edges = [MetresCard(value=metres) for metres in (from_x, to_x)]
    return RegionCard(rectangles=(RectangleCard(along=(edges[0], edges[1]), across=(None, None)),))


def rule(*limits: tuple[float, RegionCard, RegionCard | None]) -> RuleCard:
    made = tuple(LimitCard(scaling=level, within=within, until=until) for level, within, until in limits)
    return RuleCard(family=TO_TCP, levels=(0.0, 0.5, 1.0), limits=made, explained=1.0)


HELD = rule((0.0, near(0.8), near(1.0)), (0.5, box(1.5, 2.5), box(1.3, 2.7)))
PLAIN = rule((0.0, near(0.8), None), (0.5, box(1.5, 2.5), None))


def model(card: TrainingCard, levels: tuple[float, ...] = (0.0, 0.5, 1.0)) -> TrainedModel:
    """A network that is wrong nearly everywhere."""
    rng = np.random.default_rng(0)
    sizes = [(6, 4), (4, len(levels))]
    layers = tuple((rng.normal(size=size).astype(np.float32), np.zeros(size[1], np.float32)) for size in sizes)
    return TrainedModel("now", "classifier", 0.0, levels, Weights(layers, 1), card)


def scalings(safety: Any, xs: list[float], dynamics: Dynamics) -> list[float]:
    follower = Follower(safety, dynamics, 0.1)
    return [float(follower.advance(np.zeros((1, 3)), np.array([[x, 0.0, 0.0]]))[0]) for x in xs]


def test_a_rule_slows_where_it_is_entered_and_lets_go_where_it_is_left() -> None:
    safety = RuleSafety(HELD, TrainingCard())
    way = [3.0, 2.6, 2.4, 2.6, 2.8, 1.2, 0.7, 0.9, 1.1]
    assert scalings(safety, way, Dynamics()) == [1.0, 1.0, 0.5, 0.5, 1.0, 1.0, 0.0, 0.0, 1.0]
    assert not at_once(safety, Dynamics())
    assert at_once(RuleSafety(PLAIN, TrainingCard()), Dynamics())


def test_a_rule_without_hysteresis_takes_none_from_the_logs() -> None:
    way = [1.0, 0.7, 0.81, 1.0]
    assert scalings(RuleSafety(PLAIN, TrainingCard()), way, Dynamics(hysteresis_m=0.2)) == [1.0, 0.0, 1.0, 1.0]


def test_what_if_changes_the_hysteresis_of_a_rule() -> None:
    changed = altered_safety(
        Change("none", dynamics={"hysteresis_m": 0.0}), RuleSafety(HELD, TrainingCard()), Dynamics()
    )
    assert scalings(changed, [0.7, 0.81, 2.4, 2.6], Dynamics()) == [0.0, 1.0, 0.5, 1.0]
    wider = altered_safety(
        Change("more", dynamics={"hysteresis_m": 0.3}), RuleSafety(PLAIN, TrainingCard()), Dynamics()
    )
    assert scalings(wider, [0.7, 1.05, 1.11, 2.4, 2.75, 2.85], Dynamics()) == [0.0, 0.0, 1.0, 0.5, 0.5, 1.0]


def test_where_nobody_is_no_rule_holds() -> None:
    X = np.array([[0.0] * 3 + [np.nan] * 3, [0.0] * 3 + [0.5, 0.0, 0.0]])
    anywhere = rule((0.5, RegionCard(anywhere=True), None))
    assert RuleSafety(anywhere, TrainingCard()).predict(X).tolist() == [1.0, 0.5]
    assert RuleSafety(PLAIN, TrainingCard()).predict(X).tolist() == [1.0, 0.0]


def test_a_rule_is_kept_as_data_beside_the_network(tmp_path: Path) -> None:
    save_model(tmp_path / "model", model(TrainingCard(rule=HELD)))
    opened = load_model(tmp_path / "model")
    assert opened.card.rule == HELD
    asked = model_of(tmp_path / "model")
    assert isinstance(asked, RuleSafety)
    assert asked.rule == HELD
    without = replace(opened, card=structs.replace(opened.card, rule=None))
    assert model_of(without) is without


def test_a_rule_on_the_nearest_link_without_poses_of_the_arm_leaves_the_answer_to_the_network() -> None:
    asked = model(TrainingCard(rule=rule((0.0, near(0.8, TO_LINK), None))))
    assert predictor_of(asked) is asked


def test_a_rule_on_the_nearest_link_is_asked_with_the_arm_as_it_was_logged_there() -> None:
    poses = (
        PoseCard(tcp_m=(1.0, 0.0, 0.5), joints_m=((0.0, 0.0, 0.0), (0.0, 0.0, 0.5))),
        PoseCard(tcp_m=(0.0, 1.0, 0.5), joints_m=((0.0, 0.0, 0.0), (0.0, 0.0, 0.5))),
    )
    safety = predictor_of(model(TrainingCard(rule=structs.replace(rule((0.0, near(0.3, TO_LINK), None)), poses=poses))))
    assert isinstance(safety, RuleSafety)
    beside_the_elbow = [1.0, 0.0, 0.5, 0.5, 0.2, 0.5]
    beside_the_other_pose = [1.0, 0.0, 0.5, 0.2, 0.6, 0.5]
    assert safety.predict(np.array([beside_the_elbow, beside_the_other_pose])).tolist() == [0.0, safety.levels[-1]]


def test_poses_of_the_arm_give_the_nearest_link_of_executions_that_they_have_not_seen(logged: Dataset) -> None:
    names = logged.executions["execution"].to_list()
    seen, unseen = names[1:], names[:1]
    frame = logged.samples(unseen).drop_nulls(["robot_x_m", "human_x_m"])
    robot_m, human_m = (frame.select([f"{who}_{axis}_m" for axis in "xyz"]).to_numpy() for who in ("robot", "human"))
    true_m = to_nearest_link(logged, frame["execution"].to_numpy(), frame["t_s"].to_numpy(), robot_m, human_m)
    found_m = to_links(ArmPoses(poses_of(logged, seen)).points(robot_m), human_m)
    off = np.abs(found_m - true_m)
    assert np.nanmean(off) < 0.004
    assert np.nanquantile(off, 0.99) < 0.02


def test_a_rule_on_a_signal_leaves_the_answer_to_the_network() -> None:
    occupied = RegionCard(signals=(SignalCard(signal="FIELD_1", value="1"),))
    asked = model(TrainingCard(rule=rule((0.0, occupied, None))))
    assert predictor_of(asked) is asked


def test_a_field_counts_only_while_the_robot_is_in_its_region() -> None:
    region = structs.replace(box(0.0, 1.0), robot=box(0.2, 0.6).rectangles[0])
    safety = RuleSafety(rule((0.5, region, None)), TrainingCard())
    X = np.array([[0.4, 0, 0, 0.5, 0, 0], [0.7, 0, 0, 0.5, 0, 0], [0.4, 0, 0, 1.5, 0, 0]], np.float64)
    assert safety.predict(X).tolist() == [0.5, 1.0, 1.0]
    wider = safety.with_hysteresis(0.3).rule.limits[0].until
    assert wider is not None
    assert wider.robot == region.robot
    alone = RuleSafety(rule((0.5, RegionCard(robot=region.robot), None)), TrainingCard())
    X[2, 3:] = np.nan
    assert scaling_of(alone, X[:, :3], X[:, 3:]).tolist() == [0.5, 1.0, 0.5]


@pytest.mark.parametrize(
    ("path", "value"),
    [(("limits", 0, "within", "nearer", 0, "distance"), "by eye"), (("levels",), [1.0, 0.0]), (("explained",), 2.0)],
)
def test_a_damaged_rule_is_refused(path: tuple[Any, ...], value: object) -> None:
    values = plain(TrainingCard(rule=HELD))
    part: Any = values["rule"]
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    with pytest.raises(BadCard):
        checked(values, TrainingCard)


def test_the_rule_of_a_logged_cell_is_put_beside_its_network(logged: Dataset) -> None:
    found = with_rule(model(TrainingCard(), logged.levels), logged).card.rule
    assert found is not None
    assert (found.family, found.hysteresis) == (TO_TCP, False)
    assert [metres.value for metres in quantities(found.limits).values()] == pytest.approx(
        [1.2, 1.5, 1.9, 2.4], abs=0.01
    )


def test_a_forecast_has_no_rule(logged: Dataset) -> None:
    with pytest.raises(ModelError, match="a rule gives the present scaling"):
        with_rule(replace(model(TrainingCard()), problem="ahead"), logged)
