"""The sequence file: places or tasks, in order, without jumps."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.config.sequences import PlannedTask, TaskSequence, load_sequences
from cyclekit.errors import ConfigError, UnknownName


def loaded(tmp_path: Path, text: str) -> list[TaskSequence]:
    path = tmp_path / "sequences.toml"
    path.write_text(text, encoding="utf-8")
    return load_sequences(path)


def test_places_and_tasks_name_the_same_sequence(tmp_path: Path):
    text = '[[sequence]]\nname = "A"\nplaces = ["home", "conveyor", "left"]\n'
    text += '[[sequence]]\nname = "B"\ntasks = ["home->conveyor", "conveyor->left"]\noperator = ["rest", "refill"]'
    a, b = loaded(tmp_path, text)
    assert a.places == b.places == ("home", "conveyor", "left")
    assert a.tasks == ("home->conveyor", "conveyor->left")
    assert (a.name, a.operator, b.operator) == ("A", None, ("rest", "refill"))


def test_a_sequence_without_a_name_is_called_by_its_number(tmp_path: Path):
    text = '[[sequence]]\nplaces = ["a", "b"]\n[[sequence]]\nplaces = ["b", "a"]'
    assert [sequence.name for sequence in loaded(tmp_path, text)] == ["sequence 1", "sequence 2"]


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ('[[sequence]]\ntasks = ["a->b", "c->d"]', "does not start where"),
        ('[[sequence]]\ntasks = ["a->b->c"]', "is not a task"),
        ('[[sequence]]\ntasks = ["a->"]', "is not a task"),
        ("[[sequence]]\ntasks = []", "at least two places"),
        ('[[sequence]]\nplaces = ["a"]', "at least two places"),
        ('[[sequence]]\nplaces = "a"', "must be a list"),
        ('[[sequence]]\nname = "A"', r"no places, tasks or \[\[sequence.task\]\]"),
        ('[[sequence]]\nplaces = ["a", "b"]\ntasks = ["a->b"]', "both places and tasks"),
        ("", r"no \[\[sequence\]\]"),
        ("sequence = [3]", "must be a table"),
        ('[sequence]\nplaces = ["a", "b"]', "must be a list"),
        ('[[sequence]]\nname = "A"\nplaces = ["a", "b"]\n[[sequence]]\nname = "A"\nplaces = ["b", "a"]', "used twice"),
    ],
)
def test_what_is_no_sequence_is_refused_with_the_file_and_a_cure(tmp_path: Path, text: str, seen: str):
    with pytest.raises(ConfigError, match=seen) as caught:
        loaded(tmp_path, text)
    assert "sequences.toml" in caught.value.seen
    assert caught.value.cure


def test_a_key_that_is_not_known_is_refused_with_the_nearest(tmp_path: Path):
    with pytest.raises(UnknownName) as caught:
        loaded(tmp_path, '[[sequence]]\nplace = ["a", "b"]')
    assert caught.value.nearest == "places"
    with pytest.raises(UnknownName) as caught:
        loaded(tmp_path, '[[sequences]]\nplaces = ["a", "b"]')
    assert caught.value.nearest == "sequence"


@given(st.lists(st.sampled_from("abc"), min_size=2, max_size=8))
def test_the_tasks_of_a_sequence_lead_through_its_places_in_order(places: list[str]):
    tasks = TaskSequence("A", tuple(places)).tasks
    assert [task.partition("->")[0] for task in tasks] == places[:-1]
    assert [task.partition("->")[2] for task in tasks] == places[1:]


PLAN = """
[[sequence]]
name = "both"
[[sequence.task]]
agent = "robot"
name = "bring"
not_before_s = 2.5
[[sequence.task]]
agent = "operator"
name = "mount"
after = ["bring"]
"""


def test_a_plan_for_robot_and_operator_is_read(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(PLAN, encoding="utf-8")
    (found,) = load_sequences(tmp_path / "s.toml")
    assert found.plan == (PlannedTask("robot", "bring", 2.5), PlannedTask("operator", "mount", None, ("bring",)))


def test_the_zero_of_a_planner_is_zero(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(PLAN.replace("2.5", "-1.7586e-13"), encoding="utf-8")
    (found,) = load_sequences(tmp_path / "s.toml")
    assert found.plan[0].not_before_s == 0.0


@pytest.mark.parametrize(
    ("more", "seen"),
    [
        ('places = ["a", "b"]', "together with places"),
        ("", "is not a time since the cycle's start"),
    ],
)
def test_a_plan_that_cannot_be_followed_is_refused(tmp_path: Path, more: str, seen: str) -> None:
    text = PLAN.replace('name = "both"', f'name = "both"\n{more}')
    (tmp_path / "s.toml").write_text(text if more else text.replace("2.5", "-2.5"), encoding="utf-8")
    with pytest.raises(ConfigError, match=seen):
        load_sequences(tmp_path / "s.toml")
