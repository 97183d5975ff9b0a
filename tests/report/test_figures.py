"""A figure is a module and a line of the registry; nothing else of the report knows it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from matplotlib.figure import Figure as Drawing
from report_pages import draw_only, estimate

from cyclekit.report import compose_report, figures
from cyclekit.report.charts import causes, cycle_times
from cyclekit.report.figures import Chart, Figure
from cyclekit.report.inputs import PageInputs
from cyclekit.report.pictures import NARROW_IN, WIDE_IN, Picture
from cyclekit.report.tables import ReportTable

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from cyclekit.dataset.dataset import Dataset

WORDS = {"title": "Tasks per execution", "caption": "{tasks} logged tasks", "alt": "A bar"}


def draw(width_in: float) -> Drawing:
    drawing = Drawing(figsize=(width_in, 1.0))
    drawing.add_subplot().bar([0], [1])
    return drawing


def charts(page: PageInputs) -> Iterator[Chart]:
    caption = page.texts("pace.caption", tasks=page.tasks.height)
    numbers = ReportTable("pace", ["what", "count"], [["logged tasks", str(page.tasks.height)]])
    yield Chart(Picture("pace", page.texts("pace.alt"), draw), caption, page.texts("pace.title"), numbers)


@pytest.fixture(params=["answer", "where", "why", "helps", "trust"])
def section(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """A section that has one figure more, with words of its own."""
    more = Figure("pace", request.param, charts, WORDS)
    monkeypatch.setattr(figures, "FIGURES", (*figures.FIGURES, more))
    return request.param


def test_a_figure_of_the_registry_is_on_the_page_in_its_section(
    section: str, dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw_only("pace", monkeypatch)
    compose_report(dataset, None, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    part = page.partition(f'<section id="{section}">')[2].partition("</section>")[0]
    title = f"<h3>{WORDS['title']}</h3>"
    assert page.count(title) == part.count(title) == 1
    assert f"<figcaption>{dataset.tasks().height} logged tasks</figcaption>" in part
    assert part.count('id="pace-w-') > 0
    assert part.count("<td>" + str(dataset.tasks().height)) == 1


@pytest.mark.slow
def test_its_table_is_in_the_words_and_its_words_can_be_replaced(
    section: str, dataset: Dataset, tmp_path: Path
) -> None:
    (tmp_path / "texts.toml").write_text('[pace]\ncaption = "{tasks} Aufgaben"\n', encoding="utf-8")
    compose_report(dataset, None, tmp_path / "words.md", kind="md")
    assert f"| logged tasks | {dataset.tasks().height} |" in (tmp_path / "words.md").read_text(encoding="utf-8")
    compose_report(dataset, None, tmp_path / "page.html", template=tmp_path)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert f"{dataset.tasks().height} Aufgaben" in page
    assert section in page


def test_the_legend_leaves_room_for_the_only_row_on_a_phone():
    labels = {name: name for name in ("seconds", "mean", "cycles", "tip")} | {
        "without": "without safety slow-down", "takt": "takt, 40 s",
    }  # fmt: skip
    drawing = cycle_times(NARROW_IN, [estimate()], labels, 40.0)
    drawing.draw_without_rendering()
    height_in = drawing.axes[0].get_position().height * drawing.get_size_inches()[1]
    assert height_in > 0.35


def test_a_name_has_room_for_the_wider_letters_of_the_pages_font() -> None:
    """Where a browser draws it an eighth wider than it is measured here, it still begins on the picture."""
    name = "JABJJ_WXYWW"
    drawing = causes(WIDE_IN, [(name, 2.0, "#000"), ("person near", 1.0, "#000")], {"seconds": "s"})
    drawing.draw_without_rendering()
    (label,) = (label for label in drawing.axes[0].get_yticklabels() if label.get_text() == name)
    where = label.get_window_extent()
    assert where.x0 > where.width / 8
