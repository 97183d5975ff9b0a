"""`cyclekit report` with changes to try and work to put in order: computed there and then, or read from a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from cyclekit.errors import EstimateError

if TYPE_CHECKING:
    from .conftest import Shell

pytestmark = pytest.mark.usefixtures("words_only")


@pytest.fixture
def changes(tmp_path: Path) -> Path:
    file = tmp_path / "changes.toml"
    file.write_text('[[change]]\nname = "open"\nlevels = [0.5, 1.0]\nthresholds_m = [0.1]\n', encoding="utf-8")
    return file


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("option", "text", "said"),
    [
        ("--plan", 'start = "home"\nvisit = ["left_1", "left_11"]\n', "unknown place 'left_11'"),
        ("--sequences", '[[sequence]]\nname = "A"\nplaces = ["home", "conveyer"]\n', "unknown place 'conveyer'"),
        ("--what-if", "[[change]]\nplaces = { conveyer = [0.0, 0.0, 0.0] }\n", "unknown place 'conveyer'"),
    ],
)
def test_what_was_asked_for_and_is_wrong_is_an_error_and_writes_nothing(
    option: str, text: str, said: str, model: Path, dataset: Path, sequences: Path, tmp_path: Path, cyclekit: Shell
):
    file, out = tmp_path / "asked.toml", tmp_path / "r.html"
    file.write_text(text, encoding="utf-8")
    more = ["--sequences", sequences, "--extrapolate"] if option == "--what-if" else []
    words = ("report", dataset, "--model", model, option, file, *more, "--out", out, "--no-check", "--quiet")
    typed = cyclekit(*words)
    assert typed.code == 1
    assert said in typed.err
    assert not out.exists()


def test_what_was_not_asked_for_may_be_absent_and_is_told_without_a_command_line(
    model: Path, dataset: Path, tmp_path: Path, cyclekit: Shell, monkeypatch: pytest.MonkeyPatch
):
    def refused(*_: object, **__: object) -> None:
        raise EstimateError("no sample can be judged", cure="See what the logs lack: cyclekit inspect DATASET")

    monkeypatch.setattr("cyclekit.api.evaluate.evaluate", refused)
    out = tmp_path / "r.json"
    typed = cyclekit("report", dataset, "--model", model, "--out", out, "--json", "--quiet")
    assert typed.code == 0, typed.err
    assert typed.document["missing"][0] == "The model could not be evaluated: no sample can be judged."
    said = json.loads(out.read_text("utf-8"))["sentences"]
    assert "The model could not be evaluated: no sample can be judged." in said["trust"]
    assert not any("judged" in text or "cyclekit " in text for text in said["answer"])


def test_the_order_found_is_estimated_and_changed_like_a_sequence(
    model: Path, dataset: Path, jobs: Path, changes: Path, tmp_path: Path, cyclekit: Shell
):
    out = tmp_path / "r.json"
    words = ("report", dataset, "--model", model, "--plan", jobs, "--what-if", changes, "--extrapolate", "--no-check")
    typed = cyclekit(*words, "--out", out, "--takt", "10s", "--json", "--quiet")
    assert typed.code == 0, typed.err
    document = json.loads(out.read_text("utf-8"))
    (order,) = document["sequences"]
    assert (order["name"], order["places"]) == ("order found", document["plan"]["places"])
    assert [entry["sequence"] for entry in document["what_if"]] == ["order found"]
    assert document["verdict"]["text"] == document["answer"] == typed.document["answer"]
    assert document["verdict"]["best"]["expected_s"] == order["expected_s"]
    assert document["verdict"]["today"] is None  # three boxes of ten, and never alone
    assert any(
        "No logged execution at the usual speed slider does this work" in text
        for text in document["sentences"]["answer"]
    )


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


@pytest.fixture
def asked(tmp_path: Path) -> Path:
    """Two sequences: the logs can answer the first, and hold no task of the second."""
    file = tmp_path / "asked.toml"
    known, new = '["home", "conveyor", "left_1"]', '["home", "left_1", "conveyor"]'
    both = "".join(f'[[sequence]]\nname = "{n}"\nplaces = {places}\n' for n, places in (("A", known), ("B", new)))
    file.write_text(both, encoding="utf-8")
    return file


def test_the_page_answers_what_it_can_and_names_the_rest_with_the_reason(
    model: Path, dataset: Path, asked: Path, changes: Path, tmp_path: Path, cyclekit: Shell
):
    jobs, out = tmp_path / "jobs.toml", tmp_path / "r.json"
    jobs.write_text('start = "left_1"\nvisit = ["left_2", "left_3"]\n', encoding="utf-8")
    changes.write_text(changes.read_text("utf-8") + '[[change]]\nname = "often"\nfrequency = 50.0\n', encoding="utf-8")
    words = ("report", dataset, "--model", model, "--sequences", asked, "--extrapolate", "--no-check")
    typed = cyclekit(*words, "--what-if", changes, "--plan", jobs, "--out", out, "--json")
    assert typed.code == 0, typed.err
    document = json.loads(out.read_text("utf-8"))
    assert [entry["name"] for entry in document["sequences"]] == ["A"]
    assert [(entry["label"], entry["sequence"]) for entry in document["what_if"]] == [("open", "A")]
    refused = [{kind: name for kind, name in entry.items() if kind != "reason"} for entry in document["refused"]]
    assert refused == [{"sequence": "B"}, {"order": "order found"}, {"change": "often"}]
    assert typed.document["refused"] == document["refused"]
    assert "not answered: " in typed.err
    assert "home->left_1" in document["to_log"]["missing"]


def test_a_refused_sequence_is_named_below_the_estimates(
    model: Path, dataset: Path, asked: Path, tmp_path: Path, cyclekit: Shell
):
    words = ("report", dataset, "--model", model, "--sequences", asked, "--extrapolate", "--no-check", "--quiet")
    assert cyclekit(*words, "--out", tmp_path / "r.md").code == 0
    answer = (tmp_path / "r.md").read_text("utf-8").partition("## 2 ")[0]
    assert "### Not answered" in answer
    assert "| B | task 'home → left_1' was never logged" in answer
    refused = cyclekit(*words, "--baseline", "B", "--out", tmp_path / "no.html")
    assert (refused.code, (tmp_path / "no.html").exists()) == (1, False)
    assert "'home->left_1' was never logged" in refused.err


def test_a_page_of_sequences_without_any_answer_is_not_written(
    model: Path, dataset: Path, asked: Path, tmp_path: Path, cyclekit: Shell
):
    asked.write_text('[[sequence]]\nname = "B"\nplaces = ["home", "left_1", "conveyor"]\n', encoding="utf-8")
    words = ("report", dataset, "--model", model, "--sequences", asked, "--no-check", "--quiet")
    typed = cyclekit(*words, "--out", tmp_path / "r.html")
    assert (typed.code, (tmp_path / "r.html").exists()) == (1, False)
    assert "To log next: log 5 executions of home, left_1, conveyor (sequence 'B')" in typed.err
