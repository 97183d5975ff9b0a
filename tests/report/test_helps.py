from __future__ import annotations

import csv
import json
import math

import polars as pl
import pytest
from report_pages import Page, estimate

from cyclekit.cli.terminal import write_out
from cyclekit.errors import CyclekitError
from cyclekit.estimate.plan import OrderPlan
from cyclekit.estimate.whatif import NO_PROOF, WhatIf
from cyclekit.report import Tried, compose_report, load_tried
from cyclekit.report.findings import overview
from cyclekit.report.helps import _moments
from cyclekit.report.texts import load_texts

pytestmark = pytest.mark.usefixtures("words_only")

BOTH = OrderPlan(
    order=("left->right", "left"), places=("conveyor", "left", "right", "left"), expected_s=28.1,
    against="random orders", against_s=31.3, saves_s=(3.2, 2.6, 3.8), searched="search", tried=16,
    executions=40, operator=("desk", "shelf"),
)  # fmt: skip
PLANNED = OrderPlan(
    order=("right", "left"), places=("conveyor", "right", "conveyor", "left"), expected_s=28.1,
    against="logged executions", against_s=31.3, saves_s=(3.2, 2.6, 3.8), searched="all orders", tried=2, executions=40,
)  # fmt: skip


def changed(saves_s=(3.0, 2.4, 3.6), name="A first", **changes):
    after = estimate(name, 27.0, limits=("motions are bent", NO_PROOF), **changes)
    return WhatIf("table 0.3 m back", estimate(name, 30.0), after, saves_s)


def shown(dataset, out, **given):
    page = Page(
        compose_report(dataset, None, out, estimates=[estimate("A first", 30.0)], **given).path.read_text("utf-8")
    )
    return page.text.replace("\N{NO-BREAK SPACE}", " ")


def test_what_was_tried_is_held_against_todays_estimate(dataset, tmp_path):
    file = tmp_path / "changed.json"
    file.write_text(json.dumps({"sequences": [estimate("A first", 27.0).to_dict()]}), "utf-8")
    changes = load_tried(file, "table 0.3 m back")
    facts = compose_report(dataset, None, tmp_path / "r.html", estimates=[estimate("A first", 30.0)], what_if=changes)
    text = Page(facts.path.read_text("utf-8")).text
    assert "table 0.3 m back A first 27.0 26.4 to 27.6 3.0" in text
    assert "No change of zones, layout or speeds was estimated" not in text


@pytest.mark.parametrize("content", ["", "{}", '{"sequences": [{"name": "A"}]}', '{"sequences": 3}', "[1]"])
def test_a_file_that_holds_no_estimates_is_refused_with_the_cure(tmp_path, content):
    file = tmp_path / "changed.json"
    file.write_text(content, "utf-8")
    with pytest.raises(CyclekitError, match=r"changed\.json") as caught:
        load_tried(file, "x")
    assert "cyclekit estimate" in str(caught.value)


def test_what_the_whatif_command_found_keeps_interval_support_and_limits(dataset, tmp_path):
    file = tmp_path / "whatif.json"
    file.write_text(json.dumps({"safety": NO_PROOF, "answers": [changed().to_dict()]}), "utf-8")
    read = load_tried(file)
    assert read == [Tried.of(changed())]
    assert read[0].limits == ("motions are bent",)
    text = shown(dataset, tmp_path / "r.html", what_if=read)
    assert "table 0.3 m back A first 27.0 26.4 to 27.6 3.0 2.4 to 3.6 97 %" in text
    assert "tried on “A first”: “table 0.3 m back”, 3.0 s per cycle (95 % CI 2.4 to 3.6 s)." in text
    assert "table 0.3 m back: motions are bent" in text


def test_a_given_safety_function_needs_no_support(dataset, tmp_path):
    file = tmp_path / "whatif.json"
    write_out(file, {"answers": [changed(support=math.nan).to_dict()]})
    assert load_tried(file)[0].support is None
    assert load_tried(file) == [Tried.of(changed(support=math.nan))]


def test_a_change_whose_interval_reaches_nought_is_not_said_to_save(dataset, tmp_path):
    even = [Tried.of(changed(saves_s=(3.0, -0.1, 6.1)))]
    assert "None of the changes tried clearly saves time" in shown(dataset, tmp_path / "r.html", what_if=even)


def test_the_change_that_saves_most_is_named_first_of_all(dataset, tmp_path):
    some = [Tried("a", "A first", 29.0, 28.0, 30.0), Tried("b", "A first", 26.0, 25.0, 27.0), Tried("c", "Z", 1, 0, 2)]
    text = shown(dataset, tmp_path / "r.html", what_if=some)
    assert "Largest saving of the changes tried on “A first”: “b”, 4.0 s per cycle." in text


def test_what_limits_one_sequence_only_is_said_of_that_one(dataset, tmp_path):
    both, one = ("taken from elsewhere", "thin"), ("taken from elsewhere",)
    some = [Tried("a", "A first", 29.0, 28.0, 30.0, limits=both), Tried("a", "B first", 29.0, 28.0, 30.0, limits=one)]
    text = shown(dataset, tmp_path / "r.html", what_if=some)
    assert text.count("a: taken from elsewhere") == 1
    assert "a, A first: thin" in text


def test_the_order_found_is_shown_with_what_it_saves_and_rests_on(dataset, tmp_path):
    text = shown(dataset, tmp_path / "r.html", planned=PLANNED)
    assert "saves 3.2 s per cycle (95 % CI 2.6 to 3.8 s) against today's cycles" in text
    assert "Order: right → left." in text
    assert "The saving is the one to expect on executions that were not used to choose the order" in text
    assert "Every possible order: 2 orders compared on 40 logged executions" in text
    assert "No other order of the same work was searched" not in text


def test_an_order_that_saves_nothing_for_sure_is_not_praised(dataset, tmp_path):
    even = OrderPlan(**{**vars(PLANNED), "saves_s": (0.2, -0.4, 0.8)})
    text = shown(dataset, tmp_path / "r.html", planned=even)
    assert "No clearly faster order of the same work was found" in text
    assert "The best order found" not in text


@pytest.mark.parametrize("kind", ["json", "csv", "md"])
def test_changes_and_order_are_in_the_data_too(dataset, tmp_path, kind):
    out = tmp_path / f"r.{kind}"
    compose_report(
        dataset, None, out, estimates=[estimate("A first")], what_if=[Tried.of(changed())], planned=PLANNED, kind=kind
    )
    text = out.read_text("utf-8")
    if kind == "json":
        document = json.loads(text)
        assert document["plan"]["order"] == ["right", "left"]
        assert document["what_if"][0]["saves_s"] == [3.0, 2.4, 3.6]
    elif kind == "csv":
        rows = [row for row in csv.DictReader(text.splitlines()) if row["change"]]
        assert [(row["change"], row["expected_s"], row["saves_s"], row["task"]) for row in rows] == [
            ("table 0.3 m back", "27.0", "3.0", ""),
            ("order", "28.1", "3.2", ""),
            ("order", "", "", "right"),
            ("order", "", "", "left"),
        ]
    else:
        assert "| table 0.3 m back | A first | 27.0 |" in text
        assert "Order: right → left." in text


def test_where_no_task_of_the_operator_is_known_there_is_no_table_of_them(dataset):
    samples, seen = dataset.samples(), overview(dataset, dataset.samples(), dataset.tasks())
    texts = load_texts()
    assert _moments(texts, samples, seen) is not None
    unknown = samples.with_columns(human_task=pl.lit(None, pl.String))
    assert _moments(texts, unknown, seen) is None


def test_the_order_found_for_both_names_both_orders(dataset, tmp_path):
    text = shown(dataset, tmp_path / "r.html", planned=BOTH)
    assert "Order of the robot: left → right, left. Order of the operator: desk → shelf." in text
    assert "16 orders compared in simulated cycles of robot and operator, learned from 40 logged executions." in text
    assert "with the same operators" not in text  # these draws do not depend on the order
    assert "Saving on executions that were not used" not in text
