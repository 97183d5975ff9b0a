"""Outputs, registers and events that change while a robot stands tell of places, and when a process is over."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import polars as pl
import pytest
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.config import Cell, Source
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.segmentation.arrivals import PlaceStandstill
from cyclekit.segmentation.dwell import MIN_LEAD_S, Dwell, EndSignal, usual_dwells
from cyclekit.segmentation.executions import Execution, Visit

if TYPE_CHECKING:
    from pathlib import Path

Doing = list[tuple[str, float]]
WORK: Doing = [("stand", 0.2), ("flip", 3), ("stand", 0.4)]


def made_of(tmp_path: Path, logs: Path, cell: Cell | None = None) -> Dataset:
    return Dataset.open(ingest([logs], tmp_path / "dataset", cell=cell).dataset)


def where(found: Dataset) -> list[float]:
    return sorted(place.xyz_m[0] for place in found.places.values())


def rounds(*, at: Doing, often: int = 3) -> Doing:
    """Eight rounds from 0 to 1 and back; in one of so many it does `at` at 0.4."""
    doing: Doing = [("stand", 1.0)]
    for number in range(8):
        doing += [("move", 0.4), *at] if number % often == 0 else []
        doing += [("move", 1.0), *WORK, ("move", 0.0), *WORK]
    return doing


@pytest.mark.parametrize("scaling", [True, False])
def test_a_spot_at_which_the_gripper_works_is_a_place_however_often_the_robot_passes_it(
    tmp_path: Path, robot_log: Any, scaling: bool
):
    halted: Doing = [(what if what == "flip" else "halt", amount) for what, amount in WORK]
    found = made_of(tmp_path, robot_log(tmp_path / "run.csv", rounds(at=halted), scaling=scaling))
    assert where(found) == pytest.approx([0.0, 0.4, 1.0], abs=1e-3)
    assert found.tasks().height == 16 + 3


def test_an_output_that_tells_of_motion_or_halts_makes_no_place(tmp_path: Path, robot_log: Any):
    doing = [
        step
        for what, amount in rounds(at=[("halt", 2.0)])
        for step in ([("flip", 3), (what, amount), ("flip", 3)] if what == "move" else [(what, amount)])
        if what != "flip"
    ]
    found = made_of(tmp_path, robot_log(tmp_path / "run.csv", doing, scaling=False))
    assert where(found) == pytest.approx([0.0, 1.0], abs=1e-3)


def test_an_output_that_changes_on_the_way_too_makes_no_place(tmp_path: Path, robot_log: Any):
    doing = [step for each in rounds(at=[*WORK]) for step in ([each, ("flip", 3)] if each[0] == "move" else [each])]
    found = made_of(tmp_path, robot_log(tmp_path / "run.csv", doing, scaling=False))
    assert where(found) == pytest.approx([0.0, 1.0], abs=1e-3)


def halted_in_its_work(number: int, of: int) -> Doing:
    """Return work; in round `of` it waits for 2 s, and is halted for 3 s when 0.35 s of its work are left."""
    return [("stand", 2.2), ("flip", 3), ("stand", 0.05), ("halt", 3.0)] if number == of else WORK


@pytest.mark.parametrize("how", ["output", "register", "event"])
def test_after_waiting_a_signal_tells_how_much_of_a_halt_was_loss(tmp_path: Path, robot_log: Any, how: str):
    doing: Doing = [("stand", 1.0)]
    for number in range(6):
        doing += [("move", 1.0), *halted_in_its_work(number, 2), ("move", 0.0), *WORK]
    log = robot_log(tmp_path / "logs" / "run.csv", doing)
    rows = pl.read_csv(log, separator=" ")
    bits = rows["actual_digital_output_bits"]
    cell = None
    if how != "output":
        plain = rows.drop("actual_digital_output_bits")
        if how == "register":
            plain = plain.with_columns(output_int_register_0=bits // 8 + 40)
        else:
            changed = rows.filter(bits != bits.shift(1))
            events = changed.select(time_s=pl.col("timestamp") - 0.004, value=pl.col("actual_digital_output_bits") // 8)
            events.select("time_s", pl.lit("GRIP").alias("signal"), "value").write_csv(tmp_path / "logs" / "plc.csv")
            cell = Cell(sources=(Source("plc.csv", adapter="events", role="events", clock_offset_s=0.0),))
        plain.write_csv(log, separator=" ")
    tasks = made_of(tmp_path, tmp_path / "logs", cell).tasks()
    assert tasks.height == 12
    assert tasks["safety_loss_s"].to_list() == pytest.approx([0.0] * 5 + [2.65] + [0.0] * 6, abs=0.03)
    assert tasks["dwell_s"][::2].to_list() == pytest.approx([0.6] * 6, abs=0.03)  # home is no process
    assert tasks["wait_s"].to_list() == pytest.approx([0.0] * 4 + [2.0] + [0.0] * 7, abs=0.03)


def dwell_of(after_s: dict[str, list[float]], lasts_s: list[float], *, halted: int = 0) -> Dwell:
    """Return the dwell of standstills of these lengths; `after_s`: time from last change to departure, s."""
    visits = tuple(Visit("table", i, i) for i in range(len(lasts_s) + 2))
    found = {}
    for i, visit in enumerate(visits):
        lasts = lasts_s[i - 1] if 0 < i <= len(lasts_s) else 1.0
        told = tuple((name, 100.0 * i - mine[i - 1]) for name, mine in after_s.items() if 0 < i <= len(mine))
        free_s = 100.0 * i - (0.5 if 0 < i <= halted else 0.0)
        arrived_s, left_s = 100.0 * i - lasts, 100.0 * i
        found[0, visit.first, visit.last] = PlaceStandstill(arrived_s, arrived_s, free_s, left_s, told)
    return usual_dwells([Execution(0, visits, complete=True)], found)["table"]


def test_the_steadiest_signal_is_the_sign_of_a_place():
    dwell = dwell_of({"grip": [0.4, 0.4, 0.41, 3.0, 0.4], "lamp": [0.5, 0.8, 1.4, 2.0, 0.7]}, [1.0, 2.0, 3.0, 9.0, 1.0])
    assert dwell.end_signal is not None
    assert (dwell.end_signal.signal, dwell.end_signal.after_s) == ("grip", pytest.approx(0.4))


@pytest.mark.parametrize(
    "after_s",
    [
        pytest.param([MIN_LEAD_S / 2] * 6, id="it follows the motion"),
        pytest.param([0.4, 0.9, 1.3, 1.9, 2.5, 0.7], id="it is not steady"),
        pytest.param([0.4, 0.4], id="it changes in too few stands"),
    ],
)
def test_other_signals_are_no_sign(after_s: list[float]):
    assert dwell_of({"grip": after_s}, [1.0, 2.0, 3.0, 9.0, 1.0, 1.0]).end_signal is None


def test_stands_in_which_it_was_halted_do_not_say_what_is_usual():
    assert dwell_of({"grip": [9.0, 9.0, 0.4, 0.4, 0.4]}, [9.5, 9.5, 1.0, 1.0, 1.0], halted=2).end_signal == EndSignal(
        "grip", pytest.approx(0.4), pytest.approx(0.45)
    )


@at_most(60)
@given(waits_s=st.floats(0, 30), held_s=st.floats(0, 30), usual_s=st.floats(0.3, 5))
def test_a_stand_is_overdue_since_the_process_was_over_however_long_it_waited_before(waits_s, held_s, usual_s):
    after_s = 0.5 * usual_s
    dwell = Dwell(usual_s, usual_s + 0.05, EndSignal("grip", after_s, after_s + 0.05))
    standstill = PlaceStandstill(
        10.0, 10.0, left := 10.0 + waits_s + usual_s + held_s, left, (("grip", 10.0 + waits_s + after_s),)
    )
    since = dwell.excess_from_s(standstill)
    if held_s > 0.051:
        assert since == pytest.approx(10.0 + waits_s + usual_s)
    elif held_s < 0.049:
        assert since is None
    if abs(waits_s + held_s - 0.05) > 1e-3:  # without the signal waiting looks the same
        assert (dwell.excess_from_s(standstill._replace(changes=())) is not None) == (waits_s + held_s > 0.05)
    arrived, departed = standstill.times(usual_s, dwell.ready_s(standstill))
    assert (arrived, departed) == (standstill.arrived_s, standstill.left_s)


@pytest.mark.parametrize("signals", [(), (("grip", 10.2),)])
def test_a_standstill_is_not_overdue_while_its_process_is_paused(signals):
    dwell = Dwell(0.5, 0.55, EndSignal("grip", 0.3, 0.35))
    standstill = PlaceStandstill(10.0, 10.0, 14.5, 14.5, signals, ((10.4, 14.4),))
    assert dwell.excess_from_s(standstill) is None
    assert dwell.excess_from_s(standstill._replace(left_s=15.0)) == pytest.approx(14.5)
    assert dwell.excess_from_s(standstill._replace(pauses=())) == pytest.approx(10.5)


def of_works(works: dict[str, list[float]]) -> Dwell:
    """Return the dwell at `t`, between two places, from one execution per standstill of each work."""
    executions, found = [], {}
    for places, lasts_s in works.items():
        for number, last_s in enumerate(lasts_s, len(executions)):
            visits = tuple(Visit(place, at, at) for at, place in enumerate(places))
            executions.append(Execution(number, visits, complete=True))
            for at, place in enumerate(places):
                stood_s = last_s if place == "t" else 1.0
                found[number, at, at] = PlaceStandstill(0.0, 0.0, stood_s, stood_s)
    return usual_dwells(executions, found)["t"]


def test_each_work_has_its_process_where_the_standstills_of_both_are_steady():
    dwell = of_works({"atba": [4.0, 4.1, 4.05] * 3, "atca": [9.0, 9.1, 9.05] * 3})
    own = {work: one.usual_s for work, one in (dwell.of_work or {}).items()}
    assert own == {tuple("aabt"): pytest.approx(4.0), tuple("aact"): pytest.approx(9.0)}
    assert dwell.of(Execution(0, tuple(Visit(place, 0, 0) for place in "actba"), complete=True)) is dwell


@pytest.mark.parametrize(
    "other",
    [
        [4.0, 9.0, 13.0, 5.0, 7.0, 11.0, 4.5, 8.0, 6.0],  # waits: they scatter
        [9.0, 9.1, 9.05],  # too few
        [4.1, 4.2, 4.15] * 3,  # too little
    ],
)
def test_a_wait_of_one_work_is_no_process(other: list[float]):
    assert of_works({"atba": [4.0, 4.1, 4.05] * 3, "atca": other}).of_work is None
