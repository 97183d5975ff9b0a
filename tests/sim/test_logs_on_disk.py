"""What lies in the folder: vendor formats that parse back, imperfections that can be measured, whole or nothing."""

from __future__ import annotations

import hashlib
import json
import shutil
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from rosbags.highlevel import AnyReader

from cyclekit_sim import SimulationError, SimulationOptions, simulate
from cyclekit_sim.arm import JOINT_NAMES, forward

if TYPE_CHECKING:
    from simulated_cells import Cells

pytestmark = pytest.mark.slow  # of the simulator alone; what reads its logs is quick
POSE = [f"actual_TCP_pose_{i}" for i in range(3)]


def make(folder: Path, executions: int = 1, scene: str = "laser-zones", seed: int = 5, **options: object) -> Path:
    return simulate(scene, folder, executions=executions, seed=seed, options=SimulationOptions(**options))


@pytest.fixture(scope="session")
def plain(cells: Cells) -> Path:
    """Logs without imperfections, to be read by many tests."""
    return cells.logs("laser-zones", 1, seed=5)


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def frames(folder: Path) -> pl.DataFrame:
    names = ["frame", "t_s", "qx", "qy", "qz", "qw", "x", "y", "z"]
    path = folder / "session_000" / "operator.csv"
    return pl.read_csv(path, skip_rows=7, has_header=False, new_columns=names, infer_schema_length=None)


def placed(folder: Path) -> pl.DataFrame:
    """Frames with the person, robot clock and base frame, by what cell.toml tells."""
    source = tomllib.loads((folder / "cell.toml").read_text())["sources"][1]
    seen = frames(folder).drop_nulls()
    yaw, origin = np.deg2rad(source["frame"]["yaw_deg"]), source["frame"]["xyz_m"]
    x, y = seen["x"], -seen["z"]
    return pl.DataFrame(
        {
            "t_s": seen["t_s"] + source["clock_offset_s"],
            "x_m": np.cos(yaw) * x - np.sin(yaw) * y + origin[0],
            "y_m": np.sin(yaw) * x + np.cos(yaw) * y + origin[1],
            "z_m": seen["y"] + origin[2],
        }
    )


def errors_against_truth(folder: Path, tracked: pl.DataFrame) -> np.ndarray:
    truth = pl.read_parquet(folder / "truth" / "samples.parquet")
    columns = [
        np.interp(truth["t_s"], tracked["t_s"], tracked[f"{a}_m"]) - truth[f"human_{a}_m"].to_numpy() for a in "xyz"
    ]
    return np.stack(columns, axis=1)


@pytest.mark.parametrize(
    ("scene", "logs"),
    [("box-picking", "csv"), pytest.param("pick-and-package", "csv", marks=pytest.mark.slow), ("laser-zones", "mcap")],
)
def test_same_seed_same_bytes_other_seed_other_bytes(scene: str, logs: str, tmp_path: Path) -> None:
    options = {"scene": scene, "logs": logs, "delta_m": 0.02, "dropout": 0.1, "robot_rate_hz": 125}
    first, again = (digests(make(tmp_path / name, **options)) for name in ("a", "b"))
    assert first == again
    if logs == "csv":  # the seed is used before anybody knows how it will be written
        other = digests(make(tmp_path / "c", seed=6, **options))
        assert first.keys() == other.keys()
        assert all(first[name] != other[name] for name in first if name != "cell.toml")


@pytest.mark.parametrize("rate", [125, 500])
def test_the_robot_log_is_what_record_py_writes_and_its_joints_are_its_tcp(
    rate: int, plain: Path, tmp_path: Path
) -> None:
    folder = plain if rate == 125 else make(tmp_path / "logs", robot_rate_hz=rate)
    path = folder / "session_000" / "robot.csv"
    raw = path.read_bytes()
    assert raw.count(b"\r\n") == raw.count(b"\n")
    log = pl.read_csv(path, separator=" ")
    assert log.columns[:2] == ["timestamp", "actual_q_0"]
    assert log["timestamp"][0] == 152.512
    assert np.abs((log["timestamp"].to_numpy() - 152.512) * rate % 1 - 0.5).min() > 0.499
    tcp, rotation = forward(log[[f"actual_q_{i}" for i in range(6)]].to_numpy())
    assert np.abs(tcp - log[POSE].to_numpy()).max() < 1e-6
    vector = log[[f"actual_TCP_pose_{i}" for i in range(3, 6)]].to_numpy()
    assert np.abs(np.einsum("tij,tj->ti", rotation, vector) - vector).max() < 1e-4  # the axis stays where it is
    angle = np.arccos(np.clip((np.trace(rotation, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert np.abs(np.linalg.norm(vector, axis=1) - angle).max() < 1e-3


def test_logged_speeds_are_the_slopes_of_logged_positions(tmp_path: Path) -> None:
    log = pl.read_csv(make(tmp_path / "logs", with_operator=False) / "session_000" / "robot.csv", separator=" ")
    for position, speed in (("actual_q", "actual_qd"), ("actual_TCP_pose", "actual_TCP_speed")):
        for i in range(3):
            slope = np.gradient(log[f"{position}_{i}"].to_numpy(), 0.008)
            assert np.abs(slope - log[f"{speed}_{i}"].to_numpy())[2:-2].max() < 0.01


def test_the_gripper_is_closed_between_each_pick_and_its_placement(plain: Path) -> None:
    log = pl.read_csv(plain / "session_000" / "robot.csv", separator=" ")
    bit = log["actual_digital_output_bits"].to_numpy()
    closes, opens = np.flatnonzero(np.diff(bit) == 1), np.flatnonzero(np.diff(bit) == -1)
    assert len(closes) == len(opens) == 6
    assert np.all(closes < opens)
    assert np.abs(log[POSE].to_numpy()[closes] - [0.6, 0.0, 0.1]).max() < 1e-6


def test_a_perfect_tracker_put_into_the_cell_by_the_cell_file_is_the_truth(tmp_path: Path) -> None:
    folder = make(tmp_path / "logs", tracker_xyz_m=(0.3, -1.9, -0.7), tracker_yaw_deg=-120.0)
    assert np.abs(errors_against_truth(folder, placed(folder))).max() < 2e-3  # linear between frames
    assert 0.8 < frames(folder)["y"].mean() < 1.0  # y is up: a pelvis over the floor


def test_noise_has_the_size_that_was_asked_for_and_is_in_the_log_only(plain: Path, tmp_path: Path) -> None:
    clean, noisy = plain, make(tmp_path / "noisy", delta_m=0.03)
    apart = placed(noisy)[["x_m", "y_m", "z_m"]].to_numpy() - placed(clean)[["x_m", "y_m", "z_m"]].to_numpy()
    assert np.allclose(apart.std(axis=0), 0.03, rtol=0.05)
    truth = [pl.read_parquet(folder / "truth" / "samples.parquet") for folder in (clean, noisy)]
    assert truth[0].equals(truth[1])


def test_lost_frames_come_in_bursts_and_have_empty_cells(tmp_path: Path) -> None:
    lost = frames(make(tmp_path / "logs", executions=6, dropout=0.2))["x"].is_null().to_numpy()
    bursts = np.sum(np.diff(lost.astype(int)) == 1)
    assert 0.12 < lost.mean() < 0.28
    assert lost.sum() / bursts > 5


def test_an_untold_clock_offset_and_drift_are_in_the_people_log(tmp_path: Path) -> None:
    folder = make(tmp_path / "logs", executions=3, clock_offset_s=0.4, clock_drift=1e-3)
    tracked = placed(folder)
    assert np.abs(errors_against_truth(folder, tracked)).max() > 0.2
    lead_s = 152.512 - tomllib.loads((folder / "cell.toml").read_text())["sources"][1]["clock_offset_s"]
    session_s = (tracked["t_s"] - 152.512 + lead_s + 0.4) / 1.001 - lead_s
    undone = tracked.with_columns(t_s=session_s + 152.512)
    assert np.abs(errors_against_truth(folder, undone)).max() < 2e-3


def test_millimetres_are_named_in_the_header_and_nothing_else_changes(plain: Path, tmp_path: Path) -> None:
    metres, millimetres = plain, make(tmp_path / "mm", millimetres=True)
    first = (millimetres / "session_000" / "operator.csv").read_text(encoding="utf-8").split("\n")[0]
    assert "Length Units,Millimeters" in first
    assert np.allclose(frames(millimetres)["x"], frames(metres)["x"] * 1000, atol=1e-3)


def test_without_logged_override_neither_scaling_column_is_there(tmp_path: Path) -> None:
    columns = pl.read_csv(
        make(tmp_path / "logs", log_override=False) / "session_000" / "robot.csv", separator=" "
    ).columns
    assert not {"speed_scaling", "target_speed_fraction"} & set(columns)
    assert "runtime_state" in columns


def test_the_buttons_tell_each_task_of_the_operator_when_it_begins(plain: Path) -> None:
    folder = plain
    events = pl.read_csv(folder / "session_000" / "events.csv")
    cell = tomllib.loads((folder / "cell.toml").read_text())
    assert set(events["signal"]) == {"operator_goal"}
    assert set(events["value"]) <= set(cell["human_places"])
    truth = pl.read_parquet(folder / "truth" / "samples.parquet")
    told = np.searchsorted(events["time"] + cell["sources"][2]["clock_offset_s"], truth["t_s"] + 1e-3) - 1
    assert (pl.Series([events["value"][int(i)] for i in told]) == truth["human_task"]).mean() > 0.999


def test_a_bag_holds_the_same_robot_and_person_as_the_csv_logs(plain: Path, tmp_path: Path) -> None:
    csv, bag = plain, make(tmp_path / "bag", logs="mcap")
    log = pl.read_csv(csv / "session_000" / "robot.csv", separator=" ")
    with AnyReader([bag / "session_000" / "session_000.mcap"]) as reader:
        read: dict[str, list[tuple[int, object]]] = {c.topic: [] for c in reader.connections}
        for connection, t_ns, raw in reader.messages():
            read[connection.topic].append((t_ns, reader.deserialize(raw, connection.msgtype)))
    joints = [message for _, message in read["/joint_states"]]
    order = [joints[0].name.index(name) for name in JOINT_NAMES]
    assert order != list(range(6))
    q = np.array([message.position for message in joints])[:, order]
    assert np.abs(q - log[[f"actual_q_{i}" for i in range(6)]].to_numpy()).max() < 1e-6
    poses = [m.pose.position for _, m in read["/tcp_pose_broadcaster/pose"]]
    assert np.abs(np.array([[p.x, p.y, p.z] for p in poses]) - log[POSE].to_numpy()).max() < 1e-6
    scaling = [m.data for _, m in read["/speed_scaling_state_broadcaster/speed_scaling"]]
    assert np.allclose(scaling, log["speed_scaling"] * 100)
    stamps = np.array([m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m in joints])
    assert np.allclose(stamps - stamps[0], log["timestamp"] - 152.512, atol=1e-6)
    people = np.array([[m.poses[0].position.x, m.poses[0].position.y] for _, m in read["/poses"]])
    assert np.allclose(people, placed(csv)[["x_m", "y_m"]].to_numpy(), atol=1e-5)
    assert [m.data for _, m in read["/io_and_status_controller/robot_program_running"]] == [True, False]
    assert [m.data for _, m in read["/operator/goal"]] == pl.read_csv(csv / "session_000" / "events.csv")[
        "value"
    ].to_list()


def test_a_real_recording_walks_to_and_fro_and_slows_the_robot(tmp_path: Path) -> None:
    t = np.arange(0, 8, 0.05)
    table = pl.DataFrame({"t_s": t, "x_m": 0.1 * t, "y_m": 0 * t, "z_m": 1.0 + 0 * t})
    table.write_csv(tmp_path / "walk.csv")
    options = {"operator_log": tmp_path / "walk.csv", "operator_xyz_m": (-0.4, 2.35, -0.8)}
    folder = make(tmp_path / "logs", executions=2, scene="box-picking", **options)
    truth = pl.read_parquet(folder / "truth" / "samples.parquet")
    assert truth["human_x_m"].min() == pytest.approx(-0.4, abs=0.02)
    assert truth["human_x_m"].max() == pytest.approx(-0.4 + 0.795, abs=0.02)
    assert truth["human_x_m"].diff().abs().max() > 0  # it moves
    assert (
        truth.filter(pl.col("execution") == 0)["human_x_m"][0] != truth.filter(pl.col("execution") == 1)["human_x_m"][0]
    )
    assert truth["scaling"].n_unique() >= 3
    # What the tracker log says, put into the cell, is that walk again; and it can itself be an operator log.
    inside = placed(folder).filter(pl.col("t_s") >= 152.512)
    assert inside["y_m"].is_between(2.349, 2.351).all()
    again = SimulationOptions(
        operator_log=folder / "session_000" / "operator.csv", operator_xyz_m=(1.4, -2.6, -0.8), operator_yaw_deg=35
    )
    copy = simulate("box-picking", tmp_path / "copy", executions=1, seed=1, options=again)
    assert pl.read_parquet(copy / "truth" / "samples.parquet")["human_y_m"].is_between(2.349, 2.351).all()


def test_a_person_who_never_leaves_stops_the_simulation_with_a_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cyclekit_sim.engine._SLOWEST", 3.0)  # sooner than it would be
    (tmp_path / "stand.csv").write_text("t_s,x_m,y_m,z_m\n0,0,0,0\n1,0,0,0\n")
    with pytest.raises(SimulationError, match="never moves on"):
        make(tmp_path / "logs", operator_log=tmp_path / "stand.csv", operator_xyz_m=(0.0, 0.0, 0.0))
    assert [path.name for path in tmp_path.iterdir()] == ["stand.csv"]


@pytest.mark.parametrize(
    "text", ["", "version https://git-lfs\n", "Frame,Time\n1,2\n", "t_s,x_m,y_m,z_m\n0,a,0,0\n1,0,0,0\n"]
)
def test_a_recording_that_is_none_is_refused_by_its_name(text: str, tmp_path: Path) -> None:
    (tmp_path / "odd.csv").write_text(text)
    with pytest.raises(SimulationError, match=r"odd\.csv"):
        make(tmp_path / "logs", operator_log=tmp_path / "odd.csv")


def test_an_earlier_simulation_is_replaced_and_anything_else_is_left_alone(plain: Path, tmp_path: Path) -> None:
    shutil.copytree(plain, tmp_path / "logs")
    shutil.copytree(plain / "session_000", tmp_path / "logs" / "session_001")
    make(tmp_path / "logs", executions=1)
    assert sorted(path.name for path in (tmp_path / "logs").glob("session_*")) == ["session_000"]
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    with pytest.raises(SimulationError, match="another folder"):
        make(tmp_path / "mine")
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "years of work"


def test_truth_tells_what_was_simulated(tmp_path: Path) -> None:
    folder = make(tmp_path / "logs", executions=3, scene="box-picking", executions_per_session=2)
    facts = json.loads((folder / "truth" / "truth.json").read_text())
    assert facts["safety"]["thresholds_m"] == [1.2, 1.5, 1.9, 2.4]
    assert (facts["scene"], facts["seed"], facts["executions"]) == ("box-picking", 5, 3)
    executions = pl.read_parquet(folder / "truth" / "executions.parquet")
    assert executions["session"].to_list() == ["session_000", "session_000", "session_001"]
    assert executions["start_s"][2] == 152.512


@pytest.mark.parametrize(
    ("name", "value"), [("robot_rate_hz", 100), ("dropout", 1.0), ("ramp_up_per_s", 0.0), ("delta_m", -1.0)]
)
def test_an_impossible_option_is_named(name: str, value: float) -> None:
    with pytest.raises(SimulationError, match=name):
        SimulationOptions(**{name: value})


def test_an_unknown_scene_is_answered_with_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match="box-picking, pick-and-package, laser-zones"):
        make(tmp_path / "logs", scene="welding")
