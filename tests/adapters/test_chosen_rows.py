"""Rows of two robots in one table: the column that tells them is found, one is read, and mixed they are refused."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.config import Cell, Source
from cyclekit.errors import ConfigError, LogError
from cyclekit.ingest.ingest import ingest
from cyclekit.ingest.validate.validate import examined
from cyclekit_adapters.formats.mapped_csv import ADAPTER

if TYPE_CHECKING:
    from pathlib import Path

COLUMNS = {"time": "timestamp", "time_unit": "s", "clock": "epoch", "x": "x", "y": "y", "z": "z"}


def table(file: Path, later_s: float, names: tuple[str, str] = ("R1", "R2"), rows: int = 300) -> Path:
    """Write rows of two robots at 25 Hz, one after the other, the second `later_s` later."""
    lines = ["timestamp,robot_id,x,y,z,part"]
    for k in range(rows):
        t, a = 1715668200 + k / 25, k / 40
        lines.append(f"{t:.3f},{names[0]},{0.4 + 0.2 * np.sin(a):.4f},{0.2 * np.cos(a):.4f},0.3,{k // 100}")
        x, y = -0.4 + 0.1 * np.cos(2 * a), 0.8 + 0.1 * np.sin(a)
        lines.append(f"{t + later_s:.3f},{names[1]},{x:.4f},{y:.4f},0.5,{k // 100}")
    file.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return file


@pytest.mark.parametrize("later_s", [0.007, 0.02, 0.0])
@pytest.mark.parametrize("names", [("R1", "R2"), ("1", "2")])
def test_the_rows_of_one_robot_are_read_and_the_others_are_no_loss(
    later_s: float, names: tuple[str, str], tmp_path: Path
) -> None:
    file = table(tmp_path / "robot.csv", later_s, names)
    draft = ADAPTER.draft(file)
    assert draft is not None
    keys = {line.key: line for line in draft.map}
    assert (keys["only"].value, keys["only"].sure) == ({"robot_id": names[0]}, False)
    assert keys["time_unit"].value == "s"
    for name, x_m in zip(names, (0.4, -0.3), strict=True):
        options = ReadOptions(role="robot", map={**COLUMNS, "only": {"robot_id": [name]}})
        log = examined(ADAPTER.read(file, options))
        assert log.robot is not None
        assert (log.robot.height, log.rows_read, log.set_aside, log.warnings) == (300, 300, None, ())
        assert log.robot["tcp_x_m"][0] == x_m


def test_a_table_of_one_robot_with_products_is_not_divided(tmp_path: Path) -> None:
    lines = table(tmp_path / "robot.csv", 0.007).read_text(encoding="utf-8").splitlines()
    (tmp_path / "robot.csv").write_text("\n".join([lines[0], *lines[1::2], ""]), encoding="utf-8")
    draft = ADAPTER.draft(tmp_path / "robot.csv")
    assert draft is not None
    assert "only" not in {line.key for line in draft.map}


def test_mixed_rows_are_called_what_they_are_and_a_robot_that_is_not_there_is_named(tmp_path: Path) -> None:
    file = table(tmp_path / "robot.csv", 0.007)
    source = Source("robot.csv", adapter="csv", role="robot", map=COLUMNS)
    with pytest.raises(LogError, match="goes to and fro between two tracks in 597 of 600 rows: two robots") as raised:
        ingest([file], tmp_path / "d", cell=Cell(sources=(source,)))
    assert "time_unit" not in str(raised.value)
    with pytest.raises(ConfigError, match="matches no row") as refused:
        ADAPTER.read(file, ReadOptions(role="robot", map={**COLUMNS, "only": {"robot_id": "R3"}}))
    assert "The table says 'R1', 'R2'" in str(refused.value)
    with pytest.raises(ConfigError, match="only = 'R1' is not a table"):
        ADAPTER.read(file, ReadOptions(role="robot", map={**COLUMNS, "only": "R1"}))
