"""A spot where the robot waits short of a place is no place, and standing there is wait and no motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cyclekit.config import Executions
from cyclekit.dataset.dataset import Place
from cyclekit.scaling.infer.override import infer_overrides
from cyclekit.segmentation.arrivals import place_standstills, unchanged
from cyclekit.segmentation.dwell import usual_dwells
from cyclekit.segmentation.executions import Execution, Visit, find_executions, find_visits
from cyclekit.segmentation.motion import STANDING, InferredScaling, RobotRun
from cyclekit.segmentation.places import find_places
from cyclekit.segmentation.standstills import Standstill, find_standstills
from cyclekit.segmentation.time_account import ExecutedTask, time_account
from cyclekit.segmentation.waits import with_waits

STEP_S, WAY_S, DWELL_S = 0.01, 1.0, 0.8
WAITS_S = (2.5, 0.0, 0.6, 0.0, 1.4, 4.0, 0.0, 0.9)
SPOT_M, END_M = 0.5, 1.0


def _run(
    halted_s: float = 0.0, at_end: tuple[tuple[float, float], ...] = (), waits_s: tuple[float, ...] = WAITS_S
) -> RobotRun:
    """Return a robot that goes to and fro; on its way there it waits, and is then halted by safety for `halted_s`.

    At the far end it waits, and is then halted, for as long as `at_end` tells of each time.
    """
    parts: list[tuple[float, float, float]] = [(0.0, 0.0, DWELL_S)]
    for number, wait_s in enumerate(waits_s):
        stays_s, held_s = at_end[number] if at_end else (0.0, 0.0)
        parts += [(0.0, SPOT_M, WAY_S), (SPOT_M, SPOT_M, wait_s), (SPOT_M, SPOT_M, -halted_s if wait_s else 0.0)]
        parts += [(SPOT_M, END_M, WAY_S), (END_M, END_M, DWELL_S + stays_s), (END_M, END_M, -held_s)]
        parts += [(END_M, 0.0, 2 * WAY_S), (0.0, 0.0, DWELL_S)]
    x, scaling = [], []
    for begin, end, lasts_s in parts:
        u = np.arange(round(abs(lasts_s) / STEP_S)) / max(1, round(abs(lasts_s) / STEP_S))
        x.append(begin + (end - begin) * u**3 * (10.0 - 15.0 * u + 6.0 * u**2))
        scaling.append(np.full(len(u), 0.0 if lasts_s < 0.0 else 1.0))
    along = np.concatenate(x)
    xyz = np.column_stack([along, 0.3 * np.sin(2.0 * along), np.zeros(len(along))])
    speed = np.linalg.norm(np.gradient(xyz, STEP_S, axis=0), axis=1)
    t_s = np.arange(len(along), dtype=np.float64) * STEP_S
    return RobotRun(t_s, xyz, np.asarray(speed, np.float64), np.concatenate(scaling))


def _found(run: RobotRun) -> tuple[list[Execution], dict[str, Place]]:
    stops = find_standstills(run, 0)
    places = find_places([run], stops, {})
    assert sorted(round(place.xyz_m[0], 2) for place in places.values()) == [0.0, END_M]
    visits = find_visits(stops, places, [run])
    executions = find_executions(visits, places, Executions("file"), [np.empty(0, np.int64)])
    return with_waits(executions, stops, [run]), places


def _legs(run: RobotRun) -> list[ExecutedTask]:
    executions, places = _found(run)
    standstills = place_standstills([run], executions, places)
    return time_account(run, executions[0], standstills, usual_dwells(executions, standstills))


def test_standing_short_of_a_place_is_wait() -> None:
    legs = _legs(_run())
    there = legs[::2]
    assert [leg.wait_s for leg in there] == pytest.approx(WAITS_S, abs=0.15)
    assert [leg.nominal_s for leg in legs] == pytest.approx([2 * WAY_S] * len(legs), abs=0.15)
    for leg, wait_s in zip(there, WAITS_S, strict=True):
        assert leg.reached_s is not None
        assert leg.went_on_s is not None
        assert leg.went_on_s - leg.reached_s == pytest.approx(wait_s, abs=0.15)
    assert all(leg.reached_s is None for leg in legs[1::2])  # on its way back it waits nowhere


@pytest.mark.parametrize("waits_s", [(0.0,) * 7 + (4.0,), (0.0, 2.5) + (0.0,) * 5 + (4.0,)])
def test_a_single_wait_short_of_a_place_is_wait_too(waits_s: tuple[float, ...]) -> None:
    there = _legs(_run(waits_s=waits_s))[::2]
    assert [leg.wait_s for leg in there] == pytest.approx(waits_s, abs=0.15)
    assert [leg.nominal_s for leg in there] == pytest.approx([2 * WAY_S] * len(there), abs=0.15)
    assert all(leg.reached_s is not None for leg in there)


def test_what_safety_holds_there_afterwards_is_safety_loss() -> None:
    halted_s = 1.5
    there = _legs(_run(halted_s))[::2]
    waited = [leg for leg, wait_s in zip(there, WAITS_S, strict=True) if wait_s]
    assert [leg.wait_s for leg in waited] == pytest.approx([w for w in WAITS_S if w], abs=0.15)
    assert [leg.safety_loss_s for leg in waited] == pytest.approx([halted_s] * len(waited), abs=0.15)
    assert all(leg.went_on_s is None for leg in waited)  # it would have gone on before, and nobody knows when


def test_who_waits_at_a_place_when_safety_halts_it_waits_on() -> None:
    """A robot that was ready to leave when it was halted loses the halt; one that was waiting began no motion in it."""
    at_end = ((0.0, 0.0), (3.0, 2.0), (0.0, 2.0), (3.0, 0.0)) * 2
    legs = _legs(_run(at_end=at_end))
    for (wait_s, held_s), there, back in zip(at_end, legs[::2], legs[1::2], strict=True):
        assert there.dwell_s == pytest.approx(DWELL_S, abs=0.1)
        assert there.end_s - there.arrival_s - there.dwell_s == pytest.approx(wait_s + held_s * (wait_s > 0), abs=0.2)
        assert back.safety_loss_s == pytest.approx(held_s if wait_s == 0.0 else 0.0, abs=0.1)


def test_standstills_beside_no_changed_row_are_not_read_again() -> None:
    run = _run(at_end=((0.0, 0.0), (3.0, 0.0)) * 4)
    executions, places = _found(run)
    whole = InferredScaling(0, run.scaling, np.zeros(run.rows), np.zeros(run.rows, np.int8))
    run = run.with_scaling([whole])
    before = place_standstills([run], executions, places)
    key, longest = max(before.items(), key=lambda item: item[1].lasts_s)
    span_s = longest.left_s - 1.0, longest.left_s
    stopped = run.with_halts([span_s])
    first, last = run.row_at(np.array(span_s)).tolist()
    known = unchanged(before, [run], {0: [(first, last)]})
    assert known.keys() == before.keys() - {key}
    after = place_standstills([stopped], executions, places, known)
    assert after == place_standstills([stopped], executions, places)
    assert after[key].halted
    assert not longest.halted
    assert after[next(iter(known))] is known[next(iter(known))]


def test_where_no_scaling_was_logged_a_wait_is_no_stop() -> None:
    run = _run()
    run = replace(run, scaling=np.full(run.rows, np.nan))
    executions, places = _found(run)
    parts, references = infer_overrides([run], executions)
    assert references
    scaled = run.with_scaling(parts[0])
    spans = [visit.reached for visit in executions[0].visits if visit.reached is not None]
    assert sum(last > first for first, last in spans) == sum(wait_s > 0.0 for wait_s in WAITS_S)
    for first, last in spans:
        if last > first:
            there = scaled.window(first, last)
            assert np.isnan(there.scaling).all()
            assert there.gap is not None
            assert (there.gap == STANDING).all()
    assert float(np.nanmin(scaled.scaling)) > 0.9  # nor is it slowed where it brakes for the wait and starts after it
    standstills = place_standstills([scaled], executions, places)
    legs = time_account(scaled, executions[0], standstills, usual_dwells(executions, standstills))[::2]
    assert [leg.wait_s for leg in legs] == pytest.approx(WAITS_S, abs=0.15)
    assert [leg.safety_loss_s for leg in legs] == pytest.approx([0.0] * len(legs), abs=0.05)


@pytest.mark.parametrize(("spread_m", "even"), [(0.004, False), (0.0, True)])
def test_where_no_scaling_was_logged_other_stops_on_the_way_are_no_waits(spread_m: float, even: bool) -> None:
    """A robot that safety stops does not stand at one position, and one that stops in passing stands equally long."""
    rng = np.random.default_rng(1)
    stops = [
        Standstill(0, row, row + round((1.0 if even else rng.uniform(0.5, 6.0)) / STEP_S), (0.5 + off, 0.0, 0.0), None)
        for row, off in zip(range(100, 9100, 900), rng.normal(0.0, 1.0, 10) * spread_m, strict=True)
    ]
    rows = 10_000
    run = RobotRun(np.arange(rows) * STEP_S, np.full((rows, 3), 9.0), np.zeros(rows), np.full(rows, np.nan))
    visits = [Visit("a", 0, 50)]
    for stop in stops:
        visits += [Visit("b", stop.last + 20, stop.last + 30), Visit("a", stop.last + 40, stop.last + 50)]
    (found,) = with_waits([Execution(0, tuple(visits), complete=True)], stops, [run])
    assert all(visit.reached is None for visit in found.visits)
