"""Waits that the cell file gives, and that the logs contradict."""

from __future__ import annotations

from pathlib import Path

from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard, SourceCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.coupling.words import contradicted, habit_lines
from cyclekit_sim import SimulationOptions, simulate

WAIT = """
[[waits]]
agent = "operator"
before = "fixture"
until = "robot arrives rack_1"
"""


def card(*, told: bool, held: float) -> CouplingCard:
    need = ConditionCard(agent="robot", place="rack_1", event="arrives", lag_s=(0.0,), held=held)
    other = ConditionCard(agent="robot", place="fixture", event="leaves", lag_s=(0.6,), held=1.0)
    gate = GateCard(agent="operator", at="approach", place="fixture", conditions=(need, other), told=told, passages=50)
    return CouplingCard(gates=(gate,))


def test_a_wait_of_the_cell_file_that_the_logs_contradict_is_warned_of() -> None:
    (said,) = contradicted(card(told=True, held=0.22))
    assert said.text == (
        "[[waits]] in cell.toml: the operator is said to wait before fixture until robot arrives rack_1, but only 11 "
        "of 50 logged passages came after that: estimates of orders may end in deadlocks; correct or remove it"
    )


def test_a_wait_that_most_passages_obey_or_that_was_learned_is_not() -> None:
    assert contradicted(card(told=True, held=0.95)) == []
    assert contradicted(card(told=False, held=0.22)) == []
    assert contradicted(None) == []


def test_ingest_warns_of_it(tmp_path: Path) -> None:
    simulate("shared-fixture", tmp_path / "logs", executions=6, seed=9, options=SimulationOptions())
    cell = tmp_path / "logs" / "cell.toml"
    ingest([tmp_path / "logs"], tmp_path / "plain")
    assert not [one for one in Dataset.open(tmp_path / "plain").card.warnings if one.code == "wait-contradicted"]
    cell.write_text(cell.read_text(encoding="utf-8") + WAIT, encoding="utf-8")
    ingest([tmp_path / "logs"], tmp_path / "told")
    (said,) = (one for one in Dataset.open(tmp_path / "told").card.warnings if one.code == "wait-contradicted")
    assert said.values["agent"] == "operator"
    assert said.values["passages"] == 18


def test_parts_without_a_signal_are_called_parts() -> None:
    told = {"gap_s": (6.0, 10.0), "buffer": 2, "taken_by": "conveyor"}
    seen, unseen = (SourceCard(signal=name, inferred=name[0] == "p", **told) for name in ("belt", "part at conveyor"))
    assert habit_lines(CouplingCard(sources=(seen,))) == [
        "parts of belt come 6.2 to 9.8 s apart; at most 2 wait at conveyor"
    ]
    assert habit_lines(CouplingCard(sources=(unseen,))) == ["parts come 6.2 to 9.8 s apart; at most 2 wait at conveyor"]
