"""Stops that last until somebody presses a reset button: a guard door, a light curtain with restart interlock."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit.config.cells import OperatorSignal
from cyclekit.config.read import load_cell
from cyclekit.config.write import cell_to_toml
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.signals import SignalChanges
from cyclekit.derive.signals.latched_signals import latched
from cyclekit.derive.signals.operator_signals import find_signals
from cyclekit.derive.signals.signal_evidence import SignalEvidence
from cyclekit.errors import UnknownName
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.rules.of_dataset import rule_of
from cyclekit_sim import SimulationOptions, simulate

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import Cells

pytestmark = pytest.mark.tests_clocks

END_S, STEP_S, DELAY_S = 900.0, 0.1, 0.12
NOTHING = np.empty(0)


def bit(*spells_s: tuple[float, float], on: str = "1", begin_s: float = -1.0) -> SignalChanges:
    """Return a bit that has the value `on` in these spells."""
    off = {"0": "1", "1": "0"}[on]
    times = [begin_s, *(at_s for spell in spells_s for at_s in spell)]
    return SignalChanges(np.array(times), np.array([off, *[on, off] * len(spells_s)]))


def spells(changes: SignalChanges) -> list[tuple[float, str]]:
    """Return the times and values of a stop."""
    return list(zip(changes.t_s.tolist(), changes.value.tolist(), strict=True))


@pytest.mark.parametrize(
    ("door", "pressed", "stop"),
    [
        ([(5, 9)], [(12, 13)], [(5, 12)]),  # until it is pressed, not until the door is closed
        ([(5, 9)], [(7, 8), (12, 13), (15, 16)], [(5, 12)]),  # with the door open it does nothing
        ([(5, 9), (10, 11)], [(12, 13)], [(5, 12)]),  # opened again before it was pressed
        ([(5, 9), (20, 21)], [(12, 13), (30, 31)], [(5, 12), (20, 30)]),
        ([(5, 9)], [], [(5, np.inf)]),
    ],
)
def test_the_stop_lasts_until_the_button_is_pressed_after_the_door_was_closed(
    door: list[tuple[float, float]], pressed: list[tuple[float, float]], stop: list[tuple[float, float]]
) -> None:
    found = latched(bit(*door, on="0"), "0", bit(*pressed), "1", NOTHING)
    edges = [(at_s, value) for spell in stop for at_s, value in zip(spell, "10", strict=True) if at_s < np.inf]
    assert spells(found) == [(-1.0, "0"), *edges]


def test_a_button_that_counts_when_it_is_let_go() -> None:
    assert spells(latched(bit((5, 9)), "1", bit((12, 13)), "0", NOTHING)) == [(-1.0, "0"), (5.0, "1"), (13.0, "0")]


def test_where_a_log_begins_in_a_stop_the_button_tells_it() -> None:
    door, button = bit((5, 9), (40, 41)), bit((22, 23), (50, 51))
    assert spells(latched(door, "1", button, "1", np.array([20.0]))) == [
        (-1.0, "0"), (5.0, "1"), (22.0, "0"), (40.0, "1"), (50.0, "0"),
    ]  # fmt: skip
    # After the gap the door is opened next, so somebody had pressed the button in the gap.
    assert spells(latched(door, "1", bit((50, 51)), "1", np.array([20.0])))[:3] == [
        (-1.0, "0"), (5.0, "1"), (20.0, "0"),
    ]  # fmt: skip
    assert spells(latched(bit((30, 31)), "1", bit((3, 4), (40, 41)), "1", NOTHING))[:2] == [(-1.0, "1"), (3.0, "0")]


def door_cell(seed: int, *, reset_works: bool = True) -> SignalEvidence:
    """Return a cell: a warning field slows the robot; a door stops it, until its button is pressed if that works."""
    rng = np.random.default_rng(seed)
    begins = np.cumsum(rng.uniform(15.0, 40.0, 30))
    warns = np.cumsum(rng.uniform(6.0, 20.0, 60))
    closed, pressed = begins + rng.uniform(2.0, 6.0, 30), begins + rng.uniform(7.0, 11.0, 30)
    door = bit(*zip(begins, closed, strict=True), on="0")
    ends = pressed if reset_works else closed
    stopped, warning = bit(*zip(begins, ends, strict=True)), bit(*zip(warns, warns + 4.0, strict=True))
    t_s, fine_s = np.arange(0.0, END_S, STEP_S), np.arange(0.0, END_S, 0.004)

    def level(at_s: np.ndarray) -> np.ndarray:
        stop, slow = (one.at(at_s - DELAY_S) == "1" for one in (stopped, warning))
        return np.where(stop, 0, np.where(slow, 1, 2))

    change = np.diff(level(fine_s))
    signals = {
        "digital-input 2": warning,
        "digital-input 3": door,
        "digital-input 4": bit(*zip(pressed, pressed + 0.3, strict=True)),
        "digital-input 5": bit(*np.sort(rng.uniform(0.0, END_S, 200)).reshape(-1, 2)),
    }
    y_m = 0.6 * np.sin(2 * np.pi * t_s / 8.0)
    place, task = np.column_stack([np.full(len(t_s), 0.4), y_m]), (t_s // 4.0 % 2).astype(np.int64)
    falls_s, rises_s = fine_s[1:][change < 0], fine_s[1:][change > 0]
    execution = (t_s // 60.0).astype(np.int64)
    return SignalEvidence(t_s, level(t_s), place, task, execution, falls_s, rises_s, signals, (0.0, 0.5, 1.0))


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_door_with_its_reset_button_is_found_among_other_signals(seed: int) -> None:
    cards = find_signals(door_cell(seed)).cards
    assert {(one.signal, one.occupied, one.reset) for one in cards} == {
        ("digital-input 2", "1", None), ("digital-input 3", "0", "digital-input 4"),
    }  # fmt: skip
    assert "digital-input 3 (reset: digital-input 4)" in {one.name for one in cards}
    assert [one.delay_s for one in cards] == pytest.approx([DELAY_S, DELAY_S], abs=0.01)
    assert cards[-1].explained > 0.97


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_button_that_does_not_end_the_stop_is_not_believed(seed: int) -> None:
    cards = find_signals(door_cell(seed, reset_works=False)).cards
    assert {(one.signal, one.reset) for one in cards} == {("digital-input 2", None), ("digital-input 3", None)}


def test_the_cell_file_names_the_reset(tmp_path: Path) -> None:
    told = (OperatorSignal("guard door", "digital-input 3", "0", "digital-input 4"),)
    (card,) = find_signals(door_cell(3), told).cards
    assert (card.name, card.signal, card.reset, card.reset_at) == (
        "guard door", "digital-input 3", "digital-input 4", "1",
    )  # fmt: skip
    assert card.explained > find_signals(door_cell(3), (dataclasses.replace(told[0], reset=None),)).cards[0].explained
    with pytest.raises(UnknownName, match="digital-input 9"):
        find_signals(door_cell(3), (dataclasses.replace(told[0], reset="digital-input 9"),))
    file = tmp_path / "cell.toml"
    file.write_text(
        'name = "c"\n[[operator_signals]]\nname = "guard door"\nsignal = "digital-input 3"\noccupied = 0\n'
        'reset = "digital-input 4"\nreset_at = 1\n',
        encoding="utf-8",
    )
    assert load_cell(file).operator_signals == told
    file.write_text(cell_to_toml(load_cell(file)), encoding="utf-8")
    assert load_cell(file).operator_signals == told


def test_a_stop_that_lasts_until_the_reset_is_the_rule_and_its_time_is_lost_to_people(cells: Cells) -> None:
    dataset = cells("guard-door", 7).dataset
    assert {(one.signal, one.reset) for one in dataset.card.operator_signals} == {
        ("digital-input 4", None), ("digital-input 5", "digital-input 8"),
    }  # fmt: skip
    search = rule_of(dataset, dataset.levels)
    assert search.explained["table of signals"] > 0.99  # 0.97 if the stop ended as the door is closed
    assert search.rule is not None
    assert [limit.scaling for limit in search.rule.limits] == [0.0, 0.5]
    assert [[one.robot for one in limit.within.signals] for limit in search.rule.limits] == [[None], [None]]
    lost = dataset.tasks().select("safety_loss_s", "lost_person_s").sum().row(0)
    assert lost[1] > 0.98 * lost[0] > 10.0
    texts = " ".join(one.text for one in dataset.card.warnings)
    assert "digital-input 5 = 0 is taken as a person's presence, which lasts until digital-input 8" in texts


def test_signals_of_a_log_in_which_the_clock_was_restarted_count_in_both_parts(tmp_path: Path) -> None:
    simulate("guard-door", tmp_path / "logs", executions=8, seed=3, options=SimulationOptions(executions_per_session=5))
    (log,) = (tmp_path / "logs" / "session_001").glob("robot.csv")
    rows = pl.read_csv(log, separator=" ")
    half = rows.height // 2
    back_s = rows["timestamp"][half] - rows["timestamp"][0]
    begun = pl.int_range(pl.len()) >= half
    rows.with_columns(pl.when(begun).then(pl.col("timestamp") - back_s).otherwise("timestamp")).write_csv(
        log, separator=" "
    )
    ingest([tmp_path / "logs"], tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    assert {one.reset for one in dataset.card.operator_signals} == {None, "digital-input 8"}
    assert dataset.card.operator_signals[-1].explained > 0.97
    session = pl.col("execution").str.split(".").list.first().alias("session")
    known = dataset.samples().group_by(session).agg(pl.col("human_signals").is_not_null().any())
    assert dict(known.iter_rows()) == {"session_000": True, "session_001": True, "session_001-2": True}
    assert any("session_001 to session_001-2" in one.text for one in dataset.card.warnings)
