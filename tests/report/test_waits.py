"""Who waits for whom, on the page: the learned conditions, and the seconds that the logged tasks waited for each."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING

import polars as pl
import pytest
from matplotlib.figure import Figure
from msgspec import structs
from report_pages import draw_only

from cyclekit.cli.lists import coupling_table
from cyclekit.dataset.cards import ConditionCard, CouplingCard, GateCard, SourceCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.plots.waits import WaitArrow, draw_waits, height_in
from cyclekit.report import compose_report

if TYPE_CHECKING:
    from pathlib import Path

LEAVES = ConditionCard(
    agent="operator", place="desk", event="leaves", lag_s=(0.1, 0.2, 0.3), signal="release set", back=1, held=0.99,
    decided=7,
)  # fmt: skip
SET = ConditionCard(agent="signal", place="digital-input 3", event="set", lag_s=(0.1,), decided=12)
ARRIVES = ConditionCard(agent="robot", place="left", event="arrives", lag_s=(0.5,), decided=5)
CARD = CouplingCard(
    gates=(
        GateCard(agent="robot", at="approach", place="left", conditions=(LEAVES,), passages=40),
        GateCard(agent="robot", at="leave", place="right", conditions=(SET,), passages=20),
        GateCard(agent="operator", at="leave", place="desk", conditions=(ARRIVES,), passages=20),
    ),
    sources=(SourceCard(signal="digital-input 3", gap_s=(4.0, 9.0), buffer=2, taken_by="right"),),
    executions=4,
)
WAITED = {
    "conveyor->left": ("operator leaves desk (release set)", 2.0),
    "conveyor->right": ("digital-input 3 set", 3.0),
}


@pytest.fixture
def coupled(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> Dataset:
    """Executions of one visit of `left` and of `right`, with waits there, another one, and one of the operator."""
    tasks = dataset.tasks()
    wait = pl.col("task").replace_strict({name: s for name, (_, s) in WAITED.items()}, default=0.25)
    ended = pl.col("task").replace_strict({name: by for name, (by, _) in WAITED.items()}, default=None)
    robot = tasks.with_columns(agent=pl.lit("robot"), wait_s=wait, lost_wait_s=wait, waited_for=ended)
    his = robot.filter(pl.col("task") == "conveyor->left").with_columns(
        agent=pl.lit("operator"), task=pl.lit("desk"), wait_s=pl.lit(1.5), lost_wait_s=None,
        waited_for=pl.lit("robot arrives left"),
    )  # fmt: skip
    monkeypatch.setattr(Dataset, "tasks", lambda _: robot)
    monkeypatch.setattr(Dataset, "every_task", lambda _: pl.concat([robot, his]))
    return Dataset(dataset.path, structs.replace(dataset.card, coupling=CARD))


@pytest.mark.usefixtures("words_only")
def test_the_conditions_are_a_table_with_the_seconds_waited_in_each_execution(coupled: Dataset, tmp_path: Path) -> None:
    words = compose_report(coupled, None, tmp_path / "r.md", kind="md").path.read_text("utf-8")
    part = words.partition("### Who waits for whom")[2].partition("###")[0].replace("\N{NO-BREAK SPACE}", " ")
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in part.splitlines() if line.startswith("| ")
    ]
    assert rows[1:] == [
        ["robot before left", "operator leaves desk (release set), 1 visit earlier", "0.2", "0.1 to 0.3", "99 %",
         "7 of 40", "2.0"],
        ["robot at right", "digital-input 3 set", "0.1", "0.1", "100 %", "12 of 20", "3.0"],
        ["operator at desk", "robot arrives left", "0.5", "0.5", "100 %", "5 of 20", "1.5"],
        ["robot, elsewhere", "not known", "", "", "", "", "0.5"],
    ]  # fmt: skip
    assert "Parts of digital-input 3 come 4.2 to 8.8 s apart; at most 2 wait at right." in part
    typed = " ".join(coupling_table(CARD).split())
    for row in rows[1:-1]:
        assert all(word in typed for word in [*row[0].split(), *row[1].split(), row[5]])


def test_the_picture_has_an_arrow_for_each_wait_and_the_data_have_its_seconds(
    coupled: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw_only("waits", monkeypatch)
    text = compose_report(coupled, None, tmp_path / "r.html", play=False).path.read_text("utf-8")
    text = text.replace("\N{NO-BREAK SPACE}", " ")
    page = text.partition("<h3>Who waits for whom</h3>")[2].partition("<h3>")[0]
    tips = re.findall(r'<g class="tip"[^>]*><title>([^<]*)</title>', page)
    told = [
        "robot before left until operator leaves desk (release set), 1 visit earlier: 2.0 s waited per execution",
        "robot at right until digital-input 3 set: 3.0 s waited per execution",
        "operator at desk until robot arrives left: 1.5 s waited per execution",
    ]
    assert tips == told * 2  # for a wide screen and for a phone
    assert f"Longest wait: {told[1]}." in page
    found = json.loads(compose_report(coupled, None, tmp_path / "r.json", kind="json").path.read_text("utf-8"))
    assert [(one["who"], one["waited_s"], one["had_to_wait"]) for one in found["waits"]] == [
        ("robot before left", 2.0, 7), ("robot at right", 3.0, 12), ("operator at desk", 1.5, 5),
    ]  # fmt: skip


@pytest.mark.usefixtures("words_only")
def test_a_cell_where_nobody_waits_has_no_such_part(dataset: Dataset, tmp_path: Path) -> None:
    card = structs.replace(dataset.card, coupling=CouplingCard(executions=4))
    for each in (dataset, Dataset(dataset.path, card)):
        assert "Who waits for whom" not in compose_report(each, None, tmp_path / "r.md", kind="md").path.read_text(
            "utf-8"
        )


@pytest.mark.parametrize("width_in", [7.4, 3.7])
def test_arrows_lead_to_who_waits_and_no_label_covers_another(width_in: float) -> None:
    arrows = [
        WaitArrow("robot", "a fixture with a very long name", "operator", "bench", "12.5 s", 1.0),
        WaitArrow("operator", "bench", "robot", "a fixture with a very long name", "4.0 s", 0.3),
        WaitArrow("robot", "conveyor", "signal", "digital-input 3", "0.4 s"),
    ]
    figure = Figure(figsize=(width_in, height_in(arrows)))
    axes = figure.add_subplot()
    draw_waits(axes, arrows, ("robot", "operator or signal"), lambda *_: None)
    drawn = [one for one in axes.texts if getattr(one, "arrow_patch", None) is not None]
    to_left = [one.xy[0] < one.xyann[0] for one in drawn]
    assert to_left == [True, False, True]
    boxes = [one.get_window_extent() for one in axes.texts if one.get_text()]
    assert not any(a.overlaps(b) for n, a in enumerate(boxes) for b in boxes[:n])
    assert all(box.x0 >= 0 and box.x1 <= figure.bbox.x1 for box in boxes)


def test_a_robot_that_waits_for_its_machine_has_an_arrow_from_it(
    coupled: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = ConditionCard(agent="robot", place="right", event="leaves", lag_s=(15.0,), back=1, decided=12, alike=30)
    card = CouplingCard(gates=(GateCard(agent="robot", at="leave", place="right", conditions=(own,), passages=20),))
    assert "12 of 20 (30 at all alike)" in coupling_table(card)
    draw_only("waits", monkeypatch)
    asked = Dataset(coupled.path, structs.replace(coupled.card, coupling=card))
    text = compose_report(asked, None, tmp_path / "r.html", play=False).path.read_text("utf-8")
    assert "operator, signal or machine" in text
    assert "robot at right until robot leaves right, 1 visit earlier" in text.replace("\N{NO-BREAK SPACE}", " ")
