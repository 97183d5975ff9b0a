"""What a person reads when something is wrong, and the canonical tables that adapters are held to."""

from __future__ import annotations

import pickle
from pathlib import Path

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit import errors, schema
from cyclekit.errors import CyclekitError, LogError, MissingColumns, MissingExtra, ShapeError, UnknownName, nearest


def test_a_message_has_what_was_seen_the_nearest_right_thing_and_the_cure():
    error = MissingColumns(Path("run7.csv"), ["speed_scaling"], ["speed_scalling", "t"], "Record it.")
    assert str(error) == ("run7.csv: no column 'speed_scaling'\n  the nearest is 'speed_scalling'\n  Record it.")


def test_all_missing_columns_are_named_at_once():
    assert "no columns 'a', 'b'" in str(MissingColumns(Path("run.csv"), {"b", "a"}, []))


def test_an_unknown_name_is_answered_with_the_known_ones():
    error = UnknownName("sequence 'A'", "place", "homme", ["rest", "home"])
    assert (error.nearest, error.cure) == ("home", "Known: home, rest.")
    assert UnknownName("here", "place", "x", []).cure == "No place is known here."


def test_every_error_is_one_of_ours_and_can_cross_from_a_worker_process():
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, CyclekitError)]
    assert len(kinds) >= 12
    samples = [
        LogError(Path("run.csv"), "cut in half", nearest="run.bag", cure="Copy it again."),
        MissingColumns(Path("run.csv"), ["a"], ["b"], "Record it."),
        UnknownName("here", "place", "x", ["y"]),
        MissingExtra("torch", "train", "training"),
    ]
    for error in samples:
        copy = pickle.loads(pickle.dumps(error))
        assert type(copy) is type(error)
        assert str(copy) == str(error)
        assert vars(copy) == vars(error)


@given(st.text(max_size=12), st.lists(st.text(max_size=12), max_size=5))
def test_the_nearest_name_is_always_a_known_one(name: str, known: list[str]):
    assert nearest(name, known) in {None, *known}
    assert nearest("conveyer", [*known, "conveyor"]) is not None


def test_absent_columns_are_null_and_the_order_is_that_of_the_table():
    frame = schema.conform(pl.DataFrame({"value": ["shelf"], "t_s": [1]}), schema.EVENTS)
    assert frame.columns == list(schema.EVENTS)
    assert frame.row(0) == (1.0, None, "shelf", None)


def test_joints_follow_the_columns_of_a_robot_in_order_angles_before_speeds():
    frame = pl.DataFrame({"qd10_rad_s": [1], "q10_rad": [2], "q2_rad": [3], "t_s": [0]})
    found = schema.conform(frame, schema.ROBOT)
    assert found.columns == [*schema.ROBOT, "q2_rad", "q10_rad", "qd10_rad_s"]
    assert found["q2_rad"].dtype == pl.Float64
    with pytest.raises(ShapeError):
        schema.conform(frame, schema.PEOPLE)


def test_a_column_that_no_table_knows_is_refused_by_name():
    with pytest.raises(ShapeError, match=r"\['speed'\] are not in the canonical table"):
        schema.conform(pl.DataFrame({"t_s": [0.0], "speed": [1.0]}), schema.PEOPLE)


@pytest.mark.parametrize(
    ("name", "joint"), [("q0_rad", True), ("qd11_rad_s", True), ("q_rad", False), ("q1_rad_s", False)]
)
def test_a_joint_column_is_told_by_its_name(name: str, joint: bool):
    assert schema.is_joint(name) is joint


def test_an_empty_table_has_the_columns_and_no_rows():
    assert schema.empty(schema.TASKS).height == 0
    assert schema.empty(schema.TASKS).columns == list(schema.TASKS)
