"""The part to play with in a real Chromium: its numbers are the library's, its controls do what they say."""

from __future__ import annotations

import json
from importlib.resources import files

import browser
import pytest
from known_cells import logged
from msgspec import structs
from played import (
    LINKED,
    ORDERS,
    SHORT,
    STAIRS,
    WITHOUT_RULE,
    ZONED,
    Gate,
    classifier,
    linked,
    network,
    repeated,
    staircase,
    zoned,
)

from cyclekit.config.sequences import TaskSequence, load_sequences
from cyclekit.dataset.cards import DynamicsCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.whatif import what_if
from cyclekit.report import compose_report

__all__ = ["logged", "repeated"]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser.why_not() is not None, reason=str(browser.why_not())),
]
TAKT_S = 62.0
SLOW = DynamicsCard(latency_s=0.2, ramp_down_per_s=2.0, ramp_up_per_s=0.5, hold_s=0.3)
SLOW_NETWORK = structs.replace(SLOW, hysteresis_m=0.2)
CELLS = {
    "staircase": (staircase(), DynamicsCard(), STAIRS),
    "zones": (zoned(), SLOW, ZONED),
    "network": (network(), SLOW_NETWORK, {"ramp": STAIRS["ramp"]}),
    "classifier": (classifier(), DynamicsCard(), {"ramp": STAIRS["ramp"]}),
    "classifier with hysteresis": (classifier(), SLOW_NETWORK, {"ramp": STAIRS["ramp"]}),
    "links": (linked(), SLOW, LINKED),
    "signals in tables": (Gate(), SLOW, WITHOUT_RULE),
}


@pytest.fixture(scope="module", params=list(CELLS))
def cell(request, logged, tmp_path_factory):
    """The library's answers by order and change, and the page of the longest order."""
    model, dynamics, changes = CELLS[request.param]
    data = Dataset.open(logged.path)
    data.card = structs.replace(data.card, dynamics=dynamics)
    given = {each.name: each for each in estimate(model, data, ORDERS, takt_s=TAKT_S, other_cell=True)}
    check = given["long"].check
    changed = {}
    for each in ORDERS[:2]:
        for found in what_if(
            model, data, [each], [change for _, change in changes.values()], check=check, other_cell=True
        ):
            changed[each.name, found.change] = found.after
    page = tmp_path_factory.mktemp("play") / f"{request.param}.html"
    facts = compose_report(data, model, page, estimates=[given["long"]], check=check, takt_s=TAKT_S)
    assert facts.missing == ()
    return page, given, changed, changes


def told(asked):
    return json.dumps(asked).replace("Infinity", "Number.POSITIVE_INFINITY")


def same(found, wanted, within=2e-3):
    """Single cycles, quantiles and means within this part of the cycle time; shares within one of 16."""
    assert "unknown" not in found
    assert found["durations_s"] == pytest.approx(list(wanted.durations_s), rel=within)  # each cycle by itself
    three = [wanted.expected_s, wanted.expected_low_s, wanted.expected_high_s]
    assert [found["expected_s"], found["low_s"], found["high_s"]] == pytest.approx(three, rel=within)
    assert found["quantiles_s"] == pytest.approx(list(wanted.quantiles_s.values()), rel=within)
    assert found["safety_s"] == pytest.approx(wanted.safety_loss_s, abs=within * wanted.expected_s)
    assert found["support"] == pytest.approx(wanted.support, abs=0.01)
    assert [sum(task["parts"]) for task in found["tasks"]] == pytest.approx(
        [task.expected_s for task in wanted.tasks], abs=within * wanted.expected_s
    )
    if wanted.takt_probability is not None:
        assert found["takt"] == pytest.approx(list(wanted.takt_probability), abs=1 / 16)


def test_orders_and_changes_have_the_numbers_of_the_library(tab, cell):
    page, given, changed, changes = cell
    tab.events.clear()
    tab.show(page)
    assert tab.ask("cyclekitPlay.ready.then(() => document.getElementById('play').dataset.ready)") == "yes"
    for each in ORDERS:
        places = json.dumps(list(each.places))
        same(tab.ask(f"cyclekitPlay.answer({places}, {{}}, {TAKT_S})"), given[each.name])
        for asked, change in changes.values() if each in ORDERS[:2] else ():
            same(tab.ask(f"cyclekitPlay.answer({places}, {told(asked)}, null)"), changed[each.name, change.name])
    assert tab.said() == []
    assert set(tab.requests()) == {page.resolve().as_uri()}


@pytest.mark.usefixtures("repeated")
def test_orders_that_lack_repeated_visits_have_the_numbers_of_the_library(tab, logged, tmp_path):
    data, page = Dataset.open(logged.path), tmp_path / "page.html"
    given = estimate(staircase(), data, ORDERS, takt_s=TAKT_S, other_cell=True)
    assert all(any(one.code == "interludes" for one in each.findings) for each in given)
    longest = max(given, key=lambda each: each.nominal_s)
    compose_report(data, staircase(), page, estimates=[longest], check=longest.check, takt_s=TAKT_S)
    tab.show(page)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    for each in given:
        same(tab.ask(f"cyclekitPlay.answer({json.dumps(list(each.places))}, {{}}, {TAKT_S})"), each)


@pytest.fixture(scope="module")
def played(logged, tmp_path_factory):
    """A page of one order, and the library's answers to what is played there."""
    model = staircase()
    wanted = [ORDERS[0], TaskSequence("turned", ("home", *(p for s in SHORT[::-1] for p in ("conveyor", s))))]
    found = {each.name: each for each in estimate(model, logged, wanted, takt_s=30.0)}
    page = tmp_path_factory.mktemp("play") / "r.html"
    compose_report(logged, model, page, estimates=[found["short"]], takt_s=30.0)
    return page, model, found


@pytest.fixture
def desk(tab, played):
    tab.events.clear()
    tab.show(played[0], width=1200, height=1400)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    return tab


def shown(tab, part):
    return tab.ask(f"document.querySelector('#play [data-play={part}]').textContent")


def test_without_a_script_the_part_is_not_seen(played):
    text = played[0].read_text("utf-8")
    assert '<section id="play" hidden>' in text


def test_a_visit_is_dragged_and_moved_by_buttons(desk, played):
    _, _, found = played
    assert shown(desk, "mean").replace("\u00a0", " ") == f"{found['short'].expected_s:.1f} s"
    handle = "document.querySelectorAll('#play .play-handle')"
    desk.ask("document.querySelector('#play .play-order').scrollIntoView({block: 'center'})")
    places = [desk.ask(f"(b => [b.x + b.width / 2, b.y + b.height / 2])({handle}[{n}].getBoundingClientRect())")
              for n in range(3)]  # fmt: skip
    for kind, (x, y) in (("mousePressed", places[0]), ("mouseMoved", places[1]), ("mouseMoved", places[2]),
                         ("mouseMoved", [places[2][0], places[2][1] + 12]), ("mouseReleased", places[2])):  # fmt: skip
        desk.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)
    labels = "[...document.querySelectorAll('#play li label')].map(l => l.textContent.trim())"
    assert desk.ask(labels) == [f"conveyor → {slot}" for slot in ("right_3", "left_4", "left_2")]
    desk.ask("document.querySelectorAll('#play li button')[1].click()")  # the first one later
    assert desk.ask(labels) == [f"conveyor → {slot}" for slot in ("left_4", "right_3", "left_2")]
    assert desk.ask("document.activeElement.getAttribute('aria-label')") == "conveyor → right_3: later"
    assert shown(desk, "mean").replace("\u00a0", " ") == f"{found['turned'].expected_s:.1f} s"
    assert desk.said() == []


def test_what_was_played_is_read_back_as_a_sequence_file(desk, played, logged, tmp_path):
    _, model, found = played
    desk.ask("document.querySelectorAll('#play li input')[1].click()")  # without right_3
    desk.ask("document.querySelector('#play [data-play=copy]').click()")
    file = tmp_path / "sequences.toml"
    file.write_text(desk.ask("document.querySelector('#play textarea').value"), "utf-8")
    (sequence,) = load_sequences(file)
    assert sequence.places == ("home", "conveyor", "left_2", "conveyor", "left_4")
    (wanted,) = estimate(model, logged, [sequence], check=found["short"].check)
    assert shown(desk, "mean").replace("\u00a0", " ") == f"{wanted.expected_s:.1f} s"


def test_a_task_that_was_never_logged_is_not_known(desk):
    desk.ask("[0, 1, 2].forEach(n => document.querySelectorAll('#play li input')[n].click())")
    assert shown(desk, "mean") == "Not known"
    assert "No visit is left" in shown(desk, "interval")
    unknown = desk.ask("cyclekitPlay.answer(['home', 'left_2', 'right_3'], {}, null).unknown")
    assert "home → left_2, left_2 → right_3" in unknown
    often = desk.ask("cyclekitPlay.answer(['home', 'conveyor', 'left_2'], {frequency: 50}, null).unknown")
    assert "at most" in often


def test_a_slider_moves_the_numbers_and_goes_back(desk, played):
    before = shown(desk, "mean")
    desk.ask(
        "(s => { s.value = '0.4'; s.dispatchEvent(new Event('input')); })(document.querySelector('#play-slider-0'))"
    )
    assert shown(desk, "mean") != before
    assert "1.60" in desk.ask("document.querySelector('.play-slider output').textContent")
    desk.ask("document.querySelector('.play-slider button').click()")
    assert shown(desk, "mean") == before


@pytest.mark.parametrize("width", [360, 1180])
def test_the_part_fits_its_window(tab, played, width):
    tab.show(played[0], width=width, height=900, phone=width < 500)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    assert tab.ask("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("width", [390, 1180])
def test_axe_finds_nothing_that_shuts_people_out(tab, played, width):
    tab.show(played[0], width=width, height=900, phone=width < 500)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    tab.ask("document.querySelector('#play [data-play=copy]').click()")
    tab.call("Runtime.evaluate", expression=files("axe_core_python").joinpath("axe.min.js").read_text("utf-8"))
    found = tab.ask("axe.run('#play', {resultTypes: ['violations']}).then(r => JSON.stringify("
                    "r.violations.map(v => [v.id, v.nodes[0].html.slice(0, 200)])))")  # fmt: skip
    assert json.loads(found) == []
