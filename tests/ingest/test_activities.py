"""A PLC's trace alone: states of its signals become tasks, as if somebody had typed them as a task list."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest
from made_once import made_once

import cyclekit
from cyclekit.config import load_cell
from cyclekit.config.cells import Activity
from cyclekit.config.sequences import PlannedTask, TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, LogError
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import SimulationOptions, random_sequence, simulate_sequence
from cyclekit_sim.plc_only import STATION, plc_cell, write_plc_only

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


PROGRAMS = {
    "stations": (f"{STATION.format('*')}", "Taste_Start", ()),
    "steps": ("Schritt", "Schritt=0", ("0",)),
    "words": ("Zustand", "Zustand=home", ("Fahrt", "home")),
}
"""Column, cycle and idle states of the activity of each program."""


@pytest.fixture(scope="module")
def plants(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The traces of a cell: three programs, each sampled and with a row for each change, in a folder each."""

    def make(folder: Path) -> None:
        cell, session = plc_cell("scanner-fields", executions=24, seed=5)
        orders = [trace.program.executions[0].places for trace in session.traces]
        (folder / "orders.json").write_text(json.dumps(orders), encoding="utf-8")
        for program in PROGRAMS:
            for form in ("sampled", "changes"):
                write_plc_only(folder / f"{program}-{form}" / "logs" / "plc.csv", cell, session, program, form)  # type: ignore[arg-type]

    return made_once(tmp_path_factory, "plants_without_a_robot_log_24", make)


@pytest.mark.parametrize("form", ["sampled", "changes"])
@pytest.mark.parametrize("program", PROGRAMS)
def test_a_drafted_cell_file_makes_the_executions_of_a_trace_without_typing(
    plants: Path, tmp_path: Path, program: str, form: str
) -> None:
    cyclekit.start_project(plants / f"{program}-{form}" / "logs", tmp_path)
    (source,) = load_cell(tmp_path / "cell.toml").sources
    column, cycle, idle = PROGRAMS[program]
    assert source.activities == (Activity((column,), idle=idle, cycle=cycle),)
    ingest([plants / f"{program}-{form}" / "logs"], tmp_path / "dataset", cell=tmp_path / "cell.toml")
    found = cycles(Dataset.open(tmp_path / "dataset"))
    orders = json.loads((plants / "orders.json").read_text(encoding="utf-8"))
    assert len(found) == 24
    for number, tasks in enumerate(found):
        stations = [name.removeprefix(STATION.format("")) for name, *_ in tasks]
        if program == "steps":
            assert len(tasks) == 25
        else:
            logged = orders[number][1:-1]
            assert stations == (logged if program == "stations" else [*logged, "to home"])


def test_orders_that_the_plc_never_logged_take_as_long_as_they_do(plants: Path, tmp_path: Path) -> None:
    cyclekit.start_project(plants / "stations-changes" / "logs", tmp_path)
    ingest([plants / "stations-changes" / "logs"], tmp_path / "dataset", cell=tmp_path / "cell.toml")
    dataset = Dataset.open(tmp_path / "dataset")
    model = cyclekit.train_task_times(dataset)
    for seed in (1000, 1001):
        places = random_sequence("scanner-fields", seed)[:-1]  # its last way, back home, is not in a bit
        fresh = simulate_sequence(
            "scanner-fields", places, executions=60, seed=7, options=SimulationOptions(people="signals")
        )
        true_s = float(fresh["duration_s"].mean()) + 0.4  # type: ignore[arg-type]  # the button is pressed before
        plan = [PlannedTask("robot", STATION.format(name)) for name in places[1:]]
        (found,) = cyclekit.estimate_cycles(model, dataset, [TaskSequence.of_plan("new", plan)])
        assert found.expected_low_s < true_s < found.expected_high_s
        assert found.expected_s == pytest.approx(true_s, rel=0.06)


def drafted(folder: Path, columns: dict[str, list[str]], sep: str = ";") -> tuple[Activity, ...]:
    """The activities that a draft of a trace proposes; each row lasts 1 s."""
    folder.mkdir()
    rows = [sep.join([str(at), *row]) for at, row in enumerate(zip(*columns.values(), strict=True))]
    (folder / "plc.csv").write_text("\n".join([sep.join(["Zeit [s]", *columns]), *rows, ""]), encoding="utf-8")
    text = cyclekit.draft_cell(folder).cell
    (folder / "cell.toml").write_text(text, encoding="utf-8")
    return load_cell(folder / "cell.toml").sources[0].activities


def of_stations(name: str, visits: str, on: tuple[str, str] = ("1", "0")) -> dict[str, list[str]]:
    """A bit for each station of `visits`: a station a character, 0 at rest and . on a way."""
    numbers = sorted(set(visits) - {".", "0"})
    return {name.format(each): [on[0] if here == each else on[1] for here in visits] for each in numbers}


CYCLES = ("00.1.22.3" + "00.1.3.22" + "000.1.22.3") * 4
PRESSED = ["1" if two == "0." else "0" for two in (a + b for a, b in pairwise(CYCLES + "0"))]
WARN = ["TRUE" if at % 17 < 5 else "FALSE" for at in range(len(CYCLES))]
PERCENT = ["50,0" if at % 17 < 5 else "100,0" for at in range(len(CYCLES))]


@pytest.mark.parametrize(
    ("columns", "activity"),
    [
        (
            of_stations("Roboter an Station {}", CYCLES, ("TRUE", "FALSE")) | {"Start-Taster": PRESSED},
            Activity(("Roboter an Station *",), cycle="Start-Taster"),
        ),
        (of_stations("xRobAtSt{}", CYCLES), Activity(("xRobAtSt*",), cycle="xRobAtSt1")),
        (
            of_stations("xRobAtSt{}", CYCLES) | {"PackML": ["IDLE" if one == "0" else "EXECUTE" for one in CYCLES]},
            Activity(("xRobAtSt*",), cycle="PackML=EXECUTE"),
        ),
        (
            of_stations("RobAtSt{}", CYCLES)
            | {"ProgNo": ["0" if one == "0" else "57"[at > 30] for at, one in enumerate(CYCLES)]},
            Activity(("RobAtSt*",), cycle="ProgNo"),
        ),
        (
            of_stations("St{}_Rob", CYCLES) | {"Home_Rob": [str(int(one == "0")) for one in CYCLES]},
            Activity(("St1_Rob", "St2_Rob", "St3_Rob", "Home_Rob"), idle=("Home_Rob",), cycle="Home_Rob"),
        ),
        (
            {"robot_state": [{"0": "home", ".": "moving"}.get(one, f"work{one}") for one in CYCLES], "start": PRESSED},
            Activity(("robot_state",), idle=("home", "moving"), cycle="start"),
        ),
        (
            {"Rob_Station": [one.replace(".", "0") for one in CYCLES]},
            Activity(("Rob_Station",), idle=("0",), cycle="Rob_Station=1"),
        ),
    ],
    ids=["start button", "return", "PackML", "program number", "home", "words", "number of the station"],
)
def test_a_draft_says_which_states_are_tasks_and_what_begins_a_cycle(
    tmp_path: Path, columns: dict[str, list[str]], activity: Activity
) -> None:
    gripper = ["TRUE" if one in "23" else "FALSE" for one in CYCLES]
    around = {"Greifer zu": gripper, "Warnfeld": WARN, "Schutztür": ["TRUE"] * len(WARN), "Override [%]": PERCENT}
    assert drafted(tmp_path / "logs", columns | around) == (activity,)


def test_a_persons_bits_are_an_agent_of_their_own(tmp_path: Path) -> None:
    worker = ["1" if at % 9 in (4, 5, 6) else "0" for at in range(len(CYCLES))]
    columns = of_stations("Rob_St{}", CYCLES) | {"Werker_am_Platz": worker, "Start": PRESSED}
    robot, person = drafted(tmp_path / "logs", columns)
    assert (robot.column, robot.cycle) == (("Rob_St*",), "Start")
    assert person == Activity(("Werker_am_Platz",), agent="Werker")


def test_signals_beside_a_robots_log_are_no_tasks(tmp_path: Path) -> None:
    pose = {axis: [f"{0.1 * (at % 7):.3f}" for at in range(len(CYCLES))] for axis in ("tcp_x", "tcp_y", "tcp_z")}
    (tmp_path / "logs").mkdir()
    rows = [",".join([f"{0.1 * at:.1f}", *row]) for at, row in enumerate(zip(*pose.values(), strict=True))]
    (tmp_path / "logs" / "robot.csv").write_text("\n".join([",".join(["time", *pose]), *rows, ""]), encoding="utf-8")
    bits = of_stations("at_{}", CYCLES) | {"start": PRESSED}
    rows = [",".join([str(at), *row]) for at, row in enumerate(zip(*bits.values(), strict=True))]
    (tmp_path / "logs" / "plc.csv").write_text("\n".join([",".join(["time", *bits]), *rows, ""]), encoding="utf-8")
    assert "activities" not in cyclekit.draft_cell(tmp_path / "logs").cell
