"""The cell files that the guide shows for controllers without a public layout, each on a small export of its kind."""

import re
import tomllib
from pathlib import Path

import pytest

from cyclekit.adapter import ReadOptions
from cyclekit_adapters.formats import mapped_csv

GUIDE = (Path(__file__).parents[2] / "docs/adapters.md").read_text(encoding="utf-8")
SECTION = GUIDE.partition("### Controllers without a public layout")[2]
JOINTS = "joint_1,joint_2,joint_3,joint_4,joint_5,joint_6"
RIGHT_ANGLE = 1.5707963267948966

SINCE_1970 = 1_714_557_600
EXPORTS = {
    "FANUC": "logger_ms,X,Y,Z,W,GENOVERRIDE\n1000,850,-120.5,300,0,40\n1500,850,-120.5,310,0,100\n",
    "ABB": f"tm,pos_x,pos_y,pos_z,{JOINTS},speed_ratio\n1000,850,-120.5,300,90,0,0,0,0,0,40\n"
    "1500,850,-120.5,310,90,0,0,0,0,0,100\n",
    "Yaskawa": f"stamp_s,tcp_x,tcp_y,tcp_z,{JOINTS}\n{SINCE_1970 + 1},0.85,-0.1205,0.3,{RIGHT_ANGLE},0,0,0,0,0\n"
    f"{SINCE_1970 + 1.5},0.85,-0.1205,0.31,{RIGHT_ANGLE},0,0,0,0,0\n",
    "Doosan": "time_stamp,"
    + ",".join(f"actual_{what}_{i}" for what in ("tcp_position", "joint_position") for i in range(6))
    + "\n1.0,850,-120.5,300,0,0,0,90,0,0,0,0,0\n1.5,850,-120.5,310,0,0,0,90,0,0,0,0,0\n",
    "Techman": "header_stamp_s,tool_pose_0,tool_pose_1,tool_pose_2,project_speed,project_run\n"
    f"{SINCE_1970 + 1},0.85,-0.1205,0.3,40,True\n{SINCE_1970 + 1.5},0.85,-0.1205,0.31,100,False\n",
    "xArm": f"timestamp_us,actual_x,actual_y,actual_z,{JOINTS},state\n"
    f"1000000,850,-120.5,300,{RIGHT_ANGLE},0,0,0,0,0,1\n1500000,850,-120.5,310,{RIGHT_ANGLE},0,0,0,0,0,2\n",
}
CLOCKS = dict.fromkeys(EXPORTS, "uptime") | {"Yaskawa": "epoch", "Techman": "epoch"}
STATES = {"Techman": ["playing", "stopped"], "xArm": ["playing", None]}


def source_of(maker):
    block = re.search(rf"^\*\*{maker}\*\*.*?```toml\n(.*?)```", SECTION, re.MULTILINE | re.DOTALL)
    assert block, f"the guide shows no cell file for {maker}"
    (source,) = tomllib.loads(block[1])["sources"]
    return source


def read(tmp_path, maker):
    source = source_of(maker)
    log = tmp_path / source["path"].replace("*", "1")
    log.write_text(EXPORTS[maker], encoding="utf-8")
    assert source["adapter"] == "csv"
    return mapped_csv.ADAPTER.read(log, ReadOptions(role=source["role"], map=source["map"]))


def test_the_guide_shows_these_makers_and_no_other():
    assert re.findall(r"^\*\*(\w+)\*\*", SECTION, re.MULTILINE) == list(EXPORTS)
    assert "replace them by those of your own export" in SECTION


@pytest.mark.parametrize("maker", EXPORTS)
def test_the_cell_file_of_the_guide_gives_metres_and_seconds(tmp_path, maker):
    log = read(tmp_path, maker)
    begin = SINCE_1970 if CLOCKS[maker] == "epoch" else 0
    assert (log.robot["t_s"] - begin).to_list() == pytest.approx([1.0, 1.5])
    assert log.robot["tcp_x_m"].to_list() == pytest.approx([0.85] * 2)
    assert log.robot["tcp_y_m"].to_list() == pytest.approx([-0.1205] * 2)
    assert log.robot["tcp_z_m"].to_list() == pytest.approx([0.3, 0.31])
    assert log.clock == CLOCKS[maker]
    assert log.set_aside.is_empty()


@pytest.mark.parametrize("maker", ["ABB", "Yaskawa", "Doosan", "xArm"])
def test_joint_angles_are_in_radians_whatever_the_maker_writes(tmp_path, maker):
    assert read(tmp_path, maker).robot["q0_rad"].to_list() == pytest.approx([RIGHT_ANGLE] * 2)


@pytest.mark.parametrize("maker", EXPORTS)
def test_an_override_in_percent_becomes_a_fraction_and_an_absent_one_stays_unknown(tmp_path, maker):
    expected = [0.4, 1.0] if maker in ("FANUC", "ABB", "Techman") else [None, None]
    assert read(tmp_path, maker).robot["scaling"].to_list() == expected


@pytest.mark.parametrize("maker", STATES)
def test_states_are_mapped_by_the_makers_own_numbers_and_words(tmp_path, maker):
    assert read(tmp_path, maker).robot["state"].to_list() == STATES[maker]
