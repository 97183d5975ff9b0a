"""Origin of a sample: the lines (rows, messages, frames) of the logs from which it was made.

A sample is at a row of the robot's log; its operator position is the mean of the tracker's rows around it. Every row of
a recording stores its position in its file, so a suspicious number can be looked up in the log.
"""

from __future__ import annotations

import codecs
import gzip
import zlib
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, cast

import polars as pl

from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import DatasetError
from cyclekit.storage.safe_path import safe_path
from cyclekit.text.numbers import fixed, given
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from cyclekit.dataset.cards import RecordingCard

AROUND_S = 0.2
"""Maximum time, s, from a sample to the rows of people and events shown with it."""
_SHOWN = 12
_LONGEST_LINE = 2000
_GZIP = b"\x1f\x8b"


@dataclass(frozen=True)
class Origin:
    """One row of a recording, which a sample was made from or which is close to it in time.

    Attributes:
        table: robot, people or events.
        recording: Id of the recording.
        file: The log, relative to the folder of logs.
        row_is, source_row: Position in the file: line (from 1), row, message or frame (from 0).
        t_s: Session time of the row, seconds.
        values: Known values of the row.
        text: The line itself, if the folder of logs was given and the log is a text; else None.
        among: Topics of the counted messages, if a log has several kinds of messages.
    """

    table: str
    recording: str
    file: str
    row_is: str
    source_row: int | None
    t_s: float
    values: dict[str, object]
    text: str | None = None
    among: str | None = None


@dataclass(frozen=True, repr=False)
class Trace(Result):
    """A sample and its origins; as a frame, one row per log row, times in session seconds."""

    execution: str
    sample: dict[str, object]
    origins: tuple[Origin, ...]

    def _frame_rows(self) -> list[dict[str, object]]:
        names = ("table", "recording", "file", "row_is", "source_row", "t_s", "text")
        return [{name: getattr(each, name) for name in names} for each in self.origins]

    def _lines(self) -> list[str]:
        at_s = cast("float", self.sample["t_s"])
        return [
            f"execution {self.execution}, sample at {fixed(at_s, 3)} s",
            *(f"{each.table}: {each.file}, {each.row_is} {each.source_row}" for each in self.origins),
        ]


def trace(
    dataset: Dataset | str | Path, execution: str, at_s: float = 0.001, *, logs: str | Path | None = None
) -> Trace:
    """Return the log lines from which the sample nearest to a time was made.

    Args:
        dataset: A dataset, its folder or its URL.
        execution: Name of the execution, or its number from 1.
        at_s: Time since the execution began, s.
        logs: Folder of the logs, or the log itself, to show the lines.

    Raises:
        UnknownName: There is no such execution.
        DatasetError: It has no samples, or `at_s` is after its end.
    """
    dataset = Dataset.of(dataset)
    dataset.require_positions()
    name = dataset.find_execution(execution)
    entry = next(one for one in dataset.card.executions if one.execution == name)
    if at_s > (length_s := entry.end_s - entry.start_s):
        seen = (
            f"{dataset.path}: execution {name} lasts {fixed(length_s, 1)} s, so it holds no sample at {given(at_s)} s"
        )
        raise DatasetError(seen, cure="Give --at a time since the execution began, such as 12.5s.")
    samples = dataset.samples([name])
    if samples.is_empty():
        raise DatasetError(f"{dataset.path}: execution {name} has no samples", cure="Choose another one.")
    wanted = entry.start_s + at_s
    sample = samples.row(int((samples["t_s"] - wanted).abs().arg_min() or 0), named=True)
    found: list[Origin] = []
    for record in dataset.recordings:
        if record.session == entry.session:
            found += _of_recording(dataset, record, float(sample["t_s"]), logs)
    return Trace(name, {key: value for key, value in sample.items() if value is not None}, tuple(found))


def _of_recording(dataset: Dataset, record: RecordingCard, at_s: float, logs: Path | str | None) -> list[Origin]:
    rate, offset_s = record.clock.rate, record.clock.offset_s
    own_s = (at_s - offset_s) / rate
    found = []
    for table in ("robot", "people", "events"):
        if table not in record.tables:
            continue
        rows = dataset.recorded_between(record.id, table, own_s - AROUND_S / rate, own_s + AROUND_S / rate)
        if rows is None:
            continue
        if table == "robot":  # the row of the sample
            rows = rows.filter(pl.col("t_s") <= own_s + 1e-6).tail(1)
        for row in _nearest(rows, own_s).iter_rows(named=True):
            t_s, line = row.pop("t_s"), row.pop("source_row")
            values = {key: value for key, value in row.items() if value is not None}
            shown = record.shown if len(record.sources) == 1 else record.shown.rpartition("/")[0]
            text = _line(_file(Path(logs), shown), line) if logs is not None and record.rows_are == "line" else None
            where = (table, record.id, shown, record.rows_are, line)
            among = record.facts.get(f"rows of {table}", "").removeprefix("messages of ") or None
            found.append(Origin(*where, t_s * rate + offset_s, values, text, among))
    return found


def _nearest(rows: pl.DataFrame, own_s: float) -> pl.DataFrame:
    return rows.sort((pl.col("t_s") - own_s).abs(), maintain_order=True).head(_SHOWN).sort("t_s", maintain_order=True)


def _file(logs: Path, shown: str) -> Path:
    """Return the log in the folder of logs, or `logs` itself if it is that log."""
    if logs.is_file() and logs.name == Path(shown).name:
        return logs
    return safe_path(logs, *shown.split("/"), follow_links=True)  # links in the user's own folder may lead out of it


def _line(file: Path, number: int | None) -> str | None:
    """Return one line of a text, counted from 1; None if it cannot be read, or is compressed other than by gzip."""
    if number is None or not file.is_file():
        return None
    with file.open("rb") as log:
        first = log.read(4)
    opened = gzip.open if first.startswith(_GZIP) else open
    encoding = "utf-16" if first.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    try:
        with opened(file, "rt", encoding=encoding, errors="replace", newline="\n") as log:
            found = next(islice(log, number - 1, None), None)
    except (OSError, EOFError, zlib.error):
        return None
    return None if found is None or "\0" in found else found[:_LONGEST_LINE].rstrip("\r\n")
