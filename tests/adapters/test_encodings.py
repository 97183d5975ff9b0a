"""Text logs in every encoding: the declared one is used, an undeclared one is guessed and said, nothing is merged."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from cyclekit.adapter import ReadOptions, Recording, concat_parts
from cyclekit.errors import DamagedLog
from cyclekit.ingest.registry import find_adapter

NAMES = ["Tür", "Tör"]
XML = ["ISO-8859-1", "windows-1252", "ISO-8859-15", "cp437", "UTF-16", "UTF-8"]
Names = Sequence[str]
Kind = Callable[[Names], str]


def xes(names: Names, declared: str = "") -> str:
    keys = '<string key="concept:name" value="{}"/><string key="lifecycle:transition" value="{}"/>'
    when = '<string key="org:resource" value="ur5"/><date key="time:timestamp" value="2024-05-01T10:00:0{}Z"/>'
    steps = [(name, step) for name in names for step in ("start", "complete")]
    events = "".join(f"<event>{keys.format(*each)}{when.format(n)}</event>\n" for n, each in enumerate(steps))
    head = f'<?xml version="1.0" encoding="{declared}"?>\n' if declared else ""
    return f'{head}<log xes.version="1.0"><trace>{events}</trace></log>\n'


def table(names: Names) -> str:
    return "run,agent,task,start_s,end_s\n" + "".join(f"{n},ur5,{name},{n}.0,{n}.5\n" for n, name in enumerate(names))


def records(names: Names) -> str:
    rows = [{"agent": "ur5", "task": name, "start_s": n, "end_s": n + 0.5} for n, name in enumerate(names)]
    return json.dumps(rows, ensure_ascii=False)


def codesys_csv(names: Names) -> str:
    data = "".join(f"{n}.Variable; {name}\n{n}.Data; \n; 2; FALSE\n; 12; TRUE\n" for n, name in enumerate(names))
    return f"[key]; [value]\nName; Application.Trace\nFlags; 16\n{data}"


def codesys_xml(names: Names) -> str:
    lists = "<Values>FALSE,TRUE</Values><Timestamps>2,12</Timestamps>"
    told = "".join(f'<TraceVariable VarName="{name}">{lists}</TraceVariable>\n' for name in names)
    return (
        f'<Trace><TraceConfiguration><Single Name="MicroSeconds">False</Single></TraceConfiguration>\n{told}</Trace>\n'
    )


def presses(names: Names) -> str:
    return "time_s,signal,value\n" + "".join(f"{n}.0,{name},1\n" for n, name in enumerate(names))


KINDS = [table, records, xes, codesys_csv, codesys_xml, presses]


def read(path: Path, raw: bytes) -> Recording:
    path.write_bytes(raw)
    found = find_adapter(path)
    assert found is not None
    return concat_parts(found.parts(path, ReadOptions()))


def names(log: Recording) -> list[str]:
    if log.task_list is not None:
        return log.task_list["task"].to_list()
    assert log.events is not None
    return log.events["signal"].unique(maintain_order=True).to_list()


@pytest.mark.parametrize("declared", XML)
def test_the_declaration_of_an_xml_log_is_honoured(tmp_path: Path, declared: str):
    log = read(tmp_path / "a.xes", xes(NAMES, declared).encode(declared))
    assert names(log) == NAMES
    assert not any("Windows-1252" in said for said in log.warnings)


@pytest.mark.parametrize("kind", KINDS)
def test_byte_order_marks_and_wide_characters_are_honoured_in_every_text_log(tmp_path: Path, kind: Kind):
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32"):
        log = read(tmp_path / "a.log", kind(NAMES).encode(encoding))
        assert names(log) == NAMES, encoding
        assert not any("Windows-1252" in said for said in log.warnings)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("packed", [False, True])
def test_undeclared_text_that_is_no_utf_8_is_read_as_windows_1252_and_said(tmp_path: Path, kind: Kind, *, packed: bool):
    raw = kind(NAMES).encode("cp1252")
    log = read(tmp_path / "a.log", gzip.compress(raw) if packed else raw)
    assert names(log) == NAMES
    assert sum("Windows-1252" in said for said in log.warnings) == 1


def test_umlauts_may_come_late(tmp_path: Path):
    log = read(tmp_path / "a.csv", table(["weld"] * 2000 + NAMES).encode("cp1252"))
    assert set(names(log)) == {"weld", *NAMES}
    assert any("Windows-1252" in said for said in log.warnings)


def test_a_declaration_that_is_wrong_is_not_believed(tmp_path: Path):
    assert names(read(tmp_path / "a.xes", xes(NAMES, "UTF-16").encode())) == NAMES  # written from memory, by .NET
    log = read(tmp_path / "b.xes", xes(NAMES, "UTF-8").encode("cp1252"))
    assert names(log) == NAMES
    assert any("Windows-1252" in said for said in log.warnings)
    with pytest.raises(DamagedLog, match="unknown encoding 'klingon'"):
        read(tmp_path / "c.xes", xes(NAMES, "klingon").encode("latin-1"))


@pytest.mark.parametrize("kind", KINDS)
def test_what_cannot_be_read_in_utf_8_is_never_merged(tmp_path: Path, kind: Kind):
    """One name is whole in UTF-8; two others have single bytes, which may be any letter."""
    raw = kind(["Größe", "T1r", "T2r"]).encode().replace(b"T1r", b"T\xfcr").replace(b"T2r", b"T\xf6r")
    log = read(tmp_path / "a.log", raw)
    assert names(log) == ["Größe"]
    assert (log.set_aside is not None and log.set_aside.height) or any("unreadable" in said for said in log.warnings)
