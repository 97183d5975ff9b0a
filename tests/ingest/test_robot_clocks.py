"""Clocks of robots beside each other: only signals relate them, and a process may take as long as a clock is off."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest
from handing_over import EPOCH_S, HandingOver

from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import CyclekitError
from cyclekit.ingest.ingest import ingest

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.dataset.cards import RecordingCard

pytestmark = pytest.mark.tests_clocks

YEARS_66_S = 2_082_844_800.0
SECTIONS = 'name = "two"\n' + "".join(f'[[sources]]\npath = "robot_{one}.csv"\nadapter = "ur-rtde"\n' for one in "ab")
TRACE = """[[sources]]
path = "plc.csv"
adapter = "csv"
role = "events"
map = { time = "t", time_unit = "s", clock = "epoch", signal = "signal", value = "value" }
"""
RIGHT = [
    *((belt_s, wired) for belt_s in (0.0, 3.0, 7.0, 12.0, 20.0) for wired in ("both", "first", "neither")),
    *((belt_s, "both") for belt_s in (5.0, 9.0, 15.0, 30.0, 40.0)),
]
"""How much later a part comes, s, and whose outputs are inputs of the other."""


def second_robot(folder: Path, cell: str = "") -> RecordingCard:
    """Ingest two robots' logs, and return the second one's."""
    if cell:
        (folder / "logs" / "cell.toml").write_text(cell, encoding="utf-8")
    ingest([folder / "logs"], folder / "dataset")
    return next(one for one in Dataset.open(folder / "dataset").recordings if one.id == "robot_b")


def codes(log: RecordingCard) -> list[str]:
    return [one.code for one in log.clock.warnings]


@pytest.mark.parametrize("late_s", [37.0, 7200.0, YEARS_66_S])
def test_a_robot_on_another_clock_is_named_with_the_line_that_mends_it(tmp_path: Path, late_s: float) -> None:
    HandingOver().write(tmp_path / "logs", late_s=late_s)
    named = second_robot(tmp_path, SECTIONS)
    assert codes(named) == ["robot-clock-wrong"]
    (text,) = named.said
    assert "its clock is not that of robot_a.csv" in text
    role, offset = re.findall(r'(role = "robot") and (clock_offset_s = [-.\d]+) in cell.toml', text)[0]
    mended = second_robot(tmp_path, f"{SECTIONS}{role}\n{offset}\n")
    both = Dataset.open(tmp_path / "dataset").recordings
    assert not [text for one in both for text in one.said]
    (test,) = [one.clock.test for one in both if one.clock.test is not None]
    assert (test.certain, test.lag_s) == (True, pytest.approx(0.0, abs=0.1))
    assert mended.first_s == pytest.approx(EPOCH_S, abs=0.1)


def test_without_a_wire_only_the_time_zone_names_it_with_a_line_that_mends_it(tmp_path: Path) -> None:
    HandingOver(wired="neither").write(tmp_path / "logs", late_s=7200.0)
    named = second_robot(tmp_path, SECTIONS)
    assert codes(named) == ["clock-apart"]
    assert 'another time zone? Then give role = "robot" and clock_offset_s = -7200 in cell.toml' in named.said[0]
    mended = second_robot(tmp_path, f'{SECTIONS}role = "robot"\nclock_offset_s = -7200\n')
    assert not mended.said
    assert mended.first_s == EPOCH_S


@pytest.mark.parametrize("cases", [RIGHT[::7], pytest.param(RIGHT, marks=pytest.mark.slow)], ids=["some", "all"])
def test_right_clocks_are_never_called_wrong_however_long_a_part_takes(
    tmp_path: Path, cases: list[tuple[float, str]]
) -> None:
    for seed, (belt_s, wired) in enumerate(cases):
        pair = HandingOver(seed=seed, belt_s=belt_s, wired=wired)
        pair.write(tmp_path / "logs" / f"{seed:02}", days=seed)
    ingest([tmp_path / "logs"], tmp_path / "dataset")
    logs = [one for one in Dataset.open(tmp_path / "dataset").recordings if one.id.endswith("robot_b")]
    assert len(logs) == len(cases)
    assert {code for one in logs for code in codes(one)} <= {"robot-clock-or-process"}
    assert logs[0].clock.test is not None
    assert logs[0].clock.test.certain  # wired both ways and no belt: shown to be right


def test_a_wire_one_way_may_be_a_process_and_both_are_said(tmp_path: Path) -> None:
    HandingOver(wired="first").write(tmp_path / "logs", late_s=37.0)
    named = second_robot(tmp_path)
    assert codes(named) == ["robot-clock-or-process"]
    assert "at -37." in named.said[0]
    assert "the time that the process takes" in named.said[0]


def test_a_trace_of_both_that_fits_them_at_different_lags_shows_whose_clock_is_wrong(tmp_path: Path) -> None:
    HandingOver(wired="neither", plc=True).write(tmp_path / "logs", late_s=37.0)
    assert "the signals of plc.csv agree" in second_robot(tmp_path, SECTIONS + TRACE).said[0]
    wrong = {one.id: codes(one) for one in Dataset.open(tmp_path / "dataset").recordings if one.said}
    assert wrong == {"robot_b": ["robot-clock-wrong"]}  # neither the trace, nor the robot that it fits


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("clock_offset_s = -37\n", "clock_offset_s is given to the robot's log"),
        (
            'role = "robot"\nclock_offset_s = -1.7e9\n',
            "whose times would begin 15670000 s after 1970",
        ),
    ],
)
def test_an_offset_of_a_robots_log_is_used_or_refused_never_ignored(tmp_path: Path, keys: str, words: str) -> None:
    HandingOver(parts=2).write(tmp_path / "logs")
    with pytest.raises(CyclekitError, match=re.escape(words)):
        second_robot(tmp_path, SECTIONS + keys)
