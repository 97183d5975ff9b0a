"""What the commands say of task lists and of a safety system's logs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cyclekit.cli.lists import coupling_table
from cyclekit.dataset.cards.coupling import ConditionCard, CouplingCard, GateCard, SourceCard
from cyclekit_sim.task_lists import simulate_task_lists

TASKS = [
    {"agent": "Operator", "task": "pick", "start_s": 0.5, "end_s": 2.5, "run": "a", "outcome": 1},
    {"agent": "Operator", "task": "pick", "start_s": 2.0, "end_s": 6.0, "run": "a", "outcome": 0},
    {"agent": "kuka", "task": "drill", "start_s": 1.0, "end_s": 3.0, "run": "a", "planned_start_s": 0.5, "outcome": 1},
    {"agent": "kuka", "task": "drill", "start_s": 101.0, "run": "b", "outcome": 1},
]


@pytest.fixture
def tasks(tmp_path: Path) -> Path:
    (tmp_path / "logs").mkdir()
    file = tmp_path / "logs" / "tasks.json"
    file.write_text(json.dumps(TASKS), encoding="utf-8")
    return file


@pytest.fixture
def override(tmp_path: Path) -> Path:
    rows = [f"{i / 10},{value},{2.0 - i / 1000}" for i, value in enumerate([100] * 60 + [50] * 30 + [0] * 11)]
    file = tmp_path / "ovr.csv"
    file.write_text("\n".join(["time_s,safe_ovr,distance", *rows]) + "\n", encoding="utf-8")
    return file


def test_inspect_names_agents_tasks_overlaps_executions_and_outcomes(cyclekit, tasks: Path) -> None:
    done = cyclekit("inspect", tasks)
    assert done.code == 0
    lines = [" ".join(line.split()) for line in done.out.splitlines()]
    assert "Operator operator 2 1 (to 0.5 s)" in lines
    assert "kuka robot 2 0" in lines
    assert "Operator pick 2 3.00 1.41 2.00 4.00" in lines
    assert "executions: 2, 5.5 s long (median 5.5 s)" in lines
    assert "outcome: 1 of 4 tasks failed; without an end: 1" in lines
    assert "planned start: known of 25 % of the tasks" in lines
    facts = cyclekit("inspect", tasks, "--json").document["logs"][0]["task_list"]
    assert facts["failed"] == facts["no_end"] == 1
    assert {one["name"]: one["overlaps"] for one in facts["agents"]} == {"Operator": 1, "kuka": 0}


def test_inspect_gives_the_values_of_an_override_and_how_long_each_held(cyclekit, override: Path) -> None:
    done = cyclekit("inspect", override)
    text = " ".join(done.out.split())
    assert "override 0 to 100 %, 3 values, known for 10 s" in text
    assert "60 % of the time at 100 %, 30 % of the time at 50 %, 10 % of the time at 0 %" in text
    assert "distance 1.90 to 2.00 m (median 1.95 m); 0 % of the rows repeat the one before" in text
    assert "10 Hz" in text
    facts = cyclekit("inspect", override, "--json").document["logs"][0]["safety"]
    assert [value for value, _ in facts["override_values"]] == [1.0, 0.5, 0.0]
    assert [seconds for _, seconds in facts["override_values"]] == pytest.approx([6.0, 3.0, 1.0])


def test_a_silence_of_the_log_is_no_time_at_a_value(cyclekit, tmp_path: Path) -> None:
    times = [i / 10 for i in range(50)] + [1000 + i / 10 for i in range(50)]
    rows = [f"{t!r},{100 if t < 1000 else 30}" for t in times]
    (tmp_path / "ovr.csv").write_text("\n".join(["time_s,ovr", *rows]) + "\n", encoding="utf-8")
    facts = cyclekit("inspect", tmp_path / "ovr.csv", "--json").document["logs"][0]["safety"]
    assert facts["override_s"] == pytest.approx(4.9 + 0.5 + 4.9)


def test_a_dataset_of_them_is_shown_as_what_it_is(cyclekit, tasks: Path, override: Path, tmp_path: Path) -> None:
    made = cyclekit("ingest", tasks.parent, override, "--out", tmp_path / "dataset")
    assert made.code == 0, made.err
    assert "2 executions, 4 tasks, 0 samples" in made.out
    assert "cyclekit train" not in made.out
    shown = cyclekit("inspect", tmp_path / "dataset").out
    assert "positions   none: neither of the robot nor of people" in shown
    assert "safety system, ovr" in shown
    assert "Operator" in shown
    assert "operator seen in" not in shown


@pytest.mark.parametrize("command", ["levels", "replay", "trace"])
def test_commands_that_need_positions_end_with_one_sentence(
    cyclekit, tasks: Path, tmp_path: Path, command: str
) -> None:
    cyclekit("ingest", tasks.parent, "--out", tmp_path / "dataset", "--quiet")
    more = {
        "levels": [],
        "replay": ["--execution", "1", "--out", tmp_path / "a.rrd"],
        "trace": ["--execution", "1", "--at", "1s"],
    }
    done = cyclekit(command, tmp_path / "dataset", *more[command])
    assert done.code == 1
    assert "made of task lists alone: the positions of robot and people, which this needs, were not logged" in done.err
    assert len(done.err.strip().splitlines()) == 2


@pytest.mark.parametrize("command", ["estimate", "evaluate", "plan", "zones"])
def test_a_model_of_another_cell_cannot_be_asked_about_them(
    cyclekit, model: Path, tasks: Path, tmp_path: Path, command: str
) -> None:
    cyclekit("ingest", tasks.parent, "--out", tmp_path / "dataset", "--quiet")
    sequences, jobs = tmp_path / "s.toml", tmp_path / "jobs.toml"
    sequences.write_text('[[sequence]]\nname = "a"\nplaces = ["home", "there"]\n', encoding="utf-8")
    jobs.write_text('start = "home"\nvia = "there"\nvisit = ["a", "b"]\n', encoding="utf-8")
    dataset = tmp_path / "dataset"
    words = {
        "estimate": [model, sequences, "--estimator", "history", "--dataset", dataset],
        "evaluate": [model, dataset],
        "plan": [model, jobs, "--dataset", dataset],
        "zones": [model, dataset],
    }
    done = cyclekit(command, *words[command], "--other-cell")
    assert done.code == 1
    assert "made of task lists alone" in done.err


def test_convert_writes_a_task_list(cyclekit, tasks: Path, tmp_path: Path) -> None:
    done = cyclekit("convert", tasks, "--out", tmp_path / "tasks.csv")
    assert done.code == 0, done.err
    first, *rows = (tmp_path / "tasks.csv").read_text(encoding="utf-8").splitlines()
    assert first.startswith("t_s,end_s,agent,agent_name,task")
    assert rows[0].startswith("0.5,2.5,operator,Operator,pick")


@pytest.mark.usefixtures("quick_task_times")
def test_task_lists_go_from_logs_to_the_cycle_time_of_a_plan(cyclekit, tmp_path: Path) -> None:
    simulate_task_lists(tmp_path / "logs", executions=20, seed=2)
    dataset, model, file = tmp_path / "dataset", tmp_path / "model", tmp_path / "s.toml"
    cyclekit("ingest", tmp_path / "logs" / "tasks.csv", "--out", dataset, "--quiet")
    trained = cyclekit("train", dataset, "--out", model)
    assert trained.code == 0, trained.err
    assert "worker: mount" in trained.out
    tasks = [("robot", "bring"), ("robot", "weld"), ("operator", "mount")]
    told = [f'[[sequence.task]]\nagent = "{agent}"\nname = "{name}"' for agent, name in tasks]
    file.write_text("\n".join(['[[sequence]]\nname = "a"', *told]), encoding="utf-8")
    shown = cyclekit("estimate", model, file, "--dataset", dataset)
    assert shown.code == 0, shown.err
    assert "operator: mount" in shown.out
    assert "hold no positions" in shown.out
    (answer,) = cyclekit("estimate", model, file, "--dataset", dataset, "--json").document["sequences"]
    assert 15.0 < answer["expected_s"] < 18.5
    assert answer["wait_s"] > 4.0
    assert "worker: mount" in cyclekit("inspect", model).out
    assert cyclekit("inspect", model, "--json").document["card"]["executions"] == 20
    refused = cyclekit("zones", model, dataset)
    assert refused.code == 1
    assert "Use it for plans of robot and operator: cyclekit estimate" in refused.err
    other = cyclekit("estimate", model, file, "--dataset", dataset, "--estimator", "history")
    assert other.code == 1
    assert "estimator: not for a model of task times" in other.err
    assert cyclekit("estimate", model, file, "--dataset", tmp_path / "nowhere").code == 1
    assert cyclekit("train", dataset, "--out", model, "--seeds", "1,2").code == 2
    file.write_text('[[sequence]]\n[[sequence.task]]\nagent = "robt"\nname = "bring"\n', encoding="utf-8")
    assert "the nearest is 'robot'" in cyclekit("estimate", model, file, "--dataset", dataset).err


def test_logs_of_one_name_are_told_apart_by_their_folders(cyclekit, tasks: Path, tmp_path: Path) -> None:
    for number in range(4):
        (tmp_path / "days" / f"day_{number}").mkdir(parents=True)
        (tmp_path / "days" / f"day_{number}" / "tasks.csv").write_bytes(tasks.read_bytes())
    shown = cyclekit("inspect", tmp_path / "days").out
    assert [line.split()[0] for line in shown.splitlines() if " task-list " in line] == [
        f"day_{number}/tasks.csv" for number in range(4)
    ]


@pytest.mark.parametrize(
    ("gap_s", "said"),
    [((0.0,), "press\n"), ((4.0,), "press in its visit before, or 4.0 s after the one before")],
)
def test_when_a_signal_comes_names_its_own_work_only_where_it_has_some(gap_s: tuple[float, ...], said: str) -> None:
    done = ConditionCard(agent="signal", place="done", event="set", lag_s=(0.0,))
    leaves = ConditionCard(agent="robot", place="press", event="leaves", lag_s=(25.0,), back=int(gap_s[0] > 0.0))
    card = CouplingCard(
        gates=(GateCard(agent="robot", at="leave", place="press", own_s=(1.0,), conditions=(done,), passages=9),),
        sources=(SourceCard(signal="done", gap_s=gap_s, taken_by="press", after=(leaves,)),),
        executions=9,
    )
    assert f"done set comes 25.0 s after robot leaves {said}" in coupling_table(card) + "\n"


@pytest.mark.parametrize(("told", "of_logs", "said"), [(False, True, 1), (False, False, 0), (True, True, 0)])
def test_waits_found_in_logs_are_not_said_to_be_used(told: bool, of_logs: bool, said: int) -> None:
    """A model drops what rolls logged executions out worse than none; what the cell file tells it keeps."""
    leaves = ConditionCard(agent="operator", place="press", event="leaves", lag_s=(1.0,))
    gate = GateCard(agent="robot", at="approach", place="press", conditions=(leaves,), passages=9, told=told)
    shown = coupling_table(CouplingCard(gates=(gate,), executions=9), of_logs=of_logs)
    assert shown.count("a model uses them unless logged executions roll out worse with them") == said
    none = coupling_table(CouplingCard(executions=9), of_logs=of_logs)
    assert none.endswith(f"none {'found' if of_logs else 'used'} in 9 executions")
