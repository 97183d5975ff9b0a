"""Estimates are for full speed slider, and so is the logged cycle that stands beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from cyclekit.estimate.baseline import baseline_of
from cyclekit.estimate.statistics.same_work import work_of
from cyclekit_sim import MixedCauses

if TYPE_CHECKING:
    from simulated_cells import Cells

TURNED_DOWN = MixedCauses(
    slider=0.7, slider_share=0.5, reduced=None, limit=None, wait_share=0.0, part_signal=False, pauses_per_hour=0.0,
    stops_per_hour=0.0,
)  # fmt: skip


def test_todays_cycle_is_of_the_executions_at_full_slider(cells: Cells):
    found = cells("laser-zones", 8, causes=TURNED_DOWN)
    lost = found.tasks.group_by("execution", maintain_order=True).agg("lost_slider_s").sort("execution")
    full = [max(seconds) == 0.0 for seconds in lost["lost_slider_s"].to_list()]
    cards = found.dataset.card.executions
    assert 0 < sum(full) < len(cards)
    today = baseline_of(found.dataset, work_of(cards[0].places), None)
    assert today is not None
    assert today.names == tuple(card.execution for card, free in zip(cards, full, strict=True) if free)
    took = [card.end_s - card.start_s for card, free in zip(cards, full, strict=True) if free]
    assert today.mean_s == pytest.approx(sum(took) / len(took), abs=0.01)


def test_without_a_cycle_at_full_slider_there_is_none_of_today(cells: Cells):
    found = cells("laser-zones", 4, causes=MixedCauses(slider=0.7, slider_share=1.0, stops_per_hour=0.0)).dataset
    assert baseline_of(found, work_of(found.card.executions[0].places), None) is None
