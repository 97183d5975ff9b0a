"""Waits of a simulated cell: those that there are, by what ended them, and none where nobody waits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl
import pytest

from cyclekit.learning.coupling.learn import learn_coupling

if TYPE_CHECKING:
    from simulated_cells import Cells, SimulatedCell


@pytest.mark.slow
@pytest.mark.parametrize("signals", [True, False], ids=["release button", "positions only"])
def test_the_waits_of_both_are_those_of_the_truth(cells: Cells, signals: bool) -> None:
    cell = cells("shared-fixture", 16, seed=31, signals=signals)
    card = cell.dataset.card.coupling
    assert card is not None
    robot, operator = ((gate, one) for gate in card.gates for one in gate.conditions)
    assert (robot[0].agent, robot[0].at, robot[0].place) == ("robot", "approach", "fixture")
    assert (robot[1].place, robot[1].event, robot[1].back) == ("fixture", "leaves", 1)
    assert robot[1].signal == ("release set" if signals else None)
    assert operator[0].agent == "operator"  # from his bench he goes to the fixture: either of both may be the gate
    assert (operator[0].at, operator[0].place) in {("approach", "fixture"), ("leave", "bench")}
    assert (operator[1].place, operator[1].event, operator[1].back) == ("fixture", "leaves", 0)
    assert sorted(cell.dataset.places) == sorted({*cell.routes[0], "rack_1", "rack_2", "rack_3", "rack_4"})
    tasks = cell.dataset.every_task()
    for agent, ended in (("robot", "operator leaves fixture"), ("operator", "robot leaves fixture")):
        true = cell.tasks.filter(pl.col("agent") == agent)
        mine = tasks.filter(pl.col("agent") == agent, pl.col("waited_for").is_not_null())
        assert mine["waited_for"].str.starts_with(ended).all()
        assert mine.height == pytest.approx(true["wait_ended_by"].count(), abs=4)
        assert mine["wait_s"].sum() == pytest.approx(true["wait_s"].sum(), rel=0.15)
    ended = tasks.filter(
        pl.col("agent") == "operator", pl.col("goal_place") == "fixture", pl.col("end_s").is_not_null()
    )
    assert ended.height == 3 * 16  # those after the robot's last task too


def test_nobody_waits_in_a_cell_of_people_who_roam(boxes: SimulatedCell) -> None:
    assert boxes.dataset.card.coupling is None  # four executions tell nothing
    tasks = boxes.dataset.every_task()
    assert tasks["waited_for"].is_null().all()
    operator = tasks.filter(pl.col("agent") == "operator")
    assert set(operator["task"]) <= set(boxes.dataset.human_places)
    assert (operator["arrival_s"] >= operator["start_s"]).all()
    assert operator.height > 10
    assert boxes.dataset.tasks().height + operator.height == tasks.height
    assert learn_coupling(boxes.dataset) is None
