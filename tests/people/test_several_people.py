"""Two people beside one robot: said, not taken for one whose waits are learned, and covered by the interval."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from known_cells import TrueStaircase

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError
from cyclekit.estimate.rollout import estimate
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.coupling.learn import learn_coupling
from cyclekit.learning.coupling.several_people import several_people
from cyclekit_sim import SimulationOptions, simulate

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.estimate.finding import Finding


def logged(folder: Path, scene: str, **options: float) -> Dataset:
    simulate(scene, folder / "logs", executions=6, seed=3, options=SimulationOptions(**options))  # type: ignore[arg-type]
    ingest([folder / "logs"], folder / "dataset")
    return Dataset.open(folder / "dataset")


def told(dataset: Dataset) -> tuple[list[Finding], float, float]:
    """Return the findings on several people of an order, half the width of its interval and its wait, as shares."""
    asked = [TaskSequence("order", dataset.card.executions[0].places)]
    (found,) = estimate(TrueStaircase(), dataset, asked, extrapolate=True, other_cell=True)
    half = (found.expected_high_s - found.expected_low_s) / 2 / found.expected_s
    return [one for one in found.findings if one.code == "several-people"], half, found.wait_s / found.expected_s


@pytest.mark.parametrize("lost_ids_s", [0.0, 60.0])
def test_waits_are_not_learned_from_two_people_taken_for_one(tmp_path: Path, lost_ids_s: float) -> None:
    dataset = logged(tmp_path, "two-operators", swap_ids_s=lost_ids_s, lost_ids_s=lost_ids_s)
    assert several_people(dataset.recordings) > 0.9
    assert learn_coupling(dataset) is None
    (finding,), half, wait = told(dataset)
    assert "who waits for whom" in finding.text
    assert finding.blocks
    assert half > wait > 0.0


def test_waits_of_the_cell_file_are_refused_where_it_is_not_known_whose_they_are(tmp_path: Path) -> None:
    simulate("two-operators", tmp_path / "logs", executions=2, seed=3)
    with (tmp_path / "logs" / "cell.toml").open("a", encoding="utf-8") as file:
        file.write('\n[[waits]]\nagent = "robot"\nbefore = "fixture"\nuntil = "operator leaves fixture"\n')
    with pytest.raises(ConfigError, match=r"\[\[waits\]\]: in 100 % of the samples with people several are seen"):
        ingest([tmp_path / "logs"], tmp_path / "dataset")


def test_one_person_whose_id_is_lost_is_no_second_one(tmp_path: Path) -> None:
    dataset = logged(tmp_path, "shared-fixture", lost_ids_s=20.0)
    assert several_people(dataset.recordings) == 0.0
    assert learn_coupling(dataset) is not None
