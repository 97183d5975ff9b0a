"""Of many logged gaps and executions as many are learned from as allowed, some of which follow each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.dataset.cards.coupling import ConditionCard, GateCard
from cyclekit.learning.coupling.events.part_visits import PartVisits, Times
from cyclekit.learning.coupling.events.visits import Event, ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.parts.part_gaps import MAX_CHAINS, part_gaps
from cyclekit.learning.coupling.sources import find_sources
from cyclekit.learning.coupling.subset import RUN, evenly, in_runs

if TYPE_CHECKING:
    from cyclekit.dataset.cards.coupling import Agent

GATE = GateCard(
    agent="robot",
    at="leave",
    place="belt",
    own_s=(0.6,),
    conditions=(ConditionCard(agent="signal", place="part", event="set", lag_s=(0.0,)),),
)


def _signalled(name: str, gaps_s: list[float]) -> ExecutionVisits:
    """Return an execution whose robot takes its parts, which a signal reports, after the last one has come."""
    came, visits = np.cumsum(gaps_s), [PlaceVisit("home", 0.0, 0.0)]
    visits += [PlaceVisit("belt", at, at + 0.6) for at in came[-1] + 5.0 * np.arange(1.0, 4.0)]
    agents: dict[Agent, list[PlaceVisit]] = {"robot": visits, "operator": [PlaceVisit("bench", 0.0, 1.0)]}
    return ExecutionVisits(name, agents, events_of(agents) | {Event("signal", "part", "set"): came})


@pytest.mark.parametrize("executions", [20, 201, 601])
def test_every_second_gap_is_not_left_out(executions: int) -> None:
    """The second gap of each execution is longer: with one gap too many, it was left out everywhere."""
    rng = np.random.default_rng(0)
    courses = [_signalled(str(n), [9.0, 8.0 + rng.random(), 12.0 + rng.random()]) for n in range(executions)]
    (source,) = find_sources(courses, [GATE])
    assert np.mean(source.gap_s) == pytest.approx(10.5, abs=0.15)


def test_gaps_of_many_chains_are_learned() -> None:
    """Chains of first parts and of next ones alternate, one more than are allowed."""
    count = MAX_CHAINS // 2 + 1
    left_s = np.tile([9.6, 19.6], (count, 1))
    visits = PartVisits(left_s - 5.0, left_s, 0.6)
    guess = Times(np.array([7.0, 10.0, 14.0]), np.full(3, 1.0 / 3.0))
    at, _, gaps = part_gaps(visits, guess, guess, 2)
    assert gaps[np.abs(at - 10.0) < 0.5].sum() == pytest.approx(1.0, abs=0.01)


def test_subsets_are_spread_over_everything() -> None:
    assert evenly(5, 10).tolist() == in_runs(5, 400).tolist() == list(range(5))
    assert evenly(401, 400)[[0, -1]].tolist() == [0, 400]
    for count in (401, 799, 5000):
        some = in_runs(count, 400)
        assert len(set(some.tolist())) == 400
        assert some[[0, -1]].tolist() == [0, count - 1]
        assert np.mean(np.diff(some) == 1) >= 1.0 - 1.0 / RUN
