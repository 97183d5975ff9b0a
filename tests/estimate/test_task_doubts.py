"""Doubts about plans from task lists, and executions with failed tasks."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from msgspec import structs

from cyclekit import TaskSequence, estimate_cycles, train_task_times
from cyclekit.config.sequences import PlannedTask
from cyclekit.dataset.cards.task_model import NeedCard
from cyclekit.errors import EstimateError
from cyclekit.estimate.finding import doubts_of
from cyclekit.estimate.task_doubts import findings_of_plan
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.task_times.saved import TaskTimesModel


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """A robot that picks, places and offers; two of twelve executions have a failed pick, cut short and repeated."""
    folder = tmp_path_factory.mktemp("doubts")
    rng = np.random.default_rng(1)
    rows = []
    for run in range(12):
        t, at = 100.0 * run, [("pick", "done"), ("place", "done"), ("offer", "done")]
        for task, outcome in [("pick", "failed"), *at] if run % 6 == 5 else at:
            took = 0.5 if outcome == "failed" else rng.uniform(4.9, 5.1)
            rows.append((run, "arm", task, t, t + took, outcome))
            t += took + 0.1
        rows.append((run, "human", "take", t - 3.0, t - 0.1, "done"))
    pl.DataFrame(rows, schema=["run", "agent", "task", "start_s", "end_s", "outcome"], orient="row").write_csv(
        folder / "tasks.csv"
    )
    ingest([folder / "tasks.csv"], folder / "dataset")
    return folder, train_task_times(folder / "dataset", out=folder / "model")


def plan(*names: str) -> TaskSequence:
    return TaskSequence.of_plan("p", [PlannedTask("human" if name == "take" else "arm", name) for name in names])


def test_executions_with_a_failed_task_are_left_out_and_that_is_said(learned) -> None:
    folder, model = learned
    assert (model.card.executions, model.card.failed) == (10, 2)
    (answer,) = estimate_cycles(model, folder / "dataset", plan("pick", "place", "offer", "take"))
    assert answer.doubts == ()
    assert any("2 logged executions with a failed task are left out" in text for text in answer.warnings)
    assert answer.expected_s == pytest.approx(15.3, abs=0.3)


def test_what_was_never_logged_in_a_row_or_together_is_doubted(learned) -> None:
    folder, model = learned
    (answer,) = estimate_cycles(model, folder / "dataset", plan("pick", "pick", "offer"))
    assert any("never logged in a row: pick after pick, offer after pick" in text for text in answer.warnings)
    (doubt,) = answer.doubts
    assert "a joint task, and here not as often: offer with take" in doubt


def test_a_wait_for_a_task_that_the_plan_lacks_is_named(learned) -> None:
    _, model = learned
    need = NeedCard(agent="arm", task="offer", back=1)
    tasks = tuple(structs.replace(one, needs=(need,), joint=None) for one in model.card.tasks if one.task == "take")
    card = structs.replace(model.card, tasks=(*tasks, *(one for one in model.card.tasks if one.task != "take")))
    said = "wait of human: take for arm: offer: left out {}, the plan has no such task then"
    assert doubts_of(findings_of_plan(card, plan("take"))) == ()  # the first needs none
    assert doubts_of(findings_of_plan(card, plan("take", "take"))) == (said.format("once"),)
    assert doubts_of(findings_of_plan(card, plan("take", "take", "take"))) == (said.format("twice"),)
    assert said.format("once") in doubts_of(findings_of_plan(card, plan("take", "take", "take", "offer")))
    assert not any("wait of" in doubt for doubt in doubts_of(findings_of_plan(card, plan("take", "take", "offer"))))


def test_a_task_never_logged_is_refused_with_a_cure(learned) -> None:
    folder, model = learned
    with pytest.raises(EstimateError, match="unknown task of arm 'paint'") as caught:
        estimate_cycles(model, folder / "dataset", plan("pick", "paint"))
    assert "Log executions with it" in str(caught.value)


def test_a_model_far_off_on_held_out_orders_is_doubted(learned) -> None:
    folder, model = learned
    judged = structs.replace(model.card.held_out, bias=0.65)
    off = TaskTimesModel(structs.replace(model.card, held_out=judged))
    (answer,) = estimate_cycles(off, folder / "dataset", plan("pick", "place", "offer", "take"))
    assert "held-out orders were +65 % off on average" in answer.doubts[0]
