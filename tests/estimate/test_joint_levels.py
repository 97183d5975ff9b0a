"""Draws of one cycle that move together: each duration keeps its distribution, and a slow cycle is slow throughout."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from known_cells import Constant

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards import CouplingCard, GateCard
from cyclekit.dataset.cards.coupling import CommonPaceCard
from cyclekit.estimate.joint.answer import resample_counts, session_shifts, with_sessions
from cyclekit.estimate.joint.levels import WALK, WORK, Levels
from cyclekit.estimate.joint.plans import Planner
from cyclekit.estimate.joint.roll import JointCell, RolledBoth
from cyclekit.estimate.robot.nominal import nominal_tasks

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset

BOTH = CommonPaceCard(work=0.2, walk=0.1, together=1.0, between=1.0, sessions=4, once=1.0)
OPERATOR = ("inbound", "out_left_1", "inbound", "out_left_1")
PLAN = TaskSequence.of_plan(
    "both",
    [PlannedTask("robot", "home->conveyor")] + [PlannedTask("operator", name) for name in OPERATOR],
)


@given(st.floats(0.0, 0.98), st.integers(1, 400), st.sampled_from([WORK, WALK]))
def test_levels_that_move_together_are_spread_as_evenly_as_others(share: float, count: int, kind: str) -> None:
    found = Levels(0, count, BOTH).alike("work", 0, share, kind)
    assert np.sort(found) == pytest.approx((np.arange(count) + 0.5) / count)


def test_levels_correlate_as_asked_and_without_a_share_they_are_those_of_before() -> None:
    levels = Levels(3, 4000, BOTH)
    shared = levels.shared(WORK)
    assert levels.shared(WALK) == pytest.approx(shared)  # `together` is 1
    for share in (0.3, 0.9):
        scores = levels.scores[(levels.alike("work", 1, share) * 4000).astype(int)]
        assert np.corrcoef(scores, shared)[0, 1] == pytest.approx(share, abs=0.03)
    assert (levels.alike("work", 1, 0.0) == levels.of("work", 1)).all()
    assert abs(np.corrcoef(levels.of("work", 1), shared)[0, 1]) < 0.05


def test_the_share_of_a_duration_is_that_of_its_own_spread() -> None:
    levels, rng = Levels(0, 100, BOTH), np.random.default_rng(0)
    wide, narrow = (5.0 * np.exp(spread * rng.standard_normal(4000)) for spread in (0.4, 0.1))
    assert levels.share_of(wide, WORK) == pytest.approx(0.5, abs=0.03)
    assert levels.share_of(narrow, WORK) == 0.98
    assert levels.share_of(7.0 * wide, WORK) == pytest.approx(levels.share_of(wide, WORK))
    assert levels.share_of(np.full(9, 2.0), WORK) == levels.share_of(np.zeros(3), WORK) == 0.0
    assert Levels(0, 100).share_of(wide, WORK) == 0.0


def _rolled(logged: Dataset, common: CommonPaceCard | None, monkeypatch: pytest.MonkeyPatch) -> RolledBoth:
    gates = tuple(
        GateCard(agent="operator", at="leave", place=place, own_s=tuple(np.linspace(4.0, 8.0, 51).tolist()))
        for place in ("inbound", "out_left_1")
    )
    cell = JointCell(Constant(1.0), logged, CouplingCard(gates=gates, common=common))
    monkeypatch.setattr(cell.gates, "waits", lambda _: True)
    (found,) = cell.roll([Planner(cell, nominal_tasks(logged)).plan(PLAN)], cycles=400, until_s=500.0)
    assert isinstance(found, RolledBoth)
    return found


def test_cycles_scatter_more_where_durations_move_together_and_each_of_them_as_before(
    logged: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    apart, together = (_rolled(logged, each, monkeypatch) for each in (None, BOTH))
    assert together.duration_s.std() > 1.4 * apart.duration_s.std()
    assert together.duration_s.mean() == pytest.approx(apart.duration_s.mean(), rel=0.003)
    works = [each.operators[0].times.works_s - each.operators[0].times.arrives_s for each in (apart, together)]
    for one, other in zip(*(each.T for each in works), strict=True):
        assert np.sort(one) == pytest.approx(np.sort(other), abs=1e-6)
    assert np.corrcoef(together.shared, together.duration_s)[0, 1] > 0.8


def test_sessions_of_people_who_came_once_widen_the_interval_of_the_mean() -> None:
    shared = Levels(0, 1000, BOTH).main
    cycles_s = 60.0 + 6.0 * shared
    drawn = resample_counts(0, 60)
    weights = drawn / drawn.sum(axis=1, keepdims=True)
    assert session_shifts(0, None) is None
    assert session_shifts(0, CommonPaceCard(work=0.2, between=1.0, sessions=4)) is None  # the same people come again
    shifts = session_shifts(0, BOTH)
    assert shifts is not None
    wide, narrow = (np.ptp(np.quantile(each @ cycles_s, (0.16, 0.84))) / 2.0 for each in
                    (with_sessions(weights, shifts, shared), weights))  # fmt: skip
    assert narrow == pytest.approx(6.0 / 60**0.5, rel=0.15)
    assert wide == pytest.approx(6.0 * 1.2 / 4**0.5, rel=0.2)  # Student's t of three degrees of freedom
