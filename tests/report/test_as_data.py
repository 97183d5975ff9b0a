from __future__ import annotations

import json
import re

import polars as pl
import pytest
from fabricated import LEVELS
from report_pages import DistanceModel, Judgement, estimate

from cyclekit.report import compose_report


def test_the_report_as_json_gives_every_number_unrounded(dataset, tmp_path):
    one = estimate("A first", 30.123456)
    facts = compose_report(
        dataset, DistanceModel(), tmp_path / "r.json", estimates=[one], evaluation=Judgement(), kind="json"
    )  # fmt: skip
    document = json.loads(facts.path.read_text("utf-8"))
    assert document["sequences"] == [one.to_dict()]
    assert sum(task["total_s"] * task["seen"] for task in document["logged_tasks"]) == pytest.approx(
        (dataset.tasks()["end_s"] - dataset.tasks()["start_s"]).sum()
    )
    assert document["evaluation"] == Judgement().to_dict()
    assert {level["scaling"] for level in document["levels"]} <= set(LEVELS)


def test_the_report_as_csv_adds_up(dataset, tmp_path):
    facts = compose_report(dataset, None, tmp_path / "r.csv", estimates=[estimate()], kind="csv")
    rows = pl.read_csv(facts.path)
    tasks = rows.filter(pl.col("order") > 0)
    parts = tasks.select(pl.sum_horizontal("nominal_s", "safety_loss_s", "dwell_s", "wait_s")).to_series()
    assert parts.to_list() == pytest.approx(tasks["expected_s"].to_list())
    assert rows.filter(pl.col("order") == 0)["low_s"].to_list() == [29.4]
    logged = pl.read_csv(compose_report(dataset, None, tmp_path / "l.csv", kind="csv").path)
    assert logged["seen"].sum() == dataset.tasks().height


def test_the_report_as_markdown_has_every_table_whole(dataset, tmp_path):
    ranked = [estimate("A | first"), estimate("B first", 33.0)]
    facts = compose_report(dataset, DistanceModel(), tmp_path / "r.md", estimates=ranked, kind="md")
    text = facts.path.read_text("utf-8")
    assert [line for line in text.splitlines() if line.startswith("## ")] == [
        "## 1 The answer",
        "## 2 Where the time goes",
        "## 3 Why the robot slows down",
        "## 4 What would help",
        "## 5 How reliable are these numbers?",
    ]
    assert "A \\| first" in text
    assert "Not a safety validation" in text
    for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        columns = {len(re.findall(r"(?<!\\)\|", line)) for line in block.splitlines()}
        assert len(columns) == 1


@pytest.mark.parametrize("kind", ["json", "md"])
def test_where_no_picture_is_shown_none_is_drawn(kind, dataset, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr("cyclekit.report.pictures.Picture._drawn", lambda *words: drawn.append(words) or "<svg/>")
    compose_report(dataset, DistanceModel(), tmp_path / f"r.{kind}", estimates=[estimate()], kind=kind)
    assert drawn == []
    compose_report(dataset, DistanceModel(), tmp_path / "r.html", estimates=[estimate()])
    assert len(drawn) > 2
