"""A spoiled log gives its true rows, names the others with their line, or is refused: no wrong value without a word.

`benchmarks/pollution.py` reads all the spoiled files and counts; here are those that are small, every fourth of
them; in `make test`, every sixteenth.
"""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

import pytest
from reliability.clean_logs import KINDS
from reliability.judge import FOREIGN, NAMED, REFUSED, WRONG, judge
from reliability.pollute import Polluted, every_polluted_file

if TYPE_CHECKING:
    from pathlib import Path

    from reliability.clean_logs import Kind

# Column of the table, its name in the log, and what the log's unit is in the table's.
TRUTH = {
    "ur-space": (("t_s", "timestamp", 1.0), ("tcp_y_m", "actual_TCP_pose_1", 1.0), ("q5_rad", "actual_q_5", 1.0)),
    "ur-comma": (("t_s", "timestamp", 1.0), ("tcp_y_m", "actual_TCP_pose_1", 1.0), ("scaling", "speed_scaling", 1.0)),
    "robot-csv": (("t_s", "t [ms]", 1e-3), ("tcp_y_m", "Y [mm]", 1e-3), ("scaling", "OVR [%]", 1e-2)),
    "people-csv": (("t_s", "t", 1.0), ("y_m", "y", 1.0), ("person", "id", None)),
    "people-dated": (("x_m", "east", 1.0), ("y_m", "north", 1.0)),
    "events-csv": (("t_s", "time", 1.0), ("signal", "signal", None), ("value", "value", None)),
    "kuka": (("t_s", "IPOC", 1e-3), ("tcp_y_m", "Y_RIst", 1e-3)),
    "motive": (("t_s", "Time (Seconds)", 1.0), ("y_m", 7, 1.0)),
}


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_clean_log_comes_out_as_its_cells_say(kind: Kind, tmp_path: Path):
    (tmp_path / "log.csv").write_text(kind.text(), encoding="utf-8", newline="")
    log = kind.adapter.read(tmp_path / "log.csv", kind.options())
    (table,) = log.tables().values()
    assert table.height == len(kind.rows)
    for column, name, unit in TRUTH[kind.name]:
        at = name if isinstance(name, int) else kind.names.index(name)
        cells = [row[at] for row in kind.rows]
        told = cells if unit is None else [float(cell.replace(",", ".")) * unit for cell in cells]
        assert table[column].to_list() == (told if unit is None else pytest.approx(told, abs=1e-12))
    if kind.name == "people-dated":
        assert table["t_s"][0] == 1741244400.0  # 6 March 2025, 8 o'clock in Rome
        assert table["t_s"].diff().drop_nulls().to_list() == pytest.approx([0.05] * 39, abs=1e-6)


@pytest.mark.parametrize("each", [16, pytest.param(4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_spoiled_log_is_never_wrong_without_a_word(kind: Kind, each: int, tmp_path: Path):
    read = refused = 0
    for spoiled in every_polluted_file([kind]):
        if zlib.crc32(spoiled.id.encode()) % each:
            continue
        verdict = judge(spoiled, tmp_path)
        assert verdict.outcome not in (WRONG, FOREIGN), f"{spoiled.id}: {verdict.why}"
        assert verdict.outcome != NAMED or spoiled.named
        read += verdict.outcome != REFUSED
        refused += verdict.outcome == REFUSED
    assert read > refused > 0


def judged(kind: Kind, cells: list[list[str]], tmp_path: Path) -> str:
    """What is said of a log of these cells that should hold those of its kind."""
    return judge(Polluted(kind, "none", "none", kind.text(cells).encode(), kind.rows), tmp_path).outcome


def test_a_wrong_value_would_be_noticed(tmp_path: Path):
    kind = KINDS[0]
    for row, column, value in ((3, 8, "-0.487"), (39, 0, "152.826"), (7, 16, "")):
        cells = [list(row) for row in kind.rows]
        cells[row][column] = value
        assert (judged(kind, cells, tmp_path) == WRONG) == bool(value)
    assert judged(kind, kind.rows[:5], tmp_path) != WRONG  # the others are not in the file
    assert judged(kind, [*kind.rows[:5], kind.rows[4], *kind.rows[5:]], tmp_path) != WRONG  # set aside: a repeat
