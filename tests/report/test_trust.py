from __future__ import annotations

import dataclasses
import json

import numpy as np
from report_pages import DistanceModel, Page, estimate

from cyclekit.estimate.check import compare
from cyclekit.report import write_report


def checked(executions=40):
    """A check of executions of which one in ten lies outside what the other operators give."""
    rng = np.random.default_rng(0)
    logged = np.full(executions, 30.0)
    logged[::10] = 50.0
    crossed = 30.0 + rng.normal(0, 2.0, (executions, executions))
    return compare(logged, logged, crossed, np.arange(executions) % 4 == 0, (0.05, 0.5, 0.95))


def text_of(dataset, out, **given):
    facts = write_report(dataset, DistanceModel(), out, estimates=[estimate("A first")], **given)
    return Page(facts.path.read_text("utf-8")).text.replace("\N{NO-BREAK SPACE}", " ")


def test_how_often_the_intervals_held_is_told_as_measured(dataset, tmp_path):
    check = checked()
    text = text_of(dataset, tmp_path / "r.html", check=check)
    assert check.coverage == 0.9
    assert "Logged executions inside their 90 % interval (should be 90 %) 90 %" in text
    assert "Logged executions rolled out 40" in text
    assert "Of these, unseen by the model 10" in text
    assert "was not measured for this report" not in text
    assert "the error that the model showed on logged executions" in text


def test_without_a_check_no_coverage_is_claimed(dataset, tmp_path):
    text = text_of(dataset, tmp_path / "r.html")
    assert "was not measured for this report" in text
    assert "the error of the model itself is not in them" in text


def test_too_few_executions_for_a_coverage_are_said_to_be_so(dataset, tmp_path):
    text = text_of(dataset, tmp_path / "r.html", check=checked(executions=4))
    assert "4 logged executions are too few for quantiles that hold" in text
    assert "was not measured for this report" in text
    assert "should be 90 %" not in text


def test_what_a_sequence_rests_on_is_said_beside_the_proof(dataset, tmp_path):
    one = dataclasses.replace(estimate("A first"), executions=40, tracks=120)
    facts = write_report(dataset, None, tmp_path / "r.html", estimates=[one])
    assert "A first 97 % 40 120 rollout" in Page(facts.path.read_text("utf-8")).text.replace("\N{NO-BREAK SPACE}", " ")


def test_the_check_is_in_the_document(dataset, tmp_path):
    out = tmp_path / "r.json"
    write_report(dataset, None, out, estimates=[estimate()], check=checked(), kind="json")
    assert json.loads(out.read_text("utf-8"))["check"]["coverage"] == 0.9
