"""A tracker that writes nothing: nobody there, or not running."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.people.silence import Silence, absences

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import Cells

DOOR, BENCH = (3.0, 1.0, 0.2), (0.5, 1.5, 0.2)


def visits(*spans_s: tuple[float, float], ends: tuple[float, ...] = DOOR, empty: bool = False, told=None) -> Silence:
    """A log of somebody who comes by the door in each of these spans; in the last one the log ends where `ends` is."""
    t_s, xyz = [], []
    for first, last in spans_s:
        some = np.arange(first, last + 0.05, 0.1)
        here = np.tile(BENCH, (len(some), 1))
        here[0] = here[-1] = DOOR
        t_s.append(some)
        xyz.append(here)
    xyz[-1][-1] = ends
    if empty:
        t_s.append(np.array([spans_s[-1][1] + 1.0]))
        xyz.append(np.full((1, 3), np.nan))
    return Silence.of(np.concatenate(t_s), np.concatenate(xyz), told)


MANY = visits((0.0, 10.0), (20.0, 30.0), (40.0, 50.0), (60.0, 70.0))


def test_a_tracker_that_is_silent_between_visits_is_silent_since_nobody_is_there_after_them():
    one = visits((5.0, 12.0))
    found = absences([[MANY], [one]])
    assert (found[1].until_s, found[1].from_s) == pytest.approx((5.0, 12.0))


def test_a_log_that_ends_in_the_middle_of_the_cell_ended_for_another_reason():
    found = absences([[MANY], [visits((5.0, 12.0), ends=BENCH)]])
    assert found[1].until_s == pytest.approx(5.0)
    assert found[1].from_s == np.inf


def test_where_no_log_was_ever_silent_in_its_middle_silence_says_nothing():
    found = absences([[visits((0.0, 10.0))], [visits((5.0, 12.0))]])
    assert all((absence.until_s, absence.from_s) == (-np.inf, np.inf) for absence in found)


def test_a_tracker_that_also_writes_empty_rows_is_not_believed_when_silent():
    found = absences([[MANY], [visits((5.0, 12.0), empty=True)]])
    assert all((absence.until_s, absence.from_s) == (-np.inf, np.inf) for absence in found)


@pytest.mark.parametrize(("told", "ends"), [("absent", 12.0), ("unknown", np.inf)])
def test_the_cell_file_is_believed(told, ends: float):
    found = absences([[visits((5.0, 12.0), ends=BENCH, told=told)]])
    assert found[0].from_s == pytest.approx(ends)


def test_a_session_without_any_row_is_one_without_anybody():
    nothing = Silence.of(np.empty(0), np.empty((0, 3)), None)
    assert absences([[MANY], [nothing]])[1].until_s == np.inf
    assert absences([[nothing], []])[0].until_s == -np.inf


def test_nobody_is_away_while_another_log_sees_him():
    here, there = visits((5.0, 12.0)), visits((3.0, 20.0))
    found = absences([[MANY], [here, there]])[1]
    assert (found.until_s, found.from_s) == pytest.approx((3.0, 20.0))


def test_a_log_without_a_row_says_nobody_came_where_others_of_its_kind_fall_silent_or_the_cell_file_says_so() -> None:
    empty = Silence.of(np.empty(0), np.empty((0, 3)), None)
    assert [one.until_s for one in absences([[MANY], [empty]])][1] == np.inf
    assert absences([[visits((0.0, 10.0))], [empty]])[1].until_s == -np.inf
    assert absences([[visits((0.0, 10.0), told="absent")], [empty]])[1].until_s == np.inf


def test_an_execution_whose_tracker_log_has_a_header_alone_counts_as_one_without_people(
    cells: Cells, tmp_path: Path
) -> None:
    cell = cells("scanner-visits", 3, executions_per_session=1, silent_when_empty=True)
    shutil.copytree(cell.logs, tmp_path / "logs")
    for number in (1, 2):
        log = tmp_path / "logs" / f"session_00{number}" / "operator.csv"
        log.write_text("".join(log.read_text().splitlines(keepends=True)[:7]))
    text = (tmp_path / "logs" / "cell.toml").read_text()
    told = text.replace('role = "people"', 'role = "people"\nsilence = "absent"')
    (tmp_path / "logs" / "cell.toml").write_text(told)
    report = ingest(tmp_path / "logs", tmp_path / "dataset")
    gaps = Dataset.open(tmp_path / "dataset").samples(columns=["execution", "human_gap"])
    seen = gaps.group_by("execution", maintain_order=True).agg(pl.col("human_gap").unique())["human_gap"].to_list()
    assert seen[1:] == [["absent"], ["absent"]]
    assert any("2 sessions count as without an operator" in text for _, text in report.said)
