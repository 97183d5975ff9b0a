"""`cyclekit report` with changes to try and work to put in order: computed there and then, or read from a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from .conftest import Shell


@pytest.fixture
def changes(tmp_path: Path) -> Path:
    file = tmp_path / "changes.toml"
    file.write_text('[[change]]\nname = "open"\nlevels = [0.5, 1.0]\nthresholds_m = [0.1]\n', encoding="utf-8")
    return file


def test_changes_and_order_are_computed_for_the_page(
    model: Path, dataset: Path, sequences: Path, jobs: Path, changes: Path, tmp_path: Path, cyclekit: Shell
):
    out = tmp_path / "r.json"
    asked = ["--sequences", sequences, "--what-if", changes, "--plan", jobs, "--extrapolate"]
    typed = cyclekit("report", dataset, "--model", model, *asked, "--out", out, "--json", "--quiet")
    assert typed.code == 0, typed.err
    assert typed.document["missing"] == []
    document = json.loads(out.read_text("utf-8"))
    assert {entry["label"] for entry in document["what_if"]} == {"open"}
    assert len(document["what_if"]) == len(document["sequences"])
    assert document["plan"]["tried"] == 6
    assert document["check"]["executions"] > 0
    rivals = {row["name"] for row in document["evaluation"]["mse"]}
    assert {"constant mean", "distance staircase"} <= rivals
    assert "gradient boosting" not in rivals  # a page shall be quick: `cyclekit evaluate` fits it


def test_what_the_whatif_command_wrote_goes_into_the_page(
    model: Path, dataset: Path, sequences: Path, changes: Path, tmp_path: Path, cyclekit: Shell
):
    answers, out = tmp_path / "answers.json", tmp_path / "r.md"
    words = ("whatif", model, sequences, changes, "--dataset", dataset, "--extrapolate", "--quiet")
    assert cyclekit(*words, "--out", answers).code == 0
    typed = cyclekit("report", dataset, "--what-if", answers, "--out", out, "--quiet")
    assert typed.code == 0, typed.err
    assert "| open | " in out.read_text("utf-8")


def test_an_order_that_cannot_be_searched_is_said_on_the_page(
    model: Path, dataset: Path, tmp_path: Path, cyclekit: Shell
):
    file = tmp_path / "jobs.toml"
    file.write_text('start = "home"\nvisit = ["left_1", "left_11"]\n', encoding="utf-8")
    out = tmp_path / "r.md"
    typed = cyclekit("report", dataset, "--model", model, "--plan", file, "--out", out, "--json", "--quiet")
    assert typed.code == 0, typed.err
    assert "No order could be searched" in typed.document["missing"][0]
    assert "left_11" in out.read_text("utf-8")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--what-if", "{changes}"], "add --sequences"),
        (["--what-if", "{changes}", "--sequences", "{sequences}"], "add --model"),
        (["--plan", "{jobs}"], "add --model"),
        (["--what-if", "no file"], "neither CHANGES.toml nor FILE.json"),
    ],
)
def test_what_cannot_be_computed_as_asked_is_a_usage_error(
    options: list[str],
    said: str,
    dataset: Path,
    sequences: Path,
    jobs: Path,
    changes: Path,
    tmp_path: Path,
    cyclekit: Shell,
):
    words = [word.format(changes=changes, sequences=sequences, jobs=jobs) for word in options]
    typed = cyclekit("report", dataset, *words, "--out", tmp_path / "r.html")
    assert typed.code == 2
    assert said in typed.err
    assert not (tmp_path / "r.html").exists()
