"""What cannot be is found and named, row by row, wherever a log was cut into parts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cyclekit.adapter import Recording, concat_parts
from cyclekit.ingest.validate.validate import examined, examined_parts
from cyclekit.schema import PEOPLE, ROBOT, conform

if TYPE_CHECKING:
    pass


def robot(rows: int = 300, **columns: Any) -> Recording:
    """A robot that goes to and fro at 125 Hz, with some of its columns replaced."""
    t = np.arange(rows) / 125
    made = {
        "t_s": t,
        "tcp_x_m": 0.3 + 0.2 * np.sin(t),
        "tcp_y_m": 0.1 * np.cos(t),
        "tcp_z_m": 0.0 * t + 0.4,
        "source_row": np.arange(rows),
    }
    return Recording(robot=conform(pl.DataFrame(made | columns), ROBOT), rows_read=rows)


def walk(rows: int = 200, person: str = "7", x: Any = None) -> pl.DataFrame:
    t = np.arange(rows) / 30
    x = 1.0 + 0.5 * np.sin(t) if x is None else x
    columns = {"t_s": t, "person": [person] * rows, "x_m": x, "y_m": 2.0 + 0.01 * t, "z_m": 0.0 * t + 1.0}
    return conform(pl.DataFrame({**columns, "source_row": np.arange(rows)}), PEOPLE)


def with_value(column: pl.Series, row: int, value: float) -> pl.Series:
    values = column.to_list()
    values[row] = value
    return pl.Series(column.name, values)


def aside(log: Recording) -> list[tuple[int, str]]:
    return [] if log.set_aside is None else log.set_aside.rows()


def test_a_sound_recording_is_left_as_it_is():
    log = robot()
    found = examined(log)
    assert found.robot.equals(log.robot)
    assert (found.warnings, aside(found)) == ((), [])
    people = Recording(people=pl.concat([walk(person="a"), walk(person="b")]))
    assert examined(people).people.equals(people.people)
    assert examined(people).warnings == ()


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (float("nan"), "its time is not a plausible number"),
        (float("inf"), "its time is not a plausible number"),
        (99 / 125, "has the time of the row before it, and other values"),
        (50 / 125, "its time does not fit between its neighbours"),
        (1e9, "its time does not fit between its neighbours"),
        (-3.0, "its time does not fit between its neighbours"),
    ],
)
def test_a_row_whose_time_cannot_be_is_set_aside_alone(value: float, reason: str):
    log = robot()
    found = examined(robot(t_s=with_value(log.robot["t_s"], 100, value)))
    assert aside(found) == [(100, reason)]
    assert found.robot.height == 299


def test_a_restarted_clock_is_no_stray_row():
    t = np.concatenate([np.arange(150), np.arange(150)]) / 125
    found = examined(robot(t_s=t))
    assert (found.robot.height, aside(found)) == (300, [])


def test_a_clock_that_was_set_while_recording_is_named():
    t = np.arange(300) / 125 + np.where(np.arange(300) < 200, 0.0, 1.7e9)
    (said,) = examined(robot(t_s=t)).warnings
    assert "jumps ahead by 19675.9 days" in said


def test_nan_and_infinite_values_become_unknown_and_are_counted():
    log = robot()
    x = with_value(with_value(log.robot["tcp_x_m"], 3, float("nan")), 4, float("inf"))
    found = examined(robot(tcp_x_m=x))
    assert found.robot["tcp_x_m"].null_count() == 2
    assert found.warnings == ("NaN or infinite: tcp_x_m in 2 rows; unknown there",)


@pytest.mark.parametrize("value", [1.5, -0.9, 1e3, 1e300])
def test_a_tcp_that_jumps_there_and_back_is_set_aside(value: float):
    log = robot()
    found = examined(robot(tcp_x_m=with_value(log.robot["tcp_x_m"], 77, value)))
    assert [row for row, _ in aside(found)] == [77]
    assert "the TCP" in aside(found)[0][1]


@pytest.mark.parametrize("value", [5.0, -300.0])
def test_an_operator_at_20_m_s_is_set_aside_and_the_others_of_that_row_are_kept(value: float):
    other = walk(person="b")
    people = pl.concat([walk(person="a", x=with_value(walk()["x_m"], 50, value)), other])
    found = examined(Recording(people=people))
    assert [row for row, _ in aside(found)] == [50]
    assert found.people.filter(pl.col("person") == "b").equals(other)


def test_a_track_that_changes_its_person_is_named_and_kept():
    x = walk()["x_m"].to_numpy() + np.where(np.arange(200) < 100, 0.0, 6.0)
    found = examined(Recording(people=walk(x=x)))
    assert found.people.height == 200
    assert found.warnings == ("a person jumps faster than 20 m/s 1 time(s): a track that changed its person",)


def test_jitter_of_the_clock_makes_no_jump():
    t = np.arange(300) / 125
    t[100] += 0.0079  # the next row comes 0.1 ms later, 8 mm farther
    found = examined(robot(t_s=t, tcp_x_m=t))
    assert (found.warnings, aside(found)) == ((), [])


def test_millimetres_read_as_metres_are_named_with_the_cure_and_not_mended():
    log = robot(tcp_x_m=1000 * robot().robot["tcp_x_m"])
    found = examined(log)
    assert "probably millimetres" in found.warnings[0]
    assert found.robot.height == 300
    people = examined(Recording(people=walk(x=1400.0 + walk()["x_m"])))
    assert people.warnings[0].startswith("a person is 1401 m away in 200 rows: probably millimetres")


@pytest.mark.parametrize(
    ("column", "values", "said"),
    [
        (
            "scaling",
            np.linspace(0, 100, 300),
            "scaling reaches 100 in 297 rows: probably percent, set scaling_max = 100",
        ),
        ("tcp_speed_m_s", np.linspace(0, 400, 300), "likely mm/s"),
        ("q1_rad", np.linspace(-90, 90, 300), 'probably degrees; set joint_unit = "deg"'),
        ("t_s", np.arange(300) * 8.0, "robot rows lie 8 s apart"),
    ],
)
def test_a_slip_of_units_is_named_with_the_cure(column: str, values: Any, said: str):
    assert any(said in text for text in examined(robot(**{column: values})).warnings)


def test_a_tcp_that_never_moves_by_a_hair_is_named():
    same = {f"tcp_{axis}_m": [0.0] * 300 for axis in "xyz"}
    assert examined(robot(**same)).warnings == (
        "the TCP stays at exactly (0, 0) m in all 300 rows: check the logged signal",
    )
    assert examined(robot(50, **{name: values[:50] for name, values in same.items()})).warnings == ()


@given(
    st.lists(st.tuples(*[st.one_of(st.none(), st.floats())] * 5), max_size=25),
    st.lists(st.tuples(st.one_of(st.none(), st.floats()), st.sampled_from([None, "a", "b"]), st.floats()), max_size=15),
)
def test_any_numbers_at_all_are_kept_or_set_aside(rows: list[Any], tracks: list[Any]):
    columns = ("t_s", "tcp_x_m", "tcp_y_m", "scaling", "tcp_speed_m_s")
    frame = pl.DataFrame(rows, schema=dict.fromkeys(columns, pl.Float64()), orient="row").with_row_index("source_row")
    log = Recording(robot=conform(frame, ROBOT), rows_read=len(rows))
    found = examined(log)
    assert found.robot.height + len(aside(found)) == len(rows)
    assert found.robot["t_s"].is_finite().all()
    seen = {"t_s": pl.Float64(), "person": pl.String(), "x_m": pl.Float64()}
    people = conform(pl.DataFrame(tracks, schema=seen, orient="row").with_row_index("source_row"), PEOPLE)
    found = examined(Recording(people=people))
    assert found.people.height + len(aside(found)) == len(tracks)


def _in_parts(log: Recording, cuts: list[int]) -> list[Recording]:
    (name, table), edges = next(iter(log.tables().items())), sorted({0, *cuts})
    pieces = [table[a:b] for a, b in zip(edges, [*edges[1:], table.height], strict=True) if b > a or a == 0]
    return [Recording(**{name: piece}, rows_read=piece.height) for piece in pieces]


FAULTS = [float("nan"), float("inf"), -3.0, 1e9, 7.5, 40.0, 0.8]


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 59), st.sampled_from(FAULTS)), max_size=4),
    st.lists(st.tuples(st.integers(0, 59), st.sampled_from(FAULTS)), max_size=4),
    st.lists(st.integers(12, 59), max_size=6),
    st.integers(1, 3),
)
def test_what_cannot_be_does_not_depend_on_where_a_log_was_cut_into_parts(times, places, cuts, persons: int):
    log = robot(60)
    columns = {"t_s": log.robot["t_s"].to_list(), "tcp_x_m": log.robot["tcp_x_m"].to_list()}
    for row, value in times:
        columns["t_s"][row] = value if row > 11 else columns["t_s"][row]
    for row, value in places:
        columns["tcp_x_m"][row] = value if row > 11 else columns["tcp_x_m"][row]
    tracks = pl.concat([walk(20, person=f"{number}") for number in range(persons)]).sort("t_s", maintain_order=True)
    moved = tracks["x_m"].to_list()
    for row, value in places:
        moved[row % len(moved)] = value if row > 11 else moved[row % len(moved)]
    people = Recording(people=tracks.with_columns(x_m=pl.Series(moved)), rows_read=tracks.height)
    for one in (robot(60, **columns), people):
        at_once, name = examined(one), next(iter(one.tables()))
        in_parts = concat_parts(examined_parts(_in_parts(one, cuts)))
        assert in_parts.tables()[name].equals(at_once.tables()[name])
        assert sorted(aside(in_parts)) == sorted(aside(at_once))
        assert in_parts.warnings == at_once.warnings


def test_metres_that_are_said_to_be_millimetres_are_named():
    person = walk().with_columns(pl.col("x_m", "y_m", "z_m") * 1e-3)
    (said,) = examined(Recording(people=person)).warnings
    assert "never farther than" in said
    assert "metres with the unit given as millimetres" in said
    log = robot()
    small = Recording(robot=log.robot.with_columns(pl.col("^tcp_.*$") * 1e-3))
    assert any("the TCP is never farther" in text for text in examined(small).warnings)
    short = Recording(people=person.head(20))
    assert examined(short).warnings == ()
