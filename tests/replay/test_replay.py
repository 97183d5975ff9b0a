from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from fabricated import PLACES, THRESHOLDS_M, fabricate_dataset
from msgspec import structs
from rerun.chunk import RrdReader

from cyclekit.config import Cell, Furniture, NamedPlace
from cyclekit.config.arms import ARMS, joint_points, recognise_arm
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import CyclekitError, UnknownName
from cyclekit.replay import viewer, write_replay
from cyclekit.replay.execution import load_execution
from cyclekit.replay.words import log_lines, slowdowns, summary
from cyclekit.storage.atomic import write_parquet


class DistanceModel:
    """The true staircase, shifted outwards by 10 cm, as a model of problem `now`."""

    problem = "now"

    def predict(self, x):
        distance = np.linalg.norm(x[:, :3] - x[:, 3:], axis=1)
        return np.searchsorted(np.array(THRESHOLDS_M) + 0.1, distance) / 4


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return fabricate_dataset(tmp_path_factory.mktemp("cell") / "dataset", executions=2, rounds=1)


def changed(dataset, path, change):
    """A copy of the dataset with its samples passed through `change`."""
    shutil.copytree(dataset.path, path)
    for file in (path / "samples").glob("*.parquet"):
        write_parquet(change(pl.read_parquet(file)), file)
    return Dataset.open(path)


def entity(rrd, name):
    """The temporal rows of one entity as {column: list}, in order of time."""
    batches = [c.to_record_batch() for c in RrdReader(rrd).stream() if str(c.entity_path) == name and not c.is_static]
    if not batches:
        return None
    rows = pl.concat([pl.DataFrame(batch) for batch in batches])
    return rows.sort("execution").to_dict(as_series=False)


def entities(rrd):
    return {str(chunk.entity_path) for chunk in RrdReader(rrd).stream()}


def seconds(values):
    return [value.total_seconds() for value in values]


def test_the_replay_gives_back_scaling_and_distance_as_they_were_logged(dataset, tmp_path):
    facts = write_replay(dataset, "1", tmp_path / "x.rrd", model=DistanceModel())
    rows = dataset.samples([facts.execution]).sort("t_s")
    logged = entity(facts.path, "/plots/scaling/logged")
    assert seconds(logged["execution"]) == pytest.approx(rows["t_s"].to_list(), abs=1e-6)
    assert [v[0] for v in logged["Scalars:scalars"]] == rows["scaling"].to_list()
    shown = entity(facts.path, "/plots/distance")
    known = [v[0] for v in shown["Scalars:scalars"] if np.isfinite(v[0])]
    axes = [[f"{who}_{axis}_m" for axis in "xyz"] for who in ("robot", "human")]
    apart = rows.drop_nulls("human_x_m")
    expected = np.linalg.norm(apart.select(axes[0]).to_numpy() - apart.select(axes[1]).to_numpy(), axis=1)
    assert known == pytest.approx(expected.tolist())
    assert facts.bytes == facts.path.stat().st_size


def test_both_timelines_differ_by_the_start_of_the_execution_in_its_session(tmp_path):
    cell = fabricate_dataset(tmp_path / "d", executions=3, rounds=1)
    facts = write_replay(cell, "2", tmp_path / "x.rrd")
    start_s = cell.executions["start_s"][1]
    assert start_s > 0
    shown = entity(facts.path, "/plots/scaling/logged")
    apart = np.array(seconds(shown["session"])) - np.array(seconds(shown["execution"]))
    assert apart == pytest.approx(np.full(len(apart), start_s), abs=3e-6)  # microseconds, rounded twice


def test_lanes_and_words_show_the_labels_of_places(dataset, tmp_path):
    named = {name: NamedPlace(xyz_m, label=f"Slot of {name}") for name, xyz_m in PLACES.items()}
    settings = replace(dataset.card.settings, places=named)
    labelled = Dataset(dataset.path, structs.replace(dataset.card, settings=settings))
    run = load_execution(labelled, "1")
    assert run.robot_task[0] in dataset.tasks()["task"].to_list()  # the names stay what they are
    facts = write_replay(labelled, "1", tmp_path / "x.rrd")
    lane = {text for states in entity(facts.path, "/lanes/2_robot")["StateChange:state"] for text in states or ()}
    assert {text for text in lane if "→" in text}
    assert all("Slot of" in text for text in lane)
    words = [line.text for line in log_lines(run) if line.text.startswith("Robot")]
    assert all("Slot of" in text for text in words)


def test_a_time_after_the_end_is_refused(dataset, tmp_path):
    with pytest.raises(CyclekitError, match=r"lasts \d+\.\d s, so there is nothing to show at 9999 s"):
        write_replay(dataset, "1", tmp_path / "x.rrd", at=9999.0)
    assert not (tmp_path / "x.rrd").exists()


def test_rerun_itself_finds_nothing_wrong_with_the_file(dataset, tmp_path):
    facts = write_replay(dataset, "1", tmp_path / "x.rrd", model=DistanceModel())
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(facts.path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_the_file_brings_its_own_layout(dataset, tmp_path):
    facts = write_replay(dataset, "1", tmp_path / "x.rrd")
    reader = RrdReader(facts.path)
    assert len(reader.blueprints()) == 1
    views = [str(chunk.entity_path) for chunk in reader.stream(store=reader.blueprints()[0])]
    assert sum(path.startswith("/view/") and path.count("/") == 2 for path in views) >= 6
    legends = [chunk for chunk in reader.stream(store=reader.blueprints()[0]) if "PlotLegend" in str(chunk.format())]
    assert len(legends) >= 3  # a legend would cover the first seconds: each is off, and the titles name the colours


def test_a_model_that_expects_another_speed_is_seen_to_do_so(dataset, tmp_path):
    facts = write_replay(dataset, "1", tmp_path / "x.rrd", model=DistanceModel())
    run = load_execution(dataset, "1", DistanceModel())
    shown = entity(facts.path, "/plots/scaling/predicted")
    values = [v[0] for v in shown["Scalars:scalars"] if np.isfinite(v[0])]
    assert values == pytest.approx(run.predicted[np.isfinite(run.predicted)].tolist())
    both = np.isfinite(run.predicted)
    assert (run.predicted[both] <= run.scaling[both]).all()
    assert (run.predicted[both] < run.scaling[both]).any()


def test_a_hole_in_the_log_stays_a_hole(dataset, tmp_path):
    hole = pl.col("t_s").is_between(4.0, 7.0)
    cut = changed(dataset, tmp_path / "cut", lambda rows: rows.filter(~hole))
    facts = write_replay(cut, "1", tmp_path / "x.rrd")
    assert facts.gaps == 1
    shown = entity(facts.path, "/plots/scaling/logged")
    inside = [v[0] for t, v in zip(seconds(shown["execution"]), shown["Scalars:scalars"], strict=True) if 3.95 < t < 7]
    assert len(inside) == 1
    assert np.isnan(inside[0])
    tool = entity(facts.path, "/scene/robot/tool")
    gone = [p for t, p in zip(seconds(tool["execution"]), tool["Points3D:positions"], strict=True) if 3.95 < t < 7]
    assert gone == [[]]
    assert any("Gap in the log" in line.text for line in log_lines(load_execution(cut, "1")))


def test_no_trail_crosses_a_hole(dataset, tmp_path):
    hole = pl.col("t_s").is_between(4.0, 7.0)
    cut = changed(dataset, tmp_path / "cut", lambda rows: rows.filter(~hole))
    facts = write_replay(cut, "1", tmp_path / "x.rrd")
    trail = entity(facts.path, "/scene/robot/trail")
    steps = [np.linalg.norm(np.diff(s, axis=0), axis=1).max() for row in trail["LineStrips3D:strips"] for s in row]
    assert max(steps) < 0.06  # 0.5 m/s at 10 Hz; across the hole it would be decimetres


def test_an_operator_who_is_not_seen_vanishes_instead_of_standing_still(dataset, tmp_path):
    lost = pl.col("t_s").is_between(3.0, 5.0)
    gone = [pl.when(lost).then(None).otherwise(pl.col(f"human_{axis}_m")).alias(f"human_{axis}_m") for axis in "xyz"]
    cut = changed(dataset, tmp_path / "cut", lambda rows: rows.with_columns(gone))
    facts = write_replay(cut, "1", tmp_path / "x.rrd")
    body = entity(facts.path, "/scene/operator/body")
    there = {
        round(t, 1): len(p) for t, p in zip(seconds(body["execution"]), body["Capsules3D:translations"], strict=True)
    }
    assert all(there[t] == 0 for t in (3.0, 4.0, 5.0))
    assert there[2.9] == 1


def test_the_words_say_when_the_robot_was_slowed_and_how_much_that_cost(dataset):
    run = load_execution(dataset, "1")
    found = slowdowns(run)
    lost_s = dataset.tasks().filter(pl.col("execution") == run.name)["safety_loss_s"].sum()
    assert sum(each.lost_s for each in found) == pytest.approx(lost_s, abs=0.1 * len(found) + 0.1)
    assert f"{lost_s:.1f} s lost to safety slow-down" in summary(run)
    assert all(each.nearest_m < THRESHOLDS_M[-1] for each in found if np.isfinite(each.nearest_m))


def test_the_words_say_for_how_long_the_robot_waited_and_for_what(dataset):
    run = load_execution(dataset, "1")
    assert "wait" not in summary(run)
    first, second, *_ = run.tasks["index"].to_list()
    at = pl.col("index")
    ended = pl.when(at == first).then(pl.lit("operator leaves desk")).when(at == second).then(pl.lit("part set"))
    waited = run.tasks.with_columns(
        wait_s=pl.when(at == first).then(2.0).when(at == second).then(0.5).otherwise(0.0),
        waited_for=ended,
        reached_s=pl.when(at == first).then(run.start_s + pl.col("start_s") + 1.0),
        arrival_s=pl.when(at == first).then(pl.col("end_s") - 0.5).otherwise("arrival_s"),
    )
    words = summary(replace(run, tasks=waited))
    assert " and 2.5 s wait\n" in words
    start_s, end_s = waited["start_s"][0], waited["end_s"][1]
    goals = waited["goal_place"].to_list()
    assert f"**2.0 s** at {start_s + 1.0:.1f} s: robot waits before {goals[0]} until operator leaves desk" in words
    assert f"**0.5 s** at {end_s - 0.5:.1f} s: robot waits at {goals[1]} until part set" in words


@pytest.mark.parametrize(
    ("absent", "note"),
    [
        (["scaling", "scaling_origin", "step"], "Speed scaling is unknown"),
        ([f"human_{axis}_m" for axis in "xyz"], "No operator position"),
        ([f"robot_{axis}_m" for axis in "xyz"], "no robot tool position"),
        ([f"{who}_{axis}_m" for who in ("robot", "human") for axis in "xyz"], "no robot tool position"),
        (["robot_moving", "robot_task", "human_task"], "No model was given"),
    ],
)
def test_what_the_log_lacks_is_said_and_is_no_error(dataset, tmp_path, absent, note):
    poor = changed(
        dataset,
        tmp_path / "poor",
        lambda rows: rows.with_columns(pl.lit(None).cast(rows.schema[c]).alias(c) for c in absent),
    )
    facts = write_replay(poor, "1", tmp_path / "x.rrd")
    assert any(note in each for each in facts.notes)
    paths = entities(facts.path)
    assert ("/scene/operator/body" in paths) == (not any(c.startswith("human_x") for c in absent))
    assert ("/scene/robot/tool" in paths) == (not any(c.startswith("robot_x") for c in absent))


def test_a_robot_known_by_forty_joints_only_is_plotted_by_those_that_move_most(dataset, tmp_path):
    lacking = [f"robot_{axis}_m" for axis in "xyz"]
    path = tmp_path / "joints"
    poor = changed(dataset, path, lambda rows: rows.with_columns(pl.lit(None, pl.Float64).alias(c) for c in lacking))
    for file in (path / "recordings").glob("*/robot.parquet"):
        rows = pl.read_parquet(file)
        joints = [((pl.col("t_s") * 0.1 * n).sin() * n).alias(f"q{n}_rad") for n in range(40)]
        write_parquet(rows.with_columns(*joints, tcp_x_m=pl.lit(None, pl.Float64)), file)
    facts = write_replay(poor, "1", tmp_path / "x.rrd")
    shown = sorted(path for path in entities(facts.path) if path.startswith("/plots/joints/"))
    assert len(shown) == 8
    assert "/plots/joints/q0_rad" not in shown
    assert "/plots/joints/q39_rad" in shown


def test_a_planar_tracker_still_gives_an_operator_on_the_floor(dataset, tmp_path):
    flat = changed(dataset, tmp_path / "flat", lambda rows: rows.with_columns(human_z_m=pl.lit(None, pl.Float64)))
    facts = write_replay(flat, "1", tmp_path / "x.rrd")
    assert "/scene/operator/body" in entities(facts.path)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_an_arm_is_recognised_by_its_motion_with_any_tool(arm):
    rng = np.random.default_rng(3)
    joints = rng.uniform(-2, 2, size=(200, 6))
    points, turn = joint_points(arm, joints)
    tool = np.array([0.03, -0.02, 0.18])
    found = recognise_arm(joints, points[:, -1] + np.einsum("tij,j->ti", turn, tool))
    assert found is not None
    assert found.arm == arm
    assert found.tool_m == pytest.approx(tool, abs=1e-9)


def test_the_ur5e_stretched_out_reaches_as_far_as_its_links_say():
    points, _ = joint_points(ARMS[0], np.zeros((1, 6)))
    assert points[0, -1] == pytest.approx([-0.8172, -0.2329, 0.0628], abs=1e-4)


def test_an_arm_that_does_not_follow_the_log_is_not_drawn():
    rng = np.random.default_rng(3)
    assert recognise_arm(rng.uniform(-2, 2, size=(200, 6)), rng.uniform(-1, 1, size=(200, 3))) is None


def test_links_are_drawn_where_joints_and_tool_agree(dataset, tmp_path):
    path = tmp_path / "arm"
    cell = changed(dataset, path, lambda rows: rows)
    for file in (path / "recordings").glob("*/robot.parquet"):
        rows = pl.read_parquet(file)
        angles = np.stack([np.sin(rows["t_s"].to_numpy() * (0.2 + 0.1 * n)) for n in range(6)], axis=1)
        tool = joint_points(ARMS[0], angles)[0][:, -1]
        columns = {f"q{n}_rad": angles[:, n] for n in range(6)} | {
            f"tcp_{a}_m": tool[:, k] for k, a in enumerate("xyz")
        }
        write_parquet(rows.with_columns(**{name: pl.Series(values) for name, values in columns.items()}), file)
    facts = write_replay(cell, "1", tmp_path / "x.rrd")
    arm = entity(facts.path, "/scene/robot/arm")
    assert 25 <= len(arm["execution"]) / facts.duration_s <= 30.5
    assert len(arm["LineStrips3D:strips"][0][0]) == 8


def test_an_unknown_execution_is_refused_and_nothing_is_written(dataset, tmp_path):
    with pytest.raises(UnknownName, match="execution"):
        write_replay(dataset, "nobody", tmp_path / "x.rrd")
    assert list(tmp_path.iterdir()) == []


def test_an_old_replay_survives_until_the_new_one_is_whole(dataset, tmp_path, monkeypatch):
    old = tmp_path / "x.rrd"
    old.write_bytes(b"old")

    def full_disk(*_args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("cyclekit.replay.recording.log_scene", full_disk)
    with pytest.raises(CyclekitError, match="No space left"):
        write_replay(dataset, "1", old)
    assert old.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["x.rrd"]


def test_a_replay_beside_a_file_taken_for_a_folder_is_refused(dataset, tmp_path):
    (tmp_path / "blocked").write_text("a file where a folder should be")
    with pytest.raises(CyclekitError, match="cannot be written"):
        write_replay(dataset, "1", tmp_path / "blocked" / "x.rrd")


def test_the_viewer_listens_to_this_machine_only(tmp_path):
    command = viewer.viewer_command(tmp_path / "x.rrd", 9876)
    assert command[command.index("--bind") + 1] == "127.0.0.1"


@pytest.mark.parametrize(
    ("executions", "moved"),
    [
        (["1"], {"timeline": "execution", "duration": 3.0, "play_state": "playing"}),
        (["1", "2"], {"timeline": "path_phase", "sequence": 100, "play_state": "playing"}),
    ],
)
def test_the_viewer_is_moved_to_where_the_time_was_lost(dataset, tmp_path, monkeypatch, executions, moved):
    """The viewer's states: not there yet, nothing loaded yet, ready. A file alone cannot say where it begins."""
    facts = write_replay(dataset, executions, tmp_path / "x.rrd", at=4.5)
    assert facts.first is not None
    states, asked = iter([ConnectionError(), "", "recording"]), []

    class Client:
        def __enter__(self):
            return self

        def __exit__(self, *_):
            return None

        def get_state(self):
            return SimpleNamespace(active_recording=self.state)

        def set_time(self, timeline, **how):
            asked.append({"timeline": timeline, **how})

    def connect(address):
        client = Client()
        client.state = next(states)
        if isinstance(client.state, Exception):
            raise client.state
        assert address.startswith("rerun+http://127.0.0.1:")
        return client

    monkeypatch.setattr(viewer, "no_usage_counting", lambda: None)
    monkeypatch.setattr(viewer, "viewer_program", lambda: [sys.executable, "-c", "import time; time.sleep(60)"])
    monkeypatch.setattr(viewer, "ViewerClient", SimpleNamespace(connect=connect))
    with viewer.open_viewer(facts.path, facts.first) as process:
        process.kill()
    (told,) = asked
    assert told.keys() == moved.keys()
    assert told == moved | ({"sequence": facts.first.start} if "sequence" in moved else {})


def test_opening_a_replay_that_is_not_there_says_how_to_make_one(tmp_path):
    with pytest.raises(CyclekitError, match="cyclekit replay"):
        viewer.open_viewer(tmp_path / "none.rrd")


def test_places_are_where_the_cell_has_them(dataset, tmp_path):
    facts = write_replay(dataset, "1", tmp_path / "x.rrd")
    static = [c for c in RrdReader(facts.path).stream() if str(c.entity_path) == "/scene/places" and c.is_static]
    shown = static[0].to_record_batch().to_pydict()["Points3D:positions"][0]
    assert np.array(shown) == pytest.approx(np.array(list(PLACES.values())))


def test_tables_stand_where_the_cell_file_says(dataset, tmp_path):
    bench = Furniture(xyz_m=(0.5, 1.0, -0.1), size_m=(0.9, 0.4, 0.6), yaw_deg=30.0)
    card = structs.replace(dataset.card, settings=Cell(furniture={"bench": bench}))
    facts = write_replay(Dataset(dataset.path, card), "1", tmp_path / "x.rrd")
    (drawn,) = [c for c in RrdReader(facts.path).stream() if str(c.entity_path) == "/scene/furniture"]
    box = {name.removeprefix("Boxes3D:"): value[0] for name, value in drawn.to_record_batch().to_pydict().items()}
    assert box["centers"] == [pytest.approx([0.5, 1.0, -0.4])]  # the middle of its top is told
    assert box["half_sizes"] == [pytest.approx([0.45, 0.2, 0.3])]
    assert box["rotation_axis_angles"][0]["angle"] == pytest.approx(np.deg2rad(30.0))
    assert box["labels"] == ["bench"]
