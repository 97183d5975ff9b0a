"""A stated unit of time that what the log shows contradicts is refused, with both numbers."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import numpy as np
import pytest

import cyclekit
from cyclekit.errors import LogError

if TYPE_CHECKING:
    from pathlib import Path

T_S = np.arange(600) / 25
BEGIN = datetime(2024, 5, 14, 6, 30, tzinfo=UTC)
MAP = (
    '[[sources]]\npath = "{file}"\nadapter = "csv"\nrole = "{role}"\n[sources.map]\ntime = "t"\ntime_unit = "{unit}"\n'
)


def robot(logs: Path, unit: str = "s", unit_s: float = 1.0) -> str:
    rows = [f"{t / unit_s:.6f},{0.3 * np.cos(t):.5f},{0.3 * np.sin(t):.5f},0.3" for t in T_S]
    (logs / "robot.csv").write_text("\n".join(["t,x,y,z", *rows, ""]), encoding="utf-8")
    return MAP.format(file="robot.csv", role="robot", unit=unit) + 'x = "x"\ny = "y"\nz = "z"\n'


def person(logs: Path, unit: str, unit_s: float) -> str:
    rows = [f"{t / unit_s:.6f},{1.5 * np.cos(t / 2):.4f},{1.5 * np.sin(t / 2):.4f}" for t in T_S]
    (logs / "people.csv").write_text("\n".join(["t,x,y", *rows, ""]), encoding="utf-8")
    return MAP.format(file="people.csv", role="people", unit=unit) + 'x = "x"\ny = "y"\n'


@pytest.mark.parametrize(
    ("who", "unit", "unit_s", "says"),
    [
        (robot, "s", 60.0, r"the TCP moves at 17\.\d m/s, which none does \(at most 10\)"),
        (robot, "ms", 1.0, "robot rows lie 0.00004 s apart"),
        (person, "s", 60.0, r"a person moves at 44\.\d m/s, which none does \(at most 20\)"),
        (person, "ms", 1.0, r"a person moves at 7\d\d\.\d m/s, which none does"),
    ],
)
def test_a_stated_unit_in_which_nothing_moves_so_fast_is_refused(tmp_path: Path, who, unit, unit_s, says) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "cell.toml").write_text((robot(logs) if who is person else "") + who(logs, unit, unit_s), encoding="utf-8")
    with pytest.raises(LogError, match=says) as refusal:
        cyclekit.ingest_logs(logs, tmp_path / "d")
    assert "time_unit" in str(refusal.value)
    cyclekit.ingest_logs(logs, tmp_path / "d", accept_bad_logs=True)


def test_a_person_whose_track_jumps_between_two_now_and_then_is_no_wrong_unit(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    cell = robot(logs) + person(logs, "s", 1.0)
    lines = (logs / "people.csv").read_text().splitlines()
    lines[1::50] = [f"{line.split(',')[0]},9.0,9.0" for line in lines[1::50]]
    (logs / "people.csv").write_text("\n".join(lines), encoding="utf-8")
    (logs / "cell.toml").write_text(cell, encoding="utf-8")
    assert cyclekit.ingest_logs(logs, tmp_path / "d")


@pytest.mark.parametrize(("unit", "fits"), [("s", False), ("ms", True)])
def test_a_stated_unit_of_events_that_a_second_time_contradicts_is_refused(
    tmp_path: Path, unit: str, fits: bool
) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    rows = [f"{1000 * t:.0f},{BEGIN + timedelta(seconds=t):%H:%M:%S},door,{k % 2}" for k, t in enumerate(T_S[::25])]
    (logs / "plc.csv").write_text("\n".join(["t,TimeString,tag,state", *rows, ""]), encoding="utf-8")
    cell = MAP.format(file="plc.csv", role="events", unit=unit) + 'signal = "tag"\nvalue = "state"\n'
    (logs / "cell.toml").write_text(cell, encoding="utf-8")
    if fits:
        assert cyclekit.inspect_logs(logs).logs[0].tables["events"].duration_s == pytest.approx(23.0)
        return
    with pytest.raises(LogError, match=r"TimeString runs 0\.001 times as fast") as refusal:
        cyclekit.inspect_logs(logs)
    assert 'It fits "ms"' in str(refusal.value)


TICKS = [133_600_000_000_000_000 + 100_000 * k for k in range(30)]
NO_ROW = {
    "robot": ("robot.csv", "t,x,y,z", "{0},{1},0,0.3", 'role = "robot"', 'time = "t"\nx = "x"\ny = "y"\nz = "z"'),
    "people": ("people.csv", "t,x,y", "{0},{1},0", 'role = "people"', 'time = "t"\nx = "x"\ny = "y"'),
    "events": ("plc.csv", "t,signal,value", "{0},door,{1}", "", ""),
    "safety": ("speed_override.csv", "time,override", "{0},{1}", "", ""),
    "tasks": ("tasks.csv", "agent,task,start,end", "robot,t{1},{0},{0}", "", ""),
}


@pytest.mark.parametrize("kind", NO_ROW)
def test_a_log_whose_rows_are_all_set_aside_says_why_and_is_not_called_empty(tmp_path: Path, kind: str) -> None:
    file, header, row, role, columns = NO_ROW[kind]
    logs = tmp_path / "logs"
    logs.mkdir()
    rows = [row.format(tick, k) for k, tick in enumerate(TICKS)]
    (logs / file).write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    adapter = f'adapter = "csv"\n{role}' if role else ""
    cell = f'[[sources]]\npath = "{file}"\n{adapter}\n[sources.map]\ntime_unit = "s"\n{columns}\n'
    (logs / "cell.toml").write_text(cell, encoding="utf-8")
    with pytest.raises(LogError, match=r"none of its 30 rows can be used; the first \(line 2\): its time is not"):
        cyclekit.ingest_logs(logs, tmp_path / "d")


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ("frame,x,y,z", "'frame' counts rows"),
        ("tcp_x,tcp_y,tcp_z,force", "'tcp_x' rises in every row, but is no time by its name"),
    ],
)
def test_a_table_with_a_column_that_rises_is_not_said_to_have_no_time(tmp_path: Path, header: str, said: str) -> None:
    rows = [f"{k},{np.sin(k):.3f},0.5,0.25" for k in range(50)]
    (tmp_path / "robot.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    assert said in cyclekit.draft_cell(tmp_path / "robot.csv").cell
