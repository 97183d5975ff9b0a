"""Logs on clocks that are taken as known, but whose times cannot be the robot's: named at ingest, with the line."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.dataset.cards import RecordingCard

pytestmark = pytest.mark.tests_clocks

BEGAN_S, LENGTH_S, YEARS_66_S = 1_715_668_200.0, 60, 2_082_844_800.0
CELL = """
[[sources]]
path = "robot*.csv"
adapter = "csv"
role = "robot"
map = { time = "t", clock = "epoch", x = "x", y = "y", z = "z", scaling = "s", scaling_max = 100 }

[[sources]]
path = "people.csv"
adapter = "csv"
role = "people"
map = { time = "t", time_unit = "s", clock = "epoch", x = "x", y = "y", person = "who" }
"""


def person(folder: Path, late_s: float, more: str = "", robots: int = 1) -> RecordingCard:
    """A minute of a robot (or of several, one after the other), and of a person on a clock that is late."""
    logs = folder / "logs"
    logs.mkdir()
    for number in range(robots):
        times = [BEGAN_S + 600 * number + row / 25 for row in range(25 * LENGTH_S)]
        rows = [f"{t:.2f},{0.4 + 0.001 * (row % 100):.4f},0,0.3,100" for row, t in enumerate(times)]
        (logs / f"robot{number}.csv").write_text("\n".join(["t,x,y,z,s", *rows]) + "\n", encoding="utf-8")
    rows = [f"{BEGAN_S + late_s + row / 10:.2f},1,{1.5 + 0.01 * (row % 100):.3f},0.5" for row in range(10 * LENGTH_S)]
    (logs / "people.csv").write_text("\n".join(["t,who,x,y", *rows]) + "\n", encoding="utf-8")
    (logs / "cell.toml").write_text(CELL + more, encoding="utf-8")
    ingest([logs], folder / "dataset")
    return next(one for one in Dataset.open(folder / "dataset").recordings if "people" in one.tables)


def told(log: RecordingCard) -> list[str]:
    return [text for text in log.said if "overlaps" in text or "later than its file" in text]


@pytest.mark.parametrize(
    ("late_s", "words", "line"),
    [
        (7200.0, "2 h 0 min later; another time zone?", "clock_offset_s = -7200 "),
        (-16200.0 + 8.0, "4 h 30 min earlier; another time zone?", "clock_offset_s = 16200 "),
        (YEARS_66_S, "66 years 0 d later; counts since 1904 (LabVIEW)?", "clock_offset_s = -2082844800 "),
        (YEARS_66_S + 3600.0, "counts since 1904 (LabVIEW) and another time zone?", "clock_offset_s = -2082848400 "),
        (500.0, "100 % of the shorter log lies outside the other, and it is 8 min 20 s later", 'align_clocks = "logs"'),
        (55.0, "92 % of the shorter log lies outside the other, and it is 55 s later", 'align_clocks = "logs"'),
    ],
)
def test_a_log_that_hardly_overlaps_the_robot_s_is_named_with_the_line(
    tmp_path: Path, late_s: float, words: str, line: str
) -> None:
    text = told(person(tmp_path, late_s))[0]
    assert "hardly overlaps robot0.csv" in text
    assert words in text
    assert line in text


@pytest.mark.parametrize("late_s", [0.0, 20.0, -25.0])
def test_a_log_that_overlaps_by_half_is_not_named(tmp_path: Path, late_s: float) -> None:
    assert not told(person(tmp_path, late_s))


def test_the_proposed_line_mends_it(tmp_path: Path) -> None:
    assert not told(person(tmp_path, 7200.0, "clock_offset_s = -7200\n"))
    again = tmp_path / "again"
    again.mkdir()
    (text,) = told(person(again, 7200.0, "clock_offset_s = -3600\n"))
    assert "clock_offset_s = -7200 " in text


def test_a_log_in_another_time_zone_than_several_robot_logs_is_named_though_it_belongs_to_none(tmp_path: Path) -> None:
    (text,) = told(person(tmp_path, 3600.0 + 600.0, robots=3))
    assert "hardly overlaps robot1.csv" in text
    assert "clock_offset_s = -3600 " in text


def test_dates_after_the_file_was_written_are_named(tmp_path: Path) -> None:
    late = told(person(tmp_path, YEARS_66_S))
    assert any("its last time is 6" in text and "years" in text for text in late)
    robot = next(one for one in Dataset.open(tmp_path / "dataset").recordings if "robot" in one.tables)
    assert not told(robot)
    os.utime(tmp_path / "logs" / "robot0.csv", (BEGAN_S - 1e6, BEGAN_S - 1e6))
    ingest([tmp_path / "logs"], tmp_path / "dataset")
    robot = next(one for one in Dataset.open(tmp_path / "dataset").recordings if "robot" in one.tables)
    assert "its last time is 11 d 13 h later than its file was written" in told(robot)[0]


@pytest.mark.parametrize(
    ("written_in", "stated", "found"),
    [
        (1e-3, 'time_unit = "s", ', "ms"),
        (60.0, 'time_unit = "s", ', "min"),
        (60.0, "", "min"),
        (1.0, 'time_unit = "ms", ', "s"),
        (1e-6, 'time_unit = "ms", ', "us"),
        (1.0, 'time_unit = "min", ', "s"),
        (0.1, "", "1/10 s"),
        (1.0, 'time_unit = "s", ', None),
        (1.0, "", None),
    ],
)
@pytest.mark.parametrize("of_people", [True, False])
def test_a_stated_unit_in_which_a_log_does_not_last_as_long_as_the_robot_s_is_doubted_and_the_other_named(
    tmp_path: Path, written_in: float, stated: str, found: str | None, *, of_people: bool
) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    rows = [f"{row / 10:.1f},{0.4 + 0.001 * (row % 100):.4f},0,0.3,100" for row in range(10 * LENGTH_S)]
    (logs / "robot.csv").write_text("\n".join(["t,x,y,z,s", *rows]) + "\n", encoding="utf-8")
    times = [row / 2 / written_in for row in range(1, 2 * LENGTH_S - 1)]
    cells = [f"{t:.9g},1,1.000{n % 9},0.5" if of_people else f"{t:.9g},door,{n // 9 % 2}" for n, t in enumerate(times)]
    columns, mapped = ("t,who,x,y", 'x = "x", y = "y", person = "who"') if of_people else (
        "t,signal,value", 'signal = "signal", value = "value"'
    )  # fmt: skip
    (logs / "other.csv").write_text("\n".join([columns, *cells]) + "\n", encoding="utf-8")
    role = "people" if of_people else "events"
    cell = CELL[: CELL.index("[[sources]]", 5)].replace('clock = "epoch", ', "")
    cell += (
        f'[[sources]]\npath = "other.csv"\nadapter = "csv"\nrole = "{role}"\nmap = {{ time = "t", {stated}{mapped} }}\n'
    )
    (logs / "cell.toml").write_text(cell, encoding="utf-8")
    ingest([logs], tmp_path / "dataset")
    (log,) = [one for one in Dataset.open(tmp_path / "dataset").recordings if "robot" not in one.tables]
    said = [text for text in log.said if "as read, its times last" in text]
    assert len(said) == (found is not None)
    assert all(f'is time_unit = "{found}"?' in text for text in said)


def test_a_clock_that_is_wrong_in_a_cell_that_repeats_itself_is_named_without_a_certain_lag(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    times = [row / 5 for row in range(5 * 300)]
    rows = [f"{t + BEGAN_S:.2f},{0.4 + 0.01 * (t % 10):.3f},0,0.3,{50 if t % 60 < 20 else 100}" for t in times]
    (logs / "robot.csv").write_text("\n".join(["t,x,y,z,s", *rows]) + "\n", encoding="utf-8")
    rows = [f"{t + BEGAN_S + 37:.2f},1,{1.5 if t % 60 < 20 else 3.5},0.{int(t) % 3}" for t in times]
    (logs / "people.csv").write_text("\n".join(["t,who,x,y", *rows]) + "\n", encoding="utf-8")
    (logs / "cell.toml").write_text(CELL, encoding="utf-8")
    ingest([logs], tmp_path / "dataset")
    (log,) = [one for one in Dataset.open(tmp_path / "dataset").recordings if "people" in one.tables]
    (text,) = [text for text in log.said if "its clock is wrong" in text]
    assert "which is right is not certain; give clock_offset_s" in text
    assert log.clock.method == "epoch"  # it is not moved
