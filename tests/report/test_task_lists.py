"""The page of a dataset of task lists: logged executions as a time chart, with a model and without."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import pytest

from cyclekit import train_task_times, write_report
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.baseline import listed_cycle, listed_cycles
from cyclekit.ingest.ingest import ingest
from cyclekit.report.task_lists import _learned, _order

ROBOT, OPERATOR = ("robot", "arm"), ("operator", "worker")


def _lists(folder: Path, orders: list[list[tuple[tuple[str, str], str, float, float]]]) -> Dataset:
    """Write executions of (agent, task, start, end) and ingest them."""
    rows = ["execution,agent,kind,task,start_s,end_s"]
    for number, tasks in enumerate(orders):
        for (agent, name), task, start_s, end_s in tasks:
            rows.append(f"e{number:02},{name},{agent},{task},{1000 * number + start_s},{1000 * number + end_s}")
    folder.mkdir(exist_ok=True)
    (folder / "tasks.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    ingest([folder / "tasks.csv"], folder / "dataset")
    return Dataset.open(folder / "dataset")


def _usual(longer_s: float) -> list[tuple[tuple[str, str], str, float, float]]:
    """The robot brings, waits 4 s for the operator's mount, and welds."""
    return [
        (ROBOT, "bring", 0.0, 5.0),
        (OPERATOR, "mount", 5.5, 8.5 + longer_s),
        (ROBOT, "weld", 9.0 + longer_s, 15.0 + longer_s),
    ]


def _other(at_s: float) -> list[tuple[tuple[str, str], str, float, float]]:
    return [(OPERATOR, "mount", 0.0, at_s), (ROBOT, "weld", at_s, at_s + 6.0), (ROBOT, "bring", at_s + 7.0, at_s + 12)]


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Five executions of one order, one of another."""
    return _lists(tmp_path_factory.mktemp("lists"), [*(_usual(0.5 * turn) for turn in range(5)), _other(3.0)])


def test_the_order_run_most_is_drawn_with_its_mean_times_and_waits(logged: Dataset) -> None:
    (cycle,) = listed_cycles(logged).values()
    assert cycle.expected_s == pytest.approx(16.0)  # 15 to 17 s; the other order is not in it
    by_task = {share.task: share for share in cycle.plan}
    assert by_task["weld"].wait_s == pytest.approx(5.0)
    assert (by_task["mount"].start_s, by_task["mount"].end_s) == pytest.approx((5.5, 9.5))
    assert (by_task["mount"].kind, by_task["mount"].agent) == ("operator", "worker")
    assert by_task["mount"].end_low_s < 9.0 < 10.0 < by_task["mount"].end_high_s
    assert (cycle.nominal_s, cycle.wait_s) == pytest.approx((11.0, 5.0))


def test_of_orders_run_once_the_shortest_the_middle_and_the_longest_execution_are_drawn(tmp_path: Path) -> None:
    more = [[*_usual(2.0 * turn), *((OPERATOR, "pack", 40.0 + n, 40.5 + n) for n in range(turn))] for turn in range(4)]
    found = listed_cycles(_lists(tmp_path, more))
    assert list(found) == ["shortest", "middle", "longest"]
    assert [round(each.expected_s, 1) for each in found.values()] == [15.0, 41.5, 42.5]
    assert not any(each.quantiles_s for each in found.values())
    one = listed_cycles(_lists(tmp_path / "one", [_usual(0.0)]))
    assert list(one) == ["middle"]


def test_executions_of_several_orders_have_no_mean_course(logged: Dataset) -> None:
    names = [one.execution for one in logged.card.executions]
    assert listed_cycle(logged, names, "all") is None
    assert listed_cycle(logged, names[:2], "two").executions == 2


def test_the_page_of_logs_alone_shows_the_logged_executions_and_how_to_learn_more(logged: Dataset, tmp_path) -> None:
    facts = write_report(logged, tmp_path / "page.html", takt_s=15.6)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert facts.headline.replace("\N{NO-BREAK SPACE}", " ") == (
        "6 logged executions take 15.8 s on average (15.0 to 17.0 s), 50 % of them within the takt of 15.6 s: "
        "3 tasks of 2 agents."
    )
    assert facts.pictures == 1
    assert "5 logged executions of one order: 16.0 s" in page
    assert "arm waits 5.0 s before weld" in page
    assert "<pattern" not in page  # browsers print a pattern as pixels, 0.1 MB for each bar
    assert "cyclekit train DATASET --out MODEL" in page
    write_report(logged, tmp_path / "page.json")
    (part, _) = json.loads((tmp_path / "page.json").read_text(encoding="utf-8"))["parts"]
    assert part["rows"][0][1:6] == ["arm", "1", "bring", "0.0", "5.0"]


def test_the_page_has_contents_and_numbered_sections(logged: Dataset, tmp_path) -> None:
    write_report(logged, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    titles = ["Logged executions", "How reliable are these numbers?"]
    for number, title in enumerate(titles, start=1):
        assert f'<a href="#part-{number}">{number} {title}</a><span data-page-of="part-{number}"></span>' in page
        assert re.search(rf'<section id="part-{number}">\s*<h2><span class="number">{number}</span> {title}', page)


def test_the_order_found_has_a_column_for_each_agent() -> None:
    tasks = [SimpleNamespace(agent=agent, name=name) for agent, name in
             (("arm", "bring"), ("worker", "mount"), ("arm", "weld"))]  # fmt: skip
    planned = SimpleNamespace(
        saves_s=(3.0, 2.0, 4.0), estimate=SimpleNamespace(expected_s=40.0), against="logged orders",
        against_s=43.0, tasks=tasks, saving_in_words="3.0 s (95 % CI 2.0 to 4.0 s)",
    )  # fmt: skip
    (part,) = _order(planned)
    assert part.heads == ["No.", "arm", "worker"]
    assert part.rows == [["1", "bring", "mount"], ["2", "weld", ""]]
    assert "saves 3.0 s (95 % CI 2.0 to 4.0 s)" in part.sentences[0]


@pytest.mark.usefixtures("quick_task_times")
def test_with_a_model_today_stands_above_the_plans_and_the_page_is_played_with(tmp_path: Path) -> None:
    logged = _lists(tmp_path, [_usual(0.3 * (turn % 7)) for turn in range(20)])
    train_task_times(logged, out=tmp_path / "model")
    tasks = [("arm", "bring"), ("arm", "weld"), ("worker", "mount")]
    (tmp_path / "plan.toml").write_text(
        "[[sequence]]\nname = 'same'\n"
        + "".join(f"[[sequence.task]]\nagent = '{agent}'\nname = '{task}'\n" for agent, task in tasks),
        encoding="utf-8",
    )
    asked = {"model": tmp_path / "model", "sequences": tmp_path / "plan.toml"}
    facts = write_report(logged, tmp_path / "page.html", **asked)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "today, 20 logged executions: 15.9 s" in page
    assert '<section id="play" hidden>' in page
    assert '<a href="#play">' in page
    assert not any("played" in text for text in facts.missing)
    write_report(logged, tmp_path / "p.html", **asked, play=False)
    plain = (tmp_path / "p.html").read_text(encoding="utf-8")
    assert 'id="play' not in plain
    assert "script-src" not in plain
    write_report(logged, tmp_path / "other.html", model=tmp_path / "model")
    assert "Logged executions" in (tmp_path / "other.html").read_text(encoding="utf-8")


def test_a_workbook_of_task_lists_is_a_workbook(logged: Dataset, tmp_path: Path) -> None:
    pytest.importorskip("xlsxwriter")
    write_report(logged, tmp_path / "page.xlsx")
    assert (tmp_path / "page.xlsx").read_bytes()[:2] == b"PK"


@pytest.mark.parametrize(("third", "other"), [(False, "weld"), (True, "arm: weld")])
def test_speeds_beside_the_other_agent_are_a_table_and_name_him_only_among_several(third: bool, other: str) -> None:
    mount = SimpleNamespace(
        agent="worker", task="mount", work_s=(5.0,), usual_s=5.0, waits_for=("",),
        rates={"": 0.5, "arm: weld": 1.2, "arm: bring": 1.05}, waiting={"arm: weld": 0.5},
    )  # fmt: skip
    others = [SimpleNamespace(agent=name, task="x", work_s=(1.0,), usual_s=1.0, waits_for=("",), rates={}, waiting={})
              for name in ("arm", *(["helper"] if third else []))]  # fmt: skip
    _, speeds = _learned(SimpleNamespace(tasks=[mount, *others], notices=()))
    assert speeds.rows == [["worker", "mount", other, "1.20", "0.25"]]
    assert "1.2 times as fast as alone" in speeds.sentences[-1]
