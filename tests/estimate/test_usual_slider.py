"""Estimates and the logged cycle that stands beside them are for the same speed slider."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl
import pytest

from cyclekit.estimate.baseline import baseline_of
from cyclekit.estimate.robot.nominal import nominal_tasks, usual_slider
from cyclekit.estimate.statistics.same_work import work_of
from cyclekit_sim import MixedCauses

if TYPE_CHECKING:
    from simulated_cells import Cells


def at_70(share: float) -> MixedCauses:
    return MixedCauses(
        slider=0.7, slider_share=share, reduced=None, limit=None, wait_share=0.0, part_signal=False,
        pauses_per_hour=0.0, stops_per_hour=0.0,
    )  # fmt: skip


def test_todays_cycle_is_of_the_executions_at_the_usual_slider(cells: Cells):
    found = cells("laser-zones", 8, causes=at_70(0.5))
    lost = found.tasks.group_by("execution", maintain_order=True).agg("lost_slider_s").sort("execution")
    full = [max(seconds) == 0.0 for seconds in lost["lost_slider_s"].to_list()]
    cards = found.dataset.card.executions
    usual = 2 * sum(full) >= len(cards)  # full speed also if neither prevails
    assert usual_slider(found.dataset) == pytest.approx(1.0 if usual else 0.7)
    names = tuple(card.execution for card, free in zip(cards, full, strict=True) if free is usual)
    assert 0 < len(names) < len(cards)
    today = baseline_of(found.dataset, work_of(cards[0].places), None)
    assert today is not None
    assert today.names == names


def test_a_cell_at_70_percent_is_estimated_at_70_percent(cells: Cells):
    found = cells("laser-zones", 4, causes=at_70(1.0))
    today = baseline_of(found.dataset, work_of(found.dataset.card.executions[0].places), None)
    assert today is not None
    assert today.executions == 4
    logged = found.dataset.tasks().group_by("task").agg(pl.col("nominal_s").median()).rows()
    tasks = nominal_tasks(found.dataset)
    assert {name: tasks[name].nominal_s for name, _ in logged} == pytest.approx({n: s / 0.7 for n, s in logged})
