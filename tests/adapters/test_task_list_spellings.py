"""Task lists with durations, and with what tasks share written once around them."""

import json

import pytest

from cyclekit.adapter import ReadOptions
from cyclekit_adapters.formats import mapped_csv
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


TASKS = [  # agent, task, execution, start, end: s after 06:30
    (agent, task, f"cycle {cycle}", 60 * cycle + start, 60 * cycle + end)
    for cycle in range(3)
    for agent, task, start, end in (("robot", "pick", 0, 8), ("operator", "mount", 5, 40))
]
READ = sorted((agent, task, execution, end - start) for agent, task, execution, start, end in TASKS)


def iso(second):
    return f"2024-05-14 06:{30 + second // 60}:{second % 60:02}+00:00"


def events():
    """Start and end of each task, in the order of time."""
    told = [(at, order, task) for task in TASKS for order, at in enumerate(task[3:])]
    return [(task, ("start", "complete")[order], at) for at, order, task in sorted(told, key=lambda one: one[:2])]


def whole(header, row):
    return [header, *(row(*task) for task in TASKS)]


def paired(header, row):
    return [header, *(row(*task[:3], transition, at) for task, transition, at in events())]


@pytest.mark.parametrize(
    "lines",
    [
        whole("case_id,activity,resource,start_timestamp,timestamp",
              lambda a, t, c, s, e: f"{c},{t},{a},{iso(s)},{iso(e)}"),
        whole("Zyklus;Ressource;Vorgang;Beginn;Ende", lambda a, t, c, s, e: f"{c};{a};{t};{iso(s)};{iso(e)}"),
        whole("Case ID;Activity;Resource;Start Timestamp;Complete Timestamp",
              lambda a, t, c, s, e: f"{c};{t};{a};{iso(s)};{iso(e)}"),
        paired("case:concept:name,concept:name,time:timestamp,org:resource,lifecycle:transition",
               lambda a, t, c, tr, at: f"{c},{t},{iso(at)},{a},{tr}"),
        paired("case_id,activity_id,activity_instance_id,lifecycle_id,resource_id,timestamp",
               lambda a, t, c, tr, at: f"{c},{t},{c}{t},{tr.upper()},{a},{iso(at)}"),
    ],
    ids=["both-timestamps", "german", "complete", "xes-names", "bupar"],
)  # fmt: skip
def test_a_table_of_tasks_is_known_by_the_names_that_process_mining_and_planners_write(tmp_path, lines):
    path = table(tmp_path / "a.csv", *lines)
    assert ADAPTER.recognises(path)
    rows = read(path)
    took = zip(*rows.select("agent_name", "task", "execution"), rows["end_s"] - rows["t_s"], strict=True)
    assert sorted(took) == READ


@pytest.mark.parametrize(
    ("lines", "asked"),
    [
        (whole("Nr;Wer;Was;Los um;Weg um", lambda a, t, c, s, e: f"{c[-1]};{a};{t};{iso(s)};{iso(e)}"), set()),
        (whole("Serie,Was,Wer,Los,Weg", lambda a, t, c, s, e: f"{c},{t},{a},{iso(s)},{iso(e)}"), {"task", "execution"}),
        (paired("Serie,Was,Wer,Stempel,Art", lambda a, t, c, tr, at: f"{c},{t},{a},{iso(at)},{tr}"),
         {"task", "execution"}),
    ],
)  # fmt: skip
def test_a_table_of_tasks_with_other_names_is_drafted_by_its_cells(tmp_path, lines, asked):
    path = table(tmp_path / "a.csv", *lines)
    assert not ADAPTER.recognises(path)
    assert mapped_csv.ADAPTER.draft(path) is None
    draft = ADAPTER.draft(path)
    assert {line.key for line in draft.map if not line.sure} == asked
    rows = ADAPTER.read(path, ReadOptions(map={line.key: line.value for line in draft.map})).task_list
    took = zip(*rows.select("agent_name", "task"), rows["end_s"] - rows["t_s"], strict=True)
    assert sorted(took) == [(agent, task, seconds) for agent, task, _, seconds in READ]


def test_starts_and_ends_in_rows_of_their_own_keep_the_line_of_the_start_and_name_what_never_started(tmp_path):
    head = "case:concept:name,concept:name,time:timestamp,org:resource,lifecycle:transition"
    rows = [
        f"1,pick,{iso(at)},robot,{said}" for at, said in ((0, "complete"), (2, "start"), (3, "resume"), (9, "complete"))
    ]
    log = ADAPTER.read(table(tmp_path / "a.csv", head, *rows), ReadOptions())
    assert log.task_list.select("source_row", "task").rows() == [(3, "pick")]
    assert log.set_aside.rows() == [(2, "'pick' completes but never started")]
    assert "1 events 'resume' are skipped" in log.warnings


@pytest.mark.parametrize("version", [1, 2])
def test_the_events_of_an_object_centric_log_are_tasks(tmp_path, version):
    kinds = {"robot": "Robot", "w1": "Operator"} | {f"cycle {cycle}": "order" for cycle in range(3)}
    told = [
        (task, iso(at), {"lifecycle": said}, ["w1" if agent == "operator" else agent, execution])
        for (agent, task, execution, *_), said, at in events()
    ]
    if version == 2:
        document = {
            "objectTypes": [{"name": kind, "attributes": []} for kind in ("Robot", "Operator", "order")],
            "eventTypes": [{"name": task, "attributes": []} for task in ("pick", "mount")],
            "objects": [{"id": name, "type": kind, "attributes": []} for name, kind in kinds.items()],
            "events": [
                {
                    "id": f"e{number}",
                    "type": task,
                    "time": at,
                    "attributes": [{"name": key, "value": value} for key, value in more.items()],
                    "relationships": [{"objectId": name, "qualifier": ""} for name in objects],
                }
                for number, (task, at, more, objects) in enumerate(told)
            ],
        }
    else:
        document = {
            "ocel:events": {
                f"e{n}": {"ocel:activity": task, "ocel:timestamp": at, "ocel:vmap": more, "ocel:omap": objects}
                for n, (task, at, more, objects) in enumerate(told)
            },
            "ocel:objects": {name: {"ocel:type": kind, "ocel:ovmap": {}} for name, kind in kinds.items()},
        }
    path = tmp_path / "a.json"
    path.write_text(json.dumps(document, indent=1))
    assert ADAPTER.recognises(path)
    rows = read(path)
    took = zip(*rows.select("agent", "task", "execution"), rows["end_s"] - rows["t_s"], strict=True)
    assert sorted(took) == READ
    assert set(rows["agent_name"]) == {"robot", "Operator w1"}
