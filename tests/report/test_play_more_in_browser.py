"""The part to play with in a real Chromium: products, orders of the operator, and answers that take longer."""

from __future__ import annotations

import json

import browser
import pytest
from known_cells import logged
from known_products import P, Q, products
from played import LONG, ORDERS, classifier, order, staircase

from cyclekit.config.sequences import TaskSequence, load_sequences
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.whatif import what_if
from cyclekit.estimate.whatif.change import Change
from cyclekit.report import compose_report

__all__ = ["logged", "products"]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser.why_not() is not None, reason=str(browser.why_not())),
]


SLOW = Change("slow recovery", dynamics={"ramp_up_per_s": 0.2})


def opened(tab, page):
    tab.events.clear()
    tab.show(page)
    assert tab.ask("cyclekitPlay.ready.then(() => document.getElementById('play').dataset.ready)") == "yes"


def asked(tab, places, change=None, until="Infinity"):
    return tab.ask(f"cyclekitPlay.answer({json.dumps(list(places))}, {json.dumps(change or {})}, null, {until})")


def same(found, wanted):
    assert found["durations_s"] == pytest.approx(list(wanted.durations_s), rel=2e-3)
    three = [wanted.expected_s, wanted.expected_low_s, wanted.expected_high_s]
    assert [found["expected_s"], found["low_s"], found["high_s"]] == pytest.approx(three, rel=2e-3)
    assert found["quantiles_s"] == pytest.approx(list(wanted.quantiles_s.values()), rel=2e-3)
    parts = [[task.dwell_s, task.wait_s] for task in wanted.tasks]
    assert [task["parts"][2:] for task in found["tasks"]] == [pytest.approx(each, abs=0.02) for each in parts]


CHOOSE = (
    "(s => { s.value = [...s.options].find(o => o.text === '%s').value; s.dispatchEvent(new Event('change')); })"
    "(document.querySelector('#play [data-play=sequence]'))"
)


def test_each_product_has_its_own_process_times(tab, products, tmp_path):
    other = TaskSequence("other", ("home", "conveyor", "left_1", "conveyor", "right_1"))  # its work was never logged
    made = [TaskSequence("P", P.places), TaskSequence("Q", Q.places), other]
    given = {each.name: each for each in estimate(staircase(), products, made)}
    compose_report(products, staircase(), tmp_path / "r.html", estimates=[*given.values()], check=given["P"].check)
    opened(tab, tmp_path / "r.html")
    for each in made:
        found = asked(tab, each.places)
        same(found, given[each.name])
        assert found["ofAll"] == (each is other)
    for each in made[:2]:
        (slower,) = what_if(staircase(), products, [each], [SLOW], check=given["P"].check)
        same(asked(tab, each.places, {"ramp": 0.2}), slower.after)
    tab.ask(CHOOSE % "P")
    doubts = "document.querySelector('#play [data-play=thin]').textContent"
    assert "Fewer than" not in tab.ask(doubts)
    mean = "document.querySelector('#play [data-play=mean]').textContent"
    tab.ask("document.querySelectorAll('#play li input')[0].click()")  # P without left_1 is Q
    assert tab.ask(mean).replace("\u00a0", " ") == f"{given['Q'].expected_s:.1f} s"
    tab.ask(CHOOSE % "other")
    assert "Fewer than 5 executions of this work were logged" in tab.ask(doubts)
    assert tab.said() == []


def test_a_sequence_with_an_order_of_the_operator_is_played_beside_such_operators(tab, logged, tmp_path):
    first = ("inbound",)
    with_order = TaskSequence("with", ORDERS[1].places, operator=first)
    turned = TaskSequence("turned", ORDERS[2].places, operator=first)
    free = TaskSequence("free", ORDERS[1].places)
    given = {each.name: each for each in estimate(staircase(), logged, [with_order, turned, free])}
    assert len(given["with"].durations_s) < len(given["free"].durations_s)
    shown = [given["with"], given["free"]]
    compose_report(logged, staircase(), tmp_path / "r.html", estimates=shown, check=shown[0].check)
    opened(tab, tmp_path / "r.html")
    tab.ask(CHOOSE % "with")
    same(asked(tab, with_order.places), given["with"])
    same(asked(tab, turned.places), given["turned"])
    tab.ask("document.querySelector('#play [data-play=copy]').click()")
    (tmp_path / "s.toml").write_text(tab.ask("document.querySelector('#play textarea').value"), "utf-8")
    assert load_sequences(tmp_path / "s.toml")[0].operator == first
    tab.ask(CHOOSE % "free")
    same(asked(tab, free.places), given["free"])
    assert tab.said() == []


@pytest.fixture(scope="module")
def networked(logged, tmp_path_factory):
    """A page of a network, and the library's answer."""
    (given,) = estimate(classifier(), logged, [order("long", *LONG)], other_cell=True)
    page = tmp_path_factory.mktemp("network") / "r.html"
    compose_report(logged, classifier(), page, estimates=[given], check=given.check)
    return page, given


def test_a_browser_without_webassembly_gives_the_same_numbers(tab, networked):
    page, given = networked
    opened(tab, page)
    quick = asked(tab, given.places)
    number = tab.call("Page.addScriptToEvaluateOnNewDocument", source="delete window.WebAssembly")["identifier"]
    opened(tab, page)
    assert tab.ask("typeof WebAssembly") == "undefined"
    slow = asked(tab, given.places)
    tab.call("Page.removeScriptToEvaluateOnNewDocument", identifier=number)
    assert slow["durations_s"] == pytest.approx(quick["durations_s"], rel=1e-5)
    same(slow, given)


def test_an_answer_that_takes_longer_comes_in_parts(tab, networked):
    page, given = networked
    opened(tab, page)
    whole = asked(tab, given.places, {"ramp": 0.3})
    first = asked(tab, given.places, {"ramp": 0.2}, until=0)
    assert first["walked"] < len(given.durations_s) == whole["walked"]
    assert first["expected_s"] == pytest.approx(whole["expected_s"], rel=0.1)
    after = asked(tab, given.places, {"ramp": 0.2}, until="performance.now() + 60000")
    assert after["walked"] == whole["walked"]
    opened(tab, page)
    assert asked(tab, given.places, {"ramp": 0.2})["durations_s"] == after["durations_s"]


def test_on_a_busy_machine_the_page_says_of_how_many_cycles_the_numbers_are_and_goes_on(tab, networked):
    page, given = networked
    opened(tab, page)
    tab.ask("(() => { let now = 0; performance.now = () => (now += 50); })()")
    move = "(s => { s.value = '-0.5'; s.dispatchEvent(new Event('input')); })"
    slide = f"{move}(document.querySelector('.play-slider input'))"
    so_far = "(n => n.hidden ? '' : n.textContent)(document.querySelector('#play [data-play=so_far]'))"
    assert tab.ask(f"{slide}, {so_far}") == f"From 12 of {len(given.durations_s)} cycles so far."
    whole = "new Promise(done => { const look = () => %s ? setTimeout(look, 5) : done('whole'); look(); })"
    assert tab.ask(whole % so_far) == "whole"
    wanted = tab.ask(f"cyclekitPlay.answer({json.dumps(list(given.places))}, {{ramp: 10 ** -0.5}}, null).expected_s")
    mean = tab.ask("document.querySelector('#play [data-play=mean]').textContent")
    assert mean.replace("\u00a0", " ") == f"{wanted:.1f} s"
