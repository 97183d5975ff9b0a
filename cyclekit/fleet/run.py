"""All cells of a fleet through the stages that are asked for, and the page that shows them together."""

from __future__ import annotations

import datetime as dt
import json
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from cyclekit.dataset.guard import check_output
from cyclekit.errors import CyclekitError
from cyclekit.fleet.stages import LEDGER, REPORT, STAGES, Row, note, read_ledger, work_on
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.report.fleet_page import CellLine, fleet_page
from cyclekit.storage.remote.folders import join, write_text

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.fleet.read import Fleet, FleetCell

PAGE, SUMMARY = "index.html", "fleet.json"


def run_fleet(
    fleet: Fleet,
    stages: Sequence[str],
    *,
    engine: Engine = LOCAL,
    today: dt.date | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> list[Row]:
    """Do stages of every cell, one cell a task, and write the page of the fleet where `report` is among them.

    Args:
        fleet: The cells.
        stages: Of `STAGES`, in their order.
        engine: Who works. On several machines, sources and results must be where all see them, such as at URLs.
        today: The day by which logs are old; None for the day it is.
        progress: Told the part of the cells done, and what came of the last one.

    Returns:
        What came of each stage, in the order of the cells.

    Raises:
        OutputError: Something that is not the fleet's would be replaced.
        CyclekitError: The engine cannot be reached, or the page cannot be written.
    """
    _check(fleet, stages)
    rows: dict[str, list[Row]] = {}
    for done in engine.map(partial(work_on, stages=tuple(stages)), fleet.cells):
        cell = done.item
        if done.error is None:
            rows[cell.name] = done.get()
        else:  # its worker died again and again, so it could not note that itself
            rows[cell.name] = [Row(cell.name, stages[0], "failed", str(done.error))]
            with suppress(CyclekitError):  # where it was the place that failed
                note(cell, read_ledger(cell), rows[cell.name][0])
        if progress:
            progress(len(rows) / len(fleet.cells), _said(rows[cell.name][-1]))
    if "report" in stages:
        write_page(fleet, today or dt.datetime.now(tz=dt.UTC).date())
    return [row for cell in fleet.cells for row in rows[cell.name]]


def _check(fleet: Fleet, stages: Sequence[str]) -> None:
    """Refuse to work where something that is not the fleet's would be replaced, datasets and models apart."""
    for cell in fleet.cells:
        check_output(join(cell.folder, LEDGER), "cell", cell.sources, option="`out`")
        if "report" in stages:
            check_output(join(cell.folder, REPORT), "page", cell.sources, option="`out`")
    if "report" in stages:
        check_output(join(fleet.out, PAGE), "page", [], option="`out`")
        check_output(join(fleet.out, SUMMARY), "fleet", [], option="`out`")


def write_page(fleet: Fleet, today: dt.date) -> None:
    """Write `index.html` and `fleet.json`: every cell as its `cell.json` says, whatever was done today."""
    ledgers = [read_ledger(cell) for cell in fleet.cells]
    lines = [_line(cell, ledger) for cell, ledger in zip(fleet.cells, ledgers, strict=True)]
    write_text(join(fleet.out, PAGE), fleet_page(fleet.name, lines, today))
    write_text(join(fleet.out, SUMMARY), json.dumps({"fleet": fleet.name, "cells": ledgers}, indent=1) + "\n")


def _line(cell: FleetCell, ledger: dict[str, Any]) -> CellLine:
    stages = [stage for stage in STAGES if stage in ledger["stages"]]
    failed = [f"{stage}: {ledger['stages'][stage]['text']}" for stage in stages if _state(ledger, stage) == "failed"]
    unread = str(ledger["stages"].get("ingest", {}).get("text", "")).partition("not read: ")[2]
    link = f"{cell.name}/{REPORT}" if ledger.get("reported") else None
    return CellLine(cell.name, ledger["figures"], tuple(failed), unread, link)


def _state(ledger: dict[str, Any], stage: str) -> str:
    return str(ledger["stages"][stage]["state"])


def _said(row: Row) -> str:
    return f"{row.cell}: {row.stage} {row.state}"
