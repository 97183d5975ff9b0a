"""Task lists: who did what from when to when, in every way that people write them down."""

import json
import math
import os
import string
from pathlib import Path

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions, is_person
from cyclekit.errors import CyclekitError, DamagedLog, LogError
from cyclekit.ingest.registry import adapters
from cyclekit.ingest.validate.validate import examined
from cyclekit_adapters.formats.task_list import ADAPTER

T0 = 1_690_833_425.25
SAMPLES = Path(os.environ.get("CYCLEKIT_SAMPLES", "absent")) / "cnr-tasks"


def read(path, **said):
    return ADAPTER.read(path, ReadOptions(map=said))


def table(path, *lines):
    path.write_text("\n".join(lines) + "\n")
    return path


def spans(log):
    return [(row["agent"], row["task"], row["t_s"], row["end_s"]) for row in log.task_list.iter_rows(named=True)]


def test_a_table_of_intervals_is_a_task_list_and_nothing_else(tmp_path):
    path = table(
        tmp_path / "a.csv",
        "run,agent,task,t_start,t_end,outcome",
        f"1,Worker 2,assemble,{T0},{T0 + 4.5},done",
        f"1,kuka,feed,{T0 + 0.5},{T0 + 3},failed",
    )
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["task-list"]
    log = read(path)
    assert spans(log) == [("operator", "assemble", T0, T0 + 4.5), ("robot", "feed", T0 + 0.5, T0 + 3)]
    assert log.task_list["agent_name"].to_list() == ["Worker 2", "kuka"]
    assert log.task_list["execution"].to_list() == ["1", "1"]
    assert log.task_list["outcome"].to_list() == ["done", "failed"]
    assert log.task_list["source_row"].to_list() == [2, 3]
    assert (log.clock, log.rows_are, log.rows_read) == ("epoch", "line", 2)


@pytest.mark.parametrize(
    "name", ["human", "Operator", "PERSON", "worker_1", "human_right_arm", "humanWorker", "2nd worker"]
)
def test_these_agents_are_people(name):
    assert is_person(name)


@pytest.mark.parametrize(
    "name", ["ur5_on_guide", "robot", "humanoid", "cooperator", "personnel_lift", "networker", "r1"]
)
def test_these_agents_are_robots(name):
    assert not is_person(name)


def test_the_cell_file_says_who_is_a_robot_and_who_a_person(tmp_path):
    path = table(tmp_path / "a.csv", "agent,task,start_s,end_s", "Anna,a,0,1", "human,b,1,2")
    log = read(path, operator=["Anna"], robot=["human"])
    assert log.task_list["agent"].to_list() == ["operator", "robot"]
    assert log.warnings == (
        "no column gives the execution of a task: a file is taken for one. If it has several, say in the cell file "
        'which column does, map = { execution = "COLUMN" }, or that a new one begins after a rest: [executions] '
        'begin = "gap"',
    )


def test_an_agent_that_the_cell_file_names_must_be_there(tmp_path):
    path = table(tmp_path / "a.csv", "agent,task,start_s,end_s", "Anna,a,0,1")
    with pytest.raises(LogError, match="no agent 'Ana'") as caught:
        read(path, operator=["Ana"])
    assert caught.value.nearest == "Anna"
    with pytest.raises(CyclekitError, match="in robot and in operator"):
        read(path, operator=["Anna"], robot=["Anna"])


def test_columns_of_other_names_are_named_in_the_map(tmp_path):
    path = table(tmp_path / "a.csv", "Wer;Was;Ab [ms];Zu [ms]", "Anna;a;0;1500")
    assert not ADAPTER.recognises(path)
    with pytest.raises(LogError, match="no column is known for agent, task, start, end"):
        read(path)
    said = {"agent": "Wer", "task": "Was", "start": "Ab [ms]", "end": "Zu [ms]", "time_unit": "ms"}
    assert spans(read(path, **said)) == [("robot", "a", 0.0, 1.5)]
    with pytest.raises(LogError, match="no column 'Wen'") as caught:
        read(path, **{**said, "agent": "Wen"})
    assert caught.value.nearest == "Wer"


def test_mongoexport_is_read_as_what_it_stands_for(tmp_path):
    records = [
        {
            "_id": {"$oid": "64c8"},
            "agent": "human_right_arm",
            "name": "pick",
            "t_start": {"$date": "2023-07-31T19:57:11.250Z"},
            "t_end": {"$date": {"$numberLong": "1690833432500"}},
            "t_start_planned": {"$numberDouble": "-1.5e-13"},
            "outcome": {"$numberInt": "1"},
            "recipe": "a",
        },
        {
            "agent": "ur5",
            "name": "place",
            "t_start": {"$date": "2023-07-31T19:57:13.000Z"},
            "t_end": {"$date": "2023-07-31T19:57:14.000Z"},
            "t_start_planned": {"$numberDouble": "NaN"},
            "outcome": {"$numberInt": "0"},
            "recipe": "a",
        },
    ]
    path = tmp_path / "a.json"
    path.write_text(json.dumps(records))
    assert ADAPTER.recognises(path)
    log = read(path)
    start = 1690833431.25
    assert spans(log) == [("operator", "pick", start, 1690833432.5), ("robot", "place", start + 1.75, start + 2.75)]
    assert log.task_list["outcome"].to_list() == ["done", "failed"]
    assert log.task_list["planned_start_s"].to_list() == [pytest.approx(start), None]


@pytest.mark.parametrize("form", ["array", "lines", "member", "packed"])
def test_json_may_be_an_array_lines_or_inside_of_an_object(tmp_path, form):
    rows = [{"agent": f"r{i}", "task": {"name": "t"}, "start_s": i + 0.5, "end_s": i + 1.0} for i in range(5)]
    texts = {
        "array": json.dumps(rows),
        "lines": "\n".join(map(json.dumps, rows)),
        "member": json.dumps({"version": 1, "tasks": rows}),
        "packed": "\n".join(json.dumps(row, indent=2) for row in rows),
    }
    path = tmp_path / "a.json"
    path.write_text(texts[form])
    assert ADAPTER.recognises(path)
    assert spans(read(path)) == [("robot", "t", i + 0.5, i + 1.0) for i in range(5)]


def test_of_a_cut_export_the_whole_records_are_read(tmp_path):
    rows = [{"agent": "r", "task": "t", "start_s": i + 0.5, "end_s": i + 1.0} for i in range(5)]
    path = tmp_path / "a.json"
    path.write_text(json.dumps(rows)[:-20])
    log = read(path)
    assert log.task_list.height == 4
    ((row, reason),) = log.set_aside.rows()
    assert (row, reason[:33]) == (4, "the document is cut or garbled at")
    assert any("only the tasks before it are read" in text for text in log.warnings)


def test_json_of_something_else_is_no_task_list(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps([{"agent": "human", "concurrent_agent": "ur5", "dynamic_risk": 0.9}]))
    assert not ADAPTER.recognises(path)


def test_impossible_rows_are_set_aside_with_their_line_and_reason(tmp_path):
    path = table(
        tmp_path / "a.csv",
        "agent,task,start_s,end_s,run",
        "r,a,0.0,1.0,1",
        "r,b,3.0,2.0,1",
        "r,c,nan,2.0,1",
        "r,d,inf,4.0,1",
        ",e,4.0,5.0,1",
        "r,,4.0,5.0,1",
        "r,g,6.0,soon,1",
        "r,a,0.0,1.0,1",
        "r,h,7.0,,1",
    )
    log = examined(read(path))
    assert spans(log) == [("robot", "a", 0.0, 1.0), ("robot", "h", 7.0, None)]
    assert log.set_aside.rows() == [
        (3, "it ends before it starts"),
        (4, "no start"),
        (5, "no start"),
        (6, "no agent"),
        (7, "no task"),
        (8, "its end is not a time in the format of the others"),
        (9, "it repeats another task"),
    ]
    assert "7 of 9 lines (78 %) are set aside, the first is line 4: no start (2); " in log.impossible[0]


def test_a_list_of_which_no_row_can_be_used_is_refused_with_the_reason(tmp_path):
    path = table(tmp_path / "a.csv", "agent,task,start_s,end_s", "r,a,3.0,1.0")
    with pytest.raises(DamagedLog, match=r"none of its 1 tasks can be used; the first \(row 2\): it ends before"):
        read(path)


def test_the_unit_of_whole_numbers_is_left_open_until_it_is_said(tmp_path):
    path = table(tmp_path / "a.csv", "agent,task,start,end", "r,a,0,1500")
    assert {"s", "ms"} <= {unit.name for unit in read(path).time_units}
    assert spans(read(path, time_unit="ms")) == [("robot", "a", 0.0, 1.5)]


def test_a_unit_that_a_name_says_holds_for_tasks_however_short(tmp_path):
    path = table(tmp_path / "a.csv", "agent,task,start_s,end_s", "r,vacuum on,1.0,1.0625", "r,vacuum off,2.0,2.0625")
    assert spans(read(path)) == [("robot", "vacuum on", 1.0, 1.0625), ("robot", "vacuum off", 2.0, 2.0625)]


def test_start_and_end_may_count_in_different_units(tmp_path):
    path = table(tmp_path / "a.csv", "agent,task,start,end", f"r,a,{T0},{round(1000 * T0) + 1500}")
    assert spans(read(path)) == [("robot", "a", T0, T0 + 1.5)]


def test_times_without_a_zone_are_placed_by_the_zone_of_the_cell_file(tmp_path):
    path = table(tmp_path / "a.csv", "agent;task;start;end", "r;a;2024-07-01 10:00:00,5;2024-07-01 10:00:02")
    log = read(path)
    assert log.clock == "relative"
    assert any("no time zone" in text for text in log.warnings)
    rome = read(path, time_zone="Europe/Rome")
    assert (rome.clock, rome.task_list["t_s"][0]) == ("epoch", 1719820800.5)


def test_times_of_day_lack_a_date_and_exports_of_process_mining_are_known(tmp_path):
    log = read(table(tmp_path / "a.csv", "run,agent,task,begin,finish", "1,r,a,10:00:00.5,10:00:02"))
    assert log.task_list["end_s"].to_list() == [36_002.0]
    assert log.warnings == ("its times have no date, so they cannot be aligned with other logs by them",)
    header = "case:concept:name,concept:name,org:resource,start_timestamp,time:timestamp"
    path = table(tmp_path / "b.csv", header, "7,a,human,2024-05-01 10:00:00+00:00,2024-05-01 10:00:30+00:00")
    assert ADAPTER.recognises(path)
    (row,) = read(path).task_list.select("execution", "agent", "task", "t_s", "end_s").rows()
    assert row == ("7", "operator", "a", 1714557600.0, 1714557630.0)


def test_a_zone_on_one_side_only_is_refused(tmp_path):
    path = table(tmp_path / "a.csv", "agent,task,start,end", "r,a,2024-07-01T10:00:00Z,2024-07-01T10:00:02")
    with pytest.raises(LogError, match="only one of 'start' and 'end' names its time zone"):
        read(path)
    path = table(
        tmp_path / "b.csv",
        "agent,task,start,end",
        "r,a,2024-07-01T10:00:00Z,2024-07-01T10:00:02Z",
        "r,b,2024-07-01T10:00:03,2024-07-01T10:00:04Z",
    )
    with pytest.raises(LogError, match="some times of column 'start' name their time zone and some do not"):
        read(path)


@pytest.mark.parametrize("counts_from", ["the zero of the log", "the start of each execution"])
def test_a_plan_counts_from_where_it_fits(tmp_path, counts_from):
    lines = ["run,agent,task,start_s,end_s,planned_start,planned_end"]
    for run, begin in enumerate([100.5, 200.5]):
        plan = begin if counts_from == "the zero of the log" else 0.0
        lines += [
            f"{run},r,a,{begin},{begin + 3},{plan},{plan + 2.5}",
            f"{run},r,b,{begin + 3},{begin + 5},{plan + 2.5},",
        ]
    log = read(table(tmp_path / "a.csv", *lines))
    assert log.facts["plan counts from"] == counts_from
    assert log.task_list["planned_start_s"].to_list() == [100.5, 103.0, 200.5, 203.0]
    assert log.task_list["planned_end_s"].to_list() == [103.0, None, 203.0, None]


def test_a_plan_whose_first_task_begins_later_begins_with_that_task(tmp_path):
    lines = ["run,agent,task,t_start,t_end,t_start_planned,t_end_planned"]
    for run, (begin, first) in enumerate([(T0, 0.0), (T0 + 100, 4.0)]):
        lines += [
            f"{run},r,a,{begin + 0.1},{begin + 3},{first},{first + 2.5}",
            f"{run},r,b,{begin + 6.1},{begin + 8},{first + 6},{first + 8}",
        ]
    log = read(table(tmp_path / "a.csv", *lines))
    late = log.task_list["t_s"] - log.task_list["planned_start_s"]
    assert late.to_list() == pytest.approx([0.0] * 4)
    late = log.task_list["end_s"] - log.task_list["planned_end_s"]
    assert late.to_list() == pytest.approx([0.4, -0.1] * 2)


def test_a_planned_time_that_is_none_costs_no_task(tmp_path):
    header = "run,agent,task,start_s,end_s,planned_start"
    path = table(tmp_path / "a.csv", header, "1,r,a,0.5,1,soon", "1,r,b,1,2,later", "1,r,c,2,3,2.5")
    with pytest.raises(LogError, match=r"'planned_start' \('soon'\) are neither numbers nor dates"):
        read(path)
    log = read(table(tmp_path / "b.csv", header, "1,r,a,0.5,1,0.5", "1,r,b,1,2,later"))
    assert log.task_list["planned_start_s"].null_count() == 1
    assert "1 tasks: the planned start is not a time in the format of the others; unknown there" in log.warnings


def test_outcomes_of_no_known_word_are_kept_and_named(tmp_path):
    path = table(tmp_path / "a.csv", "run,agent,task,start_s,end_s,result", "1,r,a,0,1,rework", "1,r,b,1,2,True")
    log = read(path)
    assert log.task_list["outcome"].to_list() == ["rework", "done"]
    assert log.warnings == ("unknown outcomes, neither done nor failed, are kept as written: 'rework'",)


def test_a_list_in_which_nobody_is_called_a_person_says_so(tmp_path):
    path = table(tmp_path / "a.csv", "run,agent,task,start_s,end_s", "1,Anna,a,0,1", "1,r,b,1,2")
    (said,) = read(path).warnings
    assert said.startswith("no agent is recognised as a person ('Anna', 'r'): all are taken for robots")


NAMES = st.text(string.ascii_letters + " _-", min_size=1, max_size=12).filter(lambda text: text.strip())
TASKS = st.lists(
    st.tuples(
        st.sampled_from(["human", "ur5", "Anna"]),
        NAMES.filter(lambda text: text.strip().lower() not in ("nan", "na", "null", "none", "-")),
        st.floats(0, 1e6),
        st.floats(0, 1e4),
    ),
    min_size=1,
    max_size=12,
    unique_by=lambda row: row[2],
)


@given(TASKS)
def test_what_was_written_is_read_from_a_table_and_from_json_alike(tmp_path_factory, tasks):
    folder = tmp_path_factory.mktemp("tasks")
    rows = [(agent, task.strip(), start, start + lasted) for agent, task, start, lasted in tasks]
    lines = [f'{a},"{t}",{s!r},{e!r}' for a, t, s, e in rows]
    csv = table(folder / "a.csv", "agent,task,start_s,end_s", *lines)
    as_json = folder / "a.json"
    as_json.write_text(json.dumps([{"agent": a, "task": t, "start_s": s, "end_s": e} for a, t, s, e in rows]))
    expected = sorted((s, e, a, t) for a, t, s, e in rows)
    for path in (csv, as_json):
        found = read(path).task_list.select("t_s", "end_s", "agent_name", "task").rows()
        assert found == expected
    assert all(math.isfinite(row[0]) for row in expected)


@given(st.text(max_size=300))
def test_no_text_makes_the_reader_fail(tmp_path_factory, text):
    head = "agent,task,start_s,end_s\n"
    for name, content in (
        ("a.csv", head + text),
        ("a.json", "[" + text),
        ("b.json", "{" + text),
        ("a.xes", "<log>" + text),
    ):
        path = tmp_path_factory.mktemp("odd") / name
        path.write_text(content, encoding="utf-8", newline="")
        ADAPTER.recognises(path)
        try:
            log = read(path)
        except CyclekitError:
            continue
        assert isinstance(log.task_list, pl.DataFrame)


@pytest.mark.skipif(not SAMPLES.is_dir(), reason="CYCLEKIT_SAMPLES names no folder")
@pytest.mark.parametrize(("name", "rows", "executions"), [("online", 4400, 200), ("offline", 1100, 50)])
def test_a_task_planner_of_a_research_cell(name, rows, executions):
    path = SAMPLES / f"task_results_{name}.json"
    log = read(path)
    first = json.loads(path.read_text())[0]
    found = log.task_list.filter(pl.col("source_row") == 0).row(0, named=True)
    assert (found["t_s"], found["end_s"]) == (first["t_start"], first["t_end"])
    assert (found["task"], found["agent"]) == (first["name"], "operator")
    assert log.task_list.height == rows
    assert log.set_aside.is_empty()
    assert log.warnings == ()
    assert log.clock == "epoch"
    assert log.task_list["execution"].n_unique() == executions
    assert set(log.task_list["outcome"]) == {"done"}
    assert log.task_list["planned_start_s"].null_count() == 0
    assert set(log.task_list.select("agent", "agent_name").rows()) == {
        ("robot", "ur5_on_guide"),
        ("operator", "human_right_arm"),
    }
    late = log.task_list["t_s"] - log.task_list["planned_start_s"]
    assert late.min() > -1.0  # a task waits for its planned start
    assert not ADAPTER.recognises(SAMPLES / "task_synergies.json")


def test_a_date_a_name_and_a_status_beside_make_it_no_event_log(tmp_path):
    path = table(
        tmp_path / "a.csv",
        "date,name,agent,t_start,t_end,status",
        f"2023-07-31T19:57:11Z,pick,human,{T0},{T0 + 2},1",
    )
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["task-list"]
    assert read(path).task_list["outcome"].to_list() == ["done"]


@pytest.mark.parametrize(("start", "unit"), [("iso", 1), ("epoch", 1), ("iso", 1000), ("epoch", 1000)])
def test_whole_numbers_of_a_plan_are_read_in_the_unit_that_fits_what_was_done(tmp_path, start, unit):
    begin = {"iso": "2024-05-01T10:00:{:02d}Z", "epoch": "17145576{:02d}000"}[start]
    rows = [f"1,arm,task,{begin.format(at)},{begin.format(at + 4)},{at * unit}" for at in (0, 5, 10)]
    log = read(table(tmp_path / "a.csv", "run,agent,task,start,end,planned_start", *rows))
    planned = log.task_list["planned_start_s"] - log.task_list["t_s"][0]
    assert planned.to_list() == pytest.approx([0.0, 5.0, 10.0])


@pytest.mark.parametrize(
    "head", ["order,product,station,start,end", "Auftragsnr;Produkt;Arbeitsplatz;Startzeit;Endzeit"]
)
def test_orders_without_an_agent_are_flows_through_stations_and_the_reader_is_told(tmp_path, head):
    mark = ";" if ";" in head else ","
    rows = [
        ("O1", "A", "cut", 0, 40),
        ("O1", "A", "weld", 45, 90),
        ("O2", "B", "cut", 50, 80),
        ("O2", "B", "weld", 95, ""),
    ]
    written = [
        mark.join(
            [order, product, station, *(f"2025-06-02T06:{s // 60:02}:{s % 60:02}Z" if s != "" else "" for s in at)]
        )
        for order, product, station, *at in rows
    ]
    (tmp_path / "mes.csv").write_text("\n".join([head, *written, ""]))
    assert ADAPTER.recognises(tmp_path / "mes.csv")
    log = ADAPTER.read(tmp_path / "mes.csv", ReadOptions())
    found = log.task_list.select("execution", "agent_name", "task").rows()
    assert found == [(order, "part", station) for order, _, station, *_ in rows]
    assert log.task_list["end_s"].null_count() == 1
    (said,) = [text for text in log.warnings if "no column says who does a task" in text]
    assert head.split(mark)[2] in said


def test_machines_may_be_the_agents_of_a_flow(tmp_path):
    text = "order,station,operation,start,end\nO1,M1,cut,0,40\nO1,M2,weld,45,90\n"
    (tmp_path / "mes.csv").write_text(text)
    log = ADAPTER.read(tmp_path / "mes.csv", ReadOptions(map={"agent": "station", "time_unit": "s"}))
    assert log.task_list.select("agent_name", "task").rows() == [("M1", "cut"), ("M2", "weld")]
    assert not [text for text in log.warnings if "no column says who" in text]
