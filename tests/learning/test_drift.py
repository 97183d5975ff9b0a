"""Newer logs: the same cell shows no drift, a moved safety function and new habits are named and placed."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
import pytest
from ingested import without_checksums
from known_cells import LEVELS

from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ModelError
from cyclekit.learning.evaluation.drift import drift
from cyclekit.learning.windows import INPUTS

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.fixture
def model(staircase: Any, logged: Dataset) -> Any:
    names = logged.executions["execution"].to_list()
    staircase.card = {"split": {"train": names[6:], "test": names[:6]}}
    staircase.levels, staircase.horizon_s, staircase.inputs = LEVELS, 0.0, INPUTS["now"]
    return staircase


@pytest.fixture
def newer(logged: Dataset, tmp_path: Path) -> Callable[..., Dataset]:
    def made(**columns: pl.Expr) -> Dataset:
        copy = without_checksums(Path(shutil.copytree(logged.path, tmp_path / "newer")))
        file = copy / "samples" / "session_000.parquet"
        pl.read_parquet(file).with_columns(**columns).write_parquet(file)
        return Dataset.open(copy)

    return made


def test_the_same_cell_shows_no_drift(model: Any, logged: Dataset):
    found = drift(model, logged, logged)
    assert (found.safety_changed, found.habits_changed) == (False, False)
    assert found.executions == (6, 16)


def test_another_safety_function_is_named(model: Any, logged: Dataset, newer: Any):
    found = drift(model, logged, newer(scaling=pl.col("scaling") * 0.8))
    assert found.safety_changed
    assert not found.habits_changed
    everywhere = found.safety[0]
    assert (everywhere.what, everywhere.changed) == ("everywhere", True)
    assert everywhere.after > everywhere.before + 0.05


def test_new_habits_are_named_and_the_safety_function_is_not(model: Any, logged: Dataset, newer: Any):
    lazier = pl.when(pl.col("human_task") == "inbound").then(pl.lit("rest")).otherwise(pl.col("human_task"))
    found = drift(model, logged, newer(human_task=lazier))
    assert found.habits_changed
    named = {shift.what for shift in found.habits if shift.changed}
    assert {"inbound", "rest"} <= named
    assert not found.safety[0].changed
    assert found.to_json()["habits_changed"]


def test_without_activities_habits_are_places_on_the_floor(model: Any, logged: Dataset, newer: Any):
    found = drift(model, logged, newer(human_task=pl.lit(None, pl.String), human_y_m=pl.col("human_y_m").abs()))
    assert any(shift.changed and shift.what.startswith("floor") for shift in found.habits)


def test_a_model_of_other_logs_is_refused(model: Any, logged: Dataset):
    model.card = {"split": {"train": ["x"], "test": ["y"]}}
    with pytest.raises(ModelError, match="not the dataset that the model was trained on"):
        drift(model, logged, logged)
