"""A cell file that forgets the tracker's pose: the slow-downs show it, and propose the pose."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from cyclekit import ingest_logs
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.soundness import findings_of
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import train

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import Cells


def without_frame(logs: Path, folder: Path) -> Dataset:
    """Ingest logs by their cell file without its frame."""
    cell = folder / "cell.toml"
    lines = (logs / "cell.toml").read_text(encoding="utf-8").splitlines()
    cell.write_text("\n".join(line for line in lines if not line.startswith("frame = ")), encoding="utf-8")
    ingest_logs(logs, out=folder / "dataset", cell=cell)
    return Dataset.open(folder / "dataset")


def notes_of(dataset: Dataset) -> dict[str, dict[str, object]]:
    return {one.code: dict(one.values) for one in dataset.card.warnings}


@pytest.fixture(scope="module")
def forgotten(cells: Cells, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return without_frame(cells.logs("box-picking", 6), tmp_path_factory.mktemp("forgotten"))


def test_a_forgotten_frame_is_proposed_from_the_slow_downs(forgotten: Dataset):
    line = str(notes_of(forgotten)["frame-doubtful"]["line"])
    found = [float(number) for number in re.findall(r"-?\d+\.\d+", line)]
    assert found[:2] == pytest.approx([1.4, -2.6], abs=0.1)
    assert found[3] == pytest.approx(35.0, abs=1.5)


def test_a_model_and_an_estimate_without_the_frame_carry_the_warning(forgotten: Dataset):
    model = train(forgotten, ModelSpec.of("now", "classifier", epochs=1))
    assert "frame-doubtful" in {one.code for one in model.card.warnings}
    found = findings_of(model, None, forgotten, executions=20, support=1.0)  # type: ignore[arg-type]
    assert ("pose", "red") in {(one.code, one.level) for one in found}


def test_where_zones_decide_the_speed_a_forgotten_frame_is_said_to_be_unconfirmed(cells: Cells, tmp_path: Path):
    assert "frame-assumed" in notes_of(without_frame(cells.logs("laser-zones", 6), tmp_path))


@pytest.mark.parametrize(("scene", "executions"), [("box-picking", None), ("laser-zones", 6)])
def test_a_frame_of_the_cell_file_that_is_right_gets_no_note(cells: Cells, scene: str, executions: int | None):
    codes = {one.code for one in cells(scene, executions).dataset.card.warnings}
    assert not codes & {"frame-assumed", "frame-doubtful"}
