"""What the durations of one execution share where people are of different pace: found where it is, and only there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard
from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.pace.common_pace import with_common_pace

if TYPE_CHECKING:
    from collections.abc import Callable

    from cyclekit.dataset.cards.coupling import CommonPaceCard

PLACES = ("bench", "shelf", "bench", "scan", "bench", "shelf")
USUAL_S = {"bench": 3.0, "shelf": 2.0, "scan": 1.5}
NEEDS = ConditionCard(agent="robot", place="bin", event="leaves", lag_s=tuple(np.linspace(1.0, 2.2, 51).tolist()))
CARD = CouplingCard(gates=(GateCard(agent="operator", at="leave", place="scan", own_s=(1.0,), conditions=(NEEDS,)),))


def _execution(rng: np.random.Generator, number: int, work: float, walk: float, session: int) -> ExecutionVisits:
    """Return an execution; at the scanner he waits for the robot, then works as long as there if it came before."""
    at_s, visits, robot = 100.0, [], []
    for place in PLACES:
        took_s = work * USUAL_S[place] * rng.uniform(0.8, 1.2)
        left_s = at_s + took_s
        if place == "scan":
            robot.append(PlaceVisit("bin", at_s, at_s + 4.0))
            left_s += 4.0
        visits.append(PlaceVisit(place, at_s, left_s))
        at_s = left_s + walk * rng.uniform(1.0, 1.4)
    both = {"robot": robot, "operator": [*visits, PlaceVisit("rest", at_s, np.nan)]}
    return ExecutionVisits(f"{number:03d}", both, events_of(both), f"s{session}")  # type: ignore[arg-type]


def _found(
    work: Callable[[int, int], float],
    walk: Callable[[int, int], float] | None = None,
    *,
    count: int = 60,
    size: int = 10,
    seed: int = 1,
) -> CouplingCard:
    rng = np.random.default_rng(seed)
    paces = [(work(n, n // size), (walk or work)(n, n // size)) for n in range(count)]
    courses = [_execution(rng, n, *both, n // size) for n, both in enumerate(paces)]
    return with_common_pace(courses, CARD)


def _of(card: CouplingCard) -> CommonPaceCard:
    assert card.common is not None
    return card.common


@pytest.mark.parametrize("seed", [1, 2])
def test_two_people_by_session_share_their_pace_in_works_and_walks(seed: int) -> None:
    found = _of(_found(lambda _, session: (0.8, 1.2)[session % 2], seed=seed))
    assert found.work == pytest.approx(0.2, abs=0.04)
    assert found.walk == pytest.approx(0.2, abs=0.04)
    assert found.together > 0.9
    assert (found.between, found.sessions, found.once) == (1.0, 6, 0.0)  # both come again


def test_people_who_came_once_are_counted() -> None:
    found = _of(_found(lambda _, session: (0.7, 0.85, 1.0, 1.2, 1.2, 1.45)[session]))
    assert found.once == pytest.approx(4 / 6, abs=1e-3)


def test_people_who_alternate_by_execution_differ_in_these_not_between_sessions() -> None:
    found = _of(_found(lambda number, _: (0.8, 1.2)[number % 2], size=20))
    assert found.work == pytest.approx(0.2, abs=0.04)
    assert found.between < 0.1


def test_walks_of_their_own_pace_are_not_taken_for_that_of_works() -> None:
    found = _of(_found(lambda _, session: (0.8, 1.2)[session % 2], lambda n, _: 1.3 if n % 4 < 2 else 0.9))
    assert found.walk == pytest.approx(0.18, abs=0.05)
    assert found.together < 0.2
    assert _of(_found(lambda _, session: (0.8, 1.2)[session % 2], lambda *_: 1.0)).walk == 0.0


def test_one_person_shares_nothing_and_the_card_stays_as_it_is() -> None:
    assert all(_found(lambda *_: 1.0, seed=seed) is CARD for seed in range(12))
    assert _found(lambda _, session: (0.8, 1.2)[session % 2], count=10, size=5) is CARD  # too few


def test_a_lag_with_work_in_it_moves_with_the_other_work() -> None:
    (found,) = _found(lambda _, session: (0.8, 1.2)[session % 2]).gates
    assert found.conditions[0].common > 0.6
    (found,) = _found(lambda *_: 1.0).gates
    assert found.conditions[0].common == 0.0
