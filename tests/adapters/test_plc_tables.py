"""PLC traces through the map: a column per tag, or rows of tag, time and value, as plants export them."""

import json
import re
import tomllib
from pathlib import Path

import pytest
from damage import read_damaged, read_or_refuse
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import ConfigError, LogError
from cyclekit_adapters.formats.mapped_csv import ADAPTER

WIDE = (
    "Zeit;Warnfeld;Schutzfeld;Band\n1000,5;FALSE;TRUE;0,25\n1010,5;FALSE;TRUE;0,25\n"
    "1020,5;TRUE;;0,25\n1030,5;TRUE;FALSE;0,3\n"
)
WIDE_MAP = {"time": "Zeit", "time_unit": "ms", "decimal": ",", "tags": ["Warnfeld", "Schutzfeld"]}
LONG = (
    "Tag,Time,Value,Quality\nfield,2024-05-01T10:00:00Z,1,GOOD\n"
    "field,2024-05-01T10:00:01Z,0,BAD\ndoor,2024-05-01T10:00:02Z,1,good\n"
)
LONG_MAP = {"time": "Time", "time_format": "iso", "signal": "Tag", "value": "Value"}


def read(path, text, mapping, role="events"):
    path.write_text(text)
    return ADAPTER.read(path, ReadOptions(role=role, map=mapping))


def test_of_a_column_per_tag_the_first_state_and_the_changes_are_events(tmp_path):
    log = read(tmp_path / "plc.csv", WIDE, WIDE_MAP)
    assert log.events.rows() == [
        (1.0005, "Warnfeld", "FALSE", 2),
        (1.0005, "Schutzfeld", "TRUE", 2),
        (1.0205, "Warnfeld", "TRUE", 4),
        (1.0305, "Schutzfeld", "FALSE", 5),
    ]
    assert (log.robot, log.clock) == (None, "relative")


def test_tags_may_be_a_pattern_and_get_other_names(tmp_path):
    mapping = WIDE_MAP | {"tags": "*feld", "names": {"Warnfeld": "warning field"}}
    log = read(tmp_path / "plc.csv", WIDE, mapping)
    assert log.events["signal"].unique().sort().to_list() == ["Schutzfeld", "warning field"]


def test_a_value_of_bad_quality_is_set_aside_with_its_line(tmp_path):
    log = read(tmp_path / "plc.csv", LONG, LONG_MAP | {"quality": "Quality", "good": ["GOOD"]})
    assert log.events.select("signal", "value", "source_row").rows() == [("field", "1", 2), ("door", "1", 4)]
    assert log.set_aside.rows() == [(3, "its quality (Quality) is none of GOOD")]
    assert log.clock == "epoch"


def test_rows_of_tags_get_other_names_too(tmp_path):
    log = read(tmp_path / "plc.csv", LONG, LONG_MAP | {"names": {"field": "protective field"}})
    assert log.events["signal"].to_list() == ["protective field", "protective field", "door"]


@pytest.mark.parametrize(
    ("zone", "clock", "seconds"), [(None, "relative", 1714557600.25), ("Europe/Rome", "epoch", 1714550400.25)]
)
def test_times_as_spreadsheets_count_them(tmp_path, zone, clock, seconds):
    day = 45413 + (10 * 3600 + 0.25) / 86400  # 2024-05-01 10:00:00.25
    mapping = {"time": "t", "time_unit": "excel", "tags": ["field"]} | ({"time_zone": zone} if zone else {})
    log = read(tmp_path / "plc.csv", f"t,field\n{day!r},1\n{day!r},0\n", mapping)
    assert log.events["t_s"].to_list() == pytest.approx([seconds] * 2, abs=1e-5)
    assert log.clock == clock
    assert bool([said for said in log.warnings if "time zone" in said]) == (zone is None)


def test_a_number_that_is_no_day_of_a_spreadsheet_is_set_aside(tmp_path):
    log = read(
        tmp_path / "plc.csv", "t,f\n45413.5,1\n1714557600,0\n-3,0\n", {"time": "t", "time_unit": "excel", "tags": ["f"]}
    )
    assert log.set_aside["source_row"].to_list() == [3, 4]


def test_the_inputs_of_a_robots_table_are_signals_by_their_columns(tmp_path):
    text = "t,x,y,z,DI_1,DI_2\n0.0,1,2,3,0,TRUE\n0.1,1,2,3,1,TRUE\n"
    mapping = {"time": "t", "x": "x", "y": "y", "z": "z", "tags": ["DI_*"], "names": {"DI_1": "door"}}
    log = read(tmp_path / "arm.csv", text, mapping, role="robot")
    assert log.robot.height == 2
    assert log.events.select("t_s", "signal", "value").rows() == [
        (0.0, "door", "0"),
        (0.0, "DI_2", "TRUE"),
        (0.1, "door", "1"),
    ]


@pytest.mark.parametrize(
    ("mapping", "seen"),
    [
        ({"tags": ["a"], "signal": "b", "value": "c"}, "both tags and signal"),
        ({"tags": ["a"], "quality": "q"}, "quality and good go together"),
        ({"tags": ["a"], "time": ["t", "u"], "time_unit": ["excel", "ms"]}, "'excel', 'ms'"),
        ({"signal": "b"}, "signal and value"),
    ],
)
def test_keys_that_contradict_each_other_are_refused(tmp_path, mapping, seen):
    with pytest.raises(ConfigError, match=seen):
        read(tmp_path / "plc.csv", "t,a,b,c,q\n1,1,1,1,1\n", {"time": "t"} | mapping)


def test_a_damaged_trace_gives_what_is_whole(tmp_path):
    options = ReadOptions(role="events", map=WIDE_MAP)
    read_damaged(ADAPTER, tmp_path / "plc.csv", WIDE.encode(), seed=8, options=options, partly=True)


_CELL = st.sampled_from(["TRUE", "FALSE", "0", "1", "ON", "OFF", "", "1,5", '"', "x;y", "nan", "45413,5", "\x00"])


@given(st.lists(st.lists(_CELL, min_size=1, max_size=6), max_size=8), st.sampled_from(["ms", "excel", "us"]))
def test_whatever_a_wide_trace_holds_its_events_are_cells_of_it(tmp_path_factory, rows, unit):
    path = tmp_path_factory.mktemp("plc") / "plc.csv"
    path.write_text("Zeit;Warnfeld;Schutzfeld\n" + "".join(";".join(row) + "\n" for row in rows))
    log = read_or_refuse(ADAPTER, path, ReadOptions(role="events", map=WIDE_MAP | {"time_unit": unit}))
    if log is not None:
        lines = path.read_text().split("\n")
        assert all(value in lines[row - 1] for _, _, value, row in log.events.rows())
        json.dumps(log.facts)


@given(
    st.lists(st.booleans(), min_size=1, max_size=60), st.sampled_from([("TRUE", "FALSE"), ("1", "0"), ("ON", "OFF")])
)
def test_the_changes_of_a_tag_are_those_of_its_states(tmp_path_factory, states, words):
    path = tmp_path_factory.mktemp("plc") / "plc.csv"
    path.write_text("t,field\n" + "".join(f"{i},{words[not on]}\n" for i, on in enumerate(states)))
    try:
        events = ADAPTER.read(path, ReadOptions(role="events", map={"time": "t", "tags": ["field"]})).events
    except LogError:
        raise AssertionError from None
    changed = [i for i, on in enumerate(states) if i == 0 or on != states[i - 1]]
    assert events["t_s"].to_list() == [float(i) for i in changed]
    assert events["value"].to_list() == [words[not states[i]] for i in changed]


def test_the_export_of_a_safety_scanner_is_read_by_the_map_of_the_guide(tmp_path):
    guide = (Path(__file__).parents[2] / "docs/howto/no-tracker.md").read_text(encoding="utf-8")
    cell = tomllib.loads(
        next(text for text in re.findall(r"```toml\n(.*?)```", guide, re.DOTALL) if "skip_rows" in text)
    )
    lines = ["Safety scanner;report", "", "Date;Time;Device;Event;State"]
    lines += [
        "01.05.2024;12:00:00.250;Scanner 1;WF;interrupted",
        "01.05.2024;12:00:00.900;Scanner 1;PF;free",
    ]
    log = read(
        tmp_path / "scanner.csv",
        "\n".join([*lines, "01.05.2024;12:00:01.000;Scanner 2;WF;70 %", ""]),
        cell["sources"][0]["map"],
    )
    assert log.events.select("t_s", "signal", "value").rows() == [
        (1714557600.25, "warning field", "interrupted"),
        (1714557600.9, "protective field", "free"),
        (1714557601.0, "Scanner 2 / WF", "70 %"),
    ]
    assert log.clock == "epoch"
    assert cell["operator_signals"][0]["occupied"] == "interrupted"
