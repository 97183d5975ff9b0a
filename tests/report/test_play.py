"""What the part to play with holds: the library's own numbers follow from it; and why a page has none."""

from __future__ import annotations

import base64
import json
import zlib

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of
from known_cells import logged
from played import ORDERS, network, staircase, zoned
from report_pages import DistanceModel
from report_pages import estimate as made_up
from ruled import box, ruled

from cyclekit.config.sequences import PlannedTask
from cyclekit.dataset.cards.rule import LimitCard, MetresCard, PolygonCard, RegionCard, SideCard
from cyclekit.estimate.cycle.walk import roll_all
from cyclekit.estimate.operator.tracks import OperatorTracks
from cyclekit.estimate.robot.nominal import NominalTask, nominal_tasks
from cyclekit.estimate.robot.program import Program, lay_out
from cyclekit.estimate.rollout import estimate
from cyclekit.report import compose_report
from cyclekit.report.inputs import PageInputs
from cyclekit.report.play import PlayPart, part, play_part, scaling_grid
from cyclekit.report.play import packed as packing
from cyclekit.report.play.packed import FINEST, UNKNOWN, in_steps, in_units, packed, units_per_metre
from cyclekit.report.play.tables import _rule
from cyclekit.report.texts import load_texts

__all__ = ["logged"]


def unpacked(text):
    told = json.loads(text)
    (told,) = told.get("parts", [told])
    block = zlib.decompress(base64.b64decode(told["block"]))
    arrays = {
        name: np.frombuffer(block, np.dtype(kind).newbyteorder("<"), count, offset)
        for name, (kind, offset, count) in told["arrays"].items()
    }
    return told["facts"], arrays


def metres(steps, unit):
    units = np.cumsum(steps, axis=-2, dtype=np.int32)
    return np.where(units == UNKNOWN, np.nan, units / unit)


@given(xyz_m=arrays_of.arrays(np.float64, (3, 7, 3), elements=st.one_of(st.floats(-30.0, 30.0), st.just(float("nan")))))
def test_coordinates_come_back_as_fine_as_their_unit(xyz_m):
    unit = units_per_metre(xyz_m)
    assert metres(in_steps(in_units(xyz_m, unit)), unit) == pytest.approx(xyz_m, abs=0.5001 / unit, nan_ok=True)


def test_many_coordinates_are_rounded_more_coarsely(monkeypatch):
    xyz_m = np.random.default_rng(0).normal(size=(4, 500, 3)).cumsum(axis=1) / 1000
    assert units_per_metre(xyz_m) == FINEST[0]
    fits = len(zlib.compress(in_steps(in_units(xyz_m, FINEST[1])).tobytes(), 1))
    monkeypatch.setattr(packing, "FEW_BYTES", fits)
    assert units_per_metre(xyz_m) == FINEST[1]
    monkeypatch.setattr(packing, "FEW_BYTES", 0)
    assert units_per_metre(xyz_m) == FINEST[-1]


def test_no_name_ends_the_script_that_holds_it():
    text = packed({"name": "</script><!--"}, {"odd": np.arange(3, dtype=np.uint8), "next": np.arange(2.0)})
    assert "<" not in text
    facts, arrays = unpacked(text)
    assert facts["name"] == "</script><!--"
    assert arrays["next"].tolist() == [0.0, 1.0]


def rebuilt(facts, arrays):
    """The tasks, tracks and rule of a page as the library has them, from nothing but the page."""
    unit, count = facts["per_metre"], facts["tracks"]["count"]
    paths, stands = metres(arrays["paths"].reshape(-1, 3), unit), arrays["stands"].reshape(-1, count)
    tasks = {}
    for name, leg in facts["legs"].items():
        xyz_m = paths[leg["first"] : leg["first"] + leg["points"]]
        drawn = np.sort(stands[leg["stands"]]).astype(np.float64)
        tasks[name] = NominalTask(name, xyz_m, leg["nominal_s"], leg["dwell_s"], leg["wait_s"], drawn)
    people = metres(arrays["people"].reshape(-1, 3), unit)
    where = people[np.cumsum(arrays["who"], dtype=arrays["who"].dtype)].reshape(count, -1, 3)
    nothing = np.zeros(where.shape[:2], np.int64)
    logged = np.array(facts["tracks"]["logged"])
    tracks = OperatorTracks(where, nothing, (), logged, ("x",) * count, facts["tracks"]["step_s"])
    limits = msgspec.convert(facts["rule"]["limits"], tuple[LimitCard, ...])
    return tasks, tracks, limits


@pytest.mark.parametrize("model", [staircase(), zoned()], ids=["staircase", "zones"])
def test_the_tables_give_the_rolled_out_cycles_of_the_library(logged, model):
    found = estimate(model, logged, ORDERS, validate=False)
    shown = [each for each in found if each.name == "long"]
    text = play_part(PageInputs(load_texts(), logged, model, shown)).data
    tasks, tracks, limits = rebuilt(*unpacked(text))
    assert limits == model.rule.limits
    programs = {each.name: lay_out(each, nominal_tasks(logged), logged) for each in ORDERS}
    for each in found:  # also orders that are no sequence of the page
        legs = tuple(tasks[task.task] for task in programs[each.name].tasks)
        (cycles,) = roll_all(model, [Program(legs, programs[each.name].edges_s)], tracks, None)
        assert cycles.duration_s.mean() == pytest.approx(each.expected_s, rel=5e-4)


def test_a_rule_with_nothing_to_move_says_so():
    sides = tuple(SideCard(angle_rad=0.5 * np.pi * n, metres=MetresCard(value=1.0)) for n in range(3))
    area = RegionCard(polygons=(PolygonCard(sides=sides),))
    assert _rule(ruled((0.3, area, None)))["fixed"] == "fixed_rule"
    told = _rule(ruled((0.3, box(None, 1.0, None, None), None)))  # one edge was crossed, and that can be moved
    assert (told["fixed"], told["moves"][0]["axes"], told["moves"][0]["bounds"]) == (None, [0], [-0.5, 0.5])


def test_a_page_says_why_it_cannot_be_played_with(logged, monkeypatch):
    texts, rule = load_texts(), staircase()
    (short,) = estimate(rule, logged, ORDERS[:1], validate=False)
    average = DistanceModel()
    average.problem = "average"
    assert play_part(PageInputs(texts, logged, rule)) == PlayPart(None)
    for model, shown, why in (
        (None, short, texts("play.no_model")),
        (average, short, texts("play.not_now")),
        (rule, made_up(estimator="nominal"), texts("play.nothing")),
    ):
        assert play_part(PageInputs(texts, logged, model, [shown])) == PlayPart(None, (why,))
    unseen = PageInputs(texts, logged, None, [short], unseen=True)
    assert play_part(unseen) == PlayPart(None, (texts("play.unseen"),))
    plan = made_up("plan for both", plan=("x",), asked=(PlannedTask("robot", "home->conveyor"),))
    with monkeypatch.context() as patched:
        patched.setattr(part, "MAX_BYTES", len(play_part(PageInputs(texts, logged, rule, [short])).data))
        found = play_part(PageInputs(texts, logged, rule, [short, plan]))
        assert found.kinds == ("robot",)
        assert len(found.missing) == 1
        assert "This concerns: plan for both." in found.missing[0]
        patched.undo()
        patched.setattr(scaling_grid, "FEW_ENTRIES", 10)
        assert "too many for a table" in play_part(PageInputs(texts, logged, network(), [short])).missing[0]
        assert (
            "neither a rule nor a network" in play_part(PageInputs(texts, logged, DistanceModel(), [short])).missing[0]
        )
    monkeypatch.setattr(part, "MAX_BYTES", 1000)
    assert "MB" in play_part(PageInputs(texts, logged, rule, [short])).missing[0]


@pytest.mark.usefixtures("words_only")
def test_a_page_without_the_part_says_nothing_of_it(logged, tmp_path):
    rule = staircase()
    found = estimate(rule, logged, ORDERS[:1], validate=False)
    facts = compose_report(logged, rule, tmp_path / "r.html", estimates=found, play=False)
    assert 'id="play' not in facts.path.read_text("utf-8")
    assert facts.missing == ()
