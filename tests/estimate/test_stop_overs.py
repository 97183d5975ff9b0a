"""Places by which the operator always went from one task to the next, and plans that leave them out."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from known_cells import Coupled
from one_track import one_track

from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.cards import CouplingCard, GateCard
from cyclekit.estimate.joint.stop_overs import StopOvers
from cyclekit.estimate.plan.both import PairSearch
from cyclekit.estimate.plan.jobs import Jobs
from cyclekit.estimate.rollout import estimate

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cyclekit.dataset.dataset import Dataset

TASKS = "LLLWXY"


def _stepping_back(order: str) -> str:
    """Return an order in which he goes behind the line (B) after each load (L) that another follows, or nothing."""
    return order.replace("L", "LB").replace("BW", "W").replace("BX", "X").replace("BY", "Y")


def _logged(seed: int = 1, count: int = 40) -> list[str]:
    rng = np.random.default_rng(seed)
    return [_stepping_back("".join(rng.permutation(list(TASKS)))) for _ in range(count)]


def _left_out(logged: Iterable[str], order: str) -> list[tuple[int, str]]:
    return [(number, one.place) for number, one in StopOvers(logged).left_out(order)]


def test_a_step_back_between_two_tasks_at_one_place_is_missed() -> None:
    found = StopOvers(_logged())
    ((number, one),) = found.left_out("WLLXYLB")
    assert (number, one.start, one.place, one.goal, one.by_order) == (2, "L", "B", "L", True)
    assert one.times == sum(len(re.findall("(?=LBL)", order)) for order in _logged())
    assert "".join(found.through("LBLLWXY")) == "LBLBLWXY"  # one of two is named
    assert "".join(found.through("WLXLYL")) == "WLXLYL"


def test_one_line_behind_two_places_is_a_step_back_too() -> None:
    rng = np.random.default_rng(2)
    orders = ["".join(rng.permutation(list("LLMMWX"))) for _ in range(60)]
    logged = [
        "".join(f"{a}B" if b in "LM" and a in "LM" else a for a, b in zip(o, o[1:] + "$", strict=True)) for o in orders
    ]
    assert _left_out(logged, "LLWMXM") == [(1, "B")]
    assert _left_out(logged, "WLMXML") == [(2, "B"), (5, "B")]


@pytest.mark.parametrize(
    ("logged", "asked"),
    [
        (["LXLYLZ"] * 60, "LLXLYZ"),  # one order, and another of the same work
        (["LXLYLZ"] * 50 + ["LXLY"] * 10, "LLXLYZ"),  # some executions end early
        (["LXRY", "XRYL", "RYLX", "YLXR"] * 15, "LYXR"),  # the same order begun elsewhere
        (["LXLYLZ", "YLXLZL", "XLYLZL"] * 20, "LLLXYZ"),
        (["AZC"] * 60, "AC"),  # less work
        (["LBLW"] * 3, "LLW"),  # too few
    ],
)
def test_new_orders_of_the_logged_work_miss_nothing(logged: list[str], asked: str) -> None:
    assert _left_out(logged, asked) == []


def test_a_task_that_was_always_between_may_be_left_out_on_purpose() -> None:
    ((_, one),) = StopOvers(["LZL"] * 60).left_out("LL")
    assert (one.place, one.by_order) == ("Z", False)


def test_he_steps_back_at_the_end_where_he_always_did() -> None:
    logged = _logged(count=60)
    assert StopOvers(logged).at_end("L") == "B"
    assert StopOvers([*logged, *["WXL"] * 20]).at_end("L") is None
    assert StopOvers(["WXLB"] * 60).at_end("L") is None  # B may be a task


def _patched(patch: pytest.MonkeyPatch, logged: Iterable[str]) -> None:
    names = {"L": "inbound", "B": "rest", "W": "out_left_1", "X": "out_left_2", "Y": "out_right_1"}
    known = StopOvers([[names[place] for place in order] for order in logged])
    patch.setattr("cyclekit.estimate.joint.visits.StopOvers", lambda _: known)


def _both(*operator: str) -> TaskSequence:
    plan = [PlannedTask("robot", "home->conveyor"), *(PlannedTask("operator", place) for place in operator)]
    return TaskSequence.of_plan("both", plan)


CARD = CouplingCard(gates=(GateCard(agent="operator", at="leave", place="inbound", own_s=(4.0,)),))


def test_an_estimate_takes_the_step_back_and_says_so(logged: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    _patched(monkeypatch, _logged())
    asked = [_both("inbound", "inbound", "out_left_1"), _both("inbound", "rest", "inbound", "out_left_1")]
    missed, named = (estimate(Coupled(CARD), logged, [one], validate=False, extrapolate=True)[0] for one in asked)
    said = "never went from inbound straight to inbound, but by rest ("
    assert [said in " ".join(one.doubts) for one in (missed, named)] == [True, False]
    assert missed.warnings[: len(missed.doubts)] == missed.doubts
    assert missed.expected_s == pytest.approx(named.expected_s)
    assert [task.task for task in missed.plan if task.kind == "operator"] == [
        "inbound",
        "rest",
        "inbound",
        "out_left_1",
    ]


def test_a_search_of_orders_takes_the_step_back_too(logged: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    _patched(monkeypatch, _logged())
    jobs = Jobs(
        visit=("conveyor->left_2", "conveyor->left_5"), start="home", operator=("inbound", "inbound", "out_left_1")
    )
    search = PairSearch(Coupled(CARD), logged, jobs, seed=0)
    some = [search.sequence_of(0, number, "tried").plan for number in range(len(search.operators))]
    orders = {tuple(task.name for task in plan if task.agent == "operator") for plan in some}
    assert ("inbound", "rest", "inbound", "out_left_1") in orders
    assert ("inbound", "out_left_1", "inbound") in orders
    assert not any(("inbound", "inbound") in pairwise(order) for order in orders)


def test_an_interval_covers_a_task_that_may_be_left_out(logged: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = [_both("inbound", "inbound", "out_left_1"), _both("inbound", "rest", "inbound", "out_left_1")]
    plain, named = (estimate(Coupled(CARD), logged, [one], validate=False, extrapolate=True)[0] for one in asked)
    _patched(monkeypatch, ["LBLWXY"] * 40)
    (found,) = estimate(Coupled(CARD), logged, asked[:1], validate=False, extrapolate=True)
    assert found.expected_s == pytest.approx(plain.expected_s)
    assert (found.expected_low_s, found.expected_high_s) == pytest.approx((plain.expected_low_s, named.expected_high_s))
    assert f"with that the mean is {named.expected_s:.1f} s" in found.doubts[0]


def test_after_the_last_task_he_stands_where_he_stepped_back(logged: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    _patched(monkeypatch, _logged(count=60))
    found = one_track(logged, monkeypatch, (("inbound", 3.0), ("rest", 2.0), ("out_left_1", 4.0)), CouplingCard())
    xyz_m, first, count = found.table()
    (number,) = found.after("inbound").tolist()
    end_m = xyz_m[first[number] + count[number] - 1]
    assert end_m[:2] == pytest.approx(logged.human_places["rest"].xyz_m[:2], abs=0.3)
