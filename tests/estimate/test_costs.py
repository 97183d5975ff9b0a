"""What each number of the safety function costs, and its margin to the protective separation distance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from ruled import box, near, ruled

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import DynamicsCard
from cyclekit.errors import ConfigError, EstimateError
from cyclekit.estimate.robot.safety import Dynamics
from cyclekit.estimate.whatif import Change, LimitChange, load_changes, what_if
from cyclekit.estimate.whatif.alter import altered_safety
from cyclekit.estimate.whatif.costs import SafetyCosts, costs_of, parameter_label, step_label
from cyclekit.estimate.whatif.separation import Separation, margins_of, refuse_other_thresholds
from cyclekit.learning.rules.samples.distances import TO_BASE, TO_TCP
from cyclekit.learning.rules.samples.quantities import quantities

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.dataset.dataset import Dataset


HELD = ruled((0.0, near(0.8), near(0.9)), (0.5, box(1.0, 2.0, -1.0, 1.0), box(0.9, 2.1, -1.1, 1.1)))
STAIRS = ruled((0.0, near(1.2), None), (0.25, near(1.5), None), (0.5, near(1.9), None))


def values(safety: Any) -> list[float]:
    return [round(metres.value, 6) for metres in quantities(safety.rule.limits).values()]


def test_single_numbers_of_the_rule_are_changed_and_the_region_to_leave_moves_along():
    change = Change("c", limits=(LimitChange(0.0, threshold_m=0.7), LimitChange(0.501, x_m=(1.2, 1.9))))
    changed = altered_safety(change, HELD, Dynamics())
    assert values(changed) == [0.7, 0.8, 1.2, 1.9, -1.0, 1.0, 1.1, 2.0, -1.1, 1.1]
    assert values(HELD) == [0.8, 0.9, 1.0, 2.0, -1.0, 1.0, 0.9, 2.1, -1.1, 1.1]


def test_the_file_says_single_numbers_as_the_library_does(tmp_path: Path):
    file = tmp_path / "c.toml"
    file.write_text(
        '[[change]]\nname = "c"\nlimits = [{ level = 0.0, threshold_m = 0.7 }, { level = 0.5, x_m = [1.2, 1.9] }]\n',
        encoding="utf-8",
    )
    assert load_changes(file) == [
        Change("c", limits=(LimitChange(0.0, threshold_m=0.7), LimitChange(0.5, x_m=(1.2, 1.9))))
    ]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{ level = 0.5 }", "give threshold_m, x_m or y_m"),
        ("{ level = 0.5, x_m = [2.0, 1.0] }", "the first must be less than the second"),
        ("{ level = 0.5, threshold_m = -1.0 }", "must be 0 or more"),
        ("{ level = 0.5, threshold = 1.0 }", "threshold"),
    ],
)
def test_what_is_no_threshold_or_edge_is_refused_in_the_file(text: str, said: str, tmp_path: Path):
    file = tmp_path / "c.toml"
    file.write_text(f"[[change]]\nlimits = [{text}]\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=said):
        load_changes(file)


@pytest.mark.parametrize(
    ("limit", "said"),
    [
        (LimitChange(0.3, threshold_m=1.0), "not exactly one threshold_m at level 0.3"),
        (LimitChange(0.0, x_m=(0.0, 1.0)), "not exactly one x_m at level 0"),
    ],
)
def test_a_number_that_the_rule_has_not_is_refused_with_those_it_has(limit: LimitChange, said: str):
    with pytest.raises(EstimateError, match=said) as raised:
        altered_safety(Change("c", limits=(limit,)), HELD, Dynamics())
    assert "level 0: threshold_m; level 0.5: x_m, y_m." in str(raised.value)


def test_limits_are_of_a_rule_and_exclude_a_whole_function(staircase: Any):
    with pytest.raises(EstimateError, match="the model has none"):
        altered_safety(Change("c", limits=(LimitChange(0.0, threshold_m=1.0),)), staircase, Dynamics())
    with pytest.raises(ConfigError, match="both levels and limits"):
        Change("c", (0.0, 1.0), (1.0,), limits=(LimitChange(0.0, threshold_m=1.0),))


@pytest.fixture(scope="module")
def costs(logged: Dataset) -> SafetyCosts:
    """Of the stop threshold alone, with slow ramps: few rollouts."""
    card = structs.replace(logged.card, dynamics=DynamicsCard(ramp_up_per_s=0.5))
    patch = pytest.MonkeyPatch()
    patch.setattr(logged, "card", card)
    try:
        return costs_of(ruled((0.0, near(1.5), None)), logged, [TaskSequence("A", card.executions[0].places)])
    finally:
        patch.undo()


def test_a_centimetre_costs_what_a_written_function_says_it_does(costs: SafetyCosts, logged: Dataset):
    (found,) = costs.sequences
    by = {one.parameter: one for one in found.parameters}
    assert (parameter_label(by["threshold"]), step_label(by["threshold"])) == (
        "stop, distance TCP to operator",
        "+1 cm",
    )
    changes = [
        Change(str(metres), (0.0, 1.0), (metres,), dynamics={"ramp_up_per_s": 0.5, "hysteresis_m": 0.0})
        for metres in (1.45, 1.55)
    ]
    less, more = what_if(
        ruled((0.0, near(1.5), None)),
        logged,
        [TaskSequence("A", logged.card.executions[0].places)],
        changes,
        validate=False,
    )
    written_s = (more.after.expected_s - less.after.expected_s) / 10
    assert by["threshold"].costs_s == pytest.approx(written_s, rel=1e-3)
    assert 0.0 < by["threshold"].standard_error_s < by["threshold"].costs_s


def test_recovery_saves_hysteresis_costs_and_a_ramp_that_the_logs_do_not_show_is_left_out(costs: SafetyCosts):
    by = {one.parameter: one for one in costs.sequences[0].parameters}
    assert set(by) == {"threshold", "hysteresis", "reaction time", "recovery"}
    assert by["recovery"].costs_s < 0.0 < by["hysteresis"].costs_s
    assert [step_label(by[name]) for name in ("reaction time", "recovery")] == ["+10 ms", "+10 %/s"]
    assert costs.notes == ("braking: the logs show no ramp",)
    assert costs.to_frame().height == 4
    assert "no safety proof" in repr(costs)


GIVEN = Separation(0.1, (0.3,), (0.2,), 1.0, 0.1, 0.05, 0.01)


def test_the_separation_distance_is_the_sum_of_its_terms():
    # S_h 1.6 * 0.4, S_r 0.5 * 0.1, S_s 0.2, C 0.1, Z_d 0.05, Z_r 0.01
    assert GIVEN.distance_m(0.5, 0) == pytest.approx(0.64 + 0.05 + 0.2 + 0.1 + 0.05 + 0.01)


@given(st.integers(0, 7), st.floats(0.001, 0.5), st.floats(0.05, 1.0))
def test_whatever_grows_the_separation_distance_grows_and_the_margin_shrinks(which: int, by: float, level: float):
    name = list(vars(GIVEN))[which]
    old = getattr(GIVEN, name)
    more = Separation(**vars(GIVEN) | {name: (old[0] + by,) if isinstance(old, tuple) else old + by})
    assert more.distance_m(level, 0) > GIVEN.distance_m(level, 0)


def test_each_threshold_is_compared_at_the_speed_that_holds_just_beyond_it():
    several = Separation(0.1, (0.1, 0.2, 0.3), (0.2,), 2.0, 0.1, 0.0, 0.0)
    price = {(level, TO_TCP): 0.1 for level in (0.0, 0.25, 0.5)}
    found = margins_of(STAIRS.rule, several, price, latency_s=0.3)
    assert [row.speed for row in found.thresholds] == [0.25, 0.5, 1.0]
    expected = [1.6 * (0.1 + stop_s) + speed * 2.0 * 0.1 + 0.3 for stop_s, speed in ((0.1, 0.25), (0.2, 0.5), (0.3, 1))]
    assert [row.separation_m for row in found.thresholds] == pytest.approx(expected)
    assert [row.margin_m for row in found.thresholds] == pytest.approx(np.array([1.2, 1.5, 1.9]) - expected)
    # 10 ms: the person comes 1.6 cm nearer, the robot 0.5, 1 and 2 cm, at 0.1 s a centimetre
    assert found.reaction_costs_s_per_10_ms == pytest.approx(0.1 * (3 * 1.6 + 3.5))
    assert "No safety validation" in found.safety
    assert any("0.30 s, the one given is 0.1 s" in note for note in found.notes)


def test_the_robots_reach_is_not_in_a_distance_to_its_base_and_rectangles_have_none():
    base = ruled((0.0, near(1.2, TO_BASE), None), (0.5, box(1.0, 2.0, -1.0, 1.0), None))
    found = margins_of(base.rule, GIVEN, {(0.0, TO_BASE): 0.1}, None)
    assert [row.margin_m for row in found.thresholds] == [None]
    assert sum("not compared" in note for note in found.notes) == 2
    with pytest.raises(ConfigError, match="no threshold on a distance"):
        refuse_other_thresholds(ruled((0.5, box(1.0, 2.0, -1.0, 1.0), None)).rule, GIVEN)
    with pytest.raises(ConfigError, match="stopping_time_s: 2 numbers, 3 thresholds"):
        refuse_other_thresholds(STAIRS.rule, Separation(**vars(GIVEN) | {"stopping_time_s": (0.1, 0.2)}))


@pytest.mark.parametrize(
    ("name", "value", "cure"),
    [
        ("reaction_time_s", 100.0, "Give it in s: 0 or more, at most 10."),
        ("stopping_distance_m", (200.0,), "Give it in m: 0 or more, at most 10."),
        ("intrusion_m", float("nan"), "Give it in m"),
        ("operator_uncertainty_m", -0.1, "Give it in m"),
        ("approach_speed_m_s", 1600.0, "Give it in m/s: more than 0, at most 20."),
        ("robot_speed_m_s", 0.0, "Give it in m/s: more than 0"),
        ("stopping_time_s", (), "Give one, or one for each threshold."),
    ],
)
def test_numbers_in_other_units_are_refused(name: str, value: Any, cure: str):
    with pytest.raises(ConfigError, match=name) as raised:
        Separation(**vars(GIVEN) | {name: value})
    assert cure in str(raised.value)
