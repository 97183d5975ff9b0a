"""Signals that tell of people, found among others: fields of a scanner beside what the robot and the program set."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import polars as pl
import pytest
from fabricated import fabricate_dataset
from simulated_cells import ROBOT_START_S

from cyclekit.config.cells import OperatorSignal
from cyclekit.config.read import load_cell
from cyclekit.config.write import cell_to_toml
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.signals import SignalChanges
from cyclekit.derive.signals.operator_signals import find_signals
from cyclekit.derive.signals.session_signals import _held_events
from cyclekit.derive.signals.signal_evidence import SignalEvidence
from cyclekit.errors import UnknownName
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.evaluation.evaluate import evaluate
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.rules.of_dataset import rule_of
from cyclekit.learning.rules.safety import RuleSafety, predictor_of
from cyclekit.learning.rules.words import place_of
from cyclekit.learning.training import train
from cyclekit_sim import SimulationOptions, simulate

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from simulated_cells import Cells, SimulatedCell

    from cyclekit.derive.second_pass import SecondPassResult

LEVELS = (0.0, 0.5, 1.0)
EXECUTION_S, EXECUTIONS, STEP_S, DELAY_S = 60.0, 10, 0.1, 0.12
SEEDS = [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))]


def changes(times_s: np.ndarray, first: str = "0") -> SignalChanges:
    """Return a bit that flips at these times."""
    other = {"0": "1", "1": "0"}
    values = [first if n % 2 == 0 else other[first] for n in range(len(times_s) + 1)]
    return SignalChanges(np.append(-1.0, times_s), np.array(values))


def evidence(seed: int, *, more: Mapping[str, SignalChanges] | None = None) -> SignalEvidence:
    """Return a cell: the robot swings along y; a warning field slows it, a protective one stops it where y > 0.3."""
    rng = np.random.default_rng(seed)
    end_s = EXECUTION_S * EXECUTIONS
    t_s = np.arange(0.0, end_s, STEP_S)
    y_m = 0.6 * np.sin(2 * np.pi * t_s / 8.0)
    warning_s = np.sort(rng.uniform(0.0, end_s, 80))
    protective_s = np.sort(rng.uniform(0.0, end_s, 60))
    warning, protective = changes(warning_s), changes(protective_s, "1")
    program_s = np.arange(2.0, end_s, 4.0)  # at the turns of the swing
    fine_s = np.arange(0.0, end_s, 0.004)

    def level(at_s: np.ndarray) -> np.ndarray:
        stop = (protective.at(at_s - DELAY_S) == "0") & (np.interp(at_s, t_s, y_m) > 0.3)
        return np.where(stop, 0, np.where(warning.at(at_s - DELAY_S) == "1", 1, 2))

    fine = level(fine_s)
    falls_s, rises_s = fine_s[1:][np.diff(fine) < 0], fine_s[1:][np.diff(fine) > 0]
    lamp_s = np.sort(np.concatenate([falls_s, rises_s])) + 0.1
    signals = {
        "digital-input 2": warning,
        "digital-input 3": protective,
        "digital-input 4": changes(lamp_s),
        "digital-input 5": changes(program_s),
        "digital-input 6": changes(np.sort(rng.uniform(0.0, end_s, 200))),
        "digital-input 7": changes(program_s + 0.04),
        "digital-output 0": changes(program_s),
        "register": changes(falls_s - 0.2),
        **(more or {}),
    }
    place = np.column_stack([np.full(len(t_s), 0.4), y_m])
    task = (t_s // 4.0 % 2).astype(np.int64)
    execution = (t_s // EXECUTION_S).astype(np.int64)
    return SignalEvidence(t_s, level(t_s), place, task, execution, falls_s, rises_s, signals, LEVELS)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_fields_are_found_with_delay_and_polarity_and_nothing_else_is(seed: int) -> None:
    found = find_signals(evidence(seed))
    assert {one.signal: one.occupied for one in found.cards} == {"digital-input 2": "1", "digital-input 3": "0"}
    assert [one.delay_s for one in found.cards] == pytest.approx([DELAY_S, DELAY_S], abs=0.01)
    assert found.cards[-1].explained > 0.9
    assert found.latency_s == pytest.approx(DELAY_S, abs=0.01)


def three_fields(seed: int, *, walks_s: tuple[float, float]) -> SignalEvidence:
    """Return a cell whose operator is outside, at the belt or at the boxes, and walks for so long in between.

    A warning field is on unless he is outside, and so two of three fields tell nearly always what the third one says.
    The belt's stops the robot at y < -0.2, that of the boxes slows it to 0.25 at y > 0.1, the warning field to 0.5.
    """
    rng = np.random.default_rng(seed)
    end_s, at_s, now = EXECUTION_S * EXECUTIONS, 0.0, 0
    begins: list[tuple[float, int]] = [(-1.0, 0)]  # 0 outside, 1 at the belt, 2 at the boxes, 3 walking inside
    while at_s < end_s:
        now = int(rng.choice([one for one in range(3) if one != now]))
        begins += [(at_s, 3), (at_s + float(rng.uniform(*walks_s)), now)]
        at_s = begins[-1][0] + float(rng.uniform(3.0, 9.0))
    times_s, where = np.array([t for t, _ in begins]), np.array([w for _, w in begins])

    def field(on: np.ndarray) -> SignalChanges:
        turned = np.flatnonzero(np.diff(on.astype(int), prepend=-1))
        return SignalChanges(times_s[turned], np.where(on[turned], "1", "0"))

    warning, belt, boxes = field(where != 0), field(where == 1), field(where == 2)
    t_s, fine_s = np.arange(0.0, end_s, STEP_S), np.arange(0.0, end_s, 0.004)
    y_m = 0.6 * np.sin(2 * np.pi * t_s / 8.0)

    def level(of_s: np.ndarray) -> np.ndarray:
        on = [one.at(of_s - DELAY_S) == "1" for one in (warning, belt, boxes)]
        y = np.interp(of_s, t_s, y_m)
        return np.where(on[1] & (y < -0.2), 0, np.where(on[2] & (y > 0.1), 1, np.where(on[0], 2, 3)))

    change = np.diff(level(fine_s))
    signals = {
        "warning": warning,
        "belt": belt,
        "boxes": boxes,
        "boxes again": boxes._replace(t_s=boxes.t_s - 0.01),
        "part": changes(np.sort(rng.uniform(0.0, end_s, 200))),
    }
    place = np.column_stack([np.full(len(t_s), 0.4), y_m])
    task, execution = (t_s // 4.0 % 2).astype(np.int64), (t_s // EXECUTION_S).astype(np.int64)
    falls_s, rises_s = fine_s[1:][change < 0], fine_s[1:][change > 0]
    return SignalEvidence(t_s, level(t_s), place, task, execution, falls_s, rises_s, signals, (0.0, 0.25, 0.5, 1.0))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_field_that_two_others_nearly_tell_is_found_as_well(seed: int) -> None:
    cards = find_signals(three_fields(seed, walks_s=(0.2, 0.5))).cards
    explained = [0.0, *(one.explained for one in cards)]
    assert {one.signal for one in cards} in ({"warning", "belt", "boxes"}, {"warning", "belt", "boxes again"})
    assert explained[3] - explained[2] < 0.02  # no more than that, of all the lost time
    assert explained[3] > 0.99


@pytest.mark.parametrize("seed", SEEDS)
def test_a_field_that_two_others_tell_at_all_times_is_not_needed(seed: int) -> None:
    assert len(find_signals(three_fields(seed, walks_s=(0.0, 0.004))).cards) == 2


def test_what_the_cell_file_names_is_taken_and_nothing_else_is_looked_for() -> None:
    told = (OperatorSignal("protective field", "digital-input 3", "0"),)
    (card,) = find_signals(evidence(3), told).cards
    assert (card.name, card.signal, card.occupied, card.told) == ("protective field", "digital-input 3", "0", True)
    assert card.delay_s == pytest.approx(DELAY_S, abs=0.01)


def test_where_none_is_found_those_that_follow_the_speed_are_told() -> None:
    known = evidence(3)
    assert not find_signals(known).follow
    late = {
        name: one._replace(t_s=one.t_s + 0.2) if name in ("digital-input 2", "digital-input 3") else one
        for name, one in known.signals.items()
    }
    found = find_signals(dataclasses.replace(known, signals=late))
    assert not found.cards
    assert dict(found.follow) == pytest.approx(
        {"digital-input 2": 0.08, "digital-input 3": 0.08, "digital-input 4": 0.1}, abs=0.015
    )


def test_a_field_that_changes_in_the_row_of_the_speed_is_found() -> None:
    known, row_s = evidence(3), 0.04
    late = {
        name: one._replace(t_s=one.t_s + DELAY_S + row_s) if name in ("digital-input 2", "digital-input 3") else one
        for name, one in known.signals.items()
        if name != "digital-input 4"  # the lamp
    }
    same_row = dataclasses.replace(known, signals=late, period_s=row_s)
    assert {card.signal for card in find_signals(same_row).cards} == {"digital-input 2", "digital-input 3"}
    assert not find_signals(dataclasses.replace(same_row, period_s=0.008)).cards  # five rows after the speed


def test_a_signal_that_no_log_holds_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(UnknownName, match="door_closed") as refused:
        find_signals(evidence(3), (OperatorSignal("door", "door_closed", "0"),))
    assert "digital-input 3" in (refused.value.cure or "")


def test_signals_of_the_cell_file_are_read_and_written(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    text = '[[operator_signals]]\nname = "mat"\nsignal = "digital-input 3"\noccupied = '
    for value in ("0", "false", '"0"'):
        file.write_text(f'name = "c"\n{text}{value}\n', encoding="utf-8")
        cell = load_cell(file)
        assert cell.operator_signals == (OperatorSignal("mat", "digital-input 3", "0"),) or value == "false"
        assert cell.operator_signals[0].occupied == "0"
    file.write_text(cell_to_toml(cell), encoding="utf-8")
    assert load_cell(file).operator_signals == cell.operator_signals


def test_a_dataset_of_an_earlier_version_opens_with_the_signals_unknown(tmp_path: Path) -> None:
    dataset = fabricate_dataset(tmp_path / "old", executions=2, rounds=1)
    for file in (dataset.path / "samples").iterdir():
        pl.read_parquet(file).drop("human_signals").write_parquet(file)
    opened = Dataset.open(dataset.path)
    assert opened.card.operator_signals == ()
    assert opened.samples()["human_signals"].null_count() == opened.samples().height > 0


@pytest.fixture(scope="module")
def fields(cells: Cells) -> SimulatedCell:
    return cells("scanner-fields", 8)


def test_bits_in_the_samples_are_those_of_the_true_position(fields: SimulatedCell) -> None:
    cards = fields.dataset.card.operator_signals
    assert {(one.signal, one.occupied) for one in cards} == {("digital-input 4", "1"), ("digital-input 5", "0")}
    true = fields.samples.select("t_s", "human_x_m", "human_y_m").with_columns(pl.col("t_s") - ROBOT_START_S)
    mine = fields.dataset.samples(columns=["t_s", "human_signals"]).sort("t_s")
    both = mine.join_asof(true.sort("t_s"), on="t_s", strategy="nearest", tolerance=0.02).drop_nulls("human_signals")
    warning = pl.col("human_x_m").is_between(-1.2, 2.5) & pl.col("human_y_m").is_between(-1.5, 2.0)
    bit = next(k for k, one in enumerate(cards) if one.signal == "digital-input 4")
    agrees = both.select((pl.col("human_signals") // 2**bit % 2 == 1) == warning.fill_null(value=False)).to_series()
    assert agrees.mean() > 0.995


def test_the_rule_says_which_field_counts_where(fields: SimulatedCell) -> None:
    found = rule_of(fields.dataset, fields.dataset.levels)
    assert found.rule is not None
    assert found.rule.explained > 0.99
    stop, slow = found.rule.limits
    (protective,), (warning,) = stop.within.signals, slow.within.signals
    assert (protective.signal, protective.value, warning.signal) == ("digital-input 5", "0", "digital-input 4")
    assert warning.robot is None
    assert protective.robot is not None
    low, high = protective.robot.across
    assert low is not None
    assert low.value == pytest.approx(0.05, abs=0.05)
    assert high is None
    assert place_of(protective).startswith("at y above 0.0")


def test_time_lost_to_a_field_is_lost_to_people(fields: SimulatedCell) -> None:
    lost = fields.dataset.samples(columns=["lost_to"])["lost_to"].drop_nulls()
    assert (lost == "person").mean() > 0.95


@pytest.mark.slow
def test_a_model_is_trained_and_judged_without_a_tracker(fields: SimulatedCell) -> None:
    model = train(fields.dataset, ModelSpec.of("now", "classifier", epochs=3), rules=True)
    safety = predictor_of(model)
    assert isinstance(safety, RuleSafety)
    at_m = np.array([[0.0, 0.5, 0.1], [0.0, -0.5, 0.1], [0.0, 0.5, 0.1]])
    both = (1 << len(model.card.operator_signals)) - 1
    assert safety.predict_signals(at_m, np.array([both, both, 0])).tolist() == [0.0, 0.5, 1.0]
    rows = {row.name: row.mse for row in evaluate(model, fields.dataset, boosting=False).mse}
    assert rows["rule"] < 0.01 < rows["constant mean"]
    assert rows["rule"] < rows["signals alone"]


def test_a_field_that_nobody_enters_during_an_execution_says_that_nobody_is_there(tmp_path: Path) -> None:
    one_file_each = SimulationOptions(executions_per_session=1)
    simulate("scanner-fields", tmp_path / "logs", executions=8, seed=4, options=one_file_each)
    ingest(tmp_path / "logs", tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    bits = dataset.samples(columns=["execution", "human_signals"])
    assert bits["human_signals"].null_count() == 0
    protective = next(k for k, one in enumerate(dataset.card.operator_signals) if one.occupied == "0")
    entered = bits.group_by("execution").agg((pl.col("human_signals") // 2**protective % 2 == 1).any())
    assert set(entered["human_signals"].to_list()) == {True, False}


def test_a_signal_without_a_row_in_a_log_of_events_keeps_its_state_where_its_neighbours_agree() -> None:
    logs = [
        SimpleNamespace(silences=[], recordings=(SimpleNamespace(tables=t),))
        for t in (["events"], ["events"], ["events"], [])
    ]
    made = cast("list[SecondPassResult]", logs)
    first = third = SignalChanges(np.array([1.0, 5.0]), np.array(["1", "0"]))
    held = _held_events(made, [first, None, third, None])
    assert [None if one is None else one.value.tolist() for one in held] == [None, ["0"], None, None]
    other_state = third._replace(value=np.array(["0", "1"]))
    assert _held_events(made, [first, None, other_state, None]) == [None] * 4
