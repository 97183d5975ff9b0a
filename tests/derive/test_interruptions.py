"""Interrupted executions: a break or a fault is no part of the cycle time, a wait that comes in all lengths is."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import polars as pl
import pytest
from known_cells import Constant

from cyclekit import schema
from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import ExecutionCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.derive.interruptions import interruption_notes, with_interruptions
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.rollout import estimate
from cyclekit.ingest.ingest import ingest

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from simulated_cells import Cells

BREAK_S = 900.0


def cards(count: int) -> list[ExecutionCard]:
    return [ExecutionCard(execution=str(n), session="s", start_s=0.0, end_s=1.0, complete=True) for n in range(count)]


def of(took_s: Sequence[float], *, paused_s: float = 0.0, lost_s: float = 0.0) -> pl.DataFrame:
    """Return one task of each execution; the last one lost this time to safety, or was paused."""
    none = dict.fromkeys(schema.TASKS)
    rows = [
        none | {
            "execution": str(n), "task": "a->b", "start_place": "a", "start_s": 0.0, "end_s": s, "safety_loss_s": 0.0,
            "lost_pause_s": 0.0,
        }
        for n, s in enumerate(took_s)
    ]  # fmt: skip
    rows[-1] |= {"lost_pause_s": paused_s, "safety_loss_s": lost_s}
    return pl.DataFrame(rows, schema={name: column.dtype for name, column in schema.TASKS.items()})


def stopped(tasks: pl.DataFrame) -> dict[str, float]:
    marked = with_interruptions(cards(tasks.height), tasks)
    assert all(card.whole != bool(card.interrupted_s) for card in marked)
    return {card.execution: card.interrupted_s for card in marked if card.interrupted_s}


USUAL = [20.0] * 19


def test_a_long_break_interrupts_its_execution() -> None:
    assert stopped(of([*USUAL, 20.0 + BREAK_S])) == {"19": pytest.approx(BREAK_S)}


def test_a_break_shorter_than_a_cycle_is_part_of_the_work() -> None:
    assert not stopped(of([*USUAL, 28.0]))


def test_a_person_who_stops_the_robot_for_long_is_no_interruption() -> None:
    assert not stopped(of([*USUAL, 20.0 + BREAK_S], lost_s=BREAK_S))


def test_waits_of_all_lengths_are_no_interruptions() -> None:
    assert not stopped(of([*USUAL, 35.0, 48.0, 75.0]))


def test_long_repetitions_that_come_often_are_another_product() -> None:
    assert not stopped(of([20.0, 20.0, 20.0, 200.0] * 5))


def test_a_paused_program_is_told_by_its_state_however_often() -> None:
    often = of([20.0, 20.0, 20.0, 220.0])
    assert not stopped(often)
    assert stopped(often.with_columns(lost_pause_s=pl.when(pl.col("end_s") > 200.0).then(200.0).otherwise(0.0)))


def test_the_note_says_how_many_and_what_they_would_add() -> None:
    marked = with_interruptions(cards(20), of([*USUAL, 20.0 + BREAK_S]))
    (said,) = interruption_notes(marked)
    assert said.text.startswith("1 of 20 executions were interrupted")
    assert "900 s in 19" in said.text
    assert "45.0 s longer" in said.text


def with_break(log: Path, at_s: float) -> None:
    """Let the robot stand still for BREAK_S in a log."""
    rows = pl.read_csv(log, separator=" ")
    time_s = rows["timestamp"] - rows["timestamp"][0]
    stands = rows[int((time_s < at_s).sum())]
    step_s = float(time_s[1])
    held = pl.concat([stands] * round(BREAK_S / step_s))
    held = held.with_columns(timestamp=stands["timestamp"][0] + pl.Series(range(held.height)) * step_s)
    later = rows.filter(time_s >= at_s).with_columns(pl.col("timestamp") + BREAK_S)
    pl.concat([rows.filter(time_s < at_s), held, later]).write_csv(log, separator=" ")


@pytest.fixture(scope="module")
def interrupted(cells: Cells, tmp_path_factory: pytest.TempPathFactory) -> tuple[Dataset, Dataset]:
    """Eight executions from the robot's log, without a break and with one on a motion."""
    folder, cell = tmp_path_factory.mktemp("interrupted"), cells("scanner-fields", 8)
    shutil.copytree(cell.logs, folder / "logs", ignore=shutil.ignore_patterns("truth"))
    before = cell.dataset
    moves = before.tasks().filter(pl.col("execution") == before.executions["execution"][4])
    at_s = float((moves["start_s"][2] + moves["arrival_s"][2]) / 2.0)
    (log,) = (folder / "logs").rglob("robot.csv")
    with_break(log, at_s)
    ingest([folder / "logs"], folder / "after")
    return before, Dataset.open(folder / "after")


def test_a_break_in_a_log_is_found_and_said(interrupted: tuple[Dataset, Dataset]) -> None:
    _, after = interrupted
    (card,) = [one for one in after.card.executions if one.interrupted_s]
    assert card.interrupted_s == pytest.approx(BREAK_S, abs=5.0)
    assert any("1 of 8 executions were interrupted" in one.text for one in after.card.warnings)
    assert after.executions["complete"].sum() == 7


def test_a_break_in_a_log_changes_no_estimate(interrupted: tuple[Dataset, Dataset]) -> None:
    before, after = interrupted
    order = TaskSequence("order", before.card.executions[4].places)
    (usual,), (found,) = (estimate(Constant(1.0), one, [order], estimator="history") for one in interrupted)
    assert found.expected_s == pytest.approx(usual.expected_s, rel=0.03)
    assert found.expected_high_s - found.expected_low_s < 10.0
    assert any("executions were interrupted" in text for text in found.warnings)
    usual_s, found_s = (sum(t.dwell_s + t.wait_s for t in nominal_tasks(one).values()) for one in (before, after))
    assert found_s == pytest.approx(usual_s, abs=1.0)
