"""What the commands answer by a model of task times, of a cell of which task lists alone are known."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from quick_task_times import learn_quickly

from cyclekit import train_task_times
from cyclekit.ingest.ingest import ingest
from cyclekit_sim.task_lists import simulate_task_lists


@pytest.fixture(scope="module")
def listed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of task lists, and a model of it."""
    folder = tmp_path_factory.mktemp("listed")
    simulate_task_lists(folder / "logs", executions=15, seed=1)
    ingest([folder / "logs" / "tasks.csv"], folder / "dataset")
    with pytest.MonkeyPatch.context() as patch:
        learn_quickly(patch)  # other files look at rates and held-out orders
        train_task_times(folder / "dataset", out=folder / "model")
    return folder


@pytest.mark.usefixtures("words_only")
def test_plan_whatif_evaluate_and_report_answer(cyclekit, listed: Path, tmp_path: Path) -> None:
    agents = {"bring": "robot", "weld": "robot", "mount": "operator"}
    jobs = [f'[[task]]\nagent = "{agent}"\nname = "{name}"\n' for name, agent in agents.items()]
    (tmp_path / "jobs.toml").write_text("".join(jobs), encoding="utf-8")
    (tmp_path / "changes.toml").write_text('[[change]]\nno_wait = [["weld", "mount"]]\n', encoding="utf-8")
    planned, model, data = tmp_path / "planned.toml", listed / "model", listed / "dataset"
    done = cyclekit("plan", model, tmp_path / "jobs.toml", "--dataset", data, "--out", planned)
    assert "robot: bring, weld\noperator: mount" in done.out, done.err
    done = cyclekit("whatif", model, planned, tmp_path / "changes.toml", "--dataset", data, "--json")
    assert done.document["answers"][0]["saves_s"][0] == pytest.approx(5.0, abs=0.7)
    assert "15 executions: cycle time" in cyclekit("evaluate", model, data).out
    done = cyclekit("report", data, "--model", model, "--plan", tmp_path / "jobs.toml", "--out", tmp_path / "page.html")
    assert done.code == 0, done.err
    assert "“order found” takes" in done.out


@pytest.mark.usefixtures("words_only")
def test_a_plan_with_an_unknown_task_is_named_and_the_others_are_answered(
    cyclekit, listed: Path, tmp_path: Path
) -> None:
    plans, changes, model, data = tmp_path / "p.toml", tmp_path / "c.toml", listed / "model", listed / "dataset"
    task = '[[sequence.task]]\nagent = "robot"\nname = "{}"\n'
    plans.write_text(
        "".join(f'[[sequence]]\nname = "{name}"\n{task.format(of)}' for name, of in (("A", "bring"), ("B", "brign"))),
        encoding="utf-8",
    )
    two = '[[change]]\nname = "two"\nmore_places = { fixture = 1 }\n'
    quicker = "".join(f'[[change]]\nname = "{n}"\nfaster = {{ robot = 1.1 }}\n' for n in ("quicker", "again"))
    changes.write_text(quicker + two, encoding="utf-8")
    found = cyclekit("whatif", model, plans, changes, "--dataset", data, "--json").document
    assert [entry["after"]["name"] for entry in found["answers"]] == ["A", "A"]
    refused = {entry.get("sequence") or entry["change"]: entry["reason"] for entry in found["refused"]}
    assert list(refused) == ["B", "two"]
    assert "buffer = { TASK = 1 } for a second fixture" in refused["two"]
    shown = cyclekit("whatif", model, plans, changes, "--dataset", data).out
    assert "\n- task lists hold no positions" in shown  # of every change: without its name
    words = ("report", data, "--model", model, "--sequences", plans, "--what-if", changes)
    assert cyclekit(*words, "--out", tmp_path / "r.md").code == 0
    page = (tmp_path / "r.md").read_text("utf-8")
    assert "## Plans not answered" in page
    assert re.search(r"\| B \| unknown task of \w+ 'brign'", page)
    assert "| quicker | A |" in page


def test_places_are_refused_with_an_example(cyclekit, listed: Path, tmp_path: Path) -> None:
    (tmp_path / "places.toml").write_text('start = "home"\nvisit = ["a", "b"]\n', encoding="utf-8")
    done = cyclekit("plan", listed / "model", tmp_path / "places.toml", "--dataset", listed / "dataset")
    assert done.code != 0
    assert "no [[task]] in it" in done.err
    assert "[[task]]\n" in done.err


@pytest.mark.usefixtures("words_only")
def test_options_that_a_model_of_task_times_cannot_honour_are_refused(cyclekit, listed: Path, tmp_path: Path) -> None:
    plan, jobs, changes = tmp_path / "plan.toml", tmp_path / "jobs.toml", tmp_path / "changes.toml"
    plan.write_text('[[sequence]]\nname = "A"\n[[sequence.task]]\nagent = "robot"\nname = "bring"\n', encoding="utf-8")
    jobs.write_text('[[task]]\nagent = "robot"\nname = "bring"\n', encoding="utf-8")
    changes.write_text('[[change]]\nname = "quicker"\nfaster = { robot = 1.1 }\n', encoding="utf-8")
    model, data = listed / "model", ("--dataset", listed / "dataset")
    asked = ("--no-check", "--other-cell")
    page = ("--model", model, "--sequences", plan, "--out", tmp_path / "page.md")
    commands = {
        "estimate": ("estimate", model, plan, *data, "--extrapolate"),
        "plan": ("plan", model, jobs, *data),
        "whatif": ("whatif", model, plan, changes, *data, "--extrapolate"),
        "report": ("report", data[1], *page, "--extrapolate"),
    }
    for name, words in commands.items():
        done = cyclekit(*words, *asked)
        assert done.code == 1, name
        refused = "validate, other_cell" if name == "plan" else "extrapolate, validate, other_cell"
        assert f"error: {refused}: not for a model of task times" in done.err, done.err


@pytest.mark.usefixtures("words_only")
def test_the_gate_ends_with_0_1_or_2(cyclekit, listed: Path, tmp_path: Path) -> None:
    plan, words = tmp_path / "plan.toml", ("--dataset", listed / "dataset", "--share", "0.5", "--confidence", "0.9")
    order = (("robot", "bring"), ("robot", "weld"), ("operator", "mount"))
    tasks = (f'[[sequence.task]]\nagent = "{agent}"\nname = "{name}"\n' for agent, name in order)
    plan.write_text('[[sequence]]\nname = "A"\n' + "".join(tasks), encoding="utf-8")
    estimated = cyclekit("estimate", listed / "model", plan, "--dataset", listed / "dataset", "--json").document
    (entry,) = estimated["sequences"]
    low_s, middle_s, high_s = entry["quantiles_s"].values()
    for takt_s, code, answer in ((high_s, 0, "passed"), (low_s, 1, "failed"), (middle_s, 2, "unknown")):
        typed = cyclekit("gate", listed / "model", plan, "--takt", f"{takt_s}s", *words)
        assert (typed.code, typed.out.partition(":")[0]) == (code, answer), typed.out + typed.err
        assert ("log more executions" in " ".join(typed.out.split())) is (code == 2)
        document = cyclekit("gate", listed / "model", plan, "--takt", f"{takt_s}s", *words, "--json").document
        assert (document["answer"], document["passed"], bool(document["why"])) == (answer, code == 0, code == 2)
