"""Numbers and conditions that cannot be are refused in a sentence where a card or a file is read."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fabricated import fabricate_dataset
from known_cells import TrueStaircase
from msgspec import inspect

from cyclekit.api.ingest import ingest_logs
from cyclekit.config import Cell, load_cell
from cyclekit.config.project import Project
from cyclekit.config.sequences import TaskSequence, load_sequences
from cyclekit.dataset.cards import BadCard, checked
from cyclekit.dataset.cards.coupling import CouplingCard
from cyclekit.dataset.cards.dataset import DynamicsCard
from cyclekit.dataset.cards.quantities import Card
from cyclekit.dataset.cards.rule import RuleCard
from cyclekit.dataset.cards.task_model import TaskModelCard
from cyclekit.errors import ConfigError, EstimateError
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.whatif.change import load_changes
from cyclekit.fleet.read import FleetCell, load_fleet
from cyclekit.text.durations import seconds_in
from cyclekit_sim import simulate


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
            "conditions in a circle: arm: pick needs the end of Ann: fill needs Ann: fill needs the end of arm: pick",
        ),
        ([task("pick", needs=needs("pick", "arm"))], "conditions in a circle"),
        (
            [task("pick", needs=needs("fill", "Ann")), task("fill", "Ann", joint={"agent": "arm", "task": "pick"})],
            "conditions in a circle",
        ),
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
        ([gate("robot", "leave", "operator", "arrives", lag_s=[3.0, 1.0])], "lag_s must be ascending"),
        ([gate("robot", "leave", "operator", "arrives", turns=[0, 0, 1, 0])], "turns"),
        ([{"agent": "robot", "at": "leave", "place": "a", "own_s": [2.0, 1.0]}], "own_s must be ascending"),
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
    with pytest.raises(ConfigError, match=r"change 'odd'|change\[0\]"):
        load_changes(tmp_path / "changes.toml")


SOURCE = '[[sources]]\npath = "x"\n'
CELLS = ["bridge_s = -1.0", "bridge_s = 1e9", "[executions]\ngap_s = 1e15", f"{SOURCE}clock_rate = 1e-300"]
CELLS += ["[places.a]\nxyz_m = [0.0, 0.0, 0.0]\nradius_m = 1e12"]


@pytest.mark.parametrize("text", CELLS)
def test_a_cell_that_cannot_be_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"expected a number"):
        load_cell(tmp_path / "cell.toml")


FILES: dict[str, tuple[str, Callable[[Path], object]]] = {
    "cell.toml": (
        """
rate_hz = 10.0
bridge_s = 0.3
levels = [0.0, 1.0]
[[sources]]
path = "people.csv"
clock_offset_s = 0.5
clock_rate = 1.0
rate_hz = 30.0
frame = { xyz_m = [0.0, 0.0, 0.0], yaw_deg = 90.0 }
[[sources]]
path = "other.csv"
sync_events = [[1.0, 2.0], [3.0, 4.0]]
[places.home]
xyz_m = [0.4, 0.0, 0.4]
radius_m = 0.05
[furniture.table]
xyz_m = [1.4, 0.0, 0.4]
size_m = [1.0, 1.0, 1.0]
yaw_deg = 30.0
[executions]
gap_s = 2.0
bit = 3
[robot]
dh = [[0.34, 0.0, -90.0, 0.0]]
tool_m = [0.0, 0.0, 0.1]
[[waits]]
agent = "robot"
before = "home"
until = "operator leaves home"
back = 1
""",
        load_cell,
    ),
    "sequences.toml": (
        """
[[sequence]]
places = ["home", "left"]
allowance = 1.1
[[sequence]]
[[sequence.task]]
agent = "robot"
name = "pick"
not_before_s = 2.0
""",
        load_sequences,
    ),
    "changes.toml": (
        """
[[change]]
levels = [0.0, 1.0]
thresholds_m = [0.8]
zones = [{ x_m = [1.0, 2.5], y_m = [-1.0, 1.0], level = 0.0 }]
latency_s = 0.1
ramp_up_per_s = 2.0
hysteresis_m = 0.1
[[change]]
limits = [{ level = 0.5, threshold_m = 1.3 }]
signals = [{ signal = "mat", level = 0.7, x_m = [0.0, 1.0] }]
base = { xyz_m = [-0.5, 0.0, 0.0], yaw_deg = 10.0 }
places = { conveyor = [0.7, 0.0, 0.1] }
frequency = 0.5
faster = { operator = 1.2 }
buffer = { part = 3 }
more_places = { fixture = 1 }
""",
        load_changes,
    ),
    "fleet.toml": ('[fleet]\nseed = 1\nepochs = 3\n[[cell]]\nname = "a"\nsources = ["logs"]\n', load_fleet),
}
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?")
NONSENSE = ("nan", "-nan", "1e300", "-1e300", "-inf", "1e15", "-1e15")


@pytest.mark.parametrize("name", FILES)
def test_the_files_of_these_tests_are_read(name: str, tmp_path: Path) -> None:
    text, read = FILES[name]
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert read(tmp_path / name)


@pytest.mark.parametrize("name", FILES)
def test_a_number_that_cannot_be_is_refused_in_every_file_that_a_user_writes(name: str, tmp_path: Path) -> None:
    text, read = FILES[name]
    file = tmp_path / name
    for found in NUMBER.finditer(text):
        ramp = "ramp_" in text[: found.start()].rpartition("\n")[2]
        for nonsense in NONSENSE:
            if ramp and nonsense in {"1e300", "1e15"}:  # without a ramp
                continue
            file.write_text(text[: found.start()] + nonsense + text[found.end() :], encoding="utf-8")
            with pytest.raises(ConfigError) as caught:
                read(file)
            assert caught.value.cure


FREE = {"Note.values"}
"""Numbers that are only shown."""


def limitless(kind: inspect.Type, where: str, seen: set[type]) -> Iterator[str]:
    """Yield the numbers within a type that may be anything."""
    if isinstance(kind, inspect.FloatType | inspect.IntType):
        if None in (kind.ge if kind.gt is None else kind.gt, kind.le if kind.lt is None else kind.lt):
            yield where
    elif isinstance(kind, inspect.StructType | inspect.DataclassType | inspect.NamedTupleType):
        if kind.cls not in seen:
            seen.add(kind.cls)
            for each in kind.fields:
                yield from limitless(each.type, f"{kind.cls.__name__}.{each.name}", seen)
    else:
        inner = [getattr(kind, name, None) for name in ("item_type", "key_type", "value_type", "type")]
        for each in [*inner, *getattr(kind, "types", ()), *getattr(kind, "item_types", ())]:
            if isinstance(each, inspect.Type):
                yield from limitless(each, where, seen)


def cards(kind: type[Card] = Card) -> Iterator[type[Card]]:
    for each in kind.__subclasses__():
        yield from (each, *cards(each))


def test_every_number_of_a_card_or_cell_file_has_limits() -> None:
    seen: set[type] = set()
    kinds = [*cards(), Cell, Project, FleetCell]
    found = {where for kind in kinds for where in limitless(inspect.type_info(kind), kind.__name__, seen)}
    assert found == FREE
    assert len(seen) > 50


def test_a_takt_time_beyond_any_cell_is_refused() -> None:
    for text in ("1e300h", "1e300", "nan", "-5s"):
        with pytest.raises(ValueError, match="duration"):
            seconds_in(text)


def test_waits_of_the_cell_file_in_a_circle_are_refused(tmp_path: Path) -> None:
    logs = simulate("box-picking", tmp_path / "logs", executions=6, seed=0)
    waits = [("robot", "left_1", "operator arrives out_left_1"), ("operator", "out_left_1", "robot arrives left_1")]
    text = (logs / "cell.toml").read_text(encoding="utf-8")
    text += "".join(f'\n[[waits]]\nagent = "{who}"\nbefore = "{at}"\nuntil = "{until}"\n' for who, at, until in waits)
    (logs / "cell.toml").write_text(text, encoding="utf-8")
    circle = "conditions in a circle: robot approach left_1 needs operator approach out_left_1"
    with pytest.raises(ConfigError, match=re.escape(circle)) as caught:
        ingest_logs(logs, tmp_path / "dataset")
    assert "back = 1" in caught.value.cure


@pytest.mark.parametrize("places", [(), ("home",)])
def test_a_sequence_without_a_task_is_refused(places: tuple[str, ...], tmp_path: Path) -> None:
    logged = fabricate_dataset(tmp_path / "dataset", executions=2, rounds=1)
    with pytest.raises(EstimateError, match="fewer than two places"):
        estimate(TrueStaircase(), logged, [TaskSequence("empty", places)], other_cell=True)
