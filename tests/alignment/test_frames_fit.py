"""Where a tracker stands, fitted to points that robot and tracker touched: right, or refused with the reason."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cyclekit.alignment.calibrate import calibrate, frame_line
from cyclekit.alignment.frames import fit_frame, stood_up, to_base
from cyclekit.config import Frame, load_cell
from cyclekit.errors import ConfigError, DamagedLog, LogError, MissingColumns, ShapeError

CORNERS = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.1], [0.0, 0.9, 0.3], [1.1, 1.0, 0.8], [0.4, 0.5, 0.6]])
POINT = st.tuples(*[st.floats(-20, 20)] * 3)


def turned(seed: int) -> np.ndarray:
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn))


def tilted(seed: int = 1, xyz_m: tuple[float, float, float] = (1.4, -2.6, -0.8)) -> Frame:
    rows = turned(seed).tolist()
    return Frame(xyz_m, (tuple(rows[0]), tuple(rows[1]), tuple(rows[2])))


@given(
    arrays(float, st.tuples(st.integers(4, 9), st.just(3)), elements=st.floats(-3, 3)),
    st.integers(0, 50),
    POINT,
    st.sampled_from("yz"),
)
def test_points_without_error_give_the_frame_back(points: np.ndarray, seed: int, xyz_m: Any, up: Any):
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    assume(spread[1] > 0.1)
    frame = tilted(seed, xyz_m)
    fit = fit_frame(points, to_base(points, frame, up=up), up=up)
    np.testing.assert_allclose(to_base(points, fit.frame, up=up), to_base(points, frame, up=up), atol=1e-7)
    assert fit.rms_m < 1e-7
    assert np.linalg.det(np.array(fit.frame.rotation)) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_2_mm_moves_a_point_among_ten_by_less_than_3_mm_and_shows_in_the_residual(seed: int):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (10, 3))
    base = to_base(points, tilted()) + rng.normal(0.0, 0.002, (10, 3))
    fit = fit_frame(points, base)
    inside = rng.uniform(-1.0, 1.0, (50, 3))
    off = np.linalg.norm(to_base(inside, fit.frame) - to_base(inside, tilted()), axis=1)
    assert off.max() < 0.004
    assert np.sqrt(np.mean(off**2)) < 0.003
    assert fit.rms_m == pytest.approx(0.002 * np.sqrt(3), rel=0.4)
    assert fit.warnings == ()


def test_points_on_the_floor_alone_are_enough():
    flat = CORNERS * [1.0, 1.0, 0.0]
    fit = fit_frame(flat, to_base(flat, tilted()))
    np.testing.assert_allclose(fit.frame.rotation, tilted().rotation, atol=1e-9)


@pytest.mark.parametrize(
    ("log", "base", "cause"),
    [
        (CORNERS[:2], CORNERS[:2], "2 points"),
        (CORNERS[:1].repeat(4, axis=0), CORNERS[:1].repeat(4, axis=0), "one position"),
        (np.outer(np.arange(5.0), [1, 2, 0.5]), np.outer(np.arange(5.0), [1, 2, 0.5]), "one line"),
        (1000 * CORNERS, CORNERS, "millimetres"),
        (CORNERS, 1000 * CORNERS, "millimetres"),
        (CORNERS, 3.2808 * CORNERS, "3.28 times"),
        (CORNERS * [1, 1, -1], CORNERS, "mirrored"),
    ],
)
def test_points_that_do_not_tell_a_frame_are_refused(log: np.ndarray, base: np.ndarray, cause: str):
    with pytest.raises(ConfigError, match=cause):
        fit_frame(log, base)


def test_points_in_other_units_are_refused_with_the_columns_to_rename():
    with pytest.raises(ConfigError, match=r"the tracker's columns …_mm"):
        fit_frame(1000 * CORNERS, CORNERS)
    with pytest.raises(ConfigError, match=r"the robot's columns …_mm"):
        fit_frame(CORNERS, 1000 * CORNERS)


def test_arrays_that_do_not_fit_together_are_refused():
    with pytest.raises(ShapeError):
        fit_frame(CORNERS, CORNERS[:4])
    with pytest.raises(ShapeError, match="finite"):
        fit_frame(CORNERS, CORNERS * np.nan)


def test_one_point_touched_wrongly_is_named():
    base = to_base(CORNERS, tilted())
    rng = np.random.default_rng(1)
    more = rng.uniform(-1, 1, (4, 3))
    log, base = np.vstack([CORNERS, more]), np.vstack([base, to_base(more, tilted())])
    base[3] += [0.0, 0.15, 0.0]
    fit = fit_frame(log, base)
    assert int(fit.residual_m.argmax()) == 3
    assert any("point 4" in text for text in fit.warnings)


def test_three_points_are_said_to_be_unchecked():
    assert any("fourth" in text for text in fit_frame(CORNERS[:3], CORNERS[:3]).warnings)


def test_a_planar_tracker_keeps_its_floor_and_not_its_height():
    yaw = Frame((1.0, 2.0, -0.8), ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    placed = to_base(np.array([[1.0, 0.5, np.nan], [np.nan, 0.5, np.nan]]), yaw)
    np.testing.assert_allclose(placed, [[0.5, 3.0, np.nan], [np.nan] * 3])
    assert np.isnan(to_base(np.array([[1.0, 0.5, np.nan]]), tilted())).all()  # tilted, the height would matter


def written(path: Path, log: np.ndarray, base: np.ndarray, *, unit: str = "m", separator: str = ",") -> Path:
    names = [f"{side}_{axis}_{unit if side == 'log' else 'm'}" for side in ("log", "base") for axis in "xyz"]
    lines = [separator.join(["point", *names])]
    factor = 1000.0 if unit == "mm" else 1.0
    for number, (a, b) in enumerate(zip(log * factor, base, strict=True)):
        lines.append(separator.join([f"p{number}", *(f"{v:.6f}" for v in [*a, *b])]))
    path.write_text("\n".join(["# touched with the pointer", *lines]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(("unit", "separator"), [("m", ","), ("mm", ";"), ("m", "\t")])
def test_a_table_of_points_gives_the_line_for_the_cell_file(tmp_path: Path, unit: str, separator: str):
    log = stood_up(CORNERS, "z")
    file = written(tmp_path / "points.csv", log, to_base(log, tilted(), up="y"), unit=unit, separator=separator)
    found = calibrate(file, up="y")
    assert found.points == ("p0", "p1", "p2", "p3", "p4")
    assert found.fit.rms_m < 2e-6
    cell = tmp_path / "cell.toml"
    cell.write_text(f'[[sources]]\npath = "tracker.csv"\n{found.line}\n', encoding="utf-8")
    frame = load_cell(cell).sources[0].frame
    np.testing.assert_allclose(to_base(log, frame, up="y"), to_base(log, tilted(), up="y"), atol=2e-4)


def test_a_frame_that_only_turns_about_the_vertical_is_written_by_its_yaw():
    c, s = np.cos(np.radians(35.0)), np.sin(np.radians(35.0))
    line = frame_line(Frame((1.4, -2.6, -0.8), ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))))
    assert tomllib.loads(line) == {"frame": {"xyz_m": [1.4, -2.6, -0.8], "yaw_deg": 35.0}}


def test_the_wrong_upward_axis_shows_in_the_residual_or_not_at_all_but_the_frame_stays_right(tmp_path: Path):
    file = written(tmp_path / "points.csv", CORNERS, to_base(CORNERS, tilted(), up="y"))
    found = calibrate(file)  # a rotation is a rotation: the fit holds it, for a log that is read as z up
    np.testing.assert_allclose(to_base(CORNERS, found.fit.frame), to_base(CORNERS, tilted(), up="y"), atol=1e-5)


@pytest.mark.parametrize(
    ("text", "kind", "cause"),
    [
        ("", DamagedLog, "empty"),
        ("log_x_m,log_y_m\n1,2\n", MissingColumns, "log_z_m"),
        ("log_x_m,log_y_m,log_z_m,base_x_m,base_y_m,base_z_m\n1,2,3,4,5\n", DamagedLog, "line 2"),
        ("log_x_m,log_y_m,log_z_m,base_x_m,base_y_m,base_z_m\n1,2,3,4,5,x\n", DamagedLog, "point 1"),
        ("log_x_m,log_y_m,log_z_m,base_x_m,base_y_m,base_z_m\n1,2,3,4,5,inf\n", DamagedLog, "not a number"),
        ("log_x_m,log_x_m\n1,2\n", DamagedLog, "one name"),
        ("log_x_m,log_y_m,log_z_m,base_x_m,base_y_m,base_z_m\n", ConfigError, "0 points"),
    ],
)
def test_a_table_that_is_none_is_refused(tmp_path: Path, text: str, kind: type[Exception], cause: str):
    file = tmp_path / "points.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(kind, match=cause):
        calibrate(file)


def test_a_table_that_is_not_there_is_refused(tmp_path: Path):
    with pytest.raises(LogError, match="cannot be read"):
        calibrate(tmp_path / "none.csv")
    file = tmp_path / "bytes.csv"
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DamagedLog, match="UTF-8"):
        calibrate(file)
