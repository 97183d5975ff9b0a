"""The commands that ask on: estimate with its options, plan, zones, whatif, drift; errors with a cure."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import pytest

from cyclekit.config.sequences import load_sequences

if TYPE_CHECKING:
    from .conftest import Shell


def test_an_estimate_tells_takt_quantiles_work_and_check(model: Path, dataset: Path, sequences: Path, cyclekit: Shell):
    words = ("estimate", model, sequences, "--dataset", dataset, "--extrapolate", "--quiet")
    typed = cyclekit(*words, "--takt", "12s", "--quantiles", "10,50,90", "--json")
    assert typed.code == 0, typed.err
    first, second = typed.document["sequences"]
    assert set(first["quantiles_s"]) == {"0.1", "0.5", "0.9"}
    assert first["takt_s"] == 12.0
    assert 0 <= first["takt_probability"][0] <= 1
    assert first["beats"] == second["beats"] == {}  # one visits more places than the other
    assert typed.document["check"]["executions"] == 6
    shown = cyclekit(*words, "--takt", "12s").out
    assert "within 12 s" in shown
    assert "per visit" in shown
    assert "logged executions rolled out with their own operators" in " ".join(shown.split())


def test_a_sequence_that_cannot_be_answered_is_named_and_the_others_are_answered(
    model: Path, dataset: Path, sequences: Path, tmp_path: Path, cyclekit: Shell
):
    never = '[[sequence]]\nname = "never"\nplaces = ["home", "left_1", "home"]\n'
    both, none = tmp_path / "both.toml", tmp_path / "none.toml"
    both.write_text(never + sequences.read_text(encoding="utf-8"), encoding="utf-8")
    none.write_text(never, encoding="utf-8")
    words = ("--dataset", dataset, "--estimator", "history")
    typed = cyclekit("estimate", model, both, *words, "--json")
    assert typed.code == 0, typed.err
    assert len(typed.document["sequences"]) == len(load_sequences(sequences))
    ((name, reason),) = [tuple(entry.values()) for entry in typed.document["refused"]]
    assert name == "never"
    assert "was never logged" in reason
    assert "Not answered\n- " in cyclekit("estimate", model, both, *words).out
    failed = cyclekit("estimate", model, none, *words, "--out", tmp_path / "x.json")
    assert failed.code == 1
    assert "was never logged" in failed.err
    assert not (tmp_path / "x.json").exists()


@pytest.mark.parametrize("name", ["history", "nominal"])
def test_other_estimators_are_asked_by_name(name: str, model: Path, dataset: Path, sequences: Path, cyclekit: Shell):
    typed = cyclekit("estimate", model, sequences, "--dataset", dataset, "--estimator", name, "--json", "--quiet")
    assert typed.code == 0, typed.err
    assert {entry["estimator"] for entry in typed.document["sequences"]} == {name}
    assert typed.document["check"] is None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--estimator", "guess"], "unknown estimator 'guess'"),
        (["--estimator", "average"], "needs 'average'"),
    ],
)
def test_an_estimator_that_cannot_answer_is_refused(
    words: list[str], said: str, model: Path, dataset: Path, sequences: Path, cyclekit: Shell
):
    typed = cyclekit("estimate", model, sequences, "--dataset", dataset, *words)
    assert typed.code == 1
    assert said in typed.err


@pytest.mark.parametrize("words", [["--quantiles", "5"], ["--quantiles", "5,x"], ["--takt", "soon"]])
def test_a_wrong_option_is_told_as_such(words: list[str], model: Path, dataset: Path, sequences: Path, cyclekit: Shell):
    assert cyclekit("estimate", model, sequences, "--dataset", dataset, *words).code == 2


def test_a_plan_is_an_order_and_a_sequence_file(
    model: Path, dataset: Path, jobs: Path, tmp_path: Path, cyclekit: Shell
):
    out = tmp_path / "planned.toml"
    typed = cyclekit("plan", model, jobs, "--dataset", dataset, "--out", out, "--json", "--quiet")
    assert typed.code == 0, typed.err
    assert typed.document["tried"] == 6
    (planned,) = load_sequences(out)
    assert list(planned.places) == typed.document["places"]
    shown = cyclekit("plan", model, jobs, "--dataset", dataset, "--quiet").out
    assert "order: " in shown
    assert "s (95 % CI " in shown.partition("saves ")[2]


def test_a_plan_of_a_place_that_does_not_exist_is_refused(model: Path, dataset: Path, tmp_path: Path, cyclekit: Shell):
    file = tmp_path / "jobs.toml"
    file.write_text('start = "home"\nvisit = ["left_1", "left_11"]\n', encoding="utf-8")
    typed = cyclekit("plan", model, file, "--dataset", dataset)
    assert typed.code == 1
    assert "unknown place 'left_11'" in typed.err
    assert "left_1" in typed.err


def test_zones_are_a_table_and_a_picture(model: Path, dataset: Path, tmp_path: Path, cyclekit: Shell):
    out = tmp_path / "zones.svg"
    typed = cyclekit("zones", model, dataset, "--out", out, "--json", "--quiet")
    assert typed.code == 0, typed.err
    assert len(typed.document["thresholds"]) == len(typed.document["levels"]) - 1
    assert ElementTree.parse(out).getroot().tag.endswith("svg")
    shown = cyclekit("zones", model, dataset, "--quiet").out
    assert "speed 25 % when the operator is nearer than" in " ".join(shown.split())  # a rule, as a person writes it
    assert "no safety proof" in shown


SEPARATION = (
    *("--reaction-time-s", "0.1", "--stopping-time-s", "0.1,0.2,0.3,0.4", "--stopping-distance-m", "0.2"),
    *("--robot-speed-m-s", "1", "--intrusion-m", "0.1", "--operator-uncertainty-m", "0.05"),
    *("--robot-uncertainty-m", "0.01"),
)


@pytest.mark.slow  # quick: tests/estimate/test_costs.py
def test_zones_tell_what_a_centimetre_costs_and_the_margin(
    model: Path, dataset: Path, sequences: Path, cyclekit: Shell
):
    words = ("zones", model, dataset, "--cost", sequences, *SEPARATION, "--extrapolate", "--quiet")
    typed = cyclekit(*words, "--json")
    assert typed.code == 0, typed.err
    costs = typed.document["costs"]
    rows = costs["sequences"][0]["parameters"]
    assert [row["parameter"] for row in rows] == ["threshold"] * 4 + ["hysteresis", "reaction time"]
    assert all(row["costs_s"] > -3 * row["standard_error_s"] for row in rows[:4])
    assert [row["speed"] for row in costs["margins"]["thresholds"]] == [0.25, 0.5, 0.75, 1.0]
    shown = cyclekit(*words).out
    assert max(map(len, shown.splitlines())) <= 80
    assert "No safety validation" in " ".join(shown.split())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--reaction-time-s", "0.1"), "also give --stopping-time-s, --stopping-distance-m"),
        (SEPARATION, "also give --cost"),
        (("--cost", "s.toml", *SEPARATION, "--stopping-time-s", "fast"), "'fast': give numbers such as 0.1,0.3"),
    ],
)
def test_a_separation_distance_needs_all_its_terms(words: tuple[str, ...], said: str, cyclekit: Shell):
    typed = cyclekit("zones", "model", "dataset", *words)
    assert typed.code == 2
    assert said in typed.err


def test_where_no_rule_explains_the_logs_there_is_no_threshold_to_price(
    model: Path, dataset: Path, sequences: Path, cyclekit: Shell, monkeypatch: pytest.MonkeyPatch
):
    from cyclekit.learning.rules.ladder import RuleSearch

    monkeypatch.setattr("cyclekit.learning.safety_function.answer.rule_of", lambda *_, **__: RuleSearch(None))
    typed = cyclekit("zones", model, dataset, "--cost", sequences)
    assert typed.code == 1
    assert "no simple rule explains these logs: there is no threshold to move" in typed.err
    assert "cyclekit whatif" in typed.err


def test_what_if_says_that_it_is_no_safety_proof(
    model: Path, dataset: Path, sequences: Path, tmp_path: Path, cyclekit: Shell
):
    file = tmp_path / "changes.toml"
    file.write_text('[[change]]\nname = "open"\nlevels = [0.5, 1.0]\nthresholds_m = [0.1]\n', encoding="utf-8")
    words = ("whatif", model, sequences, file, "--dataset", dataset, "--extrapolate", "--quiet")
    out = tmp_path / "answers.json"
    typed = cyclekit(*words, "--out", out, "--json")
    assert typed.code == 0, typed.err
    assert "no safety proof" in typed.document["safety"]
    assert all("no safety proof" in entry["safety"] for entry in typed.document["answers"])
    assert all(entry["after"]["safety_loss_s"] < 0.1 for entry in typed.document["answers"])
    assert "no safety proof" in out.read_text(encoding="utf-8")
    shown = cyclekit(*words).out
    assert "no safety proof" in shown
    assert "open" in shown


def test_a_change_of_a_place_that_does_not_exist_is_refused(
    model: Path, dataset: Path, sequences: Path, tmp_path: Path, cyclekit: Shell
):
    file = tmp_path / "changes.toml"
    file.write_text("[[change]]\nplaces = { conveyer = [0.0, 0.0, 0.0] }\n", encoding="utf-8")
    typed = cyclekit("whatif", model, sequences, file, "--dataset", dataset, "--extrapolate")
    assert typed.code == 1
    assert "unknown place 'conveyer'" in typed.err
    assert "conveyor" in typed.err


@pytest.mark.usefixtures("no_boosting")
def test_evaluate_says_whether_the_cell_has_changed(model: Path, dataset: Path, cyclekit: Shell):
    typed = cyclekit("evaluate", model, dataset, "--trained-on", dataset, "--quiet")
    assert typed.code == 0, typed.err
    assert "the operator's habits: no change seen" in typed.out
    assert "drift" in cyclekit("evaluate", model, dataset, "--trained-on", dataset, "--json", "--quiet").document


def test_an_estimate_ends_with_the_verdict_against_a_baseline(
    model: Path, dataset: Path, sequences: Path, cyclekit: Shell
) -> None:
    name = tomllib.loads(sequences.read_text("utf-8"))["sequence"][0]["name"]
    words = ("estimate", model, sequences, "--dataset", dataset, "--no-check", "--extrapolate", "--quiet")
    typed = cyclekit(*words, "--takt", "1000s", "--baseline", name)
    last = " ".join(typed.out.rpartition("\n\n")[2].split())
    assert last.startswith(f"“{name}” (baseline) ")
    assert "100 % of cycles within the takt of 1000 s (95 % CI " in last
    refused = cyclekit(*words, "--baseline", "nobody")
    assert refused.code != 0
    assert "nobody" in refused.err
