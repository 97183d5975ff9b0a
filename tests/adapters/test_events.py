import json

import pytest
from damage import read_damaged, read_or_refuse
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions, concat_parts
from cyclekit.errors import ConfigError, LogError, UnknownName
from cyclekit.ingest.registry import adapters
from cyclekit_adapters.formats.events import ADAPTER

LONG = "time_s,signal,value\n0.5,goal,left_table\n12.25,sync_in,1\n30.0,goal,conveyor\n"
WIDE = "time_ms;DI0;gate open\n1000;0;FALSE\n1020;1;FALSE\n1040;1;TRUE\n1060;0;TRUE\n"


def read(path, text, **options):
    path.write_text(text)
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["events"]
    return ADAPTER.read(path, ReadOptions(**options))


def test_a_row_of_time_signal_and_value_is_an_event(tmp_path):
    log = read(tmp_path / "buttons.csv", LONG)
    assert log.events.rows() == [
        (0.5, "goal", "left_table", 2),
        (12.25, "sync_in", "1", 3),
        (30.0, "goal", "conveyor", 4),
    ]
    assert (log.clock, log.rows_are, log.warnings) == ("relative", "line", ())
    assert log.robot is None
    assert log.people is None


@pytest.mark.parametrize(
    ("header", "order"),
    [
        ("Time [s];Tag name;Value", "tsv"),
        ("timestamp_s;variable;state", "tsv"),
        ("Zeit (s);Signal;Wert", "tsv"),
        ("Zeitstempel [s];Eingang;Zustand", "tsv"),
        ("Variablenname;Zeit [s];Wert;Einheit", "stvx"),
        ("id;Bezeichnung;Zeit_s;Status", "xstv"),
        ("Name;Timestamp [s];Value;Status", "stvx"),
    ],
)
def test_the_usual_names_of_the_columns_in_any_order(tmp_path, header, order):
    cells = {"t": "1,25", "s": "goal", "v": "A", "x": "?"}
    log = read(tmp_path / "plc.csv", f"{header}\n{';'.join(cells[c] for c in order)}\n")
    assert log.events.select("t_s", "signal", "value").rows() == [(1.25, "goal", "A")]


@pytest.mark.parametrize(
    ("name", "text", "clock", "seconds"),
    [
        ("time", "2024-05-01T10:00:00.250Z", "epoch", 1714557600.25),
        ("time", "2024-05-01 10:00:00,250+02:00", "epoch", 1714550400.25),
        ("time", "2024-05-01T10:00:00+0200", "epoch", 1714550400.0),
        ("time", "2024-05-01 10:00:00", "relative", 1714557600.0),
        ("time", "2024-05-01 10:00", "relative", 1714557600.0),
        ("Zeitstempel", "01.05.2024 10:00:00,25", "relative", 1714557600.25),
        ("Zeitstempel", "01.05.2024, 10:00:00", "relative", 1714557600.0),
        ("time", "2024/05/01 10:00:00.25", "relative", 1714557600.25),
        ("time", "10:00:00.5", "relative", 36000.5),
        ("time", "1714557600.25", "epoch", 1714557600.25),
        ("time", "1714557600250", "epoch", 1714557600.25),
        ("time", "1714557600250000", "epoch", 1714557600.25),
        ("time_ms", "1714557600250", "epoch", 1714557600.25),
        ("time_ms", "1500", "relative", 1.5),
        ("t_s", "12", "relative", 12.0),
        ("Time [us]", "1500000", "relative", 1.5),
        ("Time [min]", "1.5", "relative", 90.0),
        ("Time (1/10 s)", "15", "relative", 1.5),
        ("FILETIME", "133590312002500000", "epoch", 1714557600.25),
        ("time", "638501544002500000", "relative", 1714557600.25),
        ("Time_ms", "45413416669,5602", "relative", 1714557600.25),
    ],
)
def test_what_a_time_counts_is_decided_by_how_it_is_written(tmp_path, name, text, clock, seconds):
    log = read(tmp_path / "plc.csv", f'{name};signal;value\n"{text}";goal;A\n')
    assert log.events["t_s"].to_list() == [pytest.approx(seconds, abs=2e-5)]
    assert log.clock == clock


def test_a_time_whose_form_cannot_be_decided_is_refused_with_the_cure(tmp_path):
    with pytest.raises(LogError, match="are ambiguous") as refusal:
        read(tmp_path / "plc.csv", "time,signal,value\n05/01/2024 10:00:00,goal,A\n")
    assert "time_unit" in refusal.value.cure
    assert 'adapter = "csv"' in refusal.value.cure


def test_the_cell_file_decides_the_unit_and_the_zone(tmp_path):
    log = read(tmp_path / "plc.csv", "time,signal,value\n1500,goal,A\n", map={"time_unit": "ms"})
    assert (log.events["t_s"][0], log.clock) == (1.5, "relative")
    text = "time,signal,value\n2024-05-01 12:00:00,goal,A\n"
    log = read(tmp_path / "plc.csv", text, map={"time_zone": "Europe/Rome"})
    assert (log.events["t_s"][0], log.clock, log.warnings) == (1714557600.0, "epoch", ())
    assert any("give time_zone" in said for said in read(tmp_path / "plc.csv", text).warnings)
    with pytest.raises(UnknownName, match="'Europe/Roma'"):
        read(tmp_path / "plc.csv", text, map={"time_zone": "Europe/Roma"})
    with pytest.raises(UnknownName, match="'zone'"):
        read(tmp_path / "plc.csv", text, map={"zone": "Europe/Rome"})
    with pytest.raises(ConfigError, match="as people"):
        read(tmp_path / "plc.csv", text, role="people")


@pytest.mark.parametrize("text", ["time,signal,value\n1500,goal,A\n", "t,signal,value\n1,goal,A\n2.5,goal,B\n"])
def test_a_unit_that_cannot_be_decided_is_left_open_with_its_candidates(tmp_path, text):
    log = read(tmp_path / "plc.csv", text)
    assert len(log.time_units) > 1
    assert "s" in {unit.name for unit in log.time_units}
    assert any("unit of its times is not stated" in said and "time_unit" in said for said in log.said)


def test_a_tag_log_of_a_panel_is_read_by_its_date_and_not_by_its_day_count(tmp_path):
    text = (
        '"VarName";"TimeString";"VarValue";"Validity";"Time_ms"\n'
        '"goal";"2024-05-01 10:00:00";"3";1;45413416666,6667\n'
        '"goal";"2024-05-01 10:00:07";"4";1;45413416747,6852\n'
    )
    log = read(tmp_path / "Tag_log0.csv", text)
    assert log.events.select("t_s", "signal", "value").rows() == [
        (1714557600.0, "goal", "3"),
        (1714557607.0, "goal", "4"),
    ]


def test_a_date_and_a_time_of_day_in_two_columns(tmp_path):
    log = read(tmp_path / "plc.csv", "Datum;Uhrzeit;Signal;Wert\n01.05.2024;10:00:00;goal;A\n")
    assert log.events["t_s"].to_list() == [1714557600.0]
    assert log.facts["time"].startswith("Datum and Uhrzeit")


def test_of_a_column_per_signal_the_first_state_and_the_changes_are_events(tmp_path):
    log = read(tmp_path / "io.csv", WIDE)
    assert log.events.rows() == [
        (1.0, "DI0", "0", 2),
        (1.0, "gate open", "FALSE", 2),
        (1.02, "DI0", "1", 3),
        (1.04, "gate open", "TRUE", 4),
        (1.06, "DI0", "0", 5),
    ]


def test_a_state_that_was_not_logged_is_no_change(tmp_path):
    log = read(tmp_path / "io.csv", "t_s,DI0\n1,0\n2,\n3,0\n4,1\n")
    assert log.events.select("t_s", "value").rows() == [(1.0, "0"), (4.0, "1")]


@pytest.mark.parametrize("text", [LONG + LONG.partition("\n")[2] * 30, WIDE + WIDE.partition("\n")[2] * 30])
def test_a_log_read_in_parts_is_the_log_read_at_once(tmp_path, monkeypatch, text):
    at_once = read(tmp_path / "plc.csv", text)
    monkeypatch.setattr("cyclekit_adapters.text.text_blocks.BLOCK_BYTES", 60)
    parts = list(ADAPTER.stream(tmp_path / "plc.csv", ReadOptions()))
    assert len(parts) > 10
    assert concat_parts(parts).events.equals(at_once.events)
    assert concat_parts(parts).warnings == at_once.warnings == ("time steps back 30 time(s)",)


def test_a_row_whose_time_is_written_otherwise_is_set_aside(tmp_path):
    text = (
        "time,signal,value\n" + "2024-05-01 10:00:00,goal,A\n" * 900 + "yesterday,goal,B\n2024-05-01 10:00:01,goal,C\n"
    )
    log = read(tmp_path / "plc.csv", text)
    assert log.set_aside.rows() == [(902, "its time does not match 'iso' (the first: 'yesterday')")]
    assert log.events["value"][-1] == "C"


def test_a_last_row_cut_while_being_written_is_set_aside(tmp_path):
    log = read(tmp_path / "buttons.csv", LONG[:-4])
    assert log.events.height == 2
    assert log.set_aside["source_row"].to_list() == [4]


@pytest.mark.parametrize(
    "other",
    [
        "time,x,y\n0.5,1,2\n",
        "time,a,b\n0.1,0,0\n0.2,0,0\n",  # numbers that never change could be anything
        "time,a,b\n0.1,0.0,1.0\n0.2,1.0,0.0\n",
        "a,b\n0,1\n1,0\n",
        "name,value\nx,1\n",
        "signal,value\ngoal,1\n",
        "time,signal,value\nsoon,goal,1\n",
        "time,signal\n1.5,goal\n",
        "x,y,z\n0,1,0\n1,0,1\n",
        "",
        "time",
        "time,value,val,signal\n1.5,1,2,goal\n",
        json.dumps({"time": 1, "signal": 2, "value": 3}),
    ],
)
def test_other_tables_are_not_recognised(tmp_path, other):
    path = tmp_path / "a.csv"
    path.write_text(other)
    assert not ADAPTER.recognises(path)
    with pytest.raises(LogError, match="no columns for time"):
        ADAPTER.read(path, ReadOptions())


@pytest.mark.parametrize("text", [LONG, WIDE])
def test_damage_gives_what_is_whole_or_a_refusal(tmp_path, text):
    path = tmp_path / "plc.csv"
    read_damaged(ADAPTER, path, text.encode(), seed=11)


_CELL = st.sampled_from(["time", "signal", "value", "Zeit", "0", "1", "1.5", "TRUE", "2024-05-01 10:00", "", '"', "x"])


@given(rows=st.lists(st.lists(_CELL, min_size=1, max_size=4), max_size=5), mark=st.sampled_from([",", ";", "\t"]))
def test_any_cells_are_read_or_refused(tmp_path_factory, rows, mark):
    path = tmp_path_factory.getbasetemp() / "any_events.csv"
    path.write_text("".join(mark.join(row) + "\n" for row in rows))
    read_or_refuse(ADAPTER, path)
