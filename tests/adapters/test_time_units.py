"""The unit of a time is proven or asked for: a log in any unit and epoch comes to one table, or its unit is named."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import numpy as np
import pytest
from epochs import EPOCHS
from examples import at_most
from hypothesis import HealthCheck, assume, given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.config import Cell, Source, cell_to_toml, load_cell
from cyclekit.errors import LogError
from cyclekit.ingest.validate.validate import examined
from cyclekit_adapters.formats import events, mapped_csv, safety_log, task_list

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.adapter import Draft, Recording

BEGIN = datetime(2024, 5, 14, 6, 30, 0, 250_000, tzinfo=UTC)
BEGIN_S = BEGIN.timestamp()
DAY_S = 86_400.0
COUNTED = {
    "ns": 1e-9, "10 ns": 1e-8, "100 ns": 1e-7, "us": 1e-6, "10 us": 1e-5, "ms": 1e-3,
    "1/100 s": 0.01, "1/10 s": 0.1, "s": 1.0, "min": 60.0, "h": 3600.0, "days": DAY_S,
}  # fmt: skip
WHOLE = {
    "ns",
    "10 ns",
    "100 ns",
    "us",
    "10 us",
    "1/100 s",
    "1/10 s",
    "filetime",
    "ticks",
    "us since 1970",
    "ns since 1970",
}
RESOLUTION_S = 2e-4
"""A float64 holds .NET ticks to 13 us, days since the year 0 to 10 us."""


def written(unit: str, t_s: np.ndarray) -> list[str]:
    """Return times since BEGIN as a program writes them in a unit; relative counts begin a little after zero."""
    if unit in COUNTED:
        counts = [(0.5 + t) / COUNTED[unit] for t in t_s.tolist()]
    else:
        seconds, ahead, _ = EPOCHS[unit]
        counts = [(t + BEGIN_S + ahead) / seconds for t in t_s.tolist()]
    return [f"{math.floor(count + 1e-6)}" if unit in WHOLE else f"{count:.10f}" for count in counts]


def robot_log(file: Path, name: str, times: list[str], t_s: np.ndarray, top_m_s: float) -> Path:
    angle = top_m_s / 0.2 * t_s
    place = zip(500 + 200 * np.cos(angle), 200 * np.sin(angle), strict=True)
    mark = "," if ";" in times[0] else ";"
    rows = [mark.join((time, f"{x:.3f}", f"{y:.3f}", "300.5")) for time, (x, y) in zip(times, place, strict=True)]
    header = mark.join((name, "tcp_x [mm]", "tcp_y [mm]", "tcp_z [mm]"))
    file.write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    return file


def drafted(log: Path) -> tuple[Draft, Source]:
    draft = mapped_csv.ADAPTER.draft(log)
    cell = log.parent / "cell.toml"
    cell.write_text(cell_to_toml(Cell(sources=(Source(log.name, "csv"),)), {log.name: draft}), encoding="utf-8")
    return draft, load_cell(cell).sources[0]


def read(log: Path, source: Source) -> Recording:
    return mapped_csv.ADAPTER.read(log, ReadOptions(role=source.role, map=source.map, rate_hz=source.rate_hz))


@at_most(60, suppress_health_check=[HealthCheck.too_slow])
@given(
    unit=st.sampled_from([*COUNTED, *EPOCHS]),
    rate_hz=st.sampled_from([5, 10, 20, 50, 100, 125, 250]),
    top_m_s=st.floats(0.15, 1.5),
    says=st.booleans(),
)
def test_a_robot_log_in_any_unit_comes_to_one_table_or_is_asked_about(
    tmp_path_factory: pytest.TempPathFactory, unit: str, rate_hz: int, top_m_s: float, says: bool
) -> None:
    assume(not 1.0 < COUNTED.get(unit, 0.0) * rate_hz < 2.0)  # rows that share a few stamps repeat a sample
    t_s = np.arange(400) / rate_hz
    times = written(unit, t_s)
    name = f"Time [{unit}]" if says and unit in COUNTED else "gps_time" if unit == "gps" else "Timestamp"
    log = robot_log(tmp_path_factory.mktemp("log") / "robot.csv", name, times, t_s, top_m_s)
    draft, source = drafted(log)
    called = EPOCHS[unit][2] if unit in EPOCHS else unit
    if draft.unsure:
        (why,) = [proposal.why for proposal in draft.map if proposal.key == "time_unit"]
        assert re.search(rf"(?:if|says) {re.escape(called)}\b", why), why
        assert "time" not in source.map
        return
    got = read(log, source)
    resolution_s = max(RESOLUTION_S, 1.01 * COUNTED.get(unit, 0.0) * (unit in WHOLE))
    assert (got.robot["t_s"] - got.robot["t_s"][0]).to_list() == pytest.approx(t_s.tolist(), abs=resolution_s)
    if unit in EPOCHS:
        assert got.robot["t_s"][0] == pytest.approx(BEGIN_S, abs=RESOLUTION_S)
        assert got.clock == ("relative" if unit in ("excel", "wincc", "matlab", "ticks") else "epoch")


T_S = np.arange(400) * 0.05
DATE = "2024-05-14"


def clock(form: str, t_s: float, begin: datetime) -> str:
    when = begin + timedelta(seconds=t_s)
    text = when.strftime(form.replace("%f", "@"))
    return text.replace("@", f"{when.microsecond // 1000:03d}")


@pytest.mark.parametrize("name", ["#1", "Werte"])
def test_a_time_is_found_by_its_cells_where_its_column_has_no_such_name(tmp_path: Path, name: str) -> None:
    times = [clock("%d.%m.%Y %H:%M:%S.%f", t, BEGIN) for t in T_S.tolist()]
    draft, _ = drafted(robot_log(tmp_path / "robot.csv", name, times, T_S, 0.5))
    assert {line.key: line.value for line in draft.map}["time_format"] == "%d.%m.%Y %H:%M:%S%.f"


@pytest.mark.parametrize(("name", "cells"), [("Messwert", "{0:.3f}"), ("Timestamp", "nach {0:.3f} Uhr")])
def test_a_column_that_may_be_the_time_is_asked_about_and_no_rate_is_invented(
    tmp_path: Path, name: str, cells: str
) -> None:
    draft, _ = drafted(robot_log(tmp_path / "robot.csv", name, [cells.format(t) for t in T_S.tolist()], T_S, 0.5))
    assert {line.key: line.value for line in draft.map if not line.sure}["time"] == name
    assert "rate_hz" not in {line.key for line in draft.source}


PANEL = [f"2024-05-14 06:30:{k:02d}" for k in range(50)]


@pytest.mark.parametrize(("unit", "fits"), [("s", "ms"), ("min", "ms"), ("us", "ms")])
def test_a_stated_unit_that_a_second_time_in_the_row_contradicts_is_refused(
    tmp_path: Path, unit: str, fits: str
) -> None:
    log = tmp_path / "robot.csv"
    rows = [f"{1000 * k},{when},{k},0.5" for k, when in enumerate(PANEL)]
    log.write_text("\n".join(["t,TimeString,x,y", *rows, ""]), encoding="utf-8")
    how = {"time": "t", "x": "x", "y": "y", "length_unit": "mm"}
    with pytest.raises(LogError, match="TimeString runs") as refusal:
        mapped_csv.ADAPTER.read(log, ReadOptions(role="robot", map=how | {"time_unit": unit}))
    assert f'"{fits}"' in str(refusal.value.cure)
    got = mapped_csv.ADAPTER.read(log, ReadOptions(role="robot", map=how))
    assert got.robot["t_s"].to_list() == pytest.approx(list(range(50)))
    assert "TimeString" in got.facts["time"]


def test_a_name_that_the_speeds_contradict_is_not_believed(tmp_path: Path) -> None:
    log = robot_log(tmp_path / "robot.csv", "time_ms", [f"{60 * t:.3f}" for t in T_S], T_S, 0.5)
    draft, _ = drafted(log)
    (why,) = [line.why for line in draft.map if line.key == "time_unit"]
    assert draft.unsure
    assert "its name says ms, but then" in why


@pytest.mark.parametrize("zone", [None, "Europe/Rome"])
def test_marks_of_a_panel_are_no_events_and_its_day_count_is_read(tmp_path: Path, zone: str | None) -> None:
    day = 45_426.0 + (6 * 3600 + 30 * 60) / DAY_S
    rows = [f'"door";{k % 2};{(day + 10 * k / DAY_S) * 1e6:.4f}'.replace(".", ",") for k in range(20)]
    rows = ['"$RT_OFF$";0;45426270810,1852', *rows, '"$RT_COUNT$";21;']
    (tmp_path / "log.csv").write_text("\n".join(['"VarName";"VarValue";"Time_ms"', *rows, ""]), encoding="utf-8")
    log = events.ADAPTER.read(tmp_path / "log.csv", ReadOptions(map={"time_zone": zone} if zone else {}))
    assert log.events["signal"].unique().to_list() == ["door"]
    begin = BEGIN_S - 0.25 - (7200.0 if zone else 0.0)
    assert log.events["t_s"].to_list() == pytest.approx([begin + 10 * k for k in range(20)], abs=1e-3)
    assert "WinCC" in log.facts["time"]


def tasks(file: Path, name: str, took: list[float], idle_s: float, unit_s: float) -> Path:
    rows, at = [], BEGIN_S
    for k, count in enumerate(took * 4):
        start = datetime.fromtimestamp(at, UTC)
        rows.append(f"1,robot,task {k % len(took)},{start:%Y-%m-%d %H:%M:%S},{count:g}")
        at += count * unit_s + idle_s
    file.write_text("\n".join([f"case,resource,activity,start,{name}", *rows, ""]), encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("name", "took", "idle_s", "unit_s"),
    [
        ("duration", [5.0, 3.0, 12.0], 0.0, 60.0),
        ("duration", [5.0, 3.0, 12.0], 0.0, 1.0),
        ("duration", [0.25, 0.5], 0.0, 3600.0),
        ("duration", [5000.0, 3000.0], 2.0, 1e-3),
        ("duration_min", [5.0, 3.0, 12.0], 600.0, 60.0),
        ("Duration [h]", [0.25, 0.5], 600.0, 3600.0),
    ],
)
def test_durations_have_the_unit_that_their_name_or_the_next_starts_prove(
    tmp_path: Path, name: str, took: list[float], idle_s: float, unit_s: float
) -> None:
    log = task_list.ADAPTER.read(tasks(tmp_path / "a.csv", name, took, idle_s, unit_s), ReadOptions())
    lasted = (log.task_list["end_s"] - log.task_list["t_s"]).to_list()
    assert lasted == pytest.approx([count * unit_s for count in took * 4])


def test_durations_that_may_be_minutes_or_seconds_are_refused_with_both(tmp_path: Path) -> None:
    path = tasks(tmp_path / "a.csv", "duration", [5.0, 3.0, 12.0], 300.0, 60.0)
    with pytest.raises(LogError, match="the next starts fit s or min"):
        task_list.ADAPTER.read(path, ReadOptions())
    log = task_list.ADAPTER.read(path, ReadOptions(map={"time_unit": "min"}))
    assert (log.task_list["end_s"] - log.task_list["t_s"]).to_list()[:3] == pytest.approx([300.0, 180.0, 720.0])


def test_a_unit_of_durations_that_the_next_starts_contradict_is_refused(tmp_path: Path) -> None:
    path = tasks(tmp_path / "a.csv", "duration_h", [5.0, 3.0, 12.0], 10.0, 60.0)
    with pytest.raises(LogError, match="the name of column 'duration_h' says h, but then"):
        task_list.ADAPTER.read(path, ReadOptions())


def coarse_log(file: Path, t_s: np.ndarray, step_s: float, name: str = "time", who: str = "") -> Path:
    stamps = np.floor(t_s / step_s) * step_s + 1_715_668_200
    place = zip(np.cos(t_s), np.sin(t_s), strict=True)
    rows = [f"{stamp:.1f},{x:.6f},{y:.6f}{who}" for stamp, (x, y) in zip(stamps, place, strict=True)]
    file.write_text("\n".join([f"{name},x,y{',id' if who else ''}", *rows, ""]), encoding="utf-8")
    return file


HOW = {"time": "time", "time_unit": "s", "clock": "epoch", "x": "x", "y": "y"}


@pytest.mark.parametrize(
    ("rate_hz", "begin_s", "step_s"),
    [(125, 0.37, 1.0), (10, 0.05, 1.0), (60, 0.99, 1.0), (100, 0.03, 0.1), (1.5, 0.3, 1.0), (4, 5.0, 60.0)],
)
def test_rows_that_share_whole_seconds_are_spread_to_where_they_were(
    tmp_path: Path, rate_hz: float, begin_s: float, step_s: float
) -> None:
    true_s = begin_s + np.arange(int(6.4 * step_s * rate_hz)) / rate_hz
    log = mapped_csv.ADAPTER.read(coarse_log(tmp_path / "a.csv", true_s, step_s), ReadOptions(role="robot", map=HOW))
    assert log.set_aside.is_empty()
    off_s = log.robot["t_s"].to_numpy() - 1_715_668_200 - true_s
    assert np.abs(off_s).max() <= 0.51 / rate_hz
    assert any(f"spread evenly, at {rate_hz} Hz" in said for said in log.warnings)


def test_a_gap_and_lost_rows_move_no_others(tmp_path: Path) -> None:
    true_s = 0.2 + np.arange(1000) / 50
    true_s = true_s[((true_s < 6.5) | (true_s > 12.3)) & (np.arange(1000) != 130)]
    log = mapped_csv.ADAPTER.read(coarse_log(tmp_path / "a.csv", true_s, 1.0), ReadOptions(role="robot", map=HOW))
    assert np.abs(log.robot["t_s"].to_numpy() - 1_715_668_200 - true_s).max() <= 1.5 / 50


def test_each_person_has_a_rate_and_parts_are_spread_as_the_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, true_s = tmp_path / "a.csv", 0.3 + np.arange(300) / 15
    one = coarse_log(path, true_s, 1.0, who=",a").read_text(encoding="utf-8").splitlines()
    two = coarse_log(path, true_s, 1.0, who=",b").read_text(encoding="utf-8").splitlines()
    both = [one[0], *(row for pair in zip(one[1:], two[1:], strict=True) for row in pair), ""]
    path.write_text("\n".join(both), encoding="utf-8")
    options = ReadOptions(role="people", map=HOW | {"person": "id"})
    people = mapped_csv.ADAPTER.read(path, options).people
    assert np.abs(people.filter(person="b")["t_s"].to_numpy() - 1_715_668_200 - true_s).max() <= 0.51 / 15
    monkeypatch.setattr("cyclekit_adapters.text.text_blocks.BLOCK_BYTES", 500)
    assert mapped_csv.ADAPTER.read(path, options).people.equals(people)


def test_rows_too_uneven_for_a_rate_are_asked_about(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    path = coarse_log(
        tmp_path / "a.csv", np.sort(np.concatenate([k + rng.uniform(0, 1, 1 + 9 * (k % 3)) for k in range(20)])), 1.0
    )
    with pytest.raises(LogError, match="too unevenly") as refusal:
        mapped_csv.ADAPTER.read(path, ReadOptions(role="robot", map=HOW))
    assert "rate_hz" in str(refusal.value.cure)
    log = mapped_csv.ADAPTER.read(path, ReadOptions(role="robot", map=HOW, rate_hz=20.0))
    assert log.set_aside.is_empty()


def test_samples_written_twice_are_still_set_aside(tmp_path: Path) -> None:
    lines = coarse_log(tmp_path / "a.csv", (np.arange(60) + 0.5) / 10, 0.1).read_text(encoding="utf-8").splitlines()
    twice = [lines[0], *(row for line in lines[1:] for row in (line, line)), ""]
    (tmp_path / "a.csv").write_text("\n".join(twice), encoding="utf-8")
    log = examined(mapped_csv.ADAPTER.read(tmp_path / "a.csv", ReadOptions(role="robot", map=HOW)))
    assert (log.robot.height, log.set_aside.height) == (60, 60)


@pytest.mark.parametrize("rate_hz", [1.3, 2.0, 10.0])
@pytest.mark.parametrize("kind", ["safety", "a row per signal", "a column per signal"])
def test_states_that_share_whole_seconds_are_spread_to_where_they_were(
    tmp_path: Path, kind: str, rate_hz: float
) -> None:
    true_s = 0.37 + np.arange(int(60 * rate_hz)) / rate_hz
    low = (true_s // 7) % 2 == 1
    rows = {
        "safety": (safety_log, "time,override", "{0},{2}"),
        "a row per signal": (events, "time,signal,value", "{0},door,{1}\n{0},lamp,0"),
        "a column per signal": (events, "time,door,lamp", "{0},{1},0"),
    }
    module, header, row = rows[kind]
    cells = [
        row.format(f"{clock('%Y-%m-%d %H:%M:%S', t, BEGIN)}Z", int(now), 50 + 50 * now)
        for t, now in zip(true_s - 0.25, low, strict=True)
    ]
    (tmp_path / "safety.csv").write_text("\n".join([header, *cells, ""]), encoding="utf-8")
    log = module.ADAPTER.read(tmp_path / "safety.csv", ReadOptions())
    assert log.set_aside is None or log.set_aside.is_empty()
    if log.safety is not None:
        t_s = log.safety["t_s"].to_numpy()
    else:
        t_s = log.events.filter(signal="door")["t_s"].to_numpy()
        true_s = true_s[np.diff(low, prepend=~low[0])] if "column" in kind else true_s
    assert np.abs(t_s - (BEGIN_S - 0.25) - true_s).max() <= 0.51 / rate_hz
    assert any("spread evenly" in said for said in log.warnings)


def test_two_robots_in_one_table_are_asked_about_not_mixed(tmp_path: Path) -> None:
    t_s = np.arange(200) / 10
    rows = [f"{1_715_668_200 + t:.1f},{x:.6f},{np.sin(t):.6f}" for t in t_s for x in (np.cos(t), 0.3 * np.cos(t) - 1.0)]
    (tmp_path / "a.csv").write_text("\n".join(["time,x,y", *rows, ""]), encoding="utf-8")
    with pytest.raises(LogError, match="several robots or people in one table"):
        mapped_csv.ADAPTER.read(tmp_path / "a.csv", ReadOptions(role="robot", map=HOW))
    later = [f"{1_715_668_200 + k * 0.05:.3f},{row.split(',', 1)[1]}" for k, row in enumerate(rows)]
    (tmp_path / "a.csv").write_text("\n".join(["time,tcp_x,tcp_y", *later, ""]), encoding="utf-8")
    assert any("several robots or people in one table" in line.why for line in drafted(tmp_path / "a.csv")[0].map)
