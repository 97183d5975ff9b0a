"""Event logs in XES: starts and completions become tasks, and nothing in the XML is followed."""

from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import ConfigError, DamagedLog
from cyclekit_adapters.formats.task_list import ADAPTER
from cyclekit_adapters.tasks import xes

HEAD = '<?xml version="1.0" encoding="UTF-8" ?>\n<log xes.version="1.0" xmlns="http://www.xes-standard.org/">\n'


def event(task, agent, transition, second, **more):
    told = {"concept:name": task, "org:resource": agent, "lifecycle:transition": transition, **more}
    attributes = "".join(f'<string key="{key}" value={quoteattr(str(v))}/>' for key, v in told.items() if v is not None)
    when = f"2024-05-01T10:00:{second:06.3f}+02:00"
    return f'<event>{attributes}<date key="time:timestamp" value="{when}"/></event>\n'


def written(path: Path, traces, before=""):
    text = HEAD + before
    for name, events in traces.items():
        text += f'<trace><string key="concept:name" value="{name}"/>{"".join(events)}</trace>\n'
    path.write_text(text + "</log>\n", encoding="utf-8")
    return path


def read(path):
    return ADAPTER.read(path, ReadOptions())


BEGIN = 1714550400.0  # 2024-05-01T10:00:00+02:00


def test_starts_and_completions_are_paired_within_their_trace(tmp_path):
    path = written(
        tmp_path / "a.xes",
        {
            "case 1": [
                event("assemble", "human", "start", 0),
                event("feed", "ur5", "start", 1),
                event("feed", "ur5", "complete", 3.5),
                event("assemble", "human", "complete", 4),
            ],
            "case 2": [event("feed", "ur5", "start", 10), event("feed", "ur5", "ate_abort", 12)],
        },
    )
    assert ADAPTER.recognises(path)
    log = read(path)
    rows = log.task_list.select("agent", "task", "execution", "outcome", "t_s", "end_s").rows()
    assert rows == [
        ("operator", "assemble", "case 1", None, BEGIN, BEGIN + 4.0),
        ("robot", "feed", "case 1", None, BEGIN + 1.0, BEGIN + 3.5),
        ("robot", "feed", "case 2", "failed", BEGIN + 10.0, BEGIN + 12.0),
    ]
    assert (log.clock, log.rows_read) == ("epoch", 6)


def test_tasks_of_the_same_name_are_told_apart_by_instance_else_first_in_first_out(tmp_path):
    path = written(
        tmp_path / "a.xes",
        {
            "1": [
                event("t", "r", "start", 0, **{"concept:instance": "i"}),
                event("t", "r", "start", 1, **{"concept:instance": "j"}),
                event("t", "r", "complete", 2, **{"concept:instance": "j"}),
                event("t", "r", "complete", 3, **{"concept:instance": "i"}),
            ],
            "2": [event("t", "r", "start", 10), event("t", "r", "start", 11), event("t", None, "complete", 12)],
        },
    )
    log = read(path)
    lasted = [(end and round(end - begin, 3)) for begin, end in log.task_list.select("t_s", "end_s").rows()]
    assert lasted == [3.0, 1.0, 2.0, None]


def test_what_never_started_is_set_aside_and_other_transitions_are_counted(tmp_path):
    events = [
        event("t", "r", "schedule", 0),
        event("t", "r", "start", 1),
        event("t", "r", "complete", 2),
        event("u", "r", "complete", 3),
    ]
    log = read(written(tmp_path / "a.xes", {"1": events}))
    assert log.task_list.height == 1
    assert log.set_aside["reason"].to_list() == ["'u' completes but never started"]
    assert "1 events 'schedule' are skipped" in log.warnings


def test_a_log_of_completions_alone_is_refused(tmp_path):
    path = written(tmp_path / "a.xes", {"1": [event("t", "r", "complete", 2)]})
    with pytest.raises(DamagedLog, match="not when they started"):
        read(path)


def test_an_event_may_hold_its_own_start(tmp_path):
    start = '<date key="start_timestamp" value="2024-05-01T10:00:01+02:00"/></event>'
    text = event("t", "r", "complete", 3).replace("</event>", start)
    log = read(written(tmp_path / "a.xes", {"1": [text]}))
    assert log.task_list.select("t_s", "end_s").rows() == [(BEGIN + 1.0, BEGIN + 3.0)]


def test_a_document_type_declaration_is_refused_before_anything_of_it_is_followed(tmp_path):
    laughs = '<!DOCTYPE log [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>\n'
    path = tmp_path / "a.xes"
    path.write_text(laughs + HEAD.partition("?>\n")[2] + "<trace>&b;</trace></log>")
    assert ADAPTER.recognises(path)
    with pytest.raises(DamagedLog, match="document type declaration"):
        read(path)


def test_xml_nested_beyond_reason_and_endless_tags_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "a.xes"
    path.write_text(HEAD + "<trace>" * 100)
    with pytest.raises(DamagedLog, match="nested 64 deep"):
        read(path)
    monkeypatch.setattr(xes, "_LONGEST_TAG", 1 << 17)
    path.write_text(HEAD + '<trace><string key="' + "a" * 400_000)
    with pytest.raises(DamagedLog, match="a tag of more than"):
        read(path)


def test_of_a_cut_file_the_whole_events_are_read(tmp_path):
    path = written(tmp_path / "a.xes", {"1": [event("t", "r", "start", 0), event("t", "r", "complete", 2)]})
    path.write_text(path.read_text()[:-30])
    log = read(path)
    assert log.task_list.height == 1
    assert "cut or garbled at line" in log.set_aside["reason"][0]


def test_columns_cannot_be_named_in_xes(tmp_path):
    path = written(tmp_path / "a.xes", {"1": [event("t", "r", "start", 0), event("t", "r", "complete", 2)]})
    with pytest.raises(ConfigError, match="XES has none"):
        ADAPTER.read(path, ReadOptions(map={"task": "x"}))


@given(st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 20), st.integers(0, 20)), min_size=1, max_size=8))
def test_tasks_one_after_the_other_come_back_as_they_were(tmp_path_factory, tasks):
    events, expected, now = [], [], 0.0
    for number, (task, wait, lasts) in enumerate(tasks):
        begin, end = now + wait / 10, now + (wait + lasts) / 10
        events += [event(task, "r", "start", begin), event(task, "r", "complete", end)]
        expected.append((task, round(begin, 3), round(end, 3)))
        now = end + 0.001 * (number + 1)
    path = written(tmp_path_factory.mktemp("xes") / "a.xes", {"1": events})
    rows = read(path).task_list.select("task", "t_s", "end_s").rows()
    assert [(t, round(b - BEGIN, 3), round(e - BEGIN, 3)) for t, b, e in rows] == expected
