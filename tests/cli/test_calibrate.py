"""`cyclekit calibrate` at the terminal: the line for the cell file, the residuals, and refusals with a cure."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from .conftest import Shell

HEAD = "point,log_x_m,log_y_m,log_z_m,base_x_m,base_y_m,base_z_m\n"
POINTS = HEAD + (
    "table,0,0,0,1,2,0\nleft,1,0,0,1,3,0\nright,0,1,0,0,2,0\npost,0,0,1,1,2,1\nmiddle,0.5,0.5,0.5,0.5,2.5,0.504\n"
)


def test_the_line_for_the_cell_file_is_printed_under_the_residual_of_each_point(tmp_path: Path, cyclekit: Shell):
    file = tmp_path / "points.csv"
    file.write_text(POINTS, encoding="utf-8")
    shown = cyclekit("calibrate", file)
    assert shown.code == 0
    assert all(name in shown.out for name in ("table", "left", "middle", "rms"))
    frame = tomllib.loads(shown.out.splitlines()[-1])["frame"]
    assert [round(v, 2) for v in frame["xyz_m"]] == [1.0, 2.0, 0.0]


def test_json_holds_frame_line_and_residuals_in_metres(tmp_path: Path, cyclekit: Shell):
    file = tmp_path / "points.csv"
    file.write_text(POINTS, encoding="utf-8")
    told = cyclekit("calibrate", file, "--json").document
    assert tomllib.loads(told["line"])["frame"].keys() == {"xyz_m", "rotation"}
    assert max(entry["residual_m"] for entry in told["points"]) < 0.004
    assert 0 < told["rms_m"] < 0.003


def test_millimetres_taken_for_metres_are_found_and_the_cure_is_named(tmp_path: Path, cyclekit: Shell):
    file = tmp_path / "points.csv"
    rows = "0,0,0,1,2,0\n1000,0,0,1,3,0\n0,1000,0,0,2,0\n0,0,1000,1,2,1\n"
    file.write_text(HEAD.removeprefix("point,") + rows, encoding="utf-8")
    shown = cyclekit("calibrate", file)
    assert shown.code == 1
    assert "millimetres taken for metres" in shown.err
    assert "_mm" in shown.err
    file.write_text(file.read_text(encoding="utf-8").replace("log_x_m,log_y_m,log_z_m", "log_x_mm,log_y_mm,log_z_mm"))
    assert cyclekit("calibrate", file).code == 0


def test_an_axis_that_does_not_exist_is_a_wrong_command_line(tmp_path: Path, cyclekit: Shell):
    assert cyclekit("calibrate", tmp_path / "points.csv", "--up", "x").code == 2


def test_no_coordinate_is_shown_as_minus_zero(tmp_path: Path, cyclekit: Shell):
    file = tmp_path / "points.csv"
    same = "".join(
        f"p{n},{xyz},{xyz}\n" for n, xyz in enumerate(("0,0,0", "1,0,0.1", "0,1,0.2", "1,1,0.9", "-1,0.3,0"))
    )
    file.write_text(HEAD + same, encoding="utf-8")
    assert "-0.0000" not in cyclekit("calibrate", file).out
