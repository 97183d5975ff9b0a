"""The operator's pace where positions are logged: found if it changes, and not taken for it what is none."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit import schema
from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard
from cyclekit.learning.coupling.events.visits import ExecutionVisits, PlaceVisit, events_of
from cyclekit.learning.coupling.learn import learn_executions
from cyclekit.learning.coupling.pace.pace import operator_pace, paces_beside
from cyclekit.learning.coupling.words import habit_lines
from cyclekit.text.numbers import percent

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.dataset.cards import OperatorPaceCard

NO_WAITS = CouplingCard()
PLACES = ("bench", "shelf", "bench", "fixture", "scan", "bench", "shelf")
USUAL_S = {"bench": 3.0, "shelf": 2.0, "fixture": 4.0, "scan": 1.5}


def _execution(
    rng: np.random.Generator,
    number: int,
    pace: float,
    *,
    session: int,
    places: Sequence[str] = PLACES,
    wait_s: float = 0.0,
    walk: float | None = None,
) -> ExecutionVisits:
    """Return an execution; before the fixture he waits for the robot, which comes `wait_s` after his own work."""
    at_s, visits, robot = 100.0, [], []
    for n, place in enumerate(places):
        left_s = at_s + pace * USUAL_S[place] * rng.uniform(0.8, 1.2)
        if places[n + 1 : n + 2] == ("fixture",):
            robot.append(PlaceVisit("fixture", left_s + wait_s - 1.0, left_s + wait_s - 0.5))
            left_s += max(wait_s, 0.0)
        visits.append(PlaceVisit(place, at_s, left_s))
        at_s = left_s + (pace if walk is None else walk) * rng.uniform(1.0, 1.4)
    both = {"robot": robot, "operator": [*visits, PlaceVisit("rest", at_s, np.nan)]}
    return ExecutionVisits(f"{number:03d}", both, events_of(both), f"s{session}")  # type: ignore[arg-type]


def _logged(
    pace: Callable[[int, int], float],
    *,
    seed: int = 1,
    count: int = 120,
    size: int = 20,
    **more: object,
) -> list[ExecutionVisits]:
    rng = np.random.default_rng(seed)
    return [
        _execution(rng, n, pace(n, n // size), session=n // size, **more)  # type: ignore[arg-type]
        for n in range(count)
    ]


def _quicker(number: int, _: int) -> float:
    return 1.0 - 0.25 * (1.0 - float(np.exp(-number / 40.0)))


def _found(courses: Sequence[ExecutionVisits], card: CouplingCard = NO_WAITS) -> OperatorPaceCard | None:
    return operator_pace(courses, card)


@pytest.mark.parametrize(
    ("size", "count"), [(20, 120), (120, 120), (5, 120), (1, 120), (20, 200), (60, 120), (20, 60), (30, 60)]
)
def test_a_pace_that_changes_over_the_executions_is_found(size: int, count: int) -> None:
    for seed in (1, 2):
        pace = _found(_logged(_quicker, seed=seed, count=count, size=size))
        assert pace is not None
        assert pace.quicker == pytest.approx(1.0 - _quicker(count - 1, 0), abs=0.06)
        factors = pace.factors()
        assert factors[f"{count - 1:03d}"] == (1.0, 1.0)
        assert factors["000"][0] == pytest.approx(1.0 / _quicker(count - 1, 0), abs=0.1)
        assert f"became {percent(pace.quicker)} quicker over {count} executions" in pace.said


def test_slower_is_found_too_and_walks_have_a_trend_of_their_own() -> None:
    pace = _found(_logged(lambda n, _: 1.0 + 0.3 * n / 119, walk=1.0))
    assert pace is not None
    assert pace.work is not None
    assert pace.work.change == pytest.approx(np.log(1.3), abs=0.05)
    assert pace.walk is None
    assert "slower" in pace.said


OTHER_PEOPLE: list[Callable[[int, int], float]] = [
    lambda *_: 1.0,
    lambda _, session: (1.15, 0.85)[session % 2],  # two people by turns
    lambda _, session: (1.1, 0.9, 1.0)[session % 3],
    lambda _, session: 1.15 if session < 3 else 0.9,  # another person from the fourth day on
    lambda n, _: 1.15 if n < 50 else 0.9,  # another shift
]


@pytest.mark.parametrize("pace", OTHER_PEOPLE)
@pytest.mark.parametrize("size", [20, 10, 40])
def test_other_people_are_no_other_pace(pace: Callable[[int, int], float], size: int) -> None:
    assert _found(_logged(pace, seed=3, size=size)) is None


@pytest.mark.slow
@pytest.mark.parametrize("pace", OTHER_PEOPLE)
def test_other_people_are_no_other_pace_in_other_logs_either(pace: Callable[[int, int], float]) -> None:
    assert all(_found(_logged(pace, seed=4, size=size)) is None for size in (20, 10, 40))


def test_two_sessions_alone_prove_nothing() -> None:
    assert _found(_logged(lambda _, session: (1.2, 0.9)[session], count=80, size=40)) is None


def test_another_order_is_no_other_pace() -> None:
    """In the second half he goes to quick places only; each visit takes as long as before."""
    slow, quick = _logged(lambda *_: 1.0, count=60), _logged(lambda *_: 1.0, places=("scan", "shelf", "scan", "shelf"))
    assert _found([*slow, *(replace(one, session=f"s{3 + n // 20}") for n, one in enumerate(quick[:60]))]) is None


def test_longer_waits_for_a_slower_robot_are_no_other_pace() -> None:
    rng = np.random.default_rng(5)
    courses = [_execution(rng, n, 1.0, session=n // 20, wait_s=-3.0 + 0.1 * n) for n in range(120)]
    waits = ConditionCard(agent="robot", place="fixture", event="leaves", lag_s=(0.5,))
    gate = GateCard(agent="operator", at="approach", place="fixture", conditions=(waits,))
    assert _found(courses) is not None  # without knowing that he waits
    assert _found(courses, CouplingCard(gates=(gate,))) is None


def test_own_work_is_learned_at_the_latest_pace() -> None:
    def bench_s(courses: list[ExecutionVisits]) -> tuple[CouplingCard, float]:
        card = learn_executions(courses, schema.empty(schema.TASKS))
        assert card is not None
        (gate,) = (one for one in card.gates if (one.agent, one.at, one.place) == ("operator", "leave", "shelf"))
        return card, float(np.median(gate.own_s))

    card, own_s = bench_s(_logged(_quicker))
    assert card.pace is not None
    assert card.pace.said in habit_lines(card)
    assert own_s == pytest.approx(USUAL_S["shelf"] * _quicker(119, 0), rel=0.06)
    card, own_s = bench_s(_logged(lambda *_: 1.0))
    assert card.pace is None
    assert own_s == pytest.approx(USUAL_S["shelf"], rel=0.06)


def test_newer_logs_are_held_against_the_latest_pace_of_the_older_ones() -> None:
    older = _logged(_quicker)
    card = replace_pace(older)
    same, slower = _logged(lambda *_: _quicker(119, 0), seed=9, count=20), _logged(lambda *_: 1.0, seed=9, count=20)
    for newer, expected in ((same, 1.0), (slower, 1.0 / _quicker(119, 0))):
        found = paces_beside(older, newer, card)
        assert found is not None
        assert found[0].mean() == pytest.approx(1.0, abs=0.02)
        assert found[1].mean() == pytest.approx(expected, abs=0.04)


def replace_pace(courses: Sequence[ExecutionVisits]) -> CouplingCard:
    return CouplingCard(pace=operator_pace(courses, NO_WAITS))
