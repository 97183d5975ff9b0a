"""Local times of the hour that is repeated when summer time ends: the order of the rows tells the two hours apart."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import TYPE_CHECKING
from zoneinfo import ZoneInfo

import polars as pl
import pytest

from cyclekit.adapter import ReadOptions
from cyclekit_adapters.formats.events import ADAPTER as EVENTS
from cyclekit_adapters.formats.mapped_csv import ADAPTER as MAPPED
from cyclekit_adapters.times.local_clock import LocalClock

if TYPE_CHECKING:
    from pathlib import Path

ROME = ZoneInfo("Europe/Rome")
FIRST = datetime(2026, 10, 25, 2, 0, tzinfo=ROME).timestamp()  # 02:00 in summer time, an hour before it is 02:00 again
TRUE_S = [FIRST + 60.0 * minute for minute in (-30, 10, 50, 65, 70, 119, 130)]


def on_the_clock(t_s: float) -> datetime:
    return datetime.fromtimestamp(t_s, ROME).replace(tzinfo=None)


def read_first(t_s: float) -> float:
    """Return the time that the clock shows, as the first of the two hours."""
    return on_the_clock(t_s).replace(tzinfo=ROME, fold=0).timestamp()


@pytest.mark.parametrize("cut", range(len(TRUE_S) + 1))
def test_times_after_a_step_back_are_of_the_second_hour_wherever_the_blocks_were_cut(cut: int):
    hour, first = LocalClock("Europe/Rome"), [read_first(t_s) for t_s in TRUE_S]
    blocks = [hour.in_order(pl.Series("t_s", some, pl.Float64)) for some in (first[:cut], first[cut:])]
    assert pl.concat(blocks).to_list() == TRUE_S
    assert hour.moved == 3
    assert "3 times are of the hour repeated" in hour.warnings()[0]


def test_an_export_whose_newest_row_comes_first_is_read_from_its_end():
    hour, first = LocalClock("Europe/Rome"), [read_first(t_s) for t_s in TRUE_S]
    assert hour.in_order(pl.Series("t_s", first[::-1], pl.Float64)).to_list() == TRUE_S[::-1]
    assert hour.moved == 3


def test_rows_a_little_out_of_order_other_hours_and_logs_without_a_zone_are_left():
    for zone, times in (
        ("Europe/Rome", [FIRST + 100.0, FIRST + 70.0, FIRST + 101.0]),
        ("Europe/Rome", [FIRST - 86_400.0, FIRST - 90_000.0]),
        (None, [FIRST + 1000.0, FIRST]),
    ):
        hour = LocalClock(zone)
        assert hour.in_order(pl.Series("t_s", times)).to_list() == times
        assert hour.warnings() == []


def test_without_a_zone_a_step_back_by_an_hour_asks_for_it():
    clock = LocalClock(None, "iso")
    for t_s in TRUE_S:
        clock.in_order(pl.Series("t_s", [read_first(t_s)]))
    assert clock.warnings() == []
    clock = LocalClock(None, "iso")
    clock.in_order(pl.Series("t_s", [FIRST + 3590.0, FIRST]))
    assert "time_zone" in clock.warnings()[0]


def test_an_unknown_time_is_no_step_back():
    hour = LocalClock("Europe/Rome")
    assert hour.in_order(pl.Series("t_s", [FIRST, None, FIRST + 1.0])).to_list() == [FIRST, None, FIRST + 1.0]


@pytest.mark.parametrize(
    ("written", "header", "line"),
    [
        ("%d.%m.%Y %H:%M:%S", "Tag;Time;Value", "door;{};{}"),
        ("%Y-%m-%d %H:%M:%S", "signal,time,value", "door,{},{}"),
    ],
)
def test_events_of_a_shift_across_the_change_are_in_order(tmp_path: Path, written: str, header: str, line: str):
    rows = [line.format(on_the_clock(t_s).strftime(written), n % 2) for n, t_s in enumerate(TRUE_S)]
    path = tmp_path / "plc.csv"
    path.write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    log = EVENTS.read(path, ReadOptions(map={"time_zone": "Europe/Rome"}))
    assert log.events["t_s"].to_list() == TRUE_S
    assert [said for said in log.warnings if "second one" in said]
    assert not [said for said in log.warnings if "steps back" in said]


def test_a_mapped_log_across_the_change_is_one_run(tmp_path: Path):
    every = [FIRST + 3500.0 + 10.0 * n for n in range(30)]
    rows = [f"{on_the_clock(t_s).isoformat()},0.1,0.2,0.3" for t_s in every]
    path = tmp_path / "robot.csv"
    path.write_text("\n".join(["when,x,y,z", *rows, ""]), encoding="utf-8")
    mapping = {"time": "when", "time_format": "iso", "time_zone": "Europe/Rome", "x": "x", "y": "y", "z": "z"}
    log = MAPPED.read(path, ReadOptions(role="robot", map=mapping))
    assert log.robot["t_s"].to_list() == every


def test_summer_time_that_begins_leaves_no_doubt():
    begins = datetime(2026, 3, 29, 1, 59, tzinfo=ROME)
    times = [(begins + timedelta(minutes=n)).timestamp() for n in range(5)]
    assert LocalClock("Europe/Rome").in_order(pl.Series("t_s", times)).to_list() == times
