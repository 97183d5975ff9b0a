"""The TCP of a log that holds joint angles alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit.adapter import Recording
from cyclekit.config import Cell, Robot, cell_to_toml, load_cell
from cyclekit.config.arms import MODELS, joint_points, recognise_arm
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.ingest.convert import convert
from cyclekit.ingest.ingest import ingest
from cyclekit.ingest.read.tool_point import TCP, with_tool_point
from cyclekit.inspect.describe import describe
from cyclekit.schema import joints_from_base

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    ("model", "flange_m"),
    [
        ("UR5e", (-0.8172, -0.2329, 0.0628)),
        ("UR20", (-1.5907, -0.3553, 0.077)),
        ("UR30", (-1.1407, -0.3553, 0.077)),
        ("Panda", (0.088, 0.0, 0.926)),
        ("FR3", (0.088, 0.0, 0.926)),
        ("iiwa 7", (0.0, 0.0, 1.266)),
        ("iiwa 14", (0.0, 0.0, 1.306)),
    ],
)
def test_a_known_arm_at_zero_is_where_its_maker_says(model: str, flange_m: tuple[float, float, float]):
    arm = MODELS[model]
    points, _ = joint_points(arm, np.zeros((1, len(arm.links))))
    assert points[0, -1] == pytest.approx(flange_m, abs=1e-6)


def test_joints_are_sorted_from_the_base_by_their_names():
    ros = [
        "elbow_joint",
        "shoulder_lift_joint",
        "shoulder_pan_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ]
    assert joints_from_base(ros) == [2, 1, 0, 3, 4, 5]
    assert joints_from_base(["panda_joint2", "panda_joint1", "panda_joint3"]) == [1, 0, 2]
    assert joints_from_base(["b", "a"]) == [0, 1]


def test_an_arm_is_recognised_in_the_base_link_of_ros_which_is_turned():
    """Universal Robots' ROS description turns `base_link` by 180 degrees against the frame of the controller."""
    angles = np.random.default_rng(0).uniform(-1.5, 1.5, (50, 6))
    points, turn = joint_points(MODELS["UR10e"], angles)
    tcp = points[:, -1] + turn @ np.array([0.0, 0.0, 0.15])
    for turned, factors in ((False, [1, 1, 1]), (True, [-1, -1, 1])):
        fit = recognise_arm(angles, tcp * factors)
        assert fit is not None
        assert (fit.arm.name, fit.turned, round(fit.error_m, 6)) == ("UR10e", turned, 0.0)
        found, flange = fit.points(angles)
        assert found == pytest.approx(points * factors)
        assert found[:, -1] + flange @ fit.tool_m == pytest.approx(tcp * factors)


def joints_only(path: Path) -> Path:
    """Log a UR5e that goes to and fro by its first joint, four times, with a stand of a second at each end."""
    swing = np.concatenate([np.zeros(125), np.linspace(0, 1, 125), np.ones(125), np.linspace(1, 0, 125)])
    angles = np.tile(swing, 4)
    columns = {"timestamp": np.arange(len(angles)) / 125}
    columns |= {f"actual_q_{i}": angles if i == 0 else 0.3 * i + 0 * angles for i in range(6)}
    pl.DataFrame(columns).write_csv(path, separator=" ", float_precision=7)
    return path


def test_a_log_of_joints_alone_has_tasks_once_the_arm_is_named(tmp_path: Path):
    log = joints_only(tmp_path / "run.csv")
    without = Dataset.open(ingest([log], tmp_path / "dataset").dataset)
    assert without.tasks().height == 0
    assert any("no TCP" in text for entry in without.card.recordings for text in entry.said)
    found = Dataset.open(ingest([log], tmp_path / "dataset", cell=Cell(robot=Robot("UR5e"))).dataset)
    assert found.tasks().height == 8
    assert any("computed for the flange" in text for entry in found.card.recordings for text in entry.said)


@pytest.mark.parametrize("beside", [True, False])
def test_inspect_and_convert_compute_the_tcp_as_ingest_does(tmp_path: Path, beside: bool):
    log = joints_only(tmp_path / "run.csv")
    without = convert(log, tmp_path / "out.parquet")
    (facts,) = describe(log).logs  # type: ignore[union-attr]
    for said in (without.warnings, facts.warnings):
        assert any("name the arm in cell.toml" in text for text in said)
    cell = tmp_path / ("cell.toml" if beside else "elsewhere.toml")
    cell.write_text(cell_to_toml(Cell(robot=Robot("UR5e", (), (0.0, 0.0, 0.1)))), encoding="utf-8")
    (facts,) = describe(log, cell=None if beside else cell).logs  # type: ignore[union-attr]
    done = convert(log, tmp_path / "out.parquet", columns=TCP, cell=None if beside else load_cell(cell))
    for said in (done.warnings, facts.warnings):
        assert any("computed for the tool of the cell file" in text for text in said)
        assert not any("no TCP" in text for text in said)
    assert set(TCP) <= set(facts.tables["robot"].known)
    made = pl.read_parquet(tmp_path / "out.parquet")
    assert made.columns == ["t_s", *TCP]
    kept = Dataset.open(ingest([log], tmp_path / "dataset", cell=load_cell(cell)).dataset)
    assert made.select(TCP).rows() == kept.recorded(kept.recordings[0].id, "robot").select(TCP).rows()  # type: ignore[union-attr]


def test_parameters_and_a_tool_of_the_cell_file_are_used_and_another_number_of_joints_is_said():
    frame = pl.DataFrame({"t_s": [0.0, 1.0], "q0_rad": [0.0, np.pi / 2], "q1_rad": [0.0, None]})
    robot = Robot(None, ((0.5, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)), (0.0, 0.2, 0.0))
    (part,) = with_tool_point([Recording(robot=frame)], robot)
    assert part.robot is not None
    assert part.robot.select("tcp_x_m", "tcp_y_m", "tcp_z_m").rows() == [pytest.approx((1.0, 0.2, 0.5)), (None,) * 3]
    (other,) = with_tool_point([Recording(robot=frame)], Robot("UR5e"))
    assert "6 joints and the log holds 2" in other.warnings[0]


@pytest.mark.parametrize(("frame", "sign"), [("base", 1.0), ("base_link", -1.0)])
def test_the_tcp_of_a_ur_is_computed_in_the_base_frame_of_its_log(frame: str, sign: float):
    """People of a bag are in `base_link` if their transforms lead there: the arm's own base, turned by pi."""
    angles = np.full((1, 6), 0.3)
    table = pl.DataFrame({"t_s": [0.0], **{f"q{axis}_rad": angles[:, axis] for axis in range(6)}})
    (part,) = with_tool_point([Recording(robot=table, facts={"base_frame": frame})], Robot("UR5e"))
    points, _ = joint_points(MODELS["UR5e"], angles)
    assert part.robot is not None
    assert part.robot.select(TCP).row(0) == pytest.approx(points[0, -1] * [sign, sign, 1.0])


def test_the_robot_of_a_cell_file_is_read_written_and_checked(tmp_path: Path):
    path = tmp_path / "cell.toml"
    for robot in (Robot("iiwa 7", (), (0.0, 0.0, 0.1)), Robot(None, ((0.3, 0.0, -90.0, 0.0),))):
        path.write_text(cell_to_toml(Cell(name="a", robot=robot)), encoding="utf-8")
        assert load_cell(path).robot == robot
    for text, error in (('model = "UR6"', UnknownName), ("dh = [[1]]", ConfigError), ("", ConfigError)):
        path.write_text(f"[robot]\n{text}\n", encoding="utf-8")
        with pytest.raises(error):
            load_cell(path)


IIWA_AXES = ((0, 0, 1), (0, 1, 0), (0, 0, 1), (0, -1, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1))
"""Around which its joints turn when it stands upright, whatever its size: as others publish it, without DH."""


@pytest.mark.parametrize(
    ("model", "heights_m", "flange_m"),
    [
        ("iiwa 7", (0, 0.34, 0.34, 0.74, 0.74, 1.14, 1.14), 1.266),
        ("iiwa 14", (0, 0.36, 0.36, 0.78, 0.78, 1.18, 1.18), 1.306),
    ],
)
def test_an_iiwa_turns_around_the_axes_that_others_give(model: str, heights_m: tuple[float, ...], flange_m: float):
    angles = np.random.default_rng(3).uniform(-2.0, 2.0, (20, 7))
    points, turn = joint_points(MODELS[model], angles)
    for row, mine in enumerate(angles):
        at, whole = np.array([0.0, 0.0, flange_m]), np.eye(3)
        for axis, height, angle in reversed(list(zip(IIWA_AXES, heights_m, mine, strict=True))):
            x, y, z = axis
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
            centre = np.array([0.0, 0.0, height])
            at, whole = centre + rotation @ (at - centre), rotation @ whole
        np.testing.assert_allclose(points[row, -1], at, atol=1e-12)
        np.testing.assert_allclose(turn[row], whole, atol=1e-12)
