"""The answer: today's logged cycle beside the order and the change that were found, for the same work only."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from report_pages import Page, estimate

from cyclekit.api.workbooks import sheets_of_plan
from cyclekit.dataset.cards import OperatorPaceCard
from cyclekit.dataset.cards.coupling import TrendCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import UnknownName
from cyclekit.estimate.baseline import baseline_of
from cyclekit.estimate.plan import OrderPlan
from cyclekit.estimate.result import TaskShare
from cyclekit.estimate.statistics.same_work import work_of
from cyclekit.report import Tried, compose_report
from cyclekit.report.verdict import verdict

pytestmark = pytest.mark.usefixtures("words_only")

ROUTE = ("home", "a", "b", "home")
TURNED = ("home", "b", "a", "home")
LONG = ("home", "a", "b", "a", "b", "home")
PLANNED = OrderPlan(
    order=("b", "a"), places=TURNED, expected_s=25.0, against="logged executions", against_s=31.0,
    saves_s=(6.0, 5.3, 6.7), searched="all orders", tried=2, executions=40,
)  # fmt: skip


@pytest.fixture
def logged(dataset):
    """The four executions as if they went through ROUTE in 28, 30, 31 and 35 s; and a fifth without operator."""
    entries = [
        structs.replace(one, end_s=one.start_s + duration, places=tuple(ROUTE), reference=False)
        for one, duration in zip(dataset.card.executions, (28.0, 30.0, 31.0, 35.0), strict=True)
    ]
    end_s = entries[0].start_s + 10.0
    reference = structs.replace(entries[0], execution="reference", reference=True, end_s=end_s)
    return Dataset(dataset.path, structs.replace(dataset.card, executions=(*entries, reference)))


def document(dataset, tmp_path, **given):
    facts = compose_report(dataset, None, tmp_path / "r.json", kind="json", **given)
    return json.loads(facts.path.read_text("utf-8").replace("\N{NO-BREAK SPACE}", " "))


def test_today_is_the_logged_cycle_and_the_order_and_change_stand_beside_it(logged, tmp_path):
    order = estimate("order found", 25.0, places=TURNED)
    change = Tried("smaller zone", "order found", 20.0, 19.5, 20.5, (5.0, 4.0, 6.0), places=TURNED, within=(1, 0.7, 1))
    given = {"estimates": [estimate("as now", 31.0, places=ROUTE), order], "what_if": [change], "planned": PLANNED}
    found = document(logged, tmp_path, takt_s=30.5, **given)
    said = (
        "Today 31.0 s (mean of 4 logged executions), 50 % of cycles within the takt of 30.5 s (95 % CI 15 to 85 %). "
        "The order found takes 25.0 s, saving 6.0 s (-19 %), 100 % of cycles within the takt (95 % CI 96 to 100 %); "
        "with “smaller zone” 20.0 s, saving 11.0 s (-35 %), 100 % of cycles within the takt (95 % CI 70 to 100 %)."
    )
    assert found["answer"] == said
    assert found["verdict"]["text"] == said
    sure = {**given, "what_if": [replace(change, within=(0.99, 0.988, 0.9901))]}
    assert document(logged, tmp_path, takt_s=30.5, **sure)["answer"].endswith("(95 % CI ± under 1 %).")
    today = found["verdict"]["today"]
    assert (today["executions"], today["mean_s"], today["missed"], today["order"]) == (4, 31.0, 2, list(ROUTE))
    assert today["within"] == pytest.approx([0.5, 0.15, 0.85], abs=0.005)  # Wilson's interval of 2 of 4
    best = found["verdict"]["best"]
    assert (best["sequence"], best["expected_s"], best["order"]) == (None, 25.0, list(TURNED))
    assert best["saves_s"] == pytest.approx(6.0)
    assert (found["verdict"]["change"]["expected_s"], found["verdict"]["change"]["saves_s"]) == (20.0, 11.0)
    assert found["verdict"]["change"]["within"] == [1, 0.7, 1]
    (basis, *_) = found["sentences"]["answer"]
    assert basis.startswith("Today: 31.0 s (95 % CI ")
    assert basis.endswith(
        "the mean of the 4 logged executions of the usual order; 2 of them (50 %) miss the takt of 30.5 s."
    )
    markdown = compose_report(logged, None, tmp_path / "r.md", kind="md", takt_s=30.5, **given).path.read_text("utf-8")
    assert f"**{said}**" in markdown.replace("\N{NO-BREAK SPACE}", " ")


def in_orders(logged, *orders):
    """The logged executions again and again, in these orders."""
    entries = [
        structs.replace(logged.card.executions[n % 4], execution=f"run {n}", places=order)
        for n, order in enumerate(orders)
    ]
    return Dataset(logged.path, structs.replace(logged.card, executions=tuple(entries)))


def test_the_baseline_is_the_usual_order_if_more_than_half_ran_it(logged, tmp_path):
    often = in_orders(logged, *[ROUTE] * 5, *[TURNED] * 3)
    today = baseline_of(often, work_of(ROUTE), None)
    assert (today.executions, today.order, today.others) == (5, ROUTE, 3)
    assert today.mean_s == pytest.approx((28 + 30 + 31 + 35 + 28) / 5)
    for few, others in ((3, 1), (5, 5)):  # too few of one order, or not the usual one
        mixed = baseline_of(in_orders(logged, *[ROUTE] * few, *[TURNED] * others), work_of(ROUTE), None)
        assert (mixed.executions, mixed.order, mixed.others) == (few + others, None, 0)
    words = document(often, tmp_path, estimates=[estimate("as now", 31.0, places=ROUTE)])["sentences"]["answer"][0]
    assert words.endswith("the mean of the 5 logged executions of the usual order (3 in other orders do not count).")


@pytest.mark.parametrize("times", [2, 3])
def test_the_interval_of_few_logged_executions_is_that_of_students_t(logged, times):
    today = baseline_of(in_orders(logged, *[ROUTE] * times), work_of(ROUTE), None)
    cycles_s = np.array((28, 30, 31)[:times])
    half_s = {2: 12.706, 3: 4.303}[times] * cycles_s.std(ddof=1) / times**0.5
    assert (today.mean_s - today.low_s, today.high_s - today.mean_s) == pytest.approx([half_s] * 2, rel=0.05)


def test_a_named_baseline_is_its_logged_executions_or_else_its_estimate(logged, tmp_path):
    both = in_orders(logged, *[ROUTE] * 4, *[TURNED] * 3)
    given = {"estimates": [estimate("as now", 31.0, places=ROUTE), estimate("turned", 20.0, places=TURNED)]}
    held = verdict(both, given["estimates"], (), None, None, "turned").today
    assert (held.executions, held.order, held.sequence) == (3, TURNED, "turned")
    found = document(logged, tmp_path, **given, takt_s=25.0, baseline="as now")
    begin = "“as now” (baseline) 31.0 s, 0 % of cycles within the takt of 25 s (95 % CI 0 to "
    assert found["answer"].startswith(begin)
    found = document(logged, tmp_path, **given, baseline="turned")
    assert found["answer"] == "“turned” (baseline) 20.0 s. No other sequence takes less time."
    assert found["sentences"]["answer"][0].startswith(
        "The baseline “turned” was never logged at the usual speed slider: its estimate"
    )
    with pytest.raises(UnknownName, match="trned"):
        document(logged, tmp_path, **given, baseline="trned")


def test_where_no_logged_execution_does_the_work_there_is_no_today(logged, tmp_path):
    found = document(logged, tmp_path, estimates=[estimate("longer", 50.0, places=LONG)])
    assert found["answer"] == "“longer” takes 50.0 s on average."
    assert found["verdict"]["today"] is None
    assert found["sentences"]["answer"][0] == (
        "No logged execution at the usual speed slider does this work (5 visits (a x2, b x2, home)): "
        "there is no cycle time of today to compare with."
    )


def test_a_sequence_within_todays_interval_is_not_said_to_be_quicker(logged, tmp_path):
    found = document(logged, tmp_path, estimates=[estimate("turned", 30.5, places=TURNED)])
    assert (
        found["answer"]
        == "Today 31.0 s (mean of 4 logged executions). “turned” takes 30.5 s on average, not clearly different."
    )


def test_an_order_that_is_not_sure_to_save_time_is_no_answer(logged, tmp_path):
    even = replace(PLANNED, saves_s=(0.2, -0.4, 0.8))
    found = document(logged, tmp_path, planned=even, estimates=[estimate("order found", 30.8, places=TURNED)])
    assert (
        found["answer"]
        == "Today 31.0 s (mean of 4 logged executions). No clearly faster order of the same work was found."
    )


def test_where_the_operator_became_quicker_today_is_at_his_latest_pace_too(logged, tmp_path):
    names = tuple(one.execution for one in logged.card.executions)
    pace = (OperatorPaceCard(executions=names, work=TrendCard(change=-0.4, count=len(names))),)
    given = {"estimates": [estimate("turned", 20.0, places=TURNED, pace=pace)], "takt_s": 30.5}
    found = document(logged, tmp_path, **given)
    today = found["verdict"]["today"]
    assert today["as_logged_s"] == 31.0
    assert today["pace_share"] == pytest.approx(0.5)  # of so few executions half of the cycle
    assert today["mean_s"] < 29.0
    assert found["verdict"]["best"]["saves_s"] == pytest.approx(today["mean_s"] - 20.0)
    assert "s at the operator's latest pace (mean of 4 logged executions, 31.0 s as logged)" in found["answer"]
    basis = found["sentences"]["answer"][0]
    assert "as logged it is 31.0 s, and 50 % of a change of his pace reaches the cycle" in basis
    assert "at that pace 1 of them (25 %) miss" in basis
    single = (structs.replace(pace[0], executions=("run 0", "run 1")),)
    given["estimates"] = [estimate("turned", 20.0, places=TURNED, pace=single)]
    held = document(in_orders(logged, ROUTE), tmp_path, **given)
    assert "(one logged execution, 28.0 s as logged)" in held["answer"]
    assert "(one logged execution does this work, in 28.0 s)" in held["sentences"]["answer"][0]
    held = document(logged, tmp_path, estimates=[estimate("as now", 25.0, places=ROUTE, pace=pace)], baseline="as now")
    assert held["answer"].startswith("“as now” (baseline) ")
    assert "s at the operator's latest pace (31.0 s as logged)" in held["answer"]


def test_a_change_of_other_work_or_without_a_sure_saving_is_not_in_the_verdict(logged, tmp_path):
    other = Tried("open", "longer", 10.0, 9.0, 11.0, (40.0, 39.0, 41.0), places=LONG)
    unsure = Tried("slower", "as now", 30.0, 29.0, 31.0, (1.0, -0.5, 2.5), places=ROUTE)
    found = document(logged, tmp_path, estimates=[estimate("as now", 31.0, places=ROUTE)], what_if=[other, unsure])
    assert found["verdict"]["change"] is None
    assert "open" not in found["answer"]


def test_the_page_about_the_logs_alone_tells_the_takt_too(logged, tmp_path):
    found = document(logged, tmp_path, takt_s=30.0)
    assert any("of the executions miss the takt of 30 s." in text for text in found["sentences"]["answer"])


def mixed():
    return [estimate("two", 18.0, places=ROUTE), estimate("four", 41.0, places=LONG)]


@pytest.mark.parametrize("kind", ["html", "json", "md"])
def test_different_work_is_neither_ranked_nor_said_to_save_time(logged, tmp_path, kind):
    facts = compose_report(logged, None, tmp_path / f"r.{kind}", kind=kind, estimates=mixed())
    text = facts.path.read_text("utf-8").replace("\N{NO-BREAK SPACE}", " ")
    shown = Page(text).text if kind == "html" else text
    assert "The sequences do 2 different kinds of work." in shown
    assert "Order alone" not in shown
    assert "less per cycle" not in shown
    assert "No clear difference" not in shown
    assert "Fastest: " not in shown
    if kind == "md":
        assert "| two | – | 18.0 |" in shown
        assert "| four | – | 41.0 |" in shown
        assert "| 3 | 6.00 |" in shown
        assert "| 5 | 8.20 |" in shown


def test_within_the_same_work_ranks_and_the_worth_of_the_order_stay(logged, tmp_path):
    alike = [*mixed(), estimate("turned", 22.0, places=TURNED)]
    text = compose_report(logged, None, tmp_path / "r.md", kind="md", estimates=alike).path.read_text("utf-8")
    text = text.replace("\N{NO-BREAK SPACE}", " ")
    assert "| two | 1/2 |" in text
    assert "| turned | 2/2 |" in text
    assert "Order alone: of the same work, “two” takes 4.0 s less per cycle than “turned”" in text


def test_the_same_name_for_other_places_saves_nothing(logged, tmp_path):
    changed = [Tried("open", "two", 10.0, 9.5, 10.5, places=LONG)]
    compose_report(logged, None, tmp_path / "r.csv", kind="csv", estimates=mixed()[:1], what_if=changed)
    (row,) = [row for row in csv.DictReader((tmp_path / "r.csv").read_text("utf-8").splitlines()) if row["change"]]
    assert (row["expected_s"], row["saves_s"]) == ("10.0", "")


def test_the_work_of_each_sequence_is_in_the_table_of_seconds(logged, tmp_path):
    compose_report(logged, None, tmp_path / "r.csv", kind="csv", estimates=mixed())
    rows = [row for row in csv.DictReader((tmp_path / "r.csv").read_text("utf-8").splitlines()) if row["order"] == "0"]
    assert [row["work"] for row in rows] == ["3 visits (a, b, home)", "5 visits (a x2, b x2, home)"]


@pytest.mark.parametrize(
    ("lost", "said"),
    [
        (3.8, "Largest part of it: b → c, 3.8 s per cycle (11 %)"),
        (20.0, "Most of it: b → c, 20.0 s per cycle (59 %)"),
    ],
)
def test_most_is_said_of_more_than_half_only(dataset, tmp_path, lost, said):
    tasks = (TaskShare("a->b", 5.0, 4.0, 1.0, 0.0, 0.0), TaskShare("b->c", 25.0, 5.0, lost, 0.0, 0.0))
    found = document(dataset, tmp_path, estimates=[estimate(tasks=tasks, safety_loss_s=33.9)])
    assert said in found["sentences"]["answer"][1]


def test_the_bound_of_an_order_that_never_ran_is_not_held_against_today(dataset, tmp_path):
    found = document(dataset, tmp_path, estimates=[estimate("A first", 30.0)])
    (bound, *_) = found["sentences"]["helps"]
    assert bound.endswith("15.0 s below the expected 30.0 s.")
    assert "today" not in bound
    (bound, *_) = document(dataset, tmp_path)["sentences"]["helps"]
    assert bound.endswith("below today's logged mean.")


def test_each_kind_of_work_is_answered_with_at_most_three_numbers(logged, tmp_path):
    asked = [estimate("turned", 20.0, places=TURNED), estimate("four", 41.0, places=LONG)]
    asked.append(estimate("order found", 15.0, places=(*ROUTE[:2], "c", "home")))
    found = document(logged, tmp_path, estimates=asked)
    assert "“turned” takes 20.0 s on average, saving 11.0 s (-35 %)." in found["answer"]
    assert "“four” takes 41.0 s on average." in found["answer"]
    assert "“order found” takes 15.0 s on average." in found["answer"]
    assert found["works"][0] == found["verdict"]
    assert [each["best"]["expected_s"] for each in found["works"]] == [20.0, 15.0, 41.0]
    given = {
        "estimates": [asked[0], estimate("found", 25.0, places=(*ROUTE[:1], "b", "a", "home"))],
        "planned": PLANNED,
    }
    html = compose_report(logged, None, tmp_path / "r.html", **given).path.read_text("utf-8")
    tiles = re.findall(r'<div class="tiles">(.*?)</div>\s*</div>', html, flags=re.DOTALL)
    assert [row.count('class="number"') for row in tiles] == [2]
    numbers = re.findall(r'class="number">([\d.]+)<', tiles[0])
    assert numbers == ["31.0", "20.0"]
    assert "saving 11.0" in tiles[0]
    assert float(numbers[0]) - float(numbers[1]) == pytest.approx(11.0)


def test_an_order_saves_nothing_against_its_own_logs_in_any_output(logged, tmp_path):
    """Today's cycles of 31 s are executions of the order that the estimate gives 20 s for: an error of the model."""
    own = estimate("as now", 20.0, places=ROUTE)
    assert baseline_of(logged, work_of(ROUTE), None).compared(own) == (31.0, (0.0, 0.0, 0.0))
    planned = replace(PLANNED, places=ROUTE, order=("a", "b"), expected_s=20.0, saves_s=(0.0, 0.0, 0.0))
    assert planned.saving_in_words == "nothing: it is the order of the logged executions"
    for given in ({"estimates": [own]}, {"estimates": [own], "planned": planned}, {"planned": planned}):
        for kind in ("json", "md", "csv", "html"):
            facts = compose_report(logged, None, tmp_path / f"r.{kind}", kind=kind, **given)
            text = facts.path.read_text("utf-8").rpartition("<body>")[2]
            assert not re.search(r"saving 1|[Ss]aves? 1|11\.0", text), text[:2000]
        found = document(logged, tmp_path, **given)
        assert found["verdict"]["best"]["saves_s"] is None
        assert all(each["best"]["saves_s"] is None for each in found["works"])
    assert "“as now” is today's own order" in document(logged, tmp_path, estimates=[own])["answer"]


@pytest.mark.parametrize("saves_s", [(0.0, 0.0, 0.0), (5.1, 3.2, 7.0)])
def test_a_workbook_has_one_saving_too_and_none_for_the_order_of_its_own_logs(logged, saves_s):
    """The order found takes 25.9 s, the logged executions 31.0 s."""
    found = replace(PLANNED, expected_s=25.9, saves_s=saves_s)
    sheets = sheets_of_plan(found, logged, None)
    answer = dict(sheets["answer"])
    assert tuple(answer[name] for name in ("saves_s", "saves_low_s", "saves_high_s")) == saves_s
    if any(saves_s):
        assert answer["saves_s"] == pytest.approx(answer["against_s"] - answer["expected_s"])
        assert answer["saves"] == "5.1 s (95 % CI 3.2 to 7.0 s)"
    else:
        assert answer["saves"] == "nothing: it is the order of the logged executions"
    everything = [cell for name, rows in sheets.items() if name != "provenance" for row in rows for cell in row]
    assert {cell for cell in everything if isinstance(cell, float) and round(cell, 1) == 5.1} == (
        {5.1} if any(saves_s) else set()
    )


def test_what_the_tiles_say_is_not_said_again(logged, tmp_path):
    order = estimate("order found", 25.0, places=TURNED)
    change = Tried("smaller zone", "order found", 20.0, 19.5, 20.5, (5.0, 4.0, 6.0), places=TURNED, within=(1, 0.7, 1))
    given = {"estimates": [estimate("as now", 31.0, places=ROUTE), order], "what_if": [change], "planned": PLANNED}
    html = compose_report(logged, None, tmp_path / "r.html", takt_s=30.5, **given).path.read_text("utf-8")
    section = html.partition('<section id="answer">')[2].partition("<figure")[0]
    tiles, beside = section.partition('class="tiles"')[2].partition('<p class="lead">')[::2]
    assert re.findall(r'class="number">([\d.]+)<', tiles) == ["31.0", "25.0", "20.0"]
    assert len(re.findall(r"95\s%\sCI", tiles)) == 3
    for number in ("31.0", "25.0", "20.0", "6.0", "11.0"):
        assert number not in beside
