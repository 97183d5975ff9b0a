"""Another cell on the same logs: safety function, moved base and places, an operator who comes more or less often."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from known_cells import LEVELS, THRESHOLDS_M
from msgspec import structs

from cyclekit.cli import run
from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import DynamicsCard, TrainingCard
from cyclekit.errors import ConfigError, EstimateError, UnknownName
from cyclekit.estimate.operator.tracks import OperatorTracks
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.robot.safety import Dynamics, Follower
from cyclekit.estimate.whatif import NO_PROOF, Change, load_changes, what_if
from cyclekit.estimate.whatif.alter import DefinedSafety, altered_safety, altered_tasks, altered_tracks
from cyclekit.estimate.whatif.change import Zone

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.validation.check import Check


def test_a_written_staircase_is_that_staircase(staircase: Any):
    X = np.random.default_rng(0).uniform(-3, 3, (500, 6)).astype(np.float32)
    written = DefinedSafety(Change("paper", levels=LEVELS, thresholds_m=THRESHOLDS_M))
    np.testing.assert_array_equal(written.predict(X), staircase.predict(X))


def test_written_zones_take_the_slowest_that_the_operator_stands_in():
    zones = (Zone((-1.0, 1.0), (-1.0, 1.0), 0.0), Zone((-2.0, 2.0), (-2.0, 2.0), 0.5))
    written = DefinedSafety(Change("zones", levels=(0.0, 0.5, 1.0), zones=zones))
    X = np.zeros((3, 6), dtype=np.float32)
    X[:, 3] = (0.9, 1.5, 2.5)
    assert written.predict(X).tolist() == [0.0, 0.5, 1.0]


BOX = (Zone((1.0, 2.0), (-1.0, 1.0), 0.5),)
CAPPED = Change("both", levels=(0.0, 0.5, 1.0), thresholds_m=(0.8, 1.2), zones=BOX)


def scalings(model: Any, dynamics: Dynamics, xs: list[float]) -> list[float]:
    """Walk an operator along x past a robot at the origin."""
    follower = Follower(model, dynamics, 0.1)
    return [float(follower.advance(np.zeros((1, 3)), np.array([[x, 0.0, 0.0]]))[0]) for x in xs]


def test_where_thresholds_and_zones_are_given_the_slower_of_both_holds(tmp_path: Path):
    X = np.zeros((5, 6), dtype=np.float32)
    X[:, 3] = (0.7, 1.1, 1.5, 2.0, 2.1)
    assert DefinedSafety(CAPPED).predict(X).tolist() == [0.0, 0.5, 0.5, 0.5, 1.0]
    file = tmp_path / "c.toml"
    file.write_text(
        '[[change]]\nname = "both"\nlevels = [0.0, 0.5, 1.0]\nthresholds_m = [0.8, 1.2]\n'
        "zones = [{ x_m = [1.0, 2.0], y_m = [-1.0, 1.0], level = 0.5 }]\n",
        encoding="utf-8",
    )
    assert load_changes(file) == [CAPPED]


def test_a_written_function_slows_at_its_thresholds_and_lets_go_by_the_hysteresis_farther_out():
    held = Dynamics(hysteresis_m=0.2)
    stairs = Change("stairs", levels=(0.5, 1.0), thresholds_m=(1.0,))
    assert scalings(DefinedSafety(stairs), held, [1.05, 0.95, 1.05, 1.15, 1.25]) == [1.0, 0.5, 0.5, 0.5, 1.0]
    assert scalings(DefinedSafety(CAPPED), held, [2.3, 2.1, 1.9, 2.1, 2.3]) == [1.0, 1.0, 0.5, 0.5, 1.0]
    beside = np.array([[1.5, y, 0.0] for y in (1.3, 0.9, 1.1, 1.3)])  # past the side of the zone, not towards the robot
    follower = Follower(DefinedSafety(CAPPED), held, 0.1)
    assert [float(follower.advance(np.zeros((1, 3)), at[None])[0]) for at in beside] == [1.0, 0.5, 0.5, 1.0]


class Hesitant:
    """0.5 within 0.9 m of the x axis, else 1; at 0.9 to 1.1 m now one, now the other, as logged with hysteresis."""

    problem, network, levels, card = "now", "classifier", (0.5, 1.0), TrainingCard()

    def probabilities(self, X: np.ndarray) -> np.ndarray:
        quick = np.clip((np.abs(X[:, 4]) - 0.9) / 0.2, 0.0, 1.0)
        return np.stack([1.0 - quick, quick], axis=1)

    def predict(self, X: np.ndarray) -> np.ndarray:
        return self.probabilities(X) @ np.array(self.levels)


def test_a_classifier_that_hesitates_within_the_hysteresis_is_on_a_level_and_zones_have_sides_too():
    follower = Follower(Hesitant(), Dynamics(hysteresis_m=0.2), 0.1)
    way = [np.array([[1.5, y, 0.0]]) for y in (1.3, 1.05, 0.85, 1.05, 1.15)]
    assert [float(follower.advance(np.zeros((1, 3)), at)[0]) for at in way] == [1.0, 1.0, 0.5, 0.5, 1.0]
    at_once = altered_safety(Change("other", dynamics={"hysteresis_m": 0.0}), Hesitant(), Dynamics(hysteresis_m=0.2))
    rows = np.array([[0.0, 0.0, 0.0, 1.5, y, 0.0] for y in (0.85, 0.95, 1.05)], dtype=np.float32)
    assert at_once.predict(rows).tolist() == [0.5, 1.0, 1.0]


def test_what_lies_around_the_operators_is_asked_all_at_once():
    asked = []

    class Counted(Hesitant):
        def probabilities(self, X: Any) -> Any:
            asked.append(len(X))
            return super().probabilities(X)

    robot, human = np.zeros((3, 3)), np.array([[0.0, 1.0, 0.0], [0.0, 2.0, 0.0], [0.0, 1.0, 0.0]])
    Follower(Counted(), Dynamics(hysteresis_m=0.2), 0.1).advance(robot, human)
    assert asked == [3, 8]


def test_what_is_learned_keeps_where_it_slows_when_the_hysteresis_is_changed(staircase: Any):
    logged = Dynamics(hysteresis_m=0.2)  # so the outer threshold of 2.4 m stands for falls at 2.3, rises at 2.5
    outwards = [2.6, 2.28, 2.45, 2.55]
    assert scalings(staircase, logged, outwards) == [1.0, 0.75, 0.75, 1.0]
    for hysteresis_m, expected in ((0.0, [1.0, 0.75, 1.0, 1.0]), (0.3, [1.0, 0.75, 0.75, 0.75])):
        change = Change("other", dynamics={"hysteresis_m": hysteresis_m})
        safety = altered_safety(change, staircase, logged)
        assert scalings(safety, Dynamics(hysteresis_m=hysteresis_m), outwards) == expected


def test_what_is_logged_of_the_scaling_in_time_holds_after_a_change_unless_it_is_changed(
    logged: Dataset, staircase: Any, monkeypatch: pytest.MonkeyPatch
):
    places = logged.card.executions[0].places
    same = {"levels": LEVELS, "thresholds_m": THRESHOLDS_M}
    changes = [Change("same", **same), Change("at once", **same, dynamics={"ramp_up_per_s": float("inf")})]
    told = DynamicsCard(ramp_up_per_s=0.3, latency_s=0.2)
    monkeypatch.setattr(logged, "card", structs.replace(logged.card, dynamics=told))
    kept, quicker = what_if(staircase, logged, [TaskSequence("A", places)], changes, validate=False)
    assert kept.saves_s[0] == pytest.approx(0.0)
    assert quicker.saves_s[0] > 1.0
    said = "the changed safety function keeps the logged latency_s 0.2"
    assert f"{said}, ramp_up_per_s 0.3" in kept.after.warnings
    assert said in quicker.after.warnings


def test_the_same_staircase_changes_nothing_and_a_smaller_one_saves_time(logged: Dataset, staircase: Any):
    places = logged.card.executions[0].places
    changes = [
        Change("same", levels=LEVELS, thresholds_m=THRESHOLDS_M),
        Change("small", levels=LEVELS, thresholds_m=(0.6, 0.8, 1.2, 1.6)),
    ]
    same, small = what_if(staircase, logged, [TaskSequence("A", places)], changes)
    assert same.saves_s[0] == pytest.approx(0.0)
    assert same.saves_s[1] <= 0.0 <= same.saves_s[2] < 2.0
    assert small.saves_s[0] > 20
    assert small.saves_s[1] < small.saves_s[0] < small.saves_s[2]
    assert small.saves_s[0] == pytest.approx(small.before.expected_s - small.after.expected_s)
    for entry in (same, small):
        assert NO_PROOF in entry.after.warnings
        assert entry.to_dict()["safety"] == NO_PROOF


def test_the_bias_of_the_learned_function_does_not_correct_one_that_is_written_down(logged: Dataset, staircase: Any):
    class Slow:
        problem, card = "now", staircase.card

        def predict(self, X: Any) -> Any:
            return 0.97 * staircase.predict(X)

    places = logged.card.executions[0].places
    same = Change("same", levels=LEVELS, thresholds_m=THRESHOLDS_M)
    (exact,) = what_if(staircase, logged, [TaskSequence("A", places)], [same], validate=False)
    (judged,) = what_if(Slow(), logged, [TaskSequence("A", places)], [same])
    assert judged.before.check is not None
    assert judged.before.check.factor < 0.99
    both = judged.before.combined
    assert both is not None
    moved = both.expected_s / both.rollout_s  # by what the tasks took in the logs, before as after
    assert judged.after.expected_s == pytest.approx(exact.after.expected_s * moved)


def test_a_saving_is_known_no_better_than_the_learned_function_it_is_measured_from(
    logged: Dataset, staircase: Any, check: Check
):
    """A written function has no network's error; the cell as it is has, and the difference with it."""
    route = TaskSequence("A", logged.card.executions[0].places[:7])
    changes = [
        Change("written", LEVELS, (0.6, 0.8, 1.2, 1.6)),
        Change("slower recovery", dynamics={"ramp_up_per_s": 0.5}),
    ]
    sure, unsure = (
        what_if(staircase, logged, [route], changes, check=replace(check, own_bias=0.0, own_error=error))
        for error in (0.0, 0.02)
    )
    for one, other in zip(sure, unsure, strict=True):
        assert one.saves_s[0] == pytest.approx(other.saves_s[0], rel=0.02)  # history's share is another
    widths = [[each.saves_s[2] - each.saves_s[1] for each in found] for found in (sure, unsure)]
    assert widths[1][0] ** 2 - widths[0][0] ** 2 > (2 * 1.96 * 0.02 * sure[0].before.expected_s) ** 2 * 0.5
    assert widths[1][1] == pytest.approx(widths[0][1], rel=0.02)


def test_a_change_that_cannot_be_answered_is_named_and_the_others_are_answered(logged: Dataset, staircase: Any):
    places = ("home", "conveyor")
    changes = [Change("too often", frequency=50.0), Change("same", levels=LEVELS, thresholds_m=THRESHOLDS_M)]
    refused: list[tuple[str, str]] = []
    (same,) = what_if(
        staircase,
        logged,
        [TaskSequence("A", places)],
        changes,
        refused=lambda change, error: refused.append((change.name, str(error))),
    )
    assert same.change == "same"
    ((name, reason),) = refused
    assert name == "too often"
    assert reason.startswith("change 'too often': ")
    with pytest.raises(EstimateError, match="change 'too often'"):
        what_if(staircase, logged, [TaskSequence("A", places)], changes)


def test_a_sequence_that_cannot_be_answered_is_named_and_the_others_are_compared(logged: Dataset, staircase: Any):
    refused: list[tuple[str, str]] = []
    known, new = TaskSequence("A", ("home", "conveyor")), TaskSequence("B", ("home", "home"))
    (same,) = what_if(
        staircase,
        logged,
        [new, known],
        [Change("same", levels=LEVELS, thresholds_m=THRESHOLDS_M)],
        refused=lambda asked, error: refused.append((asked.name, error.seen)),
    )
    assert (same.change, same.after.name) == ("same", "A")
    ((name, reason),) = refused
    assert name == "B"
    assert "'home->home' was never logged" in reason


def test_a_refusal_of_the_estimate_itself_names_the_change_too(logged: Dataset, staircase: Any):
    halted = Change("halted for ever", levels=(0.0, 1.0), thresholds_m=(900.0,))
    with pytest.raises(EstimateError, match=r"change 'halted for ever': .* do not end"):
        what_if(staircase, logged, [TaskSequence("A", ("home", "conveyor"))], [halted])


@pytest.mark.slow  # quick: the refusals above, and the command in test_answer
def test_the_command_answers_what_it_can_and_fails_where_it_can_answer_nothing(
    logged: Dataset, staircase: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr("cyclekit.api.given.load_model", lambda _: staircase)
    often = '[[change]]\nname = "too often"\nfrequency = 50.0\n'
    smaller = f'[[change]]\nname = "small"\nlevels = {list(LEVELS)}\nthresholds_m = [0.6, 0.8, 1.2, 1.6]\n'
    asked, out = tmp_path / "s.toml", tmp_path / "out.json"
    asked.write_text('[[sequence]]\nname = "A"\nplaces = ["home", "conveyor"]\n', encoding="utf-8")
    for name, text, code in (("both", often + smaller, 0), ("none", often, 1)):
        file = tmp_path / f"{name}.toml"
        file.write_text(text, encoding="utf-8")
        words = ["whatif", "m", str(asked), str(file), "--dataset", str(logged.path), "--out", str(out)]
        assert run([*words, "--json"]) == code
        found = json.loads(capsys.readouterr().out)
        if code == 0:
            assert [entry["change"] for entry in found["answers"]] == ["small"]
            assert [entry["change"] for entry in found["refused"]] == ["too often"]
            assert run(words) == 0
            shown = capsys.readouterr().out
            assert "Not answered\n- change 'too often': " in shown
            assert "based on only 16 executions that show the operator" in " ".join(shown.split())
            out.unlink()
        else:
            assert "change 'too often'" in found["error"]["message"]
            assert not out.exists()


def test_a_moved_place_bends_the_motions_there_and_no_others(logged: Dataset):
    before = nominal_tasks(logged)
    x, y, z = logged.places["conveyor"].xyz_m
    after = altered_tasks(Change("farther", places={"conveyor": (x + 0.2, y, z)}), before, logged)
    for name, task in before.items():
        start, goal = name.split("->")
        shift = [0.2 * (place == "conveyor") for place in (start, goal)]
        assert after[name].xyz_m[[0, -1], 0] - task.xyz_m[[0, -1], 0] == pytest.approx(shift)
        np.testing.assert_allclose(after[name].xyz_m[:, 1:], task.xyz_m[:, 1:])
        if "conveyor" not in (start, goal):
            assert after[name] is task
    with pytest.raises(UnknownName):
        altered_tasks(Change("slip", places={"conveyer": (0, 0, 0)}), before, logged)


def tracks_of(near: list[bool]) -> OperatorTracks:
    x = np.where(near, 0.5, 5.0)
    xyz = np.stack([x, 0 * x, 0 * x], axis=1)[None]
    return OperatorTracks(xyz, np.zeros((1, len(x)), dtype=np.int64), ("w",), np.array([len(x)]), ("e",), 0.1)


def test_half_as_often_stretches_the_time_away_and_keeps_the_visits(logged: Dataset, staircase: Any):
    tasks = nominal_tasks(logged)
    near = ([False] * 30 + [True] * 10) * 10
    tracks = tracks_of(near)
    half = altered_tracks(Change("half", frequency=0.5), tracks, tasks, staircase)
    seen = half.xyz_m[0, :, 0] < 1.0
    starts = np.flatnonzero(np.diff(seen.astype(int)) == 1)
    assert np.diff(starts) == pytest.approx([80] * (len(starts) - 1), abs=1)
    assert seen.sum() == pytest.approx(50, abs=3)
    twice = altered_tracks(Change("twice", frequency=2.0), tracks, tasks, staircase)
    starts = np.flatnonzero(np.diff((twice.xyz_m[0, : twice.logged[0], 0] < 1.0).astype(int)) == 1)
    assert np.diff(starts) == pytest.approx([20] * (len(starts) - 1), abs=1)


def test_an_operator_who_is_always_there_cannot_come_more_often(logged: Dataset, staircase: Any):
    tasks = nominal_tasks(logged)
    with pytest.raises(EstimateError, match="away 0 % of the time"):
        altered_tracks(Change("more", frequency=2.0), tracks_of([True] * 50), tasks, staircase)
    with pytest.raises(EstimateError) as caught:
        altered_tracks(Change("more", frequency=9.0), tracks_of([True, False] * 50), tasks, staircase)
    assert "At most 2 times" in str(caught.value.cure)


def test_a_moved_base_sees_the_operator_from_where_it_stands(logged: Dataset, staircase: Any):
    tracks = tracks_of([True] * 5)
    seen = altered_tracks(Change("turned", base_m=(0.5, -1.0, 0.0), base_yaw_deg=90.0), tracks, {}, staircase)
    np.testing.assert_allclose(seen.xyz_m[0, 0], [1.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("levels = [0.0, 1.0]", "levels without thresholds_m or zones"),
        ("levels = [1.0, 0.0]\nthresholds_m = [1.0]", "levels"),
        ("levels = [0.0, 1.0]\nthresholds_m = [1.0, 2.0]", "2 levels and 2 thresholds"),
        ("levels = [0.0, 0.5, 1.0]\nthresholds_m = [2.0, 1.0]", "thresholds_m"),
        ("levels = [0.0, 1.0]\nzones = [{ x_m = [0, 1], y_m = [0, 1], level = 0.5 }]", "not among levels"),
        ("levels = [0.0, 1.0]\nzones = [{ x_m = [1, 0], y_m = [0, 1], level = 0.0 }]", "must be less"),
        ("frequency = 0.0", "frequency"),
        ("ramp_up_per_s = 0.0", "ramp_up_per_s 0.0"),
        ("hysteresis_m = nan", "hysteresis_m nan"),
        ("latency_s = -0.1", "latency_s -0.1"),
        ("places = { conveyor = [0.1, 0.2] }", "expected a list of length 3, got 2"),
        ("base = 3", "base: 3 must be a table"),
        ("threshold_m = [1.0]", "unknown key 'threshold_m'"),
        ("", "nothing is changed"),
    ],
)
def test_a_change_that_is_none_is_refused(text: str, said: str, tmp_path: Path):
    file = tmp_path / "changes.toml"
    file.write_text(f"[[change]]\n{text}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=said) as caught:
        load_changes(file)
    assert caught.value.cure


def test_a_file_without_changes_is_refused(tmp_path: Path):
    file = tmp_path / "changes.toml"
    file.write_text("", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"no \[\[change\]\]"):
        load_changes(file)
