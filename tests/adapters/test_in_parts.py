"""Blocks of rows become parts of a log; one of which hardly any row can be used is refused before its end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import polars as pl
import pytest

from cyclekit.adapter import ReadOptions, Recording
from cyclekit.errors import DamagedLog
from cyclekit_adapters.formats.ur_rtde import ADAPTER
from cyclekit_adapters.text import in_parts, text_blocks
from cyclekit_adapters.text.text_rows import INDEX, SET_ASIDE, TextRows

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(in_parts, "MIN_ROWS", 1000)
    monkeypatch.setattr(text_blocks, "BLOCK_BYTES", 4096)


def log(path: Path, ur: Any, sound: int, broken: int) -> Path:
    rows = ur.text([ur.row(10.0 + 0.008 * row) for row in range(sound)])
    path.write_text(rows + "7\r\n" * broken, encoding="utf-8", newline="")
    return path


@pytest.mark.usefixtures("small_blocks")
def test_a_log_without_end_of_which_hardly_a_row_can_be_used_is_refused_early(tmp_path: Path, ur: Any):
    with pytest.raises(DamagedLog, match=r"the first bad row \(line 6\): the line below") as refused:
        ADAPTER.read(log(tmp_path / "run.csv", ur, 5, 50_000), ReadOptions())
    assert int(str(refused.value).partition("of its first ")[2].split()[0]) < 10_000


@pytest.mark.usefixtures("small_blocks")
def test_a_log_with_some_sound_rows_is_read_to_its_end(tmp_path: Path, ur: Any):
    read = ADAPTER.read(log(tmp_path / "run.csv", ur, 200, 5000), ReadOptions())
    assert read.robot is not None
    assert read.set_aside is not None
    assert (read.robot.height, read.set_aside.height, read.rows_read) == (199, 5001, 5200)


@pytest.mark.usefixtures("small_blocks")
def test_small_tables_are_put_together_until_they_are_a_quarter_of_a_block_of_text(tmp_path: Path):
    columns = {"source_row": pl.Int64(), INDEX: pl.Int64(), "t_s": pl.Float64()}  # 24 bytes a row
    aside = pl.DataFrame([(7, "torn")], schema=SET_ASIDE, orient="row")
    tables = [pl.DataFrame([[10 * n + i] * 3 for i in range(10)], schema=columns, orient="row") for n in range(12)]
    blocks = [TextRows(table, 11, aside, 2) for table in tables]

    def make(rows: TextRows) -> Recording:
        return Recording(robot=rows.frame, rows_read=rows.rows_read, set_aside=rows.set_aside)

    parts = list(in_parts.in_parts(tmp_path / "log.csv", blocks, make, lambda last: last))
    assert [part.rows_read for part in parts] == [55, 55, 22]  # four blocks are 960 bytes, and a little
    assert [part.set_aside.height for part in parts if part.set_aside is not None] == [5, 5, 2]
    assert pl.concat([part.robot for part in parts if part.robot is not None]).equals(pl.concat(tables))
    assert parts[-1].warnings == ("24 values are written as NaN or infinity: unknown there",)
