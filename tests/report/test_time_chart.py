"""The time chart: its bars, read from the drawn SVG, are the numbers of the estimate; its labels cover nothing."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from report_pages import cycles_of, draw_only, estimate

from cyclekit.estimate.baseline import logged_cycle, logged_order
from cyclekit.estimate.gantt import blocks_of
from cyclekit.estimate.result import PARTS, PlannedShare, TaskShare
from cyclekit.plots import colours
from cyclekit.report import compose_report
from cyclekit.report.figures.time_chart import PAPER_IN, draw, time_chart
from cyclekit.report.pictures import WIDE_IN, Picture, plain_style
from cyclekit.report.texts import load_texts

SHARES = (
    TaskShare("a->b", 12.0, 5.0, 5.0, 2.0, 0.0, 10.0, 15.0),
    TaskShare("b->c", 20.0, 10.0, 0.0, 4.0, 6.0, 27.0, 38.0),
)
HALF = PARTS // 2
SPLIT = {"nominal_s": 15.0, "safety_loss_s": 5.0, "dwell_s": 6.0, "wait_s": 6.0}
ONE = estimate(
    "one", 32.0, tasks=SHARES, distribution=cycles_of({0.05: 27.0, 0.5: 32.0, 0.95: 38.0}), **SPLIT,
    operator_at={"shelf": (1.0,) * HALF + (0.0,) * HALF, "desk": (0.0,) * HALF + (1.0,) * HALF},
)  # fmt: skip
BOTH = estimate(
    "both", 30.0,
    plan=(
        PlannedShare("robot", "robot", "bring", 0.0, 10.0, 0.0, {"own task before": 1.0}, 9.0, 11.0),
        PlannedShare("operator", "operator", "mount", 12.0, 30.0, 12.0, {"robot: bring": 1.0}, 28.0, 33.0),
    ),
)  # fmt: skip


def drawn(*found, takt_s=None, narrow=False):
    picture = Picture("chart", "time chart", partial(draw, found, takt_s))
    return picture.narrow if narrow else picture.wide


def spans(svg):
    """Title and colour of each bar, line and area with numbers, and from where to where it reaches, in points."""
    for title, part in re.findall(r'<g class="tip"[^>]*><title>([^<]*)</title>(.*?)</g>', svg, re.DOTALL):
        path = re.search(r'<path [^>]*?\bd="([^"]*)"([^>]*)', part, re.DOTALL)
        x = [float(number) for number in re.findall(r"[ML] (-?[\d.]+) ", path[1] if path else "")]
        colour = re.search(r"fill: (#\w+|url)", path[2] if path else "")
        if x:
            yield title, min(x), max(x), colour[1] if colour else ""


@pytest.mark.parametrize("narrow", [False, True])
def test_the_bars_are_the_numbers_of_the_estimates_on_one_time_axis(narrow):
    svg = drawn(ONE, BOTH, takt_s=40.0, narrow=narrow)
    expected = {
        "1 a → b: motion at full speed 5.0 s (42 % of the task)": (0.0, 5.0),
        "1 a → b: slow-down (mean speed 50 %) 5.0 s (42 % of the task)": (5.0, 10.0),
        "1 a → b: dwell 2.0 s (17 % of the task)": (10.0, 12.0),
        "2 b → c: motion at full speed 10.0 s (50 % of the task)": (12.0, 22.0),
        "2 b → c: dwell 4.0 s (20 % of the task)": (22.0, 26.0),
        "2 b → c: wait 6.0 s (30 % of the task)": (26.0, 32.0),
        "robot: 1 bring: 0.0 to 10.0 s": (0.0, 10.0),
        "operator waits 12.0 s before mount, until robot: bring": (0.0, 12.0),
        "operator: 1 mount: 12.0 to 30.0 s": (12.0, 30.0),
        "operator at or on the way to shelf: 50 % of the time": (0.0, 32.0),
    }
    found = {title: (low, high) for title, low, high, _ in spans(svg) if title in expected}
    assert set(found) == set(expected)
    shown = np.array([found[title] for title in expected]).ravel()
    wanted = np.array(list(expected.values())).ravel()
    slope, offset = np.polyfit(wanted, shown, 1)
    assert shown == pytest.approx(offset + slope * wanted, abs=0.02 * slope)


def planned(agent, task, start_s, end_s, wait_s=0.0, cause="own task before", share=1.0, *, rest=False):
    decided = {cause: share} if share == 1.0 else {cause: share, "own task before": 1.0 - share}
    return PlannedShare(agent, agent, task, start_s, end_s, wait_s, decided, end_s, end_s, rest)


HALTED = estimate(
    "halted", 30.0,
    tasks=(TaskShare("a->b", 6.0, 3.0, 2.0, 1.0, 0.0), TaskShare("b->c", 24.0, 6.0, 4.0, 2.0, 12.0)),
    plan=(
        planned("robot", "a->b", 0.0, 6.0),
        planned("robot", "b->c", 6.0, 8.5),
        planned("robot", "b->c", 20.5, 30.0, 12.0, "operator: c", rest=True),
        planned("operator", "c", 2.0, 10.0),
        planned("operator", "d", 20.5, 25.0, 10.5, "robot: a->b", 0.3),
    ),
)  # fmt: skip


def test_a_task_in_which_the_robot_waits_on_its_way_is_one_task_with_one_dwell():
    svg = drawn(HALTED)
    titles = [title for title, *_ in spans(svg)]
    assert [title for title in titles if "2 b → c: dwell" in title] == [
        "robot: 2 b → c: dwell 2.0 s (21 % of the task)"
    ]
    assert sum("2 b → c: motion at full speed" in title for title in titles) == 2
    assert "robot waits 12.0 s on the way to c, until operator: c" in titles
    assert not any("3 b" in title for title in titles)
    assert "4 of 4 tasks done" in svg


def test_an_arrow_comes_from_where_the_other_agent_left_and_is_dotted_where_that_is_seldom():
    (block,) = blocks_of([HALTED])
    to_robot, to_operator = block.arrows
    assert (to_robot.from_lane, to_robot.to_lane, to_robot.from_s, to_robot.to_s) == (1, 0, 20.5, 20.5)  # not at 10.0
    assert not to_robot.seldom
    assert (to_operator.from_lane, to_operator.from_s, to_operator.seldom) == (0, 6.0, True)


def test_a_wait_that_the_chart_has_no_task_for_shows_what_ended_it():
    wait = planned("robot", "b->c", 9.0, 12.0, 3.0, "operator: desk")
    mine = replace(ONE, plan=(planned("robot", "a->b", 0.0, 6.0), wait))
    (block,) = blocks_of([mine])
    (arrow,) = block.arrows
    assert (block.lanes, block.layers_name) == (("robot",), "operator")
    assert (arrow.from_lane, arrow.to_lane, arrow.from_s, arrow.to_s) == (1, 0, 9.0, 9.0)
    signal = replace(mine, plan=(mine.plan[0], replace(wait, decided={"signal: part": 1.0})))
    (block,) = blocks_of([signal])
    assert block.arrows == ()
    assert [label.texts for label in block.labels if label.start_s == 6.0] == [("until part",)]
    assert "robot waits 3.0 s before b → c, until signal: part" in [title for title, *_ in spans(drawn(signal))]


def test_places_of_the_operator_that_differ_by_their_number_alone_have_a_layer_each():
    half = (0.5, 0.5)
    titles = {title for title, *_ in spans(drawn(replace(ONE, operator_at={"spot_1": half, "spot_2": half})))}
    assert {f"operator at or on the way to spot_{n}: 50 % of the time" for n in (1, 2)} <= titles
    several = {"spot_1": (0.2, 0.2), "spot_2": (0.3, 0.3), "shelf": half}
    titles = {title for title, *_ in spans(drawn(replace(ONE, operator_at=several)))}
    assert "operator at or on the way to spot: 50 % of the time" in titles


def test_slow_down_has_the_colour_of_the_mean_speed():
    colour = {title: colour for title, _, _, colour in spans(drawn(ONE))}
    assert colour["1 a → b: slow-down (mean speed 50 %) 5.0 s (42 % of the task)"] == colours.scaling_hex(0.5)
    assert colour["1 a → b: motion at full speed 5.0 s (42 % of the task)"] == colours.scaling_hex(1.0)


def test_the_course_says_when_each_task_ends_in_single_cycles():
    svg = drawn(ONE, BOTH)
    assert "1 of 2 tasks done, a → b: 12.0 s; in single cycles 10.0 to 15.0 s" in svg
    assert "2 of 2 tasks done, b → c: 32.0 s; in single cycles 27.0 to 38.0 s" in svg
    assert "2 of 2 tasks done, operator: mount: 30.0 s; in single cycles 28.0 to 33.0 s" in svg


@settings(max_examples=8, deadline=None, phases=(Phase.explicit, Phase.generate))
@given(
    st.lists(
        st.tuples(st.text("abcdefgWM_ü", min_size=1, max_size=30), st.floats(0.5, 60.0), st.floats(0.0, 9.0)),
        min_size=1,
        max_size=14,
    ),
    st.sampled_from([3.7, 7.4]),
)
def test_no_text_covers_another_one(tasks, width_in):
    shares = tuple(TaskShare(f"x->{name}", s + wait, s, 0.0, 0.0, wait) for name, s, wait in tasks)
    total_s = sum(share.expected_s for share in shares)
    each = estimate(
        tasks[0][0] * 9, total_s, tasks=shares, distribution=cycles_of({0.05: total_s - 1, 0.95: total_s + 1})
    )
    with plain_style():
        figure = draw([each, each], 1.01 * total_s, width_in)
        renderer = FigureCanvasAgg(figure).get_renderer()
        (axes,) = figure.axes
        texts = [*axes.texts, *axes.get_yticklabels(), *figure.texts]
        boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in texts if text.get_text()]
    page = figure.bbox
    assert all(box.x0 >= page.x0 and box.x1 <= page.x1 + 1 for _, box in boxes)
    for (_, a), (_, b) in itertools.combinations(boxes, 2):
        assert a.x1 <= b.x0 + 1 or b.x1 <= a.x0 + 1 or a.y1 <= b.y0 + 4 or b.y1 <= a.y0 + 4


def test_every_sequence_is_in_one_picture_and_its_tasks_are_in_a_table(dataset, tmp_path, monkeypatch):
    draw_only("timechart", monkeypatch)
    text = compose_report(dataset, None, tmp_path / "r.html", estimates=[ONE, BOTH]).path.read_text("utf-8")
    part = text.partition('<section id="where">')[2].partition("</section>")[0]
    assert part.count('id="timechart-w-figure_1"') == 1
    words = compose_report(dataset, None, tmp_path / "r.md", kind="md", estimates=[ONE, BOTH]).path.read_text("utf-8")
    assert "| a → b | 1 | 5.0 | 5.0 | 2.0 | 0.0 | 12.0 | 12.0 | 10.0 to 15.0 |" in words
    assert "| mount | operator | 12.0 | 30.0 | 28.0 to 33.0 | 12.0 | robot: bring |" in words


def test_the_page_about_the_logs_draws_what_was_logged(dataset, tmp_path, monkeypatch):
    draw_only("timechart", monkeypatch)
    names = logged_order(dataset)
    cycle = logged_cycle(dataset, names, "today")
    tasks = dataset.tasks().filter(execution=names[0]).sort("start_s")
    took_s = tasks["end_s"][-1] - tasks["start_s"][0]
    assert [share.task for share in cycle.tasks] == tasks["task"].to_list()
    assert sum(share.expected_s for share in cycle.tasks) == pytest.approx(cycle.expected_s)
    assert cycle.expected_s == pytest.approx(took_s, rel=0.3)
    assert sum(map(sum, cycle.operator_at.values())) == pytest.approx(PARTS, abs=0.02)
    text = compose_report(dataset, None, tmp_path / "r.html").path.read_text("utf-8")
    assert 'id="timechart-w-figure_1"' in text


@pytest.mark.usefixtures("words_only")
def test_a_high_chart_is_printed_cycle_by_cycle_on_one_time_axis():
    longer = replace(ONE, name="longer", tasks=(*ONE.tasks, TaskShare("c->a", 40.0, 40.0, 0.0, 0.0, 0.0)))
    few, many = [ONE], [ONE, longer, ONE, longer]
    texts = load_texts().with_words({"time_chart": {"picture": "chart"}})
    assert time_chart(texts, few, None).paper == ()
    parts = [draw(WIDE_IN) for draw in time_chart(texts, many, None).paper]
    assert len(parts) == len(many)
    assert max(part.get_size_inches()[1] for part in parts) < PAPER_IN
    assert len({part.axes[0].get_xlim() for part in parts}) == 1
    assert len({tuple(part.axes[0].get_position().intervalx) for part in parts}) == 1
