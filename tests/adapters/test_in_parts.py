"""A log of which hardly any row can be used is refused before all of it was gone through."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog
from cyclekit_adapters import in_parts, text_blocks
from cyclekit_adapters.ur_rtde import ADAPTER

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(in_parts, "MANY", 1000)
    monkeypatch.setattr(text_blocks, "BLOCK_BYTES", 4096)


def log(path: Path, ur: Any, sound: int, broken: int) -> Path:
    rows = ur.text([ur.row(10.0 + 0.008 * row) for row in range(sound)])
    path.write_text(rows + "7\r\n" * broken, encoding="utf-8", newline="")
    return path


@pytest.mark.usefixtures("small_blocks")
def test_a_log_without_end_of_which_hardly_a_row_can_be_used_is_refused_early(tmp_path: Path, ur: Any):
    with pytest.raises(
        DamagedLog, match=r"only 4 can be used; the first that cannot \(line 6\): the line below"
    ) as refused:
        ADAPTER.read(log(tmp_path / "run.csv", ur, 5, 50_000), ReadOptions())
    assert int(str(refused.value).partition("of its first ")[2].split()[0]) < 10_000


@pytest.mark.usefixtures("small_blocks")
def test_a_log_with_some_sound_rows_is_read_to_its_end(tmp_path: Path, ur: Any):
    read = ADAPTER.read(log(tmp_path / "run.csv", ur, 200, 5000), ReadOptions())
    assert read.robot is not None
    assert read.set_aside is not None
    assert (read.robot.height, read.set_aside.height, read.rows_read) == (199, 5001, 5200)
