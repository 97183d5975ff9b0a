"""Run stages of all cells of a fleet, and write the page of the fleet."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.dataset.cards import plain
from cyclekit.dataset.guard import check_output
from cyclekit.errors import CyclekitError
from cyclekit.fleet.read import REPORT, Fleet, load_fleet
from cyclekit.fleet.stages import STAGES, StageResult, read_ledger, record_stage, run_stages
from cyclekit.learning.training import need_torch
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.report.fleet_page import CellLine, fleet_page
from cyclekit.storage.remote.folders import join, write_text
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from cyclekit.dataset.cards import CellLedger
    from cyclekit.fleet.read import Fleet, FleetCell

PAGE, SUMMARY = "index.html", "fleet.json"


@dataclass(frozen=True, repr=False)
class FleetRun(Result):
    """Results of the stages of all cells; as a frame, one row per cell and stage.

    Attributes:
        fleet: Name of the fleet.
        rows: Result of each stage, by cell in order.
        page: Path or URL of the page of the fleet; None if it was not written.
    """

    fleet: str
    rows: tuple[StageResult, ...]
    page: str | None

    @property
    def failed(self) -> tuple[StageResult, ...]:
        """The stages that failed."""
        return tuple(row for row in self.rows if row.state == "failed")

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {"fleet": self.fleet, "failed": len(self.failed), "page": self.page, "rows": self._frame_rows()}

    def _frame_rows(self) -> list[dict[str, object]]:
        return [dict(vars(row)) for row in self.rows]

    def _lines(self) -> list[str]:
        states = ("done", "unchanged", "skipped", "failed")
        counts = [f"{sum(row.state == state for row in self.rows)} {state}" for state in states]
        return [f"{self.fleet}: {', '.join(counts)}", *(f"{row.cell}: {row.stage}: {row.text}" for row in self.failed)]


@checked
def run_fleet(
    fleet: Fleet | Place,
    stages: Literal["ingest", "train", "report", "all"] | Sequence[str] = "all",
    *,
    engine: Engine = LOCAL,
    today: dt.date | None = None,
    progress: Progress | None = None,
) -> FleetRun:
    """Run stages of every cell, one task per cell, and, if `report` is among them, write the page of the fleet.

    Args:
        fleet: The fleet, or the fleet file.
        stages: One of `STAGES`, several in order, or `all`.
        engine: Runs the cells. On several machines, sources and results must be accessible to all, such as at URLs.
        today: Date from which the age of logs is counted; None for the current date.
        progress: Called with the fraction of cells done, and the result of the last one.

    Returns:
        The result of each stage, in order of the cells, including failures; other cells still run.

    Raises:
        ConfigError: The fleet file is invalid.
        MissingExtra: torch is not installed, but a model must be trained.
        OutputError: A file that does not belong to the fleet would be replaced.
        CyclekitError: The engine cannot be reached, or the page cannot be written.
    """
    stages = tuple(STAGES) if stages == "all" else (stages,) if isinstance(stages, str) else tuple(stages)
    if not isinstance(fleet, Fleet):
        file, fleet = Path(fleet), load_fleet(Path(fleet))
        check_output(fleet.out, "folder", [file])
    if "train" in stages:
        need_torch()
    _check(fleet, stages)
    rows: dict[str, list[StageResult]] = {}
    for done in engine.map(partial(run_stages, stages=tuple(stages)), fleet.cells):
        cell = done.item
        if done.error is None:
            rows[cell.name] = done.get()
        else:  # its worker died repeatedly and could not record that
            rows[cell.name] = [StageResult(cell.name, stages[0], "failed", str(done.error))]
            with suppress(CyclekitError):  # if the ledger itself cannot be written
                record_stage(cell, read_ledger(cell), rows[cell.name][0])
        if progress:
            progress(len(rows) / len(fleet.cells), _stage_line(rows[cell.name][-1]))
    if "report" in stages:
        write_page(fleet, today or dt.datetime.now(tz=dt.UTC).date())
    page = join(fleet.out, PAGE) if "report" in stages else None
    return FleetRun(fleet.name, tuple(row for cell in fleet.cells for row in rows[cell.name]), page)


def _check(fleet: Fleet, stages: Sequence[str]) -> None:
    """Raise an error if a file that does not belong to the fleet would be replaced; without datasets and models."""
    for cell in fleet.cells:
        check_output(cell.ledger, "cell", cell.sources, option="`out`")
        if "report" in stages:
            check_output(cell.report, "page", cell.sources, option="`out`")
    if "report" in stages:
        check_output(join(fleet.out, PAGE), "page", [], option="`out`")
        check_output(join(fleet.out, SUMMARY), "fleet", [], option="`out`")


def write_page(fleet: Fleet, today: dt.date) -> None:
    """Write `index.html` and `fleet.json` from the `cell.json` of every cell, also of cells not run now."""
    ledgers = [read_ledger(cell) for cell in fleet.cells]
    lines = [_line(cell, ledger) for cell, ledger in zip(fleet.cells, ledgers, strict=True)]
    cells = [plain(ledger, nulls=True) for ledger in ledgers]
    write_text(join(fleet.out, PAGE), fleet_page(fleet.name, lines, today))
    write_text(join(fleet.out, SUMMARY), json.dumps({"fleet": fleet.name, "cells": cells}, indent=1) + "\n")


def _line(cell: FleetCell, ledger: CellLedger) -> CellLine:
    done = {stage: ledger.stages[stage] for stage in STAGES if stage in ledger.stages}
    failed = tuple(f"{stage}: {one.text}" for stage, one in done.items() if one.state == "failed")
    link = f"{cell.name}/{REPORT}" if ledger.reported else None
    return CellLine(cell.name, ledger.figures, failed, ledger.unread, link)


def _stage_line(row: StageResult) -> str:
    return f"{row.cell}: {row.stage} {row.state}"
