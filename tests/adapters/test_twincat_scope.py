"""Beckhoff TwinCAT Scope: time columns of their own, decimal commas, ticks since 1601, rows that end early."""

import pytest
from damage import read_damaged, read_or_refuse
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import ConfigError, DamagedLog, UnknownName
from cyclekit.ingest.registry import adapters
from cyclekit_adapters.formats.twincat_scope import ADAPTER

START, START_S = 132959733843760000, 1651499784.376  # 2022-05-02 13:56:24.376 UTC
ROWS = ["0|0|0|1|10|1,5", "0,2|1|1|1|10|1,6", "0,4|1|2|0|20|1,7", "0,6|0"]


def export(rows=ROWS, mark="\t", about=True, types=True):
    """Return an export as Scope 3.4 writes it: a fast channel, and three of 1 ms behind a time column of their own."""
    head = ["Name|scope", "File|scope.csv"]
    head += (
        [f"Starttime of export|{START}|Montag, 2. Mai 2022|15.56.24", f"Endtime of export|{START + 9990000}"]
        if about
        else []
    )
    head += ["", "", "Name|fast|Name|field|step|position", "SymbolComment||SymbolComment|||"]
    head += ["Data-Type|BIT|Data-Type|BIT|INT16|REAL32"] if types else []
    head += ["SampleTime[ms]|0,2|SampleTime[ms]|1|1|1", "Port|851|Port|851|851|851", ""]
    return "\n".join([*head, *rows, "EOF", ""]).replace("|", mark)


def read(path, text):
    path.write_text(text)
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["twincat-scope"]
    return ADAPTER.read(path, ReadOptions())


@pytest.mark.parametrize("mark", ["\t", ";", ":"])
def test_channels_have_the_time_of_their_own_column_since_the_start_in_utc(tmp_path, mark):
    log = read(tmp_path / "scope.csv", export(mark=mark))
    seen = [(round((t_s - START_S) * 1e3, 3), signal, value) for t_s, signal, value, _ in log.events.rows()]
    assert seen == [
        *((0.0, "fast", "0"), (0.0, "field", "1"), (0.0, "step", "10")),
        *((0.2, "fast", "1"), (0.6, "fast", "0"), (2.0, "field", "0"), (2.0, "step", "20")),
    ]
    assert (log.clock, log.set_aside.height) == ("epoch", 0)
    assert any("left out" in said and "position" in said for said in log.warnings)


def test_full_timestamps_are_ticks_since_1601(tmp_path):
    rows = [f"{START + 10_000 * i}|{i % 2}|{START + 10_000 * i}|0|1|0,5" for i in range(3)]
    log = read(tmp_path / "scope.csv", export(rows))
    times = log.events.filter(log.events["signal"] == "fast")["t_s"].to_list()
    assert times == pytest.approx([START_S, START_S + 0.001, START_S + 0.002], abs=5e-6)


def test_without_data_types_the_cells_tell_which_channels_are_states(tmp_path):
    log = read(tmp_path / "scope.csv", export(types=False))
    assert set(log.events["signal"]) == {"fast", "field", "step"}


def test_without_a_start_the_times_are_relative(tmp_path):
    log = read(tmp_path / "scope.csv", export(about=False))
    assert (log.clock, log.events["t_s"][0]) == ("relative", 0.0)


def test_an_export_of_measured_values_alone_is_refused_with_the_cure(tmp_path):
    text = export(["0|0,5|0|1,5|2,5|3,5"], types=False)
    with pytest.raises(DamagedLog, match="none is a signal") as refusal:
        read(tmp_path / "scope.csv", text)
    assert "BOOL" in refusal.value.cure


def test_keys_and_roles_that_it_has_not_are_refused(tmp_path):
    (tmp_path / "scope.csv").write_text(export())
    with pytest.raises(UnknownName, match="'time'"):
        ADAPTER.read(tmp_path / "scope.csv", ReadOptions(map={"time": "x"}))
    with pytest.raises(ConfigError, match="as people"):
        ADAPTER.read(tmp_path / "scope.csv", ReadOptions(role="people"))


def test_an_export_read_in_parts_is_the_export_read_at_once(tmp_path, monkeypatch):
    rows = [f"{i}|{i % 2}|{i}|{i // 3 % 2}|{i // 5}|0,5" for i in range(200)]
    at_once = read(tmp_path / "scope.csv", export(rows))
    monkeypatch.setattr("cyclekit_adapters.text.text_blocks.BLOCK_BYTES", 300)
    parts = list(ADAPTER.stream(tmp_path / "scope.csv", ReadOptions()))
    assert len(parts) > 5
    assert [row for part in parts for row in part.events.rows()] == at_once.events.rows()


def test_a_damaged_export_gives_what_is_whole(tmp_path):
    rows = [f"{i}|{i % 2}|{i}|{i // 3 % 2}|{i // 5}|0,5" for i in range(30)]
    read_damaged(ADAPTER, tmp_path / "scope.csv", export(rows).encode(), seed=9)


@given(st.lists(st.text("0123456789,.;-TRUEF \tx", max_size=14), max_size=8), st.sampled_from(";:\t"))
def test_whatever_its_rows_hold_the_events_are_cells_of_it(tmp_path_factory, rows, mark):
    path = tmp_path_factory.mktemp("scope") / "scope.csv"
    path.write_text(export([*ROWS, *rows], mark))
    log = read_or_refuse(ADAPTER, path)
    if log is not None:
        lines = path.read_text().split("\n")
        assert all(value in lines[row - 1] for _, _, value, row in log.events.rows())
