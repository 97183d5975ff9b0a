"""Numbers and conditions that cannot be are refused in a sentence where a card or a file is read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from cyclekit.config import load_cell
from cyclekit.dataset.cards import BadCard, checked
from cyclekit.dataset.cards.coupling import CouplingCard
from cyclekit.dataset.cards.dataset import DynamicsCard
from cyclekit.dataset.cards.rule import RuleCard
from cyclekit.dataset.cards.task_model import TaskModelCard
from cyclekit.errors import ConfigError
from cyclekit.estimate.whatif.change import load_changes


def task(name: str, agent: str = "arm", **others: Any) -> dict[str, Any]:
    times = {"usual_s": 2.0, "work_s": [2.0], "rates": {"": 1.0}, "after": {"": 1.0}, "lags_s": [0.1]}
    return {"agent": agent, "task": name, **times, **others}


def model(*tasks: dict[str, Any]) -> dict[str, Any]:
    return {"agents": {"arm": "robot", "Ann": "operator"}, "tasks": list(tasks), "executions": 3}


def needs(name: str, agent: str, **others: Any) -> list[dict[str, Any]]:
    return [{"agent": agent, "task": name, **others}]


def test_a_model_of_tasks_as_it_should_be_is_read() -> None:
    other = task("fill", "Ann", needs=needs("pick", "arm", back=1))
    assert len(checked(model(task("pick", needs=needs("fill", "Ann")), other), TaskModelCard).tasks) == 2


@pytest.mark.parametrize(
    ("tasks", "said"),
    [
        ([task("pick", rates={"": 1e-300})], "rates"),
        ([task("pick", lags_s=[-1e6])], "lags_s"),
        ([task("pick", work_s=[1e9])], "work_s"),
        ([task("pick", needs=needs("fill", "Ann"))], "arm: pick waits for Ann: fill, which is no task of the model"),
        ([task("pick", joint={"agent": "Ann", "task": "x"})], "arm: pick waits for Ann: x, which is no task"),
        (
            [task("pick", needs=needs("fill", "Ann")), task("fill", "Ann", needs=needs("pick", "arm"))],
            "conditions in a circle: arm: pick needs Ann: fill needs arm: pick",
        ),
        ([task("pick", needs=needs("pick", "arm"))], "conditions in a circle"),
    ],
)
def test_a_model_of_tasks_that_cannot_be_is_refused(tasks: list[dict[str, Any]], said: str) -> None:
    with pytest.raises(BadCard, match=re.escape(said)):
        checked(model(*tasks), TaskModelCard)


def gate(agent: str, at: str, other: str, event: str, **others: Any) -> dict[str, Any]:
    condition = {"agent": other, "place": "fixture", "event": event, "lag_s": [0.5], **others}
    return {"agent": agent, "at": at, "place": "fixture", "conditions": [condition]}


def test_agents_that_hand_over_or_take_turns_are_no_circle() -> None:
    handover = [gate("robot", "leave", "operator", "arrives"), gate("operator", "leave", "robot", "arrives")]
    turns = [gate("robot", "approach", "operator", "leaves", back=1), gate("operator", "approach", "robot", "leaves")]
    for gates in (handover, turns):
        assert checked({"gates": gates}, CouplingCard).coupled


@pytest.mark.parametrize(
    ("gates", "said"),
    [
        ([gate("robot", "leave", "operator", "arrives", lag_s=[-1e6])], "lag_s"),
        (
            [gate("robot", "approach", "operator", "leaves"), gate("operator", "approach", "robot", "leaves")],
            "conditions in a circle",
        ),
    ],
)
def test_waits_that_never_end_are_refused(gates: list[dict[str, Any]], said: str) -> None:
    with pytest.raises(BadCard, match=said):
        checked({"gates": gates}, CouplingCard)


def test_a_response_that_no_safety_function_has_is_refused() -> None:
    limit = {"scaling": 0.0, "within": {"anywhere": True}}
    rule = {"family": "presence", "levels": [0.0, 1.0], "limits": [limit], "explained": 1.0}
    assert checked(rule, RuleCard).latency_s == 0.0
    with pytest.raises(BadCard, match="latency_s"):
        checked({**rule, "latency_s": 1e9}, RuleCard)
    for key, value in (("latency_s", 1e9), ("ramp_up_per_s", 1e-300), ("ramp_down_per_s", -1.0)):
        with pytest.raises(BadCard, match=key):
            checked({key: value}, DynamicsCard)


CHANGES = ["latency_s = 1e9", "ramp_up_per_s = 1e-300", "hysteresis_m = 1e9", "frequency = 1e-300"]
CHANGES += ["faster = { operator = 1e-300 }", "levels = [0.0, 1.0]\nthresholds_m = [1e9]"]


@pytest.mark.parametrize("key", CHANGES)
def test_a_change_that_cannot_be_is_refused(key: str, tmp_path: Path) -> None:
    (tmp_path / "changes.toml").write_text(f'[[change]]\nname = "odd"\n{key}\n', encoding="utf-8")
    with pytest.raises(ConfigError, match="change 'odd'"):
        load_changes(tmp_path / "changes.toml")


SOURCE = '[[sources]]\npath = "x"\n'
CELLS = ["bridge_s = -1.0", "bridge_s = 1e9", "[executions]\ngap_s = 1e15", f"{SOURCE}clock_rate = 1e-300"]
CELLS += ["[places.a]\nxyz_m = [0.0, 0.0, 0.0]\nradius_m = 1e12"]


@pytest.mark.parametrize("text", CELLS)
def test_a_cell_that_cannot_be_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"expected a number"):
        load_cell(tmp_path / "cell.toml")
