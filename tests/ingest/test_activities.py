"""A PLC's trace alone: states of its signals become tasks, as if somebody had typed them as a task list."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest
from made_once import made_once

import cyclekit
from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, LogError
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import SimulationOptions, random_sequence, simulate_sequence
from cyclekit_sim.plc_only import STATION, write_plc_only

if TYPE_CHECKING:
    from pathlib import Path

MAP = 'time = "t", time_unit = "s"'
STATIONS = """t,at_1,at_2,start,field
0,0,0,0,0
1,0,0,1,0
2,1,0,0,0
3,1,0,0,1
5,0,0,0,1
6,0,1,0,0
9,0,0,0,0
11,0,0,1,0
12,0,1,0,0
14,1,0,0,0
17,0,0,0,0
"""
STEPS = """t,step
0,0
1,10
3,20
7,0
9,10
11,30
12,0
"""
WORDS = """t,state
0,HOME
1,moving
2,PICK
4,moving
5,PLACE
6,moving
7,HOME
9,moving
10,PICK
11,moving
13,HOME
14,moving
"""


def read(folder: Path, text: str, activities: str, mapping: str = MAP) -> Dataset:
    """The dataset of one trace with these activities."""
    folder.mkdir(exist_ok=True)
    (folder / "plc.csv").write_text(text, encoding="utf-8")
    _, *tags = text.partition("\n")[0].replace(";", ",").split(",")
    mapping += "" if "signal" in mapping else f", tags = {tags}"
    source = f'[[sources]]\npath = "*.csv"\nadapter = "csv"\nrole = "events"\nmap = {{ {mapping} }}\n'
    (folder / "cell.toml").write_text(f"{source}activities = [{activities}]\n", encoding="utf-8")
    ingest([folder], folder.parent / "dataset")
    return Dataset.open(folder.parent / "dataset")


def cycles(dataset: Dataset) -> list[list[tuple[Any, ...]]]:
    """The tasks of each execution: name, start and end, session time."""
    rows = dataset.every_task().sort("start_s").group_by("execution", maintain_order=True)
    return [one.select("task", "start_s", "end_s").rows() for _, one in rows]


def test_bits_of_stations_are_visits_and_a_start_button_begins_a_cycle(tmp_path: Path) -> None:
    found = read(tmp_path / "logs", STATIONS, '{ column = "at_*", cycle = "start" }')
    assert cycles(found) == [[("at_1", 1.0, 5.0), ("at_2", 6.0, 9.0)], [("at_2", 11.0, 14.0), ("at_1", 14.0, 17.0)]]
    assert found.holds_task_lists_alone
    assert found.every_task()["agent"].unique().to_list() == ["robot"]


def test_a_sampled_trace_gives_the_tasks_of_its_changes(tmp_path: Path) -> None:
    head, *rows = STATIONS.split()
    held = [
        f"{t / 10},{row.partition(',')[2]}"
        for row, later in pairwise(rows)
        for t in range(10 * int(row.partition(",")[0]), 10 * int(later.partition(",")[0]))
    ]
    sampled = read(tmp_path / "logs", "\n".join([head, *held, rows[-1], ""]), '{ column = "at_*", cycle = "start" }')
    of_samples = cycles(sampled)
    changes = read(tmp_path / "changes", STATIONS, '{ column = ["at_1", "at_2"], cycle = "start" }')
    assert of_samples == cycles(changes)


def test_the_return_to_an_idle_step_ends_a_cycle_and_leaving_it_begins_one(tmp_path: Path) -> None:
    found = read(tmp_path / "logs", STEPS, '{ column = "step", cycle = "step=0", idle = "0" }')
    assert cycles(found) == [
        [("step 10", 1.0, 3.0), ("step 20", 3.0, 7.0)],
        [("step 10", 9.0, 11.0), ("step 30", 11.0, 12.0)],
    ]


def test_the_return_to_a_working_step_begins_a_cycle(tmp_path: Path) -> None:
    found = read(tmp_path / "logs", STEPS, '{ column = "step", cycle = "step=10", idle = "0" }')
    assert cycles(found)[0] == [("step 10", 1.0, 3.0), ("step 20", 3.0, 7.0), ("to step 10", 7.0, 9.0)]


def test_the_way_back_to_the_state_that_begins_cycles_is_a_task(tmp_path: Path) -> None:
    found = read(tmp_path / "logs", WORDS, '{ column = "state", cycle = "state=HOME", idle = ["HOME", "moving"] }')
    assert cycles(found) == [
        [("PICK", 1.0, 4.0), ("PLACE", 5.0, 6.0), ("to HOME", 6.0, 7.0)],
        [("PICK", 9.0, 11.0), ("to HOME", 11.0, 13.0)],
    ]


def test_rows_of_signal_and_value_and_two_agents(tmp_path: Path) -> None:
    rows = [
        "0,step,0",
        "1,go,1",
        "2,step,10",
        "2,go,0",
        "3,bench,TRUE",
        "5,step,0",
        "6,bench,FALSE",
        "8,go,1",
        "9,step,10",
    ]
    rows += ["10,bench,TRUE", "12,bench,FALSE", "13,step,0"]
    agents = '{ column = "step", cycle = "go", idle = ["0"] }, { column = ["bench"], agent = "worker" }'
    mapping = 'time = "t", time_unit = "s", signal = "s", value = "v"'
    found = read(tmp_path / "logs", "\n".join(["t,s,v", *rows, ""]), agents, mapping)
    assert cycles(found)[0] == [("step 10", 1.0, 5.0), ("bench", 3.0, 6.0)]
    kinds = found.every_task().select("agent", "agent_name").unique().sort("agent").rows()
    assert kinds == [("operator", "worker"), ("robot", "robot")]


@pytest.mark.parametrize(
    ("activities", "seen"),
    [
        ('{ column = "at_3" }', "no signal 'at_3', which"),
        ('{ column = "at_*", cycle = "strat" }', "the nearest is 'start'"),
        ('{ colum = "at_1" }', "'colum'"),
    ],
)
def test_a_column_that_is_none_is_refused_with_those_there_are(tmp_path: Path, activities: str, seen: str) -> None:
    with pytest.raises((LogError, ConfigError)) as error:
        read(tmp_path / "logs", STATIONS, activities)
    assert seen in str(error.value)


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The trace of a cell, a row for each change, its cell file, and a model of it; `lists`: the same typed by hand."""

    def make(folder: Path) -> None:
        write_plc_only(folder / "logs" / "plc.csv", "scanner-fields", "stations", "changes", executions=24, seed=5)
        mapping = 'time = "Zeit [ms]", time_unit = "ms", decimal = ",", delimiter = ";"'
        text = (folder / "logs" / "plc.csv").read_text(encoding="utf-8")
        station = STATION.format("*")
        found = read(folder / "logs", text, f'{{ column = "{station}", cycle = "Taste_Start" }}', mapping)
        cyclekit.train_task_times(found, out=folder / "model")

    return made_once(tmp_path_factory, "plc_only_24", make)


def test_orders_that_the_plc_never_logged_take_as_long_as_they_do(plant: Path) -> None:
    dataset = Dataset.open(plant / "dataset")
    assert len(dataset.card.executions) == 24
    for seed in (1000, 1001):
        places = random_sequence("scanner-fields", seed)[:-1]  # its last way, back home, is not in a bit
        fresh = simulate_sequence(
            "scanner-fields", places, executions=60, seed=7, options=SimulationOptions(people="signals")
        )
        true_s = float(fresh["duration_s"].mean()) + 0.4  # type: ignore[arg-type]  # the button is pressed before
        plan = [PlannedTask("robot", STATION.format(name)) for name in places[1:]]
        (found,) = cyclekit.estimate_cycles(plant / "model", dataset, [TaskSequence.of_plan("new", plan)])
        assert found.expected_low_s < true_s < found.expected_high_s
        assert found.expected_s == pytest.approx(true_s, rel=0.06)
