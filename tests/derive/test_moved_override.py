"""A set override that a program moves with people is the safety function; one that a hand turns is a knob."""

from __future__ import annotations

import shutil
from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl
import pytest

from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import EstimateError
from cyclekit.estimate.limits import refuse_unknown_mover
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import MixedCauses
from cyclekit_sim.rules import Line, Rule

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from simulated_cells import Cells

EACH = MixedCauses(
    slider=0.3, slider_every=1, reduced=None, limit=None, wait_share=0.0, part_signal=False, pauses_per_hour=0.0,
    stops_per_hour=0.0,
)  # fmt: skip
AT_RANDOM = MixedCauses(
    slider=0.3, slider_turns_per_hour=90.0, reduced=None, limit=None, wait_share=0.0, part_signal=False,
    pauses_per_hour=0.0, stops_per_hour=0.0,
)  # fmt: skip


def said(dataset: Dataset) -> dict[str, Any]:
    """Return the notes on the set override."""
    return {one.code: one.values for one in dataset.card.warnings if one.code.startswith("override-")}


@pytest.mark.parametrize(
    ("scene", "options"),
    [
        ("laser-zones", {}),
        ("scanner-fields", {}),
        ("box-picking", {"rule": Rule(line=Line(0.8, 2.4)), "delta_m": 0.02}),
    ],
    ids=["zones", "signals", "line"],
)
def test_a_slider_that_follows_people_is_the_safety_function(cells: Cells, scene: str, options: dict[str, Any]):
    moved, logged = (cells(scene, 6, **options, moves_slider=moves).dataset for moves in (True, False))
    assert list(said(moved)) == ["override-moved"]
    assert not said(moved)["override-moved"]["sliders"]
    losses = [one.tasks().select("nominal_s", "safety_loss_s", "lost_slider_s").sum().row(0) for one in (moved, logged)]
    assert losses[0] == pytest.approx(losses[1], rel=0.005)
    assert losses[0][2] == 0.0
    refuse_unknown_mover(moved)


@pytest.mark.parametrize(("scene", "causes"), [("laser-zones", EACH), ("scanner-visits", AT_RANDOM)])
def test_a_slider_that_a_hand_turns_is_none(cells: Cells, scene: str, causes: MixedCauses):
    found = cells(scene, 10, causes=causes)
    assert not said(found.dataset)
    lost = found.dataset.tasks()["lost_slider_s"].sum()
    assert lost == pytest.approx(found.tasks["lost_slider_s"].sum(), rel=0.05)


def by_region(cells: Cells, to: Path) -> Path:
    """Write a cell's logs with a slider that the program sets to 40 % on one side of the robot."""
    logs = to / "logs"
    shutil.copytree(cells("box-picking", 6).logs, logs, ignore=shutil.ignore_patterns("truth"))
    for file in logs.glob("*/robot.csv"):
        log = pl.read_csv(file, separator=" ")
        slider = pl.when(pl.col("actual_TCP_pose_1") > 0.1).then(0.4).otherwise(1.0)
        log = log.with_columns(target_speed_fraction=slider, speed_scaling=pl.col("speed_scaling") * slider)
        log.write_csv(file, separator=" ")
    return logs


def test_a_slider_that_the_program_sets_by_the_robots_position_is_told_from_people(cells: Cells, tmp_path: Path):
    found = Dataset.open(ingest([by_region(cells, tmp_path)], tmp_path / "dataset").dataset)
    assert list(said(found)) == ["override-of-program"]
    assert found.tasks()["lost_slider_s"].sum() == 0.0  # no hand turned it
    refuse_unknown_mover(found)


@pytest.mark.parametrize(("moves", "code"), [(False, "override-unknown"), (True, "override-moved")])
def test_a_slider_that_the_program_sets_by_task_is_not_taken_for_people(cells: Cells, moves: bool, code: str):
    causes = replace(EACH, slider=0.4, slider_every=0, slider_goals=("left_1", "left_2", "left_3", "right_2"))
    found = cells("box-picking", 8, causes=causes, moves_slider=moves)
    assert list(said(found.dataset)) == [code]


def test_a_hand_and_people_on_one_slider_are_told_apart(cells: Cells):
    found = cells("box-picking", 6, causes=EACH, moves_slider=True)
    assert said(found.dataset)["override-moved"]["sliders"]
    lost = found.dataset.tasks().select("lost_slider_s", "safety_loss_s").sum().row(0)
    true = found.tasks.select("lost_slider_s", "safety_loss_s").sum().row(0)
    assert sum(lost) == pytest.approx(sum(true), rel=0.01)
    assert lost == pytest.approx(true, rel=0.15)


def test_without_a_log_of_people_neither_is_believed_unless_the_cell_file_says_it(cells: Cells, tmp_path: Path):
    found = cells("laser-zones", 6, moves_slider=True, people="none")
    assert list(said(found.dataset)) == ["override-unknown"]
    with pytest.raises(EstimateError, match="set override"):
        refuse_unknown_mover(found.dataset)
    for mover, code in (("people", ["override-moved"]), ("program", ["override-of-program"]), ("hand", [])):
        logs = tmp_path / mover
        shutil.copytree(found.logs, logs, ignore=shutil.ignore_patterns("truth"))
        cell = logs / "cell.toml"
        cell.write_text(f'set_override = "{mover}"\n{cell.read_text()}')
        ingest([logs], tmp_path / f"{mover}-dataset")
        assert list(said(Dataset.open(tmp_path / f"{mover}-dataset"))) == code
