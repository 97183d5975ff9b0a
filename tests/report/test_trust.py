from __future__ import annotations

import dataclasses
import json

import msgspec
import numpy as np
import pytest
from played import classifier, network
from report_pages import DistanceModel, Page, estimate

from cyclekit.cli.estimate import validation
from cyclekit.config.sequences import PLAN
from cyclekit.dataset.cards.notes import note
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.joint.check import JointCheck
from cyclekit.estimate.result import TaskShare
from cyclekit.estimate.validation.check import compare
from cyclekit.estimate.what_to_log import RecordingPlan
from cyclekit.report import compose_report

pytestmark = pytest.mark.usefixtures("words_only")


def checked(executions=40):
    """A check of executions of which one in ten lies outside what the other operators give."""
    rng = np.random.default_rng(0)
    logged = np.full(executions, 30.0)
    logged[::10] = 50.0
    crossed = 30.0 + rng.normal(0, 2.0, (executions, executions))
    return compare(logged, logged, crossed, np.arange(executions) % 4 == 0, (0.05, 0.5, 0.95))


def text_of(dataset, out, **given):
    facts = compose_report(dataset, DistanceModel(), out, estimates=[estimate("A first")], **given)
    return Page(facts.path.read_text("utf-8")).text.replace("\N{NO-BREAK SPACE}", " ")


def test_how_often_the_intervals_held_is_told_as_measured(dataset, tmp_path):
    check = checked()
    text = text_of(dataset, tmp_path / "r.html", check=check)
    assert check.coverage == 0.9
    assert "Coverage of the 90 % prediction interval (nominal 90 %) 90 %" in text
    assert "Logged executions rolled out 40" in text
    assert "Of these, unseen by the model 10" in text
    assert "was not measured for this report" not in text
    assert "the error of the model in the backtest on logged executions" in text


def test_who_has_learned_by_regression_is_not_told_to_do_so(dataset, tmp_path):
    warned = Dataset(dataset.path, msgspec.structs.replace(dataset.card, warnings=(note("levels-many", levels=40),)))
    texts = {}
    for name, model in (("none", None), ("classifier", classifier()), ("regressor", network())):
        facts = compose_report(warned, model, tmp_path / f"{name}.html", estimates=[estimate("A first")])
        texts[name] = Page(facts.path.read_text("utf-8")).text
    assert all("40 levels are too many for discrete levels" in text for text in texts.values())
    assert [name for name, text in texts.items() if "learn it by regression" in text] == ["none", "classifier"]


def test_a_check_of_both_agents_names_their_orders_and_no_operator_tracks(dataset, tmp_path):
    check = JointCheck(**vars(checked()))
    text = text_of(dataset, tmp_path / "r.html", check=check)
    assert "Bias with each execution's own orders of robot and operator" in text
    assert "Bias with the operators of all other executions" not in text
    assert "with their own orders of robot and operator: bias" in " ".join(validation(check).split())


def test_without_a_check_no_coverage_is_claimed(dataset, tmp_path):
    text = text_of(dataset, tmp_path / "r.html")
    assert "was not measured for this report" in text
    assert "they do not include the error of the model" in text


def test_too_few_executions_for_a_coverage_are_said_to_be_so(dataset, tmp_path):
    text = text_of(dataset, tmp_path / "r.html", check=checked(executions=4))
    assert "4 logged executions are too few for reliable quantiles" in text
    assert "was not measured for this report" in text
    assert "nominal 90 %" not in text


def test_what_a_sequence_rests_on_is_said_beside_the_proof(dataset, tmp_path):
    one = dataclasses.replace(estimate("A first"), executions=40, tracks=120)
    facts = compose_report(dataset, None, tmp_path / "r.html", estimates=[one])
    assert "A first 97 % 40 120 rollout" in Page(facts.path.read_text("utf-8")).text.replace("\N{NO-BREAK SPACE}", " ")


def test_the_check_is_in_the_document(dataset, tmp_path):
    out = tmp_path / "r.json"
    compose_report(dataset, None, out, estimates=[estimate()], check=checked(), kind="json")
    assert json.loads(out.read_text("utf-8"))["check"]["coverage"] == 0.9


class Beaten:
    """An evaluation in which a baseline has the smaller error."""

    def __init__(self, best="distance staircase", mse=8.2e-5):
        rows = {"model": 8.0e-4, "model, most likely step": 1.1e-3, "constant mean": 0.138, best: mse}
        self.rows = [{"name": name, "mse": value, "note": ""} for name, value in rows.items()]

    def to_dict(self):
        return {"mse": self.rows, "held_out": True}


def said(dataset, out, **given):
    return text_of(dataset, out, **given).replace("\N{NARROW NO-BREAK SPACE}", " ")


def test_a_baseline_with_the_smaller_error_is_explained_and_what_the_numbers_are_made_with(dataset, tmp_path):
    text = said(dataset, tmp_path / "r.html", evaluation=Beaten(), check=checked())
    assert "estimated cycle times come from the network (row “model”)" in text
    assert "the distance staircase has the smaller error (MSE 8.20 · 10⁻⁵, the network 8.00 · 10⁻⁴)" in text
    assert "Explained variance of the logged speed: network 99 %, distance staircase over 99 %" in text
    assert "from the backtest: bias 0.00 % (95 % CI ± 0.00 %)" in text
    other = said(dataset, tmp_path / "o.html", evaluation=Beaten("gradient boosting"))
    assert "the network has not learned all that these logs show" in other
    assert "this baseline assumes" not in other


def test_a_network_that_is_better_than_its_baselines_needs_no_explanation(dataset, tmp_path):
    text = said(dataset, tmp_path / "r.html", evaluation=Beaten(mse=0.01))
    assert "come from the network" in text
    assert "has the smaller error" not in text


def test_the_page_says_what_to_log_next(dataset, tmp_path):
    asked = dataclasses.replace(estimate("A first"), places=("conveyor", "left", "right"))
    facts = compose_report(dataset, None, tmp_path / "r.html", estimates=[asked])
    text = Page(facts.path.read_text("utf-8")).text.replace("\N{NO-BREAK SPACE}", " ")
    assert "What to log next" in text
    assert "Missing: left → right." in text
    assert "Log 5 executions of conveyor, left, right (sequence 'A first')." in text
    compose_report(dataset, None, tmp_path / "r.json", estimates=[asked], kind="json")
    told = json.loads((tmp_path / "r.json").read_text("utf-8"))["to_log"]
    assert told["missing"] == ["left->right"]


def test_plans_for_both_ask_for_the_tasks_of_the_robot(dataset, tmp_path):
    """Not for all that were logged."""
    plan = (PLAN, "robot: left", "robot: right", "operator: desk")
    tasks = tuple(TaskShare(name, 9.0, 9.0, 0.0, 0.0, 0.0) for name in ("conveyor->left", "left->right"))
    asked = dataclasses.replace(estimate("both"), places=plan, tasks=tasks)
    compose_report(dataset, None, tmp_path / "r.json", estimates=[asked], kind="json")
    told = json.loads((tmp_path / "r.json").read_text("utf-8"))["to_log"]
    assert (told["missing"], set(told["rare"]) - {"conveyor->left"}) == (["left->right"], set())


def test_a_page_on_enough_logs_lacks_nothing(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(RecordingPlan, "in_words", lambda _plan, _shown: [])
    assert "Nothing is missing: each task was logged" in text_of(dataset, tmp_path / "r.html")
