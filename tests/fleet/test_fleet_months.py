"""The page of a fleet month by month."""

from __future__ import annotations

import datetime as dt
from typing import TYPE_CHECKING

import pytest
from fabricated import fabricate_dataset
from msgspec.structs import replace

from cyclekit.dataset.cards import FiguresCard, MonthCard
from cyclekit.fleet.figures import figures_of
from cyclekit.report.fleet_page import CellLine, fleet_page

if TYPE_CHECKING:
    from pathlib import Path

TODAY = dt.date(2026, 11, 23)
FIGURES = FiguresCard(executions=20, cycle_s=90.0, lost_s=9.0, lost_share=0.1, newest=dt.date(2026, 11, 20))


def test_the_page_shows_cells_whose_logs_reach_over_several_months() -> None:
    def month(number: int, cycle_s: float) -> MonthCard:
        return MonthCard(month=dt.date(2026, number, 1), executions=12, cycle_s=cycle_s, lost_share=cycle_s / 1000)

    quicker = replace(FIGURES, months=(month(8, 104.0), month(9, 96.5), month(11, 91.0)))
    cells = [CellLine("<b>", quicker), CellLine("new", replace(FIGURES, months=(month(11, 80.0),)))]
    page = fleet_page("Line 4", cells, TODAY).replace("\N{NO-BREAK SPACE}", " ")
    assert page.count("<svg") == 2  # for a desk and for a phone
    for said in ("&lt;b&gt;, 2026-08: 104.0 s, 12 executions", "2026-09: 96.5 s", "cycle time, s"):
        assert said in page
    assert "new, 2026-11" not in page  # one month is no course
    assert "<svg" not in fleet_page("Line 4", cells[1:], TODAY)


def test_the_figures_of_a_cell_tell_each_month(tmp_path: Path) -> None:
    logs = fabricate_dataset(tmp_path / "dataset", executions=4, rounds=1)
    sessions = dict.fromkeys(logs.executions["session"])
    days = {session: dt.date(2026, 9 + number % 2, 4 + number) for number, session in enumerate(sessions)}
    found = figures_of(logs, "", days)
    assert [each.month for each in found.months] == sorted({day.replace(day=1) for day in days.values()})
    assert sum(each.executions for each in found.months) == found.executions
    mean_s = sum(each.executions * each.cycle_s for each in found.months) / found.executions
    assert mean_s == pytest.approx(found.cycle_s)
    assert figures_of(logs, "", {}).months == ()
