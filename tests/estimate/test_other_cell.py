"""A model of another cell is refused with the reason; a grown, renewed or resampled dataset is the same cell."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from msgspec import structs

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import BadCard, CellCard, TrainingCard, checked, dataset_card, plain
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ModelError
from cyclekit.estimate.finding import Finding
from cyclekit.estimate.joint.check import JointCheck
from cyclekit.estimate.limits import refuse_biased
from cyclekit.estimate.plan import Jobs, plan
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.validation.check import Check
from cyclekit.estimate.whatif import Change, what_if
from cyclekit.learning.networks.cell import cell_of, fingerprint, other_cell_of, refuse_other_cell, trained_on

if TYPE_CHECKING:
    from collections.abc import Callable


def card_of(dataset: Dataset) -> TrainingCard:
    return TrainingCard(dataset_sha256=fingerprint(dataset), cell=cell_of(dataset))


def changed(logged: Dataset, change: Callable[[dict[str, Any]], object]) -> Dataset:
    """Return a dataset with another card; what `change` returns is not looked at."""
    card = plain(logged.card)
    change(card)
    return Dataset(logged.path, dataset_card(card))


def newer(card: dict[str, Any]) -> None:
    """Make the card one of other logs of the same cell."""
    for number, record in enumerate(card["recordings"]):
        for source in record["sources"]:
            source["blake3"] = f"{number:064x}"


def move(card: dict[str, Any], metres: float, count: int = 99) -> None:
    for place in list(card["places"].values())[:count]:
        place["xyz_m"][0] += metres


def grow(card: dict[str, Any]) -> None:
    more = {**copy.deepcopy(card["recordings"][0]), "id": "session_001.robot"}
    more["sources"][0]["blake3"] = "f" * 64
    card["recordings"].append(more)
    card["executions"].append({**card["executions"][0], "execution": "session_001.001"})


def at_20_hz(card: dict[str, Any]) -> None:
    card["rate_hz"] = 20.0
    for entry in card["executions"]:
        entry["end_s"] += 0.03


def renamed(card: dict[str, Any]) -> None:
    newer(card)
    card["places"] = {
        f"place_{n}": {**place, "inferred": True} for n, place in enumerate(card["places"].values(), start=1)
    }


def turned(card: dict[str, Any]) -> None:
    frame = next(record["frame"] for record in card["recordings"] if "xyz_m" in record["frame"])
    frame["xyz_m"][1] += 0.4


@pytest.mark.parametrize(
    "change",
    [
        lambda card: None,
        grow,
        at_20_hz,
        newer,
        renamed,
        lambda card: (newer(card), move(card, 0.3, count=2)),
        lambda card: (newer(card), card["levels"].pop(0)),
        lambda card: (newer(card), card["places"].clear()),
        lambda card: move(card, 0.3),  # the logs are those of the training: the cell file names other places
    ],
    ids=["same", "grown", "20 Hz", "newer", "found places", "one moved", "fewer levels", "no places", "renamed"],
)
def test_the_same_cell_is_taken(logged: Dataset, change: Callable[[dict[str, Any]], object]):
    assert other_cell_of(card_of(logged), changed(logged, change)) is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda card: (newer(card), move(card, 0.3)),
            "places are not where they were in training, such as conveyor at (0.90",
        ),
        (lambda card: (newer(card), card.update(levels=[0.1, 0.4, 0.6])), "has the levels 0.10, 0.40, 0.60"),
        (turned, "are in another frame"),
    ],
    ids=["places", "levels", "frame"],
)
def test_another_cell_is_refused_with_the_reason(
    logged: Dataset, change: Callable[[dict[str, Any]], object], said: str
):
    other = changed(logged, change)
    with pytest.raises(ModelError) as caught:
        refuse_other_cell(card_of(logged), other)
    assert said in str(caught.value)
    assert "--other-cell" in str(caught.value.cure)
    refuse_other_cell(card_of(logged), other, other_cell=True)
    refuse_other_cell(TrainingCard(), other)  # a function that was written by hand is of no cell


def test_estimate_plan_and_what_if_refuse_and_answer_where_it_is_meant(logged: Dataset, staircase: Any):
    elsewhere = changed(logged, lambda card: (newer(card), move(card, 0.3)))
    staircase.card = card_of(elsewhere)
    asked = [TaskSequence("A", logged.card.executions[0].places[:5])]
    slots = tuple(place for place in asked[0].places if place not in ("home", "conveyor"))
    with pytest.raises(ModelError, match="not the cell"):
        estimate(staircase, logged, asked)
    with pytest.raises(ModelError, match="not the cell"):
        what_if(staircase, logged, asked, [Change("seldom", frequency=0.9)])
    with pytest.raises(ModelError, match="not the cell"):
        plan(staircase, logged, Jobs(slots, "home", None, "conveyor"))
    (found,) = estimate(staircase, logged, asked, other_cell=True, validate=False)
    assert found.expected_s > 0
    (nominal,) = estimate(staircase, logged, asked, estimator="nominal")  # asks no model
    assert nominal.safety_loss_s == 0.0


def of_bias(check: Check) -> Finding:
    return next(one for one in check.findings if one.code == "bias")


BIASED = Check(40, 8, 0.2, 0.01, 0.2, 0.0, (0.0,) * 40, 0.9, None, (0.05, 0.95))


def test_a_bias_beyond_ten_percent_is_refused_and_one_beyond_three_stands_above_the_numbers():
    with pytest.raises(ModelError, match=r"\+20.0 % .* on 40 logged executions") as caught:
        refuse_biased(BIASED)
    assert "--other-cell" in str(caught.value.cure)
    assert "Train it on them" in str(caught.value.cure)
    with pytest.raises(ModelError) as own:
        refuse_biased(BIASED, own=True)
    assert "It was trained on them" in str(own.value.cure)
    assert "--align-clocks logs" in str(own.value.cure)
    assert "cyclekit train" not in str(own.value.cure)
    assert "[[waits]]" not in str(own.value.cure)
    with pytest.raises(ModelError) as coupled:
        refuse_biased(JointCheck(**vars(BIASED)), own=True)
    assert "the robot: log the buttons, bits and sensors that end waits" in str(coupled.value.cure)
    assert "also look at clocks" in str(coupled.value.cure)
    refuse_biased(replace(BIASED, own_error=0.07))  # chance
    warned = replace(BIASED, own_bias=0.05)
    refuse_biased(warned)
    assert "+5.0 %" in of_bias(warned).text
    levels = [
        of_bias(replace(warned, **off)).level
        for off in ({}, {"own_error": 0.02}, {"own_bias": 0.02, "own_error": 0.005})
    ]
    assert levels == ["red", "green", "amber"]


def test_a_model_far_off_on_the_logs_is_refused_unless_that_is_meant(logged: Dataset, constant: Any):
    sequence = TaskSequence("A", logged.card.executions[0].places[:5])
    with pytest.raises(ModelError, match="does not fit these logs"):
        estimate(constant(1.0), logged, [sequence], extrapolate=True)
    (found,) = estimate(constant(1.0), logged, [sequence], extrapolate=True, other_cell=True)
    assert found.check is not None
    assert of_bias(found.check).level == "red"


def test_a_model_knows_the_logs_that_it_was_trained_on(logged: Dataset):
    card = TrainingCard(cell=cell_of(logged))
    assert trained_on(card, logged)
    assert trained_on(TrainingCard(dataset_sha256=fingerprint(logged)), logged)
    assert card.cell is not None
    assert not trained_on(TrainingCard(cell=structs.replace(card.cell, logs={"others": None})), logged)
    assert not trained_on(TrainingCard(), logged)


def test_the_cell_of_a_dataset_is_one(logged: Dataset):
    stated = plain(cell_of(logged))
    assert checked(stated, CellCard) == cell_of(logged)
    with pytest.raises(BadCard, match="logs"):
        checked({**stated, "logs": {"a": [1.0]}}, CellCard)
