"""The operator's slider that no log holds: its time is not lost to the safety system."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit import schema
from cyclekit.dataset.dataset import Dataset
from cyclekit.derive.found_slider import sliders_of, without_slider_loss
from cyclekit.ingest.ingest import ingest

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import Cells

TURNED_DOWN = 0.8


def test_executions_with_the_slider_turned_down_are_told_by_the_usual_slider():
    names, slider = ["a"] * 4 + ["b"] * 4, np.array([1.0, np.nan, 1.0, 1.0, 0.8, 0.8, np.nan, 0.82])
    assert sliders_of(names, slider) == {"b": pytest.approx(0.8)}
    assert sliders_of(names, None) == {}


def test_what_the_slider_cost_is_taken_from_unknown_causes_first():
    rows = {"execution": ["b", "b", "a"], "nominal_s": [4.0, 4.0, 4.0], "safety_loss_s": [1.5, 3.0, 1.5]}
    causes = {"lost_unknown_s": [1.5, 0.5, 1.5], "lost_person_s": [0.0, 2.5, 0.0], "lost_slider_s": [0.0, 0.0, 0.0]}
    others = {f"lost_{cause}_s": [0.0] * 3 for cause in ("input", "limits", "stop")}
    tasks = schema.conform(pl.DataFrame(rows | causes | others), schema.TASKS)
    found = without_slider_loss(tasks, {"b": TURNED_DOWN})
    assert found["lost_slider_s"].to_list() == pytest.approx([1.0, 1.0, 0.0])
    assert found["safety_loss_s"].to_list() == pytest.approx([0.5, 2.0, 1.5])
    assert found["lost_unknown_s"].to_list() == pytest.approx([0.5, 0.0, 1.5])
    assert found["lost_person_s"].to_list() == pytest.approx([0.0, 2.0, 0.0])
    assert without_slider_loss(tasks, {}) is tasks


def test_a_scaling_that_includes_the_slider_is_divided(cells: Cells, tmp_path: Path):
    """Half of the executions at 80 %: the logged scaling is the product, as on many pendants."""
    logs, slow = tmp_path / "logs", []
    for number, log in enumerate(sorted(cells.logs("box-picking", 6, executions_per_session=1).rglob("robot.csv"))):
        (logs / str(number)).mkdir(parents=True)
        table, part = pl.read_csv(log, separator=" "), TURNED_DOWN if number % 2 else 1.0
        later = table["timestamp"][0] + (table["timestamp"] - table["timestamp"][0]) / part
        table = table.with_columns(later.alias("timestamp"), pl.col("speed_scaling") * part)
        table.write_csv(logs / str(number) / "robot.csv", separator=" ")
        slow.append(part < 1.0)
    ingest([logs], tmp_path / "dataset")
    tasks = Dataset.open(tmp_path / "dataset").tasks().group_by("execution", maintain_order=True)
    lost = tasks.agg(pl.col("lost_slider_s").sum(), pl.col("nominal_s").sum())
    share = (lost["lost_slider_s"] / lost["nominal_s"]).to_numpy()
    assert share == pytest.approx(np.where(slow, 0.25, 0.0), abs=0.01)
