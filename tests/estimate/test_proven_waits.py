"""What was learned on who waits for whom is used only if it rolls logged executions out no worse than without it."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from known_cells import TrueStaircase
from made_once import made_once, simulated
from msgspec import structs

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.joint.proven import with_proven_waits
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.task_times.learn import learn_task_times
from cyclekit.learning.unproven import unproven
from cyclekit_sim import COUPLED, fresh_cycles, random_orders
from cyclekit_sim.coupled_list import task_plan

if TYPE_CHECKING:
    from cyclekit.dataset.cards import TrainingCard

SCENE = "shared-zone"
LEVELS, THRESHOLDS_M = np.array((0.0, 0.25, 0.5, 0.75, 1.0)), (0.45, 0.75, 1.1, 1.6)


class OfTheCell(TrueStaircase):
    """Predicts the staircase of the simulated cells in which robot and operator wait."""

    def __init__(self, card: TrainingCard) -> None:
        self.card = card

    def predict(self, positions: np.ndarray) -> np.ndarray:
        apart_m = np.linalg.norm(positions[:, :3].astype(float) - positions[:, 3:], axis=1)
        return np.asarray(LEVELS[np.searchsorted(THRESHOLDS_M, apart_m, side="left")])


def logged(factory: pytest.TempPathFactory, scene: str, executions: int) -> tuple[Dataset, OfTheCell]:
    """Return a dataset and its model, as trained but for what its waits are judged by."""
    logs = simulated(factory, scene, executions, seed=1, signals=False)
    made = made_once(factory, f"{scene}_unproven", lambda place: ingest([logs], place / "dataset"))
    dataset = Dataset.open(made / "dataset")
    card = structs.replace(TrueStaircase().card, coupling=dataset.card.coupling)
    assert card.coupling is not None
    assert card.coupling.coupled
    return dataset, OfTheCell(card)


def test_errors_that_are_larger_by_chance_speak_against_no_waits() -> None:
    errors = np.random.default_rng(1).normal(0.0, 0.03, 20)
    small, other, large = (
        {str(n): error for n, error in enumerate(some)} for some in (errors, np.roll(errors, 1), 3.0 * errors)
    )
    assert unproven(small, other) is None
    assert unproven(other, small) is None
    assert unproven(small, large) is None
    assert unproven(large, small) is not None
    assert unproven({name: error + 0.2 for name, error in small.items()}, other) is None  # a bias is corrected
    assert unproven(dict([*large.items()][:2]), small) is None


def test_waits_that_roll_logged_executions_out_worse_are_not_used_and_this_is_said(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """A zone for one at a time: the k-th visit of one follows now and then, not always, the k-th of the other."""
    dataset, model = logged(tmp_path_factory, SCENE, 16)
    model.card = with_proven_waits(model, dataset)
    assert model.card.coupling is not None
    assert not model.card.coupling.coupled
    known = set(dataset.done_tasks()["task"])
    ways = ((order, ["->".join(pair) for pair in pairwise(order["robot"])]) for order in random_orders(SCENE, 5, 40))
    order, way = next((order, way) for order, way in ways if known.issuperset(way))
    tasks = [*(PlannedTask("robot", task) for task in way), *(PlannedTask("operator", p) for p in order["operator"])]
    (found,) = estimate(model, dataset, [TaskSequence.of_plan("asked", tasks)])
    (finding,) = (one for one in found.findings if one.code == "waits")
    assert "16 logged executions are off by" in finding.text
    true_s = fresh_cycles(SCENE, order, cycles=100, seed=1).durations_s.mean()
    assert found.expected_low_s < true_s < found.expected_high_s


def test_waits_that_explain_logged_executions_are_used(tmp_path_factory: pytest.TempPathFactory) -> None:
    dataset, model = logged(tmp_path_factory, "shared-fixture", 8)
    assert with_proven_waits(model, dataset) is model.card


@pytest.mark.slow
def test_waits_of_task_lists_are_not_used_either_where_held_out_executions_speak_against_them(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    logs = simulated(tmp_path_factory, SCENE, 20, seed=1, task_list=True)
    made = made_once(tmp_path_factory, f"{SCENE}_list", lambda place: ingest([logs / "tasks.csv"], place / "dataset"))
    model = learn_task_times(Dataset.open(made / "dataset"))
    assert not any(task.needs for task in model.tasks)
    (order,) = random_orders(SCENE, 5, 1)
    plan = TaskSequence.of_plan("asked", [PlannedTask(*task) for task in task_plan(COUPLED[SCENE], order)])
    (found,) = estimate_plans(model, [plan], refused=lambda *_: None)
    (finding,) = (one for one in found.findings if one.code == "waits")
    assert "20 logged executions are off by" in finding.text
    true_s = fresh_cycles(SCENE, order, cycles=100, seed=1).durations_s.mean()
    assert found.expected_low_s < true_s < found.expected_high_s
