"""Task lists with durations, and with what tasks share written once around them."""

import json

import pytest

from cyclekit.adapter import ReadOptions
from cyclekit_adapters.formats.task_list import ADAPTER


def read(path):
    return ADAPTER.read(path, ReadOptions()).task_list


def table(path, *lines):
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("column", "cells"),
    [("duration", ("4500", "2500")), ("Duration [s]", ("4.5", "2.5")), ("elapsed_ms", ("4500", "2500"))],
)
def test_a_duration_stands_for_the_end(tmp_path, column, cells):
    path = table(
        tmp_path / "a.csv",
        f"Run ID;Agent;Task;Start Time;{column}",
        f"1;human;mount;2024-05-01T10:00:00.000+02:00;{cells[0]}",
        f"1;human;pack;2024-05-01T10:00:05.000+02:00;{cells[1]}",
        "1;human;open;2024-05-01T10:00:09.000+02:00;",
    )
    assert ADAPTER.recognises(path)
    took = [None if row["end_s"] is None else row["end_s"] - row["t_s"] for row in read(path).to_dicts()]
    assert took == [4.5, 2.5, None]


def test_an_end_counts_more_than_a_duration(tmp_path):
    path = table(tmp_path / "a.csv", "agent,task,start_s,end_s,duration", "human,a,0.0,2.0,1.5")
    assert read(path)["end_s"].to_list() == [2.0]


@pytest.mark.parametrize(
    "nested",
    [
        {"line": 4, "executions": [{"execution_id": "e1", "tasks": "ALL"}, {"execution_id": "e2", "tasks": "ALL"}]},
        {"runs": [{"id": "e1", "tasks": "ALL"}, {"id": "e2", "tasks": "ALL"}]},
        [{"name": "e1", "tasks": "ALL"}, {"name": "e2", "tasks": "ALL"}],
        {"runs": [{"id": "e1", "agents": "BY AGENT"}, {"id": "e2", "agents": "BY AGENT"}]},
    ],
)
def test_what_is_around_an_array_of_tasks_counts_for_each(tmp_path, nested):
    every = [
        {"agent": "human", "name": "a", "start_ms": 0, "end_ms": 1500},
        {"agent": "r1", "name": "b", "start_ms": 0, "end_ms": 900},
    ]
    by_agent = [{"agent": one["agent"], "tasks": [{k: v for k, v in one.items() if k != "agent"}]} for one in every]
    text = json.dumps(nested).replace('"ALL"', json.dumps(every)).replace('"BY AGENT"', json.dumps(by_agent))
    path = tmp_path / "a.json"
    path.write_text(text)
    assert ADAPTER.recognises(path)
    rows = read(path)
    assert sorted(rows["execution"].to_list()) == ["e1", "e1", "e2", "e2"]
    assert sorted(rows["agent_name"].to_list()) == ["human", "human", "r1", "r1"]
