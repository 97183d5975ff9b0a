"""The eight traps of CSV logs: each makes a common reader stop, or give wrong values without a word."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import polars as pl
import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.errors import LogError
from cyclekit.ingest.convert import convert
from cyclekit_adapters.formats import mapped_csv, ur_rtde

if TYPE_CHECKING:
    from pathlib import Path

XYZ = [f"actual_TCP_pose_{i}" for i in range(3)]
NAMES = ["timestamp", *XYZ, "speed_scaling", "target_speed_fraction", "runtime_state"]


def ur_lines(count: int, start_s: float = 1.0, mark: str = " ", **columns: Any) -> list[str]:
    """Return the rows of an RTDE recording at 500 Hz whose TCP moves along x; a column may be given by its rows."""
    rows = []
    for row in range(count):
        told = {"timestamp": round(start_s + 0.002 * row, 3), XYZ[0]: 0.001 * row, XYZ[1]: 0.25, XYZ[2]: 0.5}
        told |= {"speed_scaling": 1.0, "target_speed_fraction": 1.0, "runtime_state": 2}
        told |= {name: values[row] for name, values in columns.items()}
        rows.append(mark.join(str(told[name]) for name in NAMES))
    return rows


def ur_file(path: Path, rows: list[str], mark: str = " ", end: str = "\n") -> Path:
    path.write_bytes("\n".join([mark.join(NAMES), *rows]).encode() + end.encode())
    return path


def robot(path: Path) -> tuple[pl.DataFrame, list[int]]:
    log = ur_rtde.ADAPTER.read(path, ReadOptions())
    assert log.robot is not None
    return log.robot, [] if log.set_aside is None else log.set_aside["source_row"].to_list()


def test_trap_1_a_column_that_stands_at_0_for_long_and_then_says_a_half(tmp_path: Path):
    scaling = ["0"] * 3000 + ["0.5"] * 10
    table, aside = robot(ur_file(tmp_path / "a.csv", ur_lines(3010, speed_scaling=scaling)))
    assert aside == []
    assert table["scaling"].to_list() == [float(value) for value in scaling]


def test_trap_2_a_doubled_blank_shifts_no_column(tmp_path: Path):
    rows = ur_lines(20)
    rows[7] = rows[7].replace(" ", "  ", 1)
    cells = rows[11].split(" ")
    rows[11] = " ".join([*cells[:2], "", *cells[3:]])  # as many fields as the header has
    table, aside = robot(ur_file(tmp_path / "a.csv", rows))
    assert aside == [9, 13]
    assert table["tcp_x_m"].to_list() == pytest.approx([0.001 * row for row in range(20) if row not in (7, 11)])
    assert table["tcp_y_m"].unique().to_list() == [0.25]


@pytest.mark.parametrize("mark", [" ", ",", ";", "\t"])
def test_trap_3_a_last_line_cut_inside_a_number_is_not_believed(tmp_path: Path, mark: str):
    names = NAMES[::-1]  # the time stands last: what is left of it is a time as well
    rows = [mark.join(row.split(mark)[::-1]) for row in ur_lines(20, 14.37, mark)]
    (tmp_path / "a.csv").write_text("\n".join([mark.join(names), *rows])[:-2], encoding="utf-8")
    table, aside = robot(tmp_path / "a.csv")
    assert (table.height, aside) == (19, [21])


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-8-sig"])
def test_trap_4_another_encoding_is_read_or_refused(tmp_path: Path, encoding: str):
    path = ur_file(tmp_path / "a.csv", ur_lines(20))
    path.write_bytes(path.read_text(encoding="utf-8").encode(encoding))
    table, aside = robot(path)
    assert (table["tcp_x_m"].to_list(), aside) == (pytest.approx([0.001 * row for row in range(20)]), [])


def test_trap_4_a_block_of_nul_bytes_costs_its_rows_and_no_others(tmp_path: Path):
    rows = ur_lines(20)
    rows[6] = rows[6][:9] + "\0" * 4096 + rows[6][12:]
    table, aside = robot(ur_file(tmp_path / "a.csv", rows))
    assert (table.height, aside) == (19, [8])
    (tmp_path / "b.csv").write_bytes(bytes(8192))
    with pytest.raises(LogError):
        ur_rtde.ADAPTER.read(tmp_path / "b.csv", ReadOptions())


def test_trap_5_blanks_separate_and_one_more_at_the_end_of_each_line_does_not_matter(tmp_path: Path):
    table, aside = robot(ur_file(tmp_path / "a.csv", [row + " " for row in ur_lines(20)], end=" \n"))
    assert (table.height, aside) == (20, [])
    assert table["tcp_x_m"].to_list() == pytest.approx([0.001 * row for row in range(20)])


def test_trap_6_runs_of_a_restarted_clock_are_not_merged(tmp_path: Path):
    rows = [line for _ in range(4) for line in ur_lines(500)]
    done = convert(ur_file(tmp_path / "a.csv", rows), tmp_path / "a.parquet", rate_hz=10)
    table = pl.read_parquet(tmp_path / "a.parquet")
    assert done.rows == table.height == 4 * 10
    assert table["tcp_x_m"].to_list() == pytest.approx(4 * table["tcp_x_m"][:10].to_list())


def test_trap_7_a_decimal_comma_makes_numbers_and_no_texts(tmp_path: Path):
    (tmp_path / "a.csv").write_text("t;x;y\n0,5;1,25;-3,0\n0,6;1,5;1.234\n", encoding="utf-8")
    words = {"time": "t", "x": "x", "y": "y", "decimal": ","}
    log = mapped_csv.ADAPTER.read(tmp_path / "a.csv", ReadOptions(role="people", map=words))
    assert log.people is not None
    assert log.people.select("t_s", "x_m", "y_m").rows() == [(0.5, 1.25, -3.0)]
    assert log.set_aside is not None
    assert log.set_aside["source_row"].to_list() == [3]  # with a decimal comma 1.234 may mean 1234
    comma = [row.replace(".", ",") for row in ur_lines(20, mark=";")]
    table, aside = robot(ur_file(tmp_path / "b.csv", comma, mark=";"))
    assert (table["tcp_x_m"].to_list(), aside) == (pytest.approx([0.001 * row for row in range(20)]), [])


def test_trap_8_fewer_rows_are_averages_and_not_every_fiftieth(tmp_path: Path):
    scaling = [1.0] * 30 + [0.2] * 20 + [0.6] * 50
    convert(ur_file(tmp_path / "a.csv", ur_lines(100, speed_scaling=scaling)), tmp_path / "a.parquet", rate_hz=10)
    assert pl.read_parquet(tmp_path / "a.parquet")["scaling"].to_list() == pytest.approx([0.68, 0.6])
