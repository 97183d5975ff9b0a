"""Executions, places and tasks found from motion, and where every second went, against the simulator's truth."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st
from tcp_speed import tcp_speed

from cyclekit.config import Cell, Executions, NamedPlace, load_cell
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import UnknownName
from cyclekit.ingest.ingest import ingest
from cyclekit.segmentation.motion import RobotRun
from cyclekit.segmentation.places import MERGE_M, cluster, count_passes
from cyclekit_sim import SCENES, scene_places

if TYPE_CHECKING:
    from simulated_cells import Cells, SimulatedCell

VARIANTS = [
    *((scene, {}) for scene in SCENES),
    pytest.param(("box-picking", {"robot_rate_hz": 500}), marks=pytest.mark.slow),
    pytest.param(("pick-and-package", {"robot_rate_hz": 500}), marks=pytest.mark.slow),
    pytest.param(("laser-zones", {"robot_rate_hz": 500}), marks=pytest.mark.slow),
    ("box-picking", {"ramp_down_per_s": 2.0, "ramp_up_per_s": 1.0, "latency_s": 0.1, "hysteresis_m": 0.05}),
]
SHORT = {"pick-and-package": 1, "box-picking": 2, "laser-zones": 3, "scanner-visits": 3}


@pytest.fixture(params=VARIANTS, ids=lambda v: "-".join([v[0], *(f"{k}={x}" for k, x in v[1].items())]))
def cell(request: pytest.FixtureRequest, cells: Cells) -> SimulatedCell:
    scene, options = request.param
    return cells(scene, SHORT[scene] if options else None, **options)


def made_of(tmp_path: Path, logs: Path, cell: Cell | Path | None = None) -> Dataset:
    return Dataset.open(ingest([logs], tmp_path / "dataset", cell=cell).dataset)


def test_all_executions_and_tasks_are_found_in_order_and_none_is_invented(cell: SimulatedCell):
    assert cell.routes_found == cell.routes
    truth = (cell.tasks["start_place"] + "->" + cell.tasks["goal_place"]).to_list()
    assert cell.dataset.tasks()["task"].to_list() == truth
    assert cell.dataset.executions["complete"].all()


def test_the_parts_of_a_task_add_up_to_its_duration_and_the_tasks_to_the_execution(cell: SimulatedCell):
    tasks = cell.dataset.tasks()
    parts = tasks.select(pl.sum_horizontal("nominal_s", "safety_loss_s", "dwell_s", "wait_s"))["nominal_s"]
    assert (parts - (tasks["end_s"] - tasks["start_s"])).abs().max() < 1e-3
    for _, rows in tasks.group_by("execution"):
        assert (rows["start_s"][1:] - rows["end_s"][:-1]).abs().max() < 1e-9
    assert (
        tasks.select((pl.col("nominal_s", "safety_loss_s", "dwell_s", "wait_s") >= -1e-9).all()).row(0) == (True,) * 4
    )


def test_executions_last_as_long_as_they_really_did(cell: SimulatedCell):
    late = cell.dataset.executions["duration_s"] - cell.executions["duration_s"]
    # A robot that idles at home before it may leave does not show when it wanted to.
    assert late.abs().max() < (0.7 if cell.scene == "pick-and-package" else 0.1)


def test_nominal_time_and_safety_loss_of_every_task_are_those_of_the_truth(cell: SimulatedCell):
    found = cell.dataset.tasks()
    nominal = (found["nominal_s"] - cell.tasks["nominal_s"]).to_numpy()
    loss = (found["safety_loss_s"] - cell.tasks["safety_loss_s"]).to_numpy()
    assert np.abs(nominal).max() < 0.1
    assert np.quantile(np.abs(loss), 0.97) < 0.07
    assert found["nominal_s"].sum() == pytest.approx(cell.tasks["nominal_s"].sum(), rel=0.006)
    assert found["safety_loss_s"].sum() == pytest.approx(cell.tasks["safety_loss_s"].sum(), rel=0.02)


def test_stands_are_told_into_dwell_and_wait(cells: Cells):
    boxes, packing = cells("box-picking"), cells("pick-and-package")
    dwell = boxes.dataset.tasks()["dwell_s"] - boxes.tasks["dwell_s"]
    assert dwell.abs().max() < 0.12
    assert boxes.dataset.tasks()["wait_s"].sum() == 0.0  # its boxes are always there
    found, true = packing.dataset.tasks(), packing.tasks
    stands = found["dwell_s"] + found["wait_s"] - true["dwell_s"] - true["wait_s"]
    assert stands.abs().quantile(0.97) < 0.12  # type: ignore[operator]
    long = true["wait_s"] > 0.9
    assert long.sum() >= 5
    assert (found.filter(long)["wait_s"] > 0.7).all()
    assert found.filter(true["goal_place"] != "conveyor")["wait_s"].sum() < 0.1


@pytest.mark.parametrize("scene", [SCENES[0], *(pytest.param(scene, marks=pytest.mark.slow) for scene in SCENES[1:])])
def test_places_are_found_without_a_cell_file_from_motion_alone(cells: Cells, scene: str, tmp_path: Path):
    cell = cells(scene)
    found = made_of(tmp_path, cell.logs, Cell(ignore=("truth/*",)))
    truth = scene_places(scene)
    visited = {name for route in cell.routes for name in route}
    named = {}
    for name, place in found.places.items():
        apart = {true: float(np.linalg.norm(np.subtract(place.xyz_m, xyz))) for true, xyz in truth.items()}
        named[name] = min(apart, key=lambda true: apart[true])
        assert apart[named[name]] < 1e-3, f"{name} is no place of the cell"
        assert place.inferred
    assert sorted(named.values()) == sorted(visited)
    assert [[named[place] for place in entry.places] for entry in found.card.executions] == cell.routes


def test_where_safety_halts_the_robot_on_its_way_is_no_place_however_often(tmp_path: Path, robot_log: Any):
    doing: list[tuple[str, float]] = [("stand", 1.0)]
    for _ in range(8):
        doing += [("move", 0.4), ("halt", 2.0), ("move", 1.0), ("stand", 0.6), ("move", 0.0), ("stand", 0.6)]
    found = made_of(tmp_path, robot_log(tmp_path / "run.csv", doing))
    assert sorted(place.xyz_m[0] for place in found.places.values()) == pytest.approx([0.0, 1.0], abs=1e-3)
    there = found.tasks().filter(pl.col("task") == "place_1->place_2")
    assert there.height == 8
    assert there["safety_loss_s"].to_list() == pytest.approx([2.0] * 8, abs=0.05)
    assert there["nominal_s"].to_list() == pytest.approx([2.0] * 8, abs=0.05)


def test_without_any_scaling_a_spot_it_often_passes_without_standing_is_no_place(tmp_path: Path, robot_log: Any):
    doing: list[tuple[str, float]] = [("stand", 1.0)]
    for number in range(8):
        doing += [("move", 0.4), ("stand", 2.0)] if number % 3 == 0 else []
        doing += [("move", 1.0), ("stand", 0.6), ("move", 0.0), ("stand", 0.6)]
    found = made_of(tmp_path, robot_log(tmp_path / "run.csv", doing, scaling=False))
    assert sorted(place.xyz_m[0] for place in found.places.values()) == pytest.approx([0.0, 1.0], abs=1e-3)


@pytest.mark.parametrize(("lasts_s", "is_place"), [((0.6,) * 6, True), ((0.3, 2.0, 0.8, 4.0, 1.2, 0.5), False)])
def test_a_spot_that_it_often_passes_is_a_place_where_it_stands_for_the_same_time(
    tmp_path: Path, robot_log: Any, lasts_s: tuple[float, ...], *, is_place: bool
):
    doing: list[tuple[str, float]] = [("stand", 1.0)]
    for stand_s in lasts_s:
        doing += [("move", 0.4), ("stand", stand_s), ("move", 1.0), ("stand", 0.6), ("move", 0.0), ("stand", 0.6)]
    found = made_of(tmp_path, robot_log(tmp_path / "run.csv", doing, scaling=False))
    places_m = sorted(place.xyz_m[0] for place in found.places.values())
    assert places_m == pytest.approx([0.0, 0.4, 1.0] if is_place else [0.0, 1.0], abs=1e-3)


def test_a_halt_a_hair_before_the_goal_is_loss_of_the_motion_that_it_stopped(tmp_path: Path, robot_log: Any):
    doing: list[tuple[str, float]] = [("stand", 1.0)]
    for number in range(5):
        hair = [("move", 0.9998), ("halt", 3.0)] if number == 2 else []
        doing += [*hair, ("move", 1.0), ("stand", 0.6), ("move", 0.0), ("stand", 0.6)]
    tasks = made_of(tmp_path, robot_log(tmp_path / "run.csv", doing)).tasks()
    assert tasks.height == 10
    hindered = tasks.row(4, named=True)
    assert hindered["task"] == "place_1->place_2"
    assert hindered["safety_loss_s"] == pytest.approx(3.0, abs=0.1)
    assert tasks["dwell_s"][::2].to_list() == pytest.approx([0.6] * 5, abs=0.05)
    assert tasks["safety_loss_s"].sum() == pytest.approx(3.0, abs=0.1)


def test_a_robot_that_is_not_allowed_to_leave_loses_that_time_on_its_next_motion(tmp_path: Path, robot_log: Any):
    doing: list[tuple[str, float]] = [("stand", 1.0)]
    for number in range(5):
        held = [("halt", 4.0)] if number == 2 else []
        doing += [("move", 1.0), ("stand", 0.6), *held, ("move", 0.0), ("stand", 0.6)]
    tasks = made_of(tmp_path, robot_log(tmp_path / "run.csv", doing)).tasks()
    hindered = tasks.row(5, named=True)
    assert hindered["task"] == "place_2->place_1"
    assert hindered["safety_loss_s"] == pytest.approx(4.0, abs=0.1)
    assert tasks["dwell_s"][::2].to_list() == pytest.approx([0.6] * 5, abs=0.05)


def test_standing_free_for_longer_than_usual_is_waiting(tmp_path: Path, robot_log: Any):
    doing: list[tuple[str, float]] = [("stand", 1.0)]
    for number in range(5):
        doing += [("move", 1.0), ("stand", 4.6 if number == 2 else 0.6), ("move", 0.0), ("stand", 0.6)]
    tasks = made_of(tmp_path, robot_log(tmp_path / "run.csv", doing)).tasks()
    assert tasks["wait_s"].to_list() == pytest.approx([0.0] * 4 + [4.0] + [0.0] * 5, abs=0.05)
    assert tasks["safety_loss_s"].sum() == pytest.approx(0.0, abs=0.05)


def test_the_spot_at_which_recordings_begin_and_end_is_home_though_the_robot_never_stands_there(
    tmp_path: Path, robot_log: Any
):
    for number in range(3):
        doing = [("move", 0.4), ("stand", 0.6), ("move", 1.0), ("stand", 0.6), ("move", 0.0)]
        robot_log(tmp_path / "logs" / f"run_{number}.csv", doing)
    found = made_of(tmp_path, tmp_path / "logs")
    assert found.places["place_1"].xyz_m == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    assert [list(entry.places) for entry in found.card.executions] == [["place_1", "place_2", "place_3", "place_1"]] * 3


def test_where_a_recorder_was_switched_off_is_no_place(tmp_path: Path, robot_log: Any):
    doing: list[tuple[str, float]] = [("stand", 1.0)]
    doing += [("move", 1.0), ("stand", 0.6), ("move", 0.0), ("stand", 0.6)] * 3
    found = made_of(tmp_path, robot_log(tmp_path / "run.csv", [*doing, ("move", 0.5)]))
    assert sorted(place.xyz_m[0] for place in found.places.values()) == pytest.approx([0.0, 1.0], abs=1e-3)
    assert found.tasks().height == 6


def test_executions_of_an_endless_recording_begin_at_home(tmp_path: Path, robot_log: Any):
    doing = [
        ("stand", 1.0),
        *[("move", 0.4), ("stand", 0.6), ("move", 1.0), ("stand", 0.6), ("move", 0.0), ("stand", 1)] * 3,
    ]
    log = robot_log(tmp_path / "run.csv", doing)
    places = {"rest": NamedPlace((0, 0, 0)), "pick": NamedPlace((0.4, 0, 0)), "put": NamedPlace((1.0, 0, 0))}
    routes = {}
    for how in (Executions(), Executions(home="pick"), Executions("file"), Executions("gap")):
        found = Dataset.open(ingest([log], tmp_path / "dataset", cell=Cell(places=places, executions=how)).dataset)
        routes[(how.begin, how.home)] = [list(entry.places) for entry in found.card.executions]
    assert routes["auto", None] == [["rest", "pick", "put", "rest"]] * 3
    assert routes["auto", "pick"] == [["pick", "put", "rest", "pick"]] * 2 + [["pick", "put", "rest"]]
    assert routes["file", None] == routes["gap", None] == [["rest", *["pick", "put", "rest"] * 3]]


def test_a_place_named_home_is_where_executions_begin_though_logs_begin_elsewhere(tmp_path: Path, robot_log: Any):
    cycle: list[tuple[str, float]] = [("move", 0.4), ("stand", 0.6), ("move", 1.0), ("stand", 0.6)]
    log = robot_log(tmp_path / "run.csv", [("stand", 1.0), *[*cycle, ("move", 0.0), ("stand", 0.6)] * 3])
    places = {"pick": NamedPlace((0, 0, 0)), "put": NamedPlace((0.4, 0, 0)), "home": NamedPlace((1.0, 0, 0))}
    found = made_of(tmp_path, log, Cell(places=places))
    whole = [list(entry.places) for entry in found.card.executions if entry.whole]
    assert whole == [["home", "pick", "put", "home"]] * 2


def test_the_last_execution_of_an_endless_recording_that_was_cut_is_not_complete(tmp_path: Path, robot_log: Any):
    cycle = [("move", 0.4), ("stand", 0.6), ("move", 1.0), ("stand", 0.6), ("move", 0.0), ("stand", 1)]
    log = robot_log(tmp_path / "run.csv", [("stand", 1.0), *cycle * 2, *cycle[:3]])
    found = made_of(tmp_path, log)
    assert found.executions["complete"].to_list() == [True, True, False]


def test_a_wait_that_the_end_of_a_log_cuts_is_as_long_as_it_is_known(tmp_path: Path, robot_log: Any):
    """Two logs of three end at home; one ends as the robot has stood 9 s at a place whose process takes a second."""
    cycle = [
        ("stand", 1.0),
        ("move", 0.4),
        ("stand", 0.6),
        ("move", 1.0),
        ("stand", 1.0),
        ("move", 0.0),
        ("stand", 5.0),
    ]
    for number in range(3):
        doing = cycle if number < 2 else [*cycle[:4], ("stand", 9.0)]
        robot_log(tmp_path / "logs" / f"run_{number}.csv", doing)
    found = made_of(tmp_path, tmp_path / "logs")
    assert found.executions["complete"].to_list() == [True, True, False]
    home, waited = (found.tasks().row(at, named=True) for at in (2, -1))
    assert (home["cut"], home["dwell_s"], home["wait_s"]) == (True, 0.0, 0.0)  # what follows a cycle is none of it
    assert waited["cut"]
    assert waited["dwell_s"] == pytest.approx(1.0, abs=0.05)
    assert waited["wait_s"] == pytest.approx(8.0, abs=0.05)
    assert found.card.executions[-1].end_s - waited["arrival_s"] == pytest.approx(9.0, abs=0.05)
    assert found.tasks()["cut"].sum() == 3  # a task that was left is whole, though no other follows


def test_a_wait_short_of_a_place_that_the_end_of_a_log_cuts_is_known_too(tmp_path: Path, robot_log: Any):
    """The robot goes twice to 0.5 m and 1 m; it may wait at 0.8 m, where one log ends after 9 s."""
    waits_s = [(2.0, 0.0), (0.0, 4.0), (3.0, 1.5), (0.0, 0.0), (2.5, 9.0)]
    for number, mine in enumerate(waits_s):
        doing = [("stand", 1.0)]
        for wait_s in mine:
            doing += [("move", 0.5), ("stand", 0.6), ("move", 0.8), *([("stand", wait_s)] if wait_s else [])]
            doing += [("move", 1.0), ("stand", 1.0)] if wait_s < 9.0 else []
        home = [("move", 0.0), ("stand", 0.5)] if number < 4 else []
        robot_log(tmp_path / "logs" / f"run_{number}.csv", [*doing, *home])
    found = made_of(tmp_path, tmp_path / "logs")
    card = found.card.executions[-1]
    whole, cut = (found.tasks().filter(execution=card.execution).row(at, named=True) for at in (1, -1))
    assert (cut["task"], cut["arrival_s"], cut["nominal_s"], cut["cut"]) == (whole["task"], None, None, True)
    assert cut["wait_s"] == cut["end_s"] - cut["reached_s"] == pytest.approx(9.0, abs=0.05)
    assert (len(card.places), card.complete, card.end_s) == (4, False, cut["end_s"])
    assert found.whole_tasks()["arrival_s"].null_count() == 0


def test_a_silence_of_the_log_separates_executions(boxes: SimulatedCell, tmp_path: Path):
    told = load_cell(boxes.logs / "cell.toml")
    pauses = (boxes.executions["start_s"][1:] - boxes.executions["end_s"][:-1]).to_list()
    assert min(pauses) > 5
    in_one = Cell(told.name, told.sources, told.ignore, places=told.places, executions=Executions("file"))
    found = made_of(tmp_path, boxes.logs, in_one)
    assert found.executions.height == 1  # the whole file


def test_executions_can_begin_by_the_register_that_counts_them(cells: Cells, tmp_path: Path):
    cell = cells("pick-and-package")
    told = load_cell(cell.logs / "cell.toml")
    counted = Cell(told.name, told.sources, told.ignore, places=told.places, executions=Executions("register"))
    found = made_of(tmp_path, cell.logs, counted)
    assert [list(entry.places) for entry in found.card.executions] == cell.routes


def test_executions_can_begin_by_an_event_of_another_log_of_the_session(cells: Cells, tmp_path: Path):
    cell = cells("pick-and-package")
    logs = shutil.copytree(cell.logs, tmp_path / "logs")
    told = load_cell(logs / "cell.toml")
    behind = next(source.clock_offset_s for source in told.sources if source.role == "events")
    with (logs / "session_000" / "events.csv").open("a", encoding="utf-8") as events:
        for start in cell.executions["start_s"].to_list():
            events.write(f"{start - behind - 0.2:.4f},cycle_start,1\n{start - behind:.4f},cycle_start,0\n")
    begun = Executions("signal", signal="cycle_start=1")
    counted = Cell(told.name, told.sources, told.ignore, places=told.places, executions=begun)
    found = made_of(tmp_path, logs, counted)
    assert [list(entry.places) for entry in found.card.executions] == cell.routes
    unknown = Cell(told.name, told.sources, told.ignore, executions=Executions("signal", signal="cycle_strat"))
    with pytest.raises(UnknownName, match="cycle_start"):
        ingest([logs], tmp_path / "other", cell=unknown)


def test_executions_can_begin_at_a_program_line_in_the_register(tmp_path: Path, robot_log: Any):
    doing: list[tuple[str, float]] = [("stand", 1.0)]
    for _ in range(6):
        doing += [("move", 1.0), ("stand", 0.6), ("move", 0.0), ("stand", 0.6)]
    log = robot_log(tmp_path / "run.csv", doing)
    rows = pl.read_csv(log, separator=" ")
    away = (pl.col("actual_TCP_pose_0") > 1e-6).cast(pl.Int64)
    lap = ((away.diff().fill_null(0) == 1).cast(pl.Int64).cum_sum() - 1) % 2  # every other departure is a cycle
    line = pl.when(away == 0).then(10).when(lap == 0).then(100).otherwise(200)
    rows.with_columns(output_int_register_0=line).write_csv(log, separator=" ")
    found = made_of(tmp_path, log, Cell(executions=Executions("signal", signal="register=100")))
    assert [len(entry.places) for entry in found.card.executions] == [5, 5, 5]


def test_a_home_that_is_no_place_is_refused(tmp_path: Path, robot_log: Any):
    log = robot_log(tmp_path / "run.csv", [("stand", 1.0), ("move", 1.0), ("stand", 1.0)])
    with pytest.raises(UnknownName, match="unknown place 'hoem'"):
        ingest([log], tmp_path / "dataset", cell=Cell(executions=Executions(home="hoem")))


@pytest.mark.parametrize("doing", [[("stand", 3.0)], [("move", 0.4)], [("halt", 3.0)]])
def test_a_robot_that_does_no_task_is_an_execution_to_look_at_all_the_same(
    tmp_path: Path, robot_log: Any, doing: list[tuple[str, float]]
):
    found = made_of(tmp_path, robot_log(tmp_path / "run.csv", doing))
    assert found.executions["complete"].to_list() == [False]
    assert found.tasks().height == 0
    assert found.samples()["robot_x_m"].null_count() == 0


@pytest.mark.parametrize("rate_hz", [125, 500])
def test_the_speed_of_a_steady_motion_is_its_slope(rate_hz: int):
    t_s = np.arange(0.0, 1.0, 1 / rate_hz)
    xyz = np.column_stack([0.3 * t_s, 0.4 * t_s, 0.0 * t_s])
    np.testing.assert_allclose(tcp_speed(t_s, xyz), 0.5, rtol=1e-9)


def test_spots_nearer_than_the_radius_are_one_group_and_none_is_left_out():
    rng = np.random.default_rng(1)
    centres = np.array([[0.0, 0, 0], [0.05, 0, 0], [0, 0.5, 0]])
    xyz = np.repeat(centres, [40, 20, 10], axis=0) + rng.uniform(-5e-4, 5e-4, (70, 3))
    groups = cluster(xyz, np.arange(70), 0.01)
    assert [len(group) for group in groups] == [40, 20, 10]
    assert sorted(np.concatenate(groups).tolist()) == list(range(70))


@at_most(40)
@given(seed=st.integers(0, 10_000), shift=st.floats(-0.02, 0.02), turn=st.floats(0.0, 6.3))
def test_groups_of_standstills_do_not_depend_on_where_the_axes_lie(seed: int, shift: float, turn: float):
    rng = np.random.default_rng(seed)
    xyz = np.repeat(rng.uniform(-0.5, 0.5, (6, 3)), 12, axis=0) + rng.normal(0.0, 1e-3, (72, 3))
    c, s = np.cos(turn), np.sin(turn)
    turned = xyz @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T + shift
    here, there = (
        sorted(tuple(sorted(group.tolist())) for group in cluster(points, np.arange(72), 0.01))
        for points in (xyz, turned)
    )
    assert here == there


def test_a_protective_stop_that_lets_go_along_a_ramp_is_no_place(tmp_path: Path, robot_log: Any):
    """The robot reverses at a via: slow there by itself, it creeps below what can be told from noise as s rises."""
    doing: list[tuple[str, float]] = [("stand", 1.0)]
    for _ in range(8):
        doing += [("move", 0.4), ("halt", 1.5), ("creep", 0.3), ("move", 1.0), ("stand", 0.6), ("move", 0.0)]
        doing += [("stand", 0.6)]
    found = made_of(tmp_path, robot_log(tmp_path / "run.csv", doing))
    assert sorted(place.xyz_m[0] for place in found.places.values()) == pytest.approx([0.0, 1.0], abs=1e-3)


def test_where_all_places_are_named_nothing_else_is_one(tmp_path: Path, robot_log: Any):
    doing: list[tuple[str, float]] = [("stand", 1.0)]
    for _ in range(4):
        doing += [("move", 0.4), ("stand", 0.6), ("move", 1.0), ("stand", 0.6), ("move", 0.0), ("stand", 0.6)]
    log = robot_log(tmp_path / "logs" / "run.csv", doing)
    named = {name: NamedPlace((x, 0.0, 0.0)) for name, x in (("home", 0.0), ("far", 1.0))}
    loose = made_of(tmp_path / "loose", log, Cell(places=named))
    strict = made_of(tmp_path / "strict", log, Cell(places=named, all_places_named=True))
    assert sorted(loose.places) == ["far", "home", "place_1"]
    assert sorted(strict.places) == ["far", "home"]
    assert set(strict.tasks()["task"]) == {"home->far", "far->home"}


@pytest.mark.parametrize("speed_logged", [True, False])
def test_tasks_are_found_in_spite_of_a_noisy_robot_log(cells: Cells, tmp_path: Path, speed_logged: bool):
    """Twenty micrometres of jitter; without a logged speed it becomes millimetres per second of its slope."""
    cell, rng = cells("laser-zones"), np.random.default_rng(5)
    logs = tmp_path / "logs" / "session_000"
    logs.mkdir(parents=True)
    (tmp_path / "logs" / "cell.toml").write_bytes((cell.logs / "cell.toml").read_bytes())
    table = pl.read_csv(cell.logs / "session_000" / "robot.csv", separator=" ")
    noise = {f"actual_TCP_pose_{i}": 2e-5 for i in range(3)} | {f"actual_TCP_speed_{i}": 1e-3 for i in range(3)}
    table = table.with_columns(pl.col(name) + rng.normal(0.0, sd, table.height) for name, sd in noise.items())
    if not speed_logged:
        table = table.drop([f"actual_TCP_speed_{i}" for i in range(6)])
    table.write_csv(logs / "robot.csv", separator=" ", line_terminator="\r\n")
    found = made_of(tmp_path, tmp_path / "logs")
    assert [list(entry.places) for entry in found.card.executions] == cell.routes
    assert found.tasks()["nominal_s"].sum() == pytest.approx(cell.tasks["nominal_s"].sum(), rel=0.04)
    assert found.tasks()["safety_loss_s"].sum() == pytest.approx(cell.tasks["safety_loss_s"].sum(), rel=0.05)
    late = found.executions["duration_s"] - cell.executions["duration_s"]
    assert late.abs().max() < 0.15


@at_most(60)
@given(seed=st.integers(0, 10_000), spots=st.integers(1, 12), rows=st.integers(2, 400), centimetres=st.booleans())
def test_passes_of_spots_are_counted_as_by_looking_at_every_row(seed: int, spots: int, rows: int, centimetres: bool):
    random = np.random.default_rng(seed)
    xyz = np.cumsum(random.normal(0.0, 0.004, (rows, 3)), axis=0)
    xyz[random.random(rows) < 0.05] = np.nan
    centres = random.uniform(-0.04, 0.04, (spots, 3))
    if centimetres:  # spots at whole centimetres, anywhere in a cell: 0.6 / 0.01 is 59.99 and 0.61 / 0.01 is 61.0
        corner = random.integers(-100, 100, 3)
        centres = (np.round(centres / 0.01) + corner) * 0.01
        xyz += corner * 0.01
    run = RobotRun(np.arange(rows) / 125, xyz, np.zeros(rows), np.full(rows, np.nan))
    near = np.linalg.norm(xyz[None] - centres[:, None], axis=2) <= MERGE_M
    entered = near & ~np.concatenate([np.zeros((spots, 1), bool), near[:, :-1]], axis=1)
    assert count_passes([run], centres).tolist() == entered.sum(axis=1).tolist()
