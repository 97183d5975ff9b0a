"""The part to play with where robot and operator wait for each other, and for task lists: the library's own numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.resources import files

import browser
import numpy as np
import pytest
from known_cells import logged
from msgspec import structs
from played import STAIRS, ask, both, network, repeated, same, some_deadlocks_are_left_out, staircase

from cyclekit import TaskSequence, estimate_cycles, train_task_times, what_if, write_report
from cyclekit.config.sequences import PlannedTask, load_sequences
from cyclekit.dataset.cards import ConditionCard, CouplingCard, DynamicsCard, GateCard, SourceCard, TrainingCard
from cyclekit.dataset.cards.coupling import Turns
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.whatif import what_if as try_changes
from cyclekit.estimate.whatif.change import Change, LimitChange
from cyclekit.ingest.ingest import ingest
from cyclekit.report import compose_report
from cyclekit_sim.task_lists import ListOptions, random_order, simulate_task_lists

__all__ = ["logged", "repeated", "some_deadlocks_are_left_out"]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser.why_not() is not None, reason=str(browser.why_not())),
]
TAKT_S = 45.0
ROBOT = ("home", "conveyor", "left_2", "conveyor", "right_3", "conveyor", "left_4")
OPERATOR = ("rest", "inbound", "out_left_1", "inbound", "rest")


def _waits(place: str, agent: str, after: str, *, event: str = "leaves", **told: object) -> ConditionCard:
    return ConditionCard(agent=agent, place=after, event=event, lag_s=(0.1, 0.3, 0.9), **told)  # type: ignore[arg-type]


CARD = CouplingCard(
    gates=(
        GateCard(
            agent="robot", at="leave", place="conveyor", own_s=(0.5, 0.7, 1.4),
            conditions=(
                _waits("conveyor", "operator", "inbound", back=1, needed=0.2, together=1),
                ConditionCard(agent="signal", place="part", event="set", lag_s=(0.1,)),
            ),
        ),
        GateCard(agent="robot", at="approach", place="right_3", phase=0.4,
                 conditions=(_waits("right_3", "operator", "out_left_1", event="arrives"),)),
        GateCard(agent="operator", at="approach", place="out_left_1",
                 conditions=(_waits("out_left_1", "robot", "left_2", turns=Turns(every=1), needed=0.2, together=1),)),
        GateCard(agent="operator", at="leave", place="inbound", own_s=(1.0, 2.0, 4.0)),
        GateCard(agent="robot", at="leave", place="left_4", own_s=(0.4,)),
    ),
    sources=(SourceCard(signal="part", gap_s=(4.0, 5.0, 9.0), first_s=(0.5, 2.0), buffer=2, taken_by="conveyor"),),
)  # fmt: skip


TURNED = ("home", "conveyor", "left_4", "conveyor", "left_2", "conveyor", "right_3")
TOLD = TaskSequence.of_plan("told", [
    PlannedTask("robot", "home->conveyor"),
    PlannedTask("robot", "conveyor->left_2", after=("inbound",)),
    PlannedTask("operator", "rest"),
    PlannedTask("operator", "inbound", not_before_s=3.5),
    PlannedTask("operator", "out_left_1", after=("conveyor->left_2", "left_2->conveyor")),
    PlannedTask("robot", "left_2->conveyor"),
    PlannedTask("robot", "right_3", not_before_s=20.0),
    PlannedTask("robot", "conveyor"),
    PlannedTask("operator", "inbound"),
    PlannedTask("robot", "conveyor->left_4", after=("inbound", "rest")),
    PlannedTask("operator", "rest", after=("right_3",)),
])  # fmt: skip
ORDERS = [both(ROBOT, OPERATOR, "given"), both(TURNED, OPERATOR[1:], "turned"),
          TaskSequence("places", ROBOT, OPERATOR), TOLD]  # fmt: skip
ASKED = {"given": (ROBOT, OPERATOR, True), "turned": (TURNED, OPERATOR[1:], True), "places": (ROBOT, OPERATOR, False)}
CHANGES = {
    "faster": ({"pace": 1.3}, Change("p", faster={"operator": 1.3})),
    "no wait": ({"without": ["robot before right_3"]}, Change("n", without_waits=("robot approach right_3",))),
    "parts": ({"buffer": {"part": 3}}, Change("b", buffer={"part": 3})),
    "ramp": STAIRS["ramp"],
    "threshold": STAIRS["threshold"],
}
CELLS = {
    "staircase": (staircase, DynamicsCard(), list(CHANGES)),
    "network": (network, DynamicsCard(latency_s=0.2, ramp_up_per_s=0.5, hysteresis_m=0.2), ["faster", "ramp"]),
}


@pytest.fixture(scope="module", params=list(CELLS))
def cell(request, logged, tmp_path_factory):
    """The library's answers by order and change, and the page of the first order."""
    make, dynamics, changes = CELLS[request.param]
    model, data = make(), Dataset.open(logged.path)
    card = TrainingCard(coupling=CARD)
    model = replace(model, card=card)
    data.card = structs.replace(data.card, dynamics=dynamics)
    asked = {"other_cell": True, "extrapolate": True}
    given = {each.name: each for each in estimate(model, data, ORDERS, takt_s=TAKT_S, **asked)}
    check, changed = given["given"].check, {}
    for name in changes:
        for found in try_changes(model, data, ORDERS[:2], [CHANGES[name][1]], check=check, **asked):
            changed[found.after.name, name] = found.after
    page = tmp_path_factory.mktemp("together") / f"{request.param}.html"
    estimates = [given["given"], given["told"]]
    facts = compose_report(data, model, page, estimates=estimates, check=check, takt_s=TAKT_S)
    assert facts.missing == ()
    return page, given, changed, (model, data)


def test_orders_and_changes_of_both_agents_have_the_numbers_of_the_library(tab, cell):
    page, given, changed, _ = cell
    tab.events.clear()
    tab.show(page)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    for name, (robot, operator, plan) in ASKED.items():
        played = {"robot": robot, "operator": operator, "both": plan}
        found = ask(tab, played, {}, TAKT_S)
        same(found, given[name])
        assert found["safety_s"] == pytest.approx(given[name].safety_loss_s, abs=2e-3 * given[name].expected_s)
        assert found["support"] == pytest.approx(given[name].support, abs=0.02)
        for (whose, change), wanted in changed.items():
            if whose == name:
                same(ask(tab, played, CHANGES[change][0]), wanted)
    assert changed["given", "faster"].expected_s < given["given"].expected_s - 0.2  # or nothing would be shown by it
    assert tab.said() == []
    assert set(tab.requests()) == {page.resolve().as_uri()}


@pytest.fixture(scope="module")
def lists(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lists")
    simulate_task_lists(folder / "logs", executions=40, seed=1, options=ListOptions())
    ingest([folder / "logs" / "tasks.csv"], folder / "dataset")
    model = train_task_times(folder / "dataset")
    orders = {name: random_order(np.random.default_rng(seed)) for name, seed in (("one", 7), ("other", 8))}
    plans = {
        name: [PlannedTask(agent, str(task)) for agent, tasks in order.items() for task in tasks]
        for name, order in orders.items()
    }
    plans["less"] = [task for number, task in enumerate(plans["one"]) if number != 1]
    plans["planned"] = [as_planned(task, number) for number, task in enumerate(plans["one"])]
    sequences = [TaskSequence.of_plan(name, plan) for name, plan in plans.items()]
    page = folder / "page.html"
    facts = write_report(folder / "dataset", page, model=model, sequences=sequences[:1], takt_s=TAKT_S)
    assert not any("played" in text for text in facts.missing)
    return page, model, Dataset.open(folder / "dataset"), {each.name: each for each in sequences}


def as_planned(task: PlannedTask, number: int) -> PlannedTask:
    return PlannedTask(task.agent, task.name, not_before_s=12.0) if number == 2 else task


def as_played(model, sequence):
    name = {kind: agent for agent, kind in model.card.agents.items()}
    return [
        {"agent": name.get(task.agent, task.agent), "asked": task.agent, "name": task.name, "after": task.after}
        | ({} if task.not_before_s is None else {"not_before_s": task.not_before_s})
        for task in sequence.plan
    ]


def test_plans_of_task_lists_have_the_numbers_of_the_library(tab, lists):
    page, model, data, sequences = lists
    tab.events.clear()
    tab.show(page)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    for wanted in estimate_cycles(model, data, list(sequences.values()), takt_s=TAKT_S):
        same(ask(tab, as_played(model, sequences[wanted.name]), {}, TAKT_S), wanted, within=1e-5)
    operator = next(agent for agent, kind in model.card.agents.items() if kind == "operator")
    wait = next((task.task, need.task) for task in model.card.tasks for need in task.needs)
    changes = {
        "faster": ({"paces": {operator: 1.3}}, Change("faster", faster={"operator": 1.3})),
        "no wait": ({"without": [f"{wait[0]} for {wait[1]}"]}, Change("no wait", no_wait=(wait,))),
    }
    for changed, change in changes.values():
        (found,) = what_if(model, data, [sequences["other"]], [change])
        same(ask(tab, as_played(model, sequences["other"]), changed), found.after, within=1e-5)
    assert tab.said() == []
    assert set(tab.requests()) == {page.resolve().as_uri()}


def shown(tab, part):
    return tab.ask(f"document.querySelector('#play [data-play={part}]').textContent").replace("\u00a0", " ")


def test_tasks_of_a_plan_are_moved_left_out_and_copied(tab, lists, tmp_path):
    page, model, data, sequences = lists
    tab.show(page, width=1200, height=1400)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    before = shown(tab, "mean")
    tab.ask("document.querySelectorAll('#play ol')[1].querySelectorAll('li button')[1].click()")  # a later first task
    tab.ask("document.querySelectorAll('#play ol')[0].querySelectorAll('li input')[1].click()")  # and without another
    tab.ask("document.querySelector('#play [data-play=copy]').click()")
    file = tmp_path / "sequences.toml"
    file.write_text(tab.ask("document.querySelector('#play textarea').value"), "utf-8")
    (sequence,) = load_sequences(file)
    given = sequences["one"].plan
    agents = list(dict.fromkeys(task.agent for task in given))
    first, second = ([task.name for task in given if task.agent == agent] for agent in agents)
    assert [task.name for task in sequence.plan] == [first[0], *first[2:], second[1], second[0], *second[2:]]
    (wanted,) = estimate_cycles(model, data, [sequence])
    assert shown(tab, "mean") == f"{wanted.expected_s:.1f} s" != before
    titles = tab.ask("[...document.querySelectorAll('#play .play-lane')].map(bar => bar.lastChild?.title)")
    ends = [f"\u2013{task.end_s:.1f} s;" for task in wanted.plan]
    assert all(end in title for end, title in zip(ends, filter(None, titles), strict=True))
    tab.ask("document.querySelector('#play [data-play=reset]').click()")
    assert shown(tab, "mean") == before


WHOLE = (
    "new Promise(done => { const look = () => (document.getElementById('play').dataset.whole === 'yes'"
    " ? done(1) : setTimeout(look, 20)); look(); })"
)


def begin_with(tab, name):
    """Choose a sequence of the page."""
    tab.ask("(s => { s.value = [...s.options].find(o => o.text === " + json.dumps(name) + ").value;"
            "s.dispatchEvent(new Event('change')); })(document.querySelector('#play select'))")  # fmt: skip


def copied(tab, file):
    tab.ask("document.querySelector('#play [data-play=copy]').click()")
    file.write_text(tab.ask("document.querySelector('#play textarea').value"), "utf-8")
    return load_sequences(file)


def now(tab):
    """Return the answer to what the page shows, at the takt of the tests."""
    return json.loads(tab.ask("JSON.stringify(cyclekitPlay.answer(cyclekitPlay.now(), {}, 45))"))


def test_earliest_starts_and_predecessors_move_with_their_tasks(tab, cell, tmp_path):
    page, given, _, (model, data) = cell
    tab.events.clear()
    tab.show(page, width=1200, height=1400)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    begin_with(tab, "told")
    same(now(tab), given["told"])
    notes = "[...document.querySelectorAll('#play .play-asked')].map(each => each.textContent)"
    assert any("not before 20 s" in note for note in tab.ask(notes))
    assert any("after conveyor → left_2, left_2 → conveyor" in note for note in tab.ask(notes))
    row = "document.querySelectorAll('#play ol')[{}].querySelectorAll('li')[{}].querySelectorAll('button')[{}].click()"
    tab.ask(row.format(0, 0, 1))  # left_2 after right_3, where the robot waits for who waits for left_2
    assert "Nobody can go on" in shown(tab, "interval")
    tab.ask(row.format(0, 1, 0))
    tab.ask(row.format(0, 1, 1))  # left_4 before right_3
    assert any("after conveyor → left_2, left_4 → conveyor" in note for note in tab.ask(notes))
    tab.ask(row.format(1, 0, 1))  # the operator fetches once more before
    (sequence,) = copied(tab, tmp_path / "sequences.toml")
    assert sequence.plan != TOLD.plan
    assert sorted(task.not_before_s for task in sequence.plan if task.not_before_s) == [3.5, 20.0]
    (wanted,) = estimate(model, data, [sequence], check=given["told"].check, other_cell=True, extrapolate=True)
    assert abs(wanted.expected_s - given["told"].expected_s) > 0.3
    same(now(tab), wanted)
    tab.ask("document.querySelectorAll('#play ol')[1].querySelectorAll('li input')[1].click()")
    assert tab.said() == []


def test_a_task_after_one_that_is_left_out_is_not_known(tab, cell):
    tab.show(cell[0], width=1200, height=1400)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    begin_with(tab, "told")
    labels = tab.ask("[...document.querySelectorAll('#play li label')].map(l => l.firstElementChild.nextSibling.data)")
    index = next(n for n, label in enumerate(labels) if "right_3" in label)
    tab.ask(f"document.querySelectorAll('#play li input')[{index}].click()")
    assert shown(tab, "mean") == "Not known"
    assert "comes after a task that was left out: left_2 → conveyor, right_3" in shown(tab, "interval")


def test_plans_are_played_where_nobody_waits_beside_orders_of_the_robot(tab, logged, tmp_path):
    model = staircase()
    asked = [TaskSequence("alone", ROBOT), both(ROBOT, OPERATOR, "given"), TOLD]
    given = {each.name: each for each in estimate(model, logged, asked, takt_s=TAKT_S, extrapolate=True)}
    page = tmp_path / "page.html"
    found = compose_report(logged, model, page, estimates=list(given.values()), takt_s=TAKT_S)
    assert found.missing == ()
    tab.events.clear()
    tab.show(page, width=1200, height=1400)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    heads = "[...document.querySelectorAll('#play dt')].some(e => e.offsetParent && e.textContent === 'Waits')"
    for name in ("alone", "given", "told", "alone", "given"):
        begin_with(tab, name)
        assert tab.ask(heads) is (name != "alone")
        tab.ask(WHOLE)
        assert shown(tab, "mean") == f"{given[name].expected_s:.1f} s"
        if name != "alone":
            same(now(tab), given[name])
        else:
            assert now(tab)["durations_s"] == pytest.approx(list(given[name].durations_s), rel=2e-3)
    slide = "(s => { s.value = '0.2'; s.dispatchEvent(new Event('input')); })"
    tab.ask(f"{slide}(document.querySelector('#play-slider-0'))")
    tab.ask(WHOLE)
    change = Change("t", limits=(LimitChange(0.0, threshold_m=1.4),))
    asked = {"check": given["given"].check, "extrapolate": True}
    (wanted,) = try_changes(model, logged, [both(ROBOT, OPERATOR, "given")], [change], **asked)
    assert shown(tab, "mean") == f"{wanted.after.expected_s:.1f} s"
    assert tab.said() == []


@pytest.mark.parametrize("cell", ["staircase"], indirect=True)
def test_the_operators_visits_are_moved_and_a_wait_removed(tab, cell, tmp_path):
    page, given, changed, _ = cell
    tab.show(page, width=1200, height=1400)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    begin_with(tab, "given")
    whole = WHOLE
    tab.ask(whole)
    assert shown(tab, "mean") == f"{given['given'].expected_s:.1f} s"
    tab.ask("[...document.querySelectorAll('.play-switch input')]"
            ".find(each => each.value === 'robot before right_3').click()")  # fmt: skip
    tab.ask(whole)
    assert shown(tab, "mean") == f"{changed['given', 'no wait'].expected_s:.1f} s"
    tab.ask("document.querySelectorAll('#play ol')[1].querySelectorAll('li button')[1].click()")
    tab.ask("document.querySelector('#play [data-play=copy]').click()")
    file = tmp_path / "sequences.toml"
    file.write_text(tab.ask("document.querySelector('#play textarea').value"), "utf-8")
    (sequence,) = load_sequences(file)
    assert [task.name for task in sequence.plan if task.agent == "operator"] != list(OPERATOR)
    assert sorted(task.name for task in sequence.plan if task.agent == "operator") == sorted(OPERATOR)


@pytest.mark.parametrize("width", [390, 1180])
def test_the_part_fits_its_window_and_axe_finds_nothing(tab, lists, cell, width):
    for page in (lists[0], cell[0]):
        tab.show(page, width=width, height=900, phone=width < 500)
        tab.ask("cyclekitPlay.ready.then(() => 1)")
        assert tab.ask("document.documentElement.scrollWidth") <= width
        tab.call("Runtime.evaluate", expression=files("axe_core_python").joinpath("axe.min.js").read_text("utf-8"))
        found = tab.ask("axe.run('#play', {resultTypes: ['violations']}).then(r => JSON.stringify("
                        "r.violations.map(v => [v.id, v.nodes[0].html.slice(0, 200)])))")  # fmt: skip
        assert json.loads(found) == []


@pytest.mark.usefixtures("repeated")
def test_an_order_that_lacks_repeated_visits_has_the_numbers_of_the_library(tab, logged, tmp_path):
    data, model = Dataset.open(logged.path), replace(staircase(), card=TrainingCard(coupling=CARD))
    asked = {"takt_s": TAKT_S, "other_cell": True, "extrapolate": True}
    (given,) = estimate(model, data, [TaskSequence("places", ROBOT, OPERATOR)], **asked)
    assert any(one.code == "interludes" for one in given.findings)
    page = tmp_path / "page.html"
    compose_report(data, model, page, estimates=[given], check=given.check, takt_s=TAKT_S)
    tab.show(page)
    tab.ask("cyclekitPlay.ready.then(() => 1)")
    same(ask(tab, {"robot": ROBOT, "operator": OPERATOR, "both": False}, {}, TAKT_S), given)
