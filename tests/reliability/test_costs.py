"""What reading costs: time in proportion to the bytes, memory within bounds, whatever a file holds or states."""

from __future__ import annotations

import math
import struct
import time
import tracemalloc
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from reliability.own_logs import own_logs

from cyclekit.adapter import ReadOptions, Recording, concat_parts
from cyclekit.errors import DamagedLog, LogError
from cyclekit.ingest.registry import find_adapter
from cyclekit_adapters.formats import azure_kinect, codesys_trace, task_list
from cyclekit_adapters.tasks import xes
from cyclekit_adapters.text.text_layout import MAX_COLUMNS, header_names

if TYPE_CHECKING:
    from collections.abc import Callable

FACTOR = 4
"""How many times larger the second of two logs is."""


def read(path: Path, raw: bytes) -> Recording:
    path.write_bytes(raw)
    found = find_adapter(path)
    assert found is not None
    return concat_parts(found.parts(path, ReadOptions()))


def event(task: str, step: str, second: int) -> str:
    keys = f'<string key="concept:name" value="{task}"/><string key="lifecycle:transition" value="{step}"/>'
    when = f'<date key="time:timestamp" value="2024-05-01T10:{second // 60 % 60:02d}:{second % 60:02d}Z"/>'
    return f'<event>{keys}<string key="org:resource" value="ur5"/>{when}</event>\n'


def never_ended(count: int) -> bytes:
    """Tasks that start, and others that end: each end may belong to any start."""
    steps = [event(f"a{n}", "start", n) for n in range(count)] + [event(f"b{n}", "complete", n) for n in range(count)]
    return f"<log xes.version='1.0'><trace>{''.join(steps)}</trace></log>".encode()


def variables(count: int) -> bytes:
    lists = "<Values>TRUE,FALSE</Values><Timestamps>1,2</Timestamps>"
    told = "".join(f'<TraceVariable VarName="v{n}">{lists}</TraceVariable>' for n in range(count))
    unit = '<TraceConfiguration><Single Name="MicroSeconds">False</Single></TraceConfiguration>'
    return f"<Trace>{unit}{told}</Trace>".encode()


def channels(count: int) -> bytes:
    names, types = "\t".join(f"c{n}" for n in range(count)), "\t".join(["BIT"] * count)
    head = f"Name\tscope\nFile\tx\nStarttime of export\t132959733843760000\n\nName\t{names}\nData-Type\t{types}\n\n"
    return (head + "".join(f"{row}\t" + "\t".join([str(row % 2)] * count) + "\n" for row in range(3))).encode()


TRIES = 5
"""Number of measurements; the least one counts, as other processes slow this one by chance."""


@pytest.mark.parametrize(("write", "count"), [(never_ended, 500), (variables, 2000), (channels, 1000)])
def test_time_is_in_proportion_to_the_size(tmp_path: Path, write: Callable[[int], bytes], count: int):
    logs, took_s = [write(count), write(FACTOR * count)], [math.inf, math.inf]
    for _ in range(TRIES):
        for number, raw in enumerate(logs):
            begin = time.process_time()
            read(tmp_path / "a.log", raw)
            took_s[number] = min(took_s[number], time.process_time() - begin)
        if took_s[1] < 2 * FACTOR * took_s[0]:
            return
    assert took_s[1] < 2 * FACTOR * took_s[0]  # the square of FACTOR is twice that


def test_parameters_of_a_c3d_file_that_lie_in_each_other_are_not_read(tmp_path: Path):
    raw = next(log for log in own_logs(tmp_path) if log.name == "c3d").files["log.c3d"]
    nested = struct.pack("<bb", 1, 1) + b"X" + struct.pack("<H", 6) + struct.pack("<bBBB", -1, 2, 250, 250)
    body = (nested * (255 * 512 // len(nested)))[: 255 * 512 - 4]
    harmed = raw[:512] + bytes([1, 0x50, 255, 84]) + body + raw[1024:]
    tracemalloc.start()
    try:
        with pytest.raises(LogError):
            read(tmp_path / "b.c3d", harmed)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 50e6


def test_lists_too_long_for_the_memory_are_refused_before_they_fill_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(task_list, "MAX_TASKS", 10)
    monkeypatch.setattr(codesys_trace, "MAX_SAMPLES", 10)
    monkeypatch.setattr(xes, "_MAX_HELD", 1000)
    monkeypatch.setattr(azure_kinect, "MAX_BODIES", 10)
    rows = "".join(f"{n},ur5,t,{n}.0,{n}.5\n" for n in range(11))
    kinect = next(log for log in own_logs(tmp_path) if log.name == "azure kinect").files["log.txt"]
    for raw in (f"run,agent,task,start_s,end_s\n{rows}".encode(), never_ended(9), variables(6), kinect):
        with pytest.raises(DamagedLog, match="more than"):
            read(tmp_path / "a.log", raw)


@pytest.mark.parametrize("mark", [",", " ", "\\s+"])
def test_a_header_of_millions_of_names_is_not_taken_apart(mark: str):
    line = (" " if mark == "\\s+" else mark).join(["x"] * 3_000_000)
    assert len(header_names(line, mark)) == MAX_COLUMNS + 1


@pytest.mark.parametrize("name", ["t", "t_s", "source_row", "value", "signal", "name", "count"])
def test_a_variable_may_have_any_name(tmp_path: Path, name: str):
    csv = f"[key]; [value]\nFlags; 16\n0.Variable; {name}\n0.Data; \n; 1; TRUE\n; 2; FALSE\n"
    scope = channels(1).replace(b"\tc0", f"\t{name}".encode())
    for raw in (csv.encode(), variables(1).replace(b'"v0"', f'"{name}"'.encode()), scope):
        events = read(tmp_path / "a.log", raw).events
        assert events is not None
        assert {signal.removesuffix("#2") for signal in events["signal"]} == {name}
