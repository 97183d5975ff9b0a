"""Places that logs write for an unknown one are found, named, counted and unknown; true ones are kept."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import Recording, concat_parts
from cyclekit.errors import ConfigError
from cyclekit.ingest.validate.validate import examined, examined_parts
from cyclekit.inspect.describe import describe
from cyclekit.schema import PEOPLE, conform

if TYPE_CHECKING:
    from pathlib import Path


def people(places: np.ndarray, person: str = "1") -> pl.DataFrame:
    """Rows at 25 Hz of one person at places (N, 2 or 3)."""
    axes = dict(zip(("x_m", "y_m", "z_m"), places.T, strict=False))
    t_s = np.arange(len(places)) / 25
    return conform(pl.DataFrame({"t_s": t_s, "person": [person] * len(places), **axes}, nan_to_null=True), PEOPLE)


def walk(rows: int, axes: int = 3) -> np.ndarray:
    t = np.arange(rows) / 25
    return np.column_stack([1.5 + 0.5 * np.sin(t), 2.0 + 0.3 * np.cos(t), 0.9 + 0.01 * np.sin(9 * t)])[:, :axes]


def seen(recording: Recording) -> list[bool]:
    assert recording.people is not None
    return recording.people["x_m"].is_not_null().to_list()


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("value", [0.0, -0.0, -1.0, -0.001, 9999 * 0.001, 9999.0, -9999.0, 999.0 / 1000])
def test_a_place_that_stands_for_nobody_is_unknown_counted_and_named(value: float, axes: int):
    places = walk(480, axes)
    places[100:324] = value
    found = examined(Recording(people=people(places)))
    assert seen(found) == [not 100 <= row < 324 for row in range(480)]
    (said,) = found.warnings
    assert said.startswith(f"a person is at exactly {value + 0.0:g} m on every axis in 224 of 480 rows")
    assert found.set_aside is None


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("cuts", [[1000], [180, 333, 487]])
def test_positions_that_a_tracker_holds_until_it_sees_the_person_elsewhere_are_said(axes: int, cuts: list[int]):
    t = np.arange(1000) / 25
    places = np.column_stack([1.5 + 1.2 * np.sin(t), 2.0 + 1.2 * np.cos(t), 0.9 + 0.01 * np.sin(9 * t)])[:, :axes]
    for first, end in ((100, 180), (400, 475), (800, 824)):  # 3.2 s, 3 s, and less than 1 s
        places[first:end] = places[first]
    table, ends = people(places), np.cumsum(cuts)
    parts = [Recording(people=table[end - cut : end]) for cut, end in zip(cuts, ends, strict=True)]
    said, _ = concat_parts(examined_parts(parts)).warnings  # the jumps themselves are said, too
    assert "at least 1 s and then jumps, 2 time(s), 6.1 s in all" in said


def test_who_stands_where_a_tracker_rounds_and_walks_on_is_not_held():
    t = np.arange(1000) / 25
    way = np.round(np.interp(t, [0, 10, 12, 30, 33, 40], [0, 0, 2.5, 2.5, 0.5, 0.5]), 2)
    assert examined(Recording(people=people(np.column_stack([1 + way, 2 + way])))).warnings == ()


def robot(values: np.ndarray, names: tuple[str, ...]) -> Recording:
    """Rows of a robot at 25 Hz, with values (N, len(names))."""
    columns = dict(zip(names, values.T, strict=True))
    return Recording(robot=pl.DataFrame({"t_s": np.arange(len(values)) / 25, **columns}), rows_read=len(values))


def bursts(rows: int, every: int, length: int) -> np.ndarray:
    """Return a mask of rows in bursts."""
    return np.asarray(np.arange(rows) % every >= every - length)


TOOL, JOINTS = ("tcp_x_m", "tcp_y_m", "tcp_z_m"), tuple(f"q{i}_rad" for i in range(6))


def motion(axes: int) -> np.ndarray:
    t = np.arange(500)[:, None] / 25
    return np.asarray(0.6 + 0.2 * np.sin(t + np.arange(axes)))


@pytest.mark.parametrize(("names", "value"), [(TOOL, 0.0), (TOOL, -1.0), (TOOL[:2], 0.0), (JOINTS, 0.0)])
@pytest.mark.parametrize("cuts", [[500], [61, 300, 139]])
def test_a_robot_that_jumps_to_a_placeholder_in_bursts_is_unknown_there(
    names: tuple[str, ...], value: float, cuts: list[int]
):
    odd, places = bursts(500, 80, 10), motion(len(names))
    places[odd] = value
    log, ends = robot(places, names), np.cumsum(cuts)
    parts = [Recording(robot=log.robot[end - cut : end], rows_read=cut) for cut, end in zip(cuts, ends, strict=True)]
    found = concat_parts(examined_parts(parts))
    assert found.robot is not None
    assert (found.robot[names[0]].is_null().to_numpy() == odd).all()
    assert found.robot.drop_nulls(names).select(names).to_numpy().tolist() == places[~odd].tolist()
    told = "all joints jump to exactly 0 in 60 of 500 rows" if names == JOINTS else f"exactly {value:g} m on every axis"
    assert sum(told in text for text in found.warnings) == 1
    assert found.set_aside is None


def test_a_tool_point_computed_from_joints_of_a_placeholder_is_unknown_too():
    odd, places = bursts(500, 80, 10), motion(9)
    places[odd] = [0, 0, 0, 0, 0, 0, -0.8, -0.2, 0.1]
    found = examined(robot(places, (*JOINTS, *TOOL)))
    assert found.robot is not None
    assert (found.robot["tcp_x_m"].is_null().to_numpy() == odd).all()
    places[odd, 6:] = motion(9)[odd, 6:]  # the tool was logged: only the joints are unknown
    found = examined(robot(places, (*JOINTS, *TOOL)))
    assert found.robot is not None
    assert not found.robot["tcp_x_m"].null_count()


@pytest.mark.parametrize("names", [TOOL, JOINTS])
def test_a_robot_that_moves_to_0_or_rests_there_is_known(names: tuple[str, ...]):
    there = np.clip(np.abs(np.arange(500) - 250)[:, None] / 200 - 0.25, 0, 1) * np.ones(len(names))
    assert (there == 0).all(axis=1).sum() > 90
    for places in (there, np.zeros((500, len(names)))):
        found = examined(robot(places, names))
        assert found.robot is not None
        assert not found.robot[names[0]].null_count()


def test_a_tracker_that_only_ever_says_nobody_saw_nobody():
    assert not any(seen(examined(Recording(people=people(np.zeros((50, 3)))))))


def test_who_walks_across_the_middle_of_a_floor_in_centimetres_stays_seen():
    places = np.column_stack([np.round(np.linspace(-1, 1, 201), 2)] * 2)
    assert (places == 0.0).all(axis=1).sum() == 1
    found = examined(Recording(people=people(places)))
    assert all(seen(found))
    assert found.warnings == ()


@given(st.lists(st.booleans(), min_size=1, max_size=40), st.sampled_from([0.0, -1.0]), st.integers(1, 30))
def test_it_does_not_matter_where_the_log_was_cut(there: list[bool], value: float, length: int):
    places = walk(3 * len(there))
    places[np.repeat(~np.array(there), 3)] = value
    table = people(places)
    parts = [Recording(people=table[first : first + length]) for first in range(0, table.height, length)]
    found = concat_parts(examined_parts(parts))
    assert seen(found) == np.repeat(there, 3).tolist()
    assert found.warnings == examined(Recording(people=table)).warnings


def mapped(folder: Path, keys: str) -> Path:
    folder.mkdir()
    rows = [f"{i / 25:.2f},{1 + 0.01 * i:.2f},{2 + 0.001 * i:.3f},0.9" for i in range(60)]
    lines = [f"{row},{0.8 if i < 40 else 0}" for i, row in enumerate(rows)]
    lines[10:15] = [f"{i / 25:.2f},7777,7777,7777,0.8" for i in range(10, 15)]
    (folder / "people.csv").write_text("\n".join(["t,x,y,z,sure", *lines, ""]), encoding="utf-8")
    source = '[[sources]]\npath = "people.csv"\nadapter = "csv"\nrole = "people"\n[sources.map]\n'
    (folder / "cell.toml").write_text(f'{source}time = "t"\nx = "x"\ny = "y"\nz = "z"\n{keys}', encoding="utf-8")
    return folder


def test_the_cell_file_names_other_numbers_and_the_column_that_says_how_sure_a_place_is(tmp_path: Path):
    (log,) = describe(mapped(tmp_path / "a", 'missing = [-7, 7777]\nconfidence = "sure"\n')).logs
    assert log.tables["people"].known["x_m"] == 35 / 60
    assert "the position is missing (-7, 7777) in 5 of 60 rows: unknown there" in log.warnings
    assert "sure is 0 in 20 of 60 rows: no person is detected there" in log.warnings


def test_missing_is_a_list_of_numbers(tmp_path: Path):
    with pytest.raises(ConfigError, match="missing = 'NA' is not a list of numbers"):
        describe(mapped(tmp_path / "a", 'missing = "NA"\n'))
