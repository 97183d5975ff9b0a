"""Times in the forms that people have, in all tables: through `draft_cell`, `inspect_logs` and `ingest_logs`."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import TYPE_CHECKING
from zoneinfo import ZoneInfo

import numpy as np
import pytest

import cyclekit
from cyclekit.errors import LogError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Written = Callable[[datetime], str]

T_S = np.arange(0.0, 30.0, 0.25)
SPREADSHEET = datetime(1899, 12, 30, tzinfo=UTC)
ROME = ZoneInfo("Europe/Rome")


def form(pattern: str) -> Written:
    """Return a function that writes times; `%f` are milliseconds."""
    return lambda when: when.strftime(pattern.replace("%f", f"{when.microsecond // 1000:03d}"))


def short(pattern: str) -> Written:
    """Return a function that leaves out zeros at the end of fractions, and fractions that are zero."""
    return lambda when: form(pattern)(when).rstrip("0").rstrip(".") if when.microsecond else form(pattern)(when)[:-4]


def days(zero: int) -> Written:
    return lambda when: f"{(when - SPREADSHEET) / timedelta(days=1) + zero:.10f}"


MORNING, NOON, MIDNIGHT = "2024-05-14 06:59:50", "2024-05-14 11:59:50", "2024-05-14 23:59:50"
FORMS: dict[str, tuple[Written, str]] = {
    "HH:MM:SS:mmm": (form("%H:%M:%S:%f"), MORNING),
    "HH:MM:SS;mmm": (form("%H:%M:%S;%f"), MORNING),
    "HH:MM:SS,mmm at midnight": (form("%H:%M:%S,%f"), MIDNIGHT),
    "HH:MM:SS.mmm at midnight": (form("%H:%M:%S.%f"), MIDNIGHT),
    "mm:ss.0 at the full hour": (form("%M:%S.%f"), MORNING),
    "mm:ss,0 at the full hour": (form("%M:%S,%f"), MORNING),
    "days of a spreadsheet": (days(0), MORNING),
    "datenum": (days(693_960), MORNING),
    "AM/PM at midnight": (form("%m/%d/%Y %I:%M:%S.%f %p"), MIDNIGHT),
    "AM/PM at midnight, no date": (form("%I:%M:%S.%f %p"), MIDNIGHT),
    "AM/PM at noon, no date": (form("%I:%M:%S.%f %p"), NOON),
    "a.m.": (lambda when: form("%I:%M:%S.%f %p")(when).replace("AM", "a.m.").replace("PM", "p.m."), NOON),
    "local, summer time ends": (
        lambda when: form("%Y-%m-%d %H:%M:%S.%f")(when.astimezone(ROME)),
        "2024-10-27 00:59:50",
    ),
    "local, summer time begins": (
        lambda when: form("%Y-%m-%d %H:%M:%S.%f")(when.astimezone(ROME)),
        "2024-03-31 00:59:50",
    ),
    "mixed fractions": (short("%Y-%m-%d %H:%M:%S.%f"), MORNING),
    "mixed fractions, no date": (short("%H:%M:%S.%f"), MORNING),
    "German": (form("%d.%m.%Y %H:%M:%S:%f"), MORNING),
    "German, points": (form("%d.%m.%Y %H.%M.%S,%f"), MORNING),
    "ISO 8601": (form("%Y-%m-%dT%H:%M:%S.%fZ"), MORNING),
    "ISO 8601, basic": (form("%Y%m%dT%H%M%S.%fZ"), MORNING),
    "compact": (form("%Y%m%d %H%M%S.%f"), MORNING),
    "digits alone": (form("%Y%m%d%H%M%S%f"), MORNING),
    "a zone's name": (form("%Y-%m-%d %H:%M:%S.%f CEST"), MORNING),
    "a zone's offset": (form("%Y-%m-%d %H:%M:%S.%f+0530"), MORNING),
    "months in words": (form("%d-%b-%Y %H:%M:%S.%f"), MORNING),
    "months in words, US": (form("%b %d, %Y %I:%M:%S.%f %p"), NOON),
    "ctime": (form("%a %b %d %H:%M:%S.%f %Y"), MORNING),
    "file names": (form("%Y-%m-%d_%H-%M-%S.%f"), MORNING),
    "PLC": (form("DT#%Y-%m-%d-%H:%M:%S.%f"), MORNING),
    "PLC, time of day": (form("TOD#%H:%M:%S.%f"), MIDNIGHT),
    "pandas": (form("0 days %H:%M:%S.%f"), "2024-05-14 00:00:00"),
    "nanoseconds": (form("%Y-%m-%dT%H:%M:%S.%f123456"), MORNING),
}


def folder_of(logs: Path, times: list[str]) -> Path:
    """Write the logs of a robot, of events, of a safety system and of tasks, all with the same times."""
    mark = "," if ";" in times[0] else ";"
    spans = list(pairwise(times))
    tables = {
        "robot.csv": [
            ("Timestamp", "tcp_x [mm]", "tcp_y [mm]", "tcp_z [mm]"),
            *(
                (time, f"{500 + 99 * np.cos(t):.3f}", f"{99 * np.sin(t):.3f}", "3")
                for time, t in zip(times, T_S, strict=True)
            ),
        ],
        "plc.csv": [("Timestamp", "signal", "value"), *((time, "door", str(k % 2)) for k, time in enumerate(times))],
        "speed_override.csv": [
            ("Timestamp", "override"),
            *((time, str(100 - 50 * (k % 2))) for k, time in enumerate(times)),
        ],
        "tasks.csv": [
            ("agent", "task", "start", "end"),
            *((("robot", "operator")[k % 2], f"t{k % 4}", *span) for k, span in enumerate(spans)),
        ],
    }
    logs.mkdir()
    for name, rows in tables.items():
        (logs / name).write_text("\n".join([*map(mark.join, rows), ""]), encoding="utf-8")
    return logs


@pytest.mark.parametrize("name", FORMS)
def test_times_are_read_as_people_write_them(tmp_path: Path, name: str) -> None:
    write, begin = FORMS[name]
    start = datetime.fromisoformat(begin).replace(tzinfo=UTC)
    logs = folder_of(tmp_path / "logs", [write(start + timedelta(seconds=t)) for t in T_S.tolist()])
    draft = cyclekit.draft_cell(logs)
    assert not draft.unsure, draft.cell
    zone = 'time_zone = "Europe/Rome"\n' if "local" in name else ""
    cell = draft.cell.replace("[sources.map]\n", f"[sources.map]\n{zone}")
    for file in ("plc.csv", "speed_override.csv", "tasks.csv") if zone else ():
        cell = cell.replace(f'path = "{file}"\n', f'path = "{file}"\nmap = {{ {zone.strip()} }}\n')
    (logs / "cell.toml").write_text(cell, encoding="utf-8")
    described = cyclekit.inspect_logs(logs)
    assert {table.rows for log in described.logs for table in log.tables.values()} == {len(T_S), len(T_S) - 1}
    dataset = cyclekit.Dataset.open(cyclekit.ingest_logs(logs, tmp_path / "d").place)
    assert len(dataset.recordings) == 4
    for card in dataset.recordings:
        rows = dataset.recorded(card.id, card.tables[0])
        assert rows is not None
        assert not card.rows_set_aside
        assert (rows["t_s"] - rows["t_s"][0]).to_list() == pytest.approx(T_S[: rows.height].tolist(), abs=2e-3), (
            card.shown
        )
        if "end_s" in rows.columns:
            assert (rows["end_s"] - rows["t_s"]).to_list() == pytest.approx([0.25] * rows.height, abs=2e-3)
        if card.clock.kind == "epoch" and "offset" not in name and "zone" not in name:
            assert card.first_s == pytest.approx(start.timestamp(), abs=2e-3)


def night(file: Path, starts_s: list[float]) -> Path:
    """Write the tasks of two agents, one after the other, at times of day."""
    rows = [
        f"{who},{who} {k},{clock(at)},{clock(at + 5)}" for who in ("robot", "operator") for k, at in enumerate(starts_s)
    ]
    file.write_text("\n".join(["agent,task,start,end", *rows, ""]), encoding="utf-8")
    return file


def clock(at_s: float) -> str:
    return form("%H:%M:%S.%f")(datetime(2024, 5, 14, tzinfo=UTC) + timedelta(seconds=at_s))


def test_agents_in_a_list_one_after_the_other_share_one_night(tmp_path: Path) -> None:
    starts_s = [86_400.0 + t for t in (-600.0, -300.0, -2.0, 60.0, 900.0)]
    night(tmp_path / "tasks.csv", starts_s)
    dataset = cyclekit.Dataset.open(cyclekit.ingest_logs(tmp_path / "tasks.csv", tmp_path / "d").place)
    rows = dataset.recorded(dataset.recordings[0].id, "task_list")
    assert rows is not None
    assert rows["t_s"].to_list() == pytest.approx(sorted(2 * starts_s))
    assert (rows["end_s"] - rows["t_s"]).to_list() == pytest.approx([5.0] * 10)


def test_times_of_day_of_several_days_out_of_order_are_refused(tmp_path: Path) -> None:
    night(tmp_path / "tasks.csv", [3600.0 * hour for hour in range(20, 51, 6)])
    with pytest.raises(LogError, match="of several days"):
        cyclekit.ingest_logs(tmp_path / "tasks.csv", tmp_path / "d")


@pytest.mark.parametrize("header", ["Date,Time,Signal,State", "Date Time,Signal,State"])
def test_dates_with_the_year_or_the_day_first_are_not_guessed(tmp_path: Path, header: str) -> None:
    mark = "," if "Date," in header else " "
    start = datetime(2024, 5, 14, 6, 30, tzinfo=UTC)
    rows = [f"{start + timedelta(seconds=7 * k):%y/%m/%d{mark}%H:%M:%S},door,{k % 2}" for k in range(40)]
    (tmp_path / "plc.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    with pytest.raises(LogError, match=r"%d/%m/%y %H:%M:%S%\.f or as %y/%m/%d"):
        cyclekit.ingest_logs(tmp_path / "plc.csv", tmp_path / "d")


@pytest.mark.parametrize(("zero_days", "unit_s"), [(15_018, 86_400.0), (0, 1.0)])
def test_dates_after_the_file_was_written_are_no_dates(tmp_path: Path, zero_days: int, unit_s: float) -> None:
    """Modified Julian days look like days of a spreadsheet in 2065, seconds since 1900 like those of 1904 in 2028."""
    count = (datetime(2024, 5, 14, tzinfo=UTC) - SPREADSHEET) / timedelta(seconds=unit_s) + zero_days
    rows = [f"{count + t / unit_s:.9f},{99 * np.cos(t):.3f},{99 * np.sin(t):.3f}" for t in T_S]
    (tmp_path / "robot.csv").write_text("\n".join(["stamp,x [mm],y [mm]", *rows, ""]), encoding="utf-8")
    draft = cyclekit.draft_cell(tmp_path / "robot.csv")
    assert draft.unsure
    assert "its dates would be after the file's own" in draft.cell
