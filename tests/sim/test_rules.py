"""Rules in place of a scene's safety function: what they allow, how they are read, the truth beside the logs."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.api.simulate import simulate_logs
from cyclekit_sim import SimulationError, SimulationOptions, read_rule
from cyclekit_sim.fields import on_of
from cyclekit_sim.rules import IsoLaw, Limit, Line, Rectangle, Rule
from cyclekit_sim.safety import SafetyInputs, SpeedScaling
from cyclekit_sim.scenes import BUILT_IN

if TYPE_CHECKING:
    from pathlib import Path

WRITTEN = """
[[limits]]
scaling = 0
distance = "tcp"
below_m = 0.8

[[limits]]
scaling = 0.3
polygon_m = [[1, -1], [3, -1], [3, 1]]
robot_polygon_m = [[0, 0], [1, 0], [1, 1], [0, 1]]
"""


def at(person: tuple[float, float], tcp: tuple[float, float] = (0.5, 0.5)) -> SafetyInputs:
    link = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 2.0, 0.0]]])
    return SafetyInputs(np.array([[*tcp, 0.0]]), np.array([[*person, 0.0]]), lambda: link)


def allowed(rule: Rule, person: tuple[float, float], margin_m: float = 0.0, **where: tuple[float, float]) -> float:
    return float(rule.allowed(at(person, **where), margin_m)[0])


def test_all_conditions_of_a_limit_must_hold_and_the_lowest_limit_counts(tmp_path: Path) -> None:
    (tmp_path / "rule.toml").write_text(WRITTEN)
    rule = read_rule(tmp_path / "rule.toml")
    assert rule.levels == (0.0, 0.3, 1.0)
    assert allowed(rule, (2.9, 0.0)) == 0.3
    assert allowed(rule, (2.9, 0.0), tcp=(-0.5, 0.5)) == 1.0, "the TCP is not above its polygon"
    assert allowed(rule, (2.9, 0.0), tcp=(2.9, 0.5)) == 0.0
    assert allowed(rule, (1.0, 0.0)) == 0.0
    assert allowed(rule, (3.1, 0.0)) == 1.0
    assert allowed(rule, (3.1, 0.0), margin_m=0.2) == 0.3, "within the hysteresis"


def test_distances_are_to_tcp_floor_base_and_nearest_link() -> None:
    def by(distance: str, metres: float) -> float:
        return allowed(Rule((Limit(0.0, distance=distance, below_m=metres),)), (2.0, 1.0), tcp=(0.5, 1.0))

    for distance, metres in (("tcp", 1.5), ("tcp-floor", 1.5), ("base", np.sqrt(5.0)), ("link", 1.0)):
        assert (by(distance, metres + 1e-9), by(distance, metres - 1e-6)) == (0.0, 1.0), distance


@given(
    st.floats(-3, 3), st.floats(-3, 3), st.floats(-80, 80), st.tuples(st.floats(0.1, 2), st.floats(0.1, 2))
)  # fmt: skip
def test_a_rectangle_is_the_polygon_of_its_corners(
    x: float, y: float, turned: float, size: tuple[float, float]
) -> None:
    zone = Rectangle((0.5, 0.5 + size[0]), (-0.3, -0.3 + size[1]), turned)
    nearly = [allowed(Rule((Limit(0.5, rectangle=zone),)), (x, y), by) for by in (-1e-6, 1e-6)]
    if nearly[0] == nearly[1]:
        assert allowed(Rule((Limit(0.5, polygon_m=zone.corners()),)), (x, y)) == nearly[0]


def test_cells_side_by_side_are_each_judged_by_itself(tmp_path: Path) -> None:
    (tmp_path / "rule.toml").write_text(WRITTEN)
    rule, rng = read_rule(tmp_path / "rule.toml"), np.random.default_rng(1)
    person_m, tcp_m = (
        np.round(rng.uniform(low, 3.2, (400, 3)), 1) for low in (-1.2, -0.4)
    )  # also on edges, at corners
    for margin_m in (0.0, 0.1):
        together = rule.allowed(SafetyInputs(tcp_m, person_m, lambda: person_m[:, None]), margin_m)
        pairs = zip(person_m.tolist(), tcp_m.tolist(), strict=True)
        alone = [
            rule.allowed(SafetyInputs(np.array([tcp]), np.array([person]), lambda: tcp_m), margin_m)[0]
            for person, tcp in pairs
        ]
        assert together.tolist() == alone
        assert set(alone) == {0.0, 0.3, 1.0}


@given(st.floats(0.05, 1.0), st.floats(0.0, 2.0), st.floats(0.0, 0.5), st.floats(0.5, 10.0), st.floats(0.2, 3.0))
def test_the_law_allows_the_speed_whose_protective_separation_distance_is_the_distance(
    scaling: float, person: float, reaction: float, deceleration: float, programmed: float
) -> None:
    law = IsoLaw("base", person, reaction, deceleration, 0.2, programmed)
    v = scaling * programmed
    stops_s, way_m = v / deceleration, v**2 / (2 * deceleration)
    protective_m = person * (reaction + stops_s) + v * reaction + way_m + 0.2
    assert law.distance_m(scaling) == pytest.approx(protective_m)
    assert allowed(Rule(law=law), (protective_m, 0.0)) == pytest.approx(scaling, abs=1e-9)
    assert allowed(Rule(law=law), (0.0, 0.0)) == 0.0
    assert allowed(Rule(law=law), (100.0, 0.0)) == 1.0


@pytest.mark.parametrize(("apart_m", "scaling"), [(0.5, 0.2), (1.0, 0.2), (1.5, 0.5), (2.0, 1.0), (9.0, 1.0)])
def test_a_line_rises_from_its_near_to_its_far_distance(apart_m: float, scaling: float) -> None:
    assert allowed(Rule(line=Line(1.0, 2.0, "base", 0.2)), (apart_m, 0.0)) == pytest.approx(scaling)


def test_a_robot_stays_slow_for_the_hold_time() -> None:
    rule = Rule((Limit(0.0, distance="base", below_m=1.0),))
    scaling = SpeedScaling(rule, SimulationOptions(hold_s=0.04, latency_s=0.016))
    way = [0.5, 2.0, 2.0, 0.5, *[2.0] * 12]
    found = [float(scaling.advance(at((x, 0.0)))[0]) for x in way]
    assert found.index(1.0) == 3 + 2 + 5 + 1  # last slow cycle, latency, hold, then fast
    assert found[:11] == [0.0] * 11


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "an empty rule"),
        ("[[limits]]\nscaling = 2\npresent = true", "scaling is 2.0"),
        ("[[limits]]\nscaling = 0.2", "a limit without a condition"),
        ("[[limits]]\nscaling = 0.2\nbelow_m = 1", "give both"),
        ("[[limits]]\nscaling = 0.2\npolygon_m = [[0, 0], [1, 1]]", "polygon_m has 2 corners"),
        ('[law]\nspeed = "x"', "unknown field `speed`"),
        ('[law]\ndistance = "hand"', "use one of tcp, "),
        ("limits = 3", "limits"),
        ("[", "rule.toml: "),
    ],
)
def test_what_is_no_rule_is_refused_with_its_place(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "rule.toml").write_text(text)
    with pytest.raises(SimulationError, match=r"rule\.toml: ") as caught:
        read_rule(tmp_path / "rule.toml")
    assert said in str(caught.value)


def test_the_truth_of_the_rule_lies_beside_the_logs(tmp_path: Path) -> None:
    (tmp_path / "rule.toml").write_text("[law]\nperson_m_s = 1.2\nlowest = 0.6")
    settings = {"rule": tmp_path / "rule.toml", "latency_s": 0.1}
    logs = simulate_logs("box-picking", tmp_path / "logs", executions=1, seed=2, settings=settings).logs
    truth = json.loads((logs / "truth" / "truth.json").read_text())
    assert (truth["safety"]["law"]["person_m_s"], truth["safety"]["law"]["lowest"]) == (1.2, 0.6)
    rows = pl.read_parquet(logs / "truth" / "samples.parquet")
    assert rows["scaling"].min() == 0.6
    assert rows["scaling"].n_unique() > 50, "a law has no levels"


def test_operators_of_pick_and_package_stand_in_its_fields_and_outside_of_them():
    scene = BUILT_IN["pick-and-package"]
    on = {name: int(on_of(scene.fields, np.array([one.xyz_m]))[0]) for name, one in scene.stations.items()}
    assert on == {"inspect": 0b011, "pack": 0b101, "refill": 0}
