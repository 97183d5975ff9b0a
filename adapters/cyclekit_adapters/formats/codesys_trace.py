"""CODESYS Trace: files of "Save Trace" and "Save Trace to File", as *.trace (XML), *.trace.csv and *.txt.

The vendor's page "Command: Save Trace" (CODESYS Trace, online help) names the three file types and their content, and
"Data Sampling with Trace" states that times count from the start of the recording. The layouts are not published; they
were taken from published files of CODESYS 3.5:

- csv: `[key]; [value]`, settings, then for each variable `0.Variable; NAME`, `0.Data; ` and lines `; time; value`.
  Setting `Flags` gives the unit of time: 16 is milliseconds, 32 microseconds.
- trace: `TraceData` with `Values` and `Timestamps` of each variable, comma-separated lists; setting `MicroSeconds`.
- txt: a title line, the project's path, `Timestamp(ms) NAME NAME ...`, and rows separated by blanks.
"""

from __future__ import annotations

import re
import sys
from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from xml.parsers import expat

import numpy as np
import polars as pl

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import ConfigError, DamagedLog, LogError
from cyclekit.text.numbers import count
from cyclekit_adapters.mapped.source_map import words
from cyclekit_adapters.tasks.state_changes import StateChanges
from cyclekit_adapters.tasks.trace_signals import are_states, left_out
from cyclekit_adapters.text.delimited import TextLayout, read_rows
from cyclekit_adapters.text.text_blocks import (
    blocks_of,
    characters_of,
    encoding_notes,
    file_encoding,
    head_lines,
    head_of,
)
from cyclekit_adapters.text.text_layout import header_names
from cyclekit_adapters.text.text_rows import SET_ASIDE, UNDECODED

if TYPE_CHECKING:
    from pathlib import Path

_UNITS = {"ms": 1e-3, "us": 1e-6}
_FLAGS = {16: "ms", 32: "us"}
_VARIABLE = re.compile(r"\d+\.Variable; ?(.+)")
_SAMPLE = re.compile(r"; ?(\d{1,20}); ?(\S.*)")
_TIME = re.compile(r"\s*\d{1,20}\s*")
_SETTING = re.compile(r"(?:\d+\.)?[A-Za-z][\w.]*; ?.*")
_UNIT_FLAGS = re.compile(r"Flags;\s*(\d{1,9})", re.ASCII)
_TIMES = re.compile(r"\w+\((ms|us|µs)\)")
MAX_SAMPLES = 5_000_000
"""Maximum number of samples of a trace, which is held in memory as a whole."""
_LONGEST = 1 << 24
"""Maximum number of characters of the times or values of one variable."""
_CUT = "the file ends in this line: it was cut while being written"


@dataclass
class _Samples:
    """Samples of one variable: times as written, values, and the line (or number) of each."""

    times: array[float] = field(default_factory=lambda: array("d"))
    values: list[str] = field(default_factory=list)
    rows: array[int] = field(default_factory=lambda: array("q"))

    def add(self, time: str, value: str, row: int) -> None:
        self.times.append(float(time))
        self.values.append(sys.intern(value))
        self.rows.append(row)


@dataclass
class _Trace:
    """Content of a file.

    Attributes:
        samples: Samples by variable.
        unit: Unit of time, `ms` or `us`; None if the file does not give it.
        aside: Line and reason.
        rows_read: Number of samples read.
        warnings: One sentence each.
    """

    samples: dict[str, _Samples] = field(default_factory=dict)
    unit: str | None = None
    aside: list[tuple[int, str]] = field(default_factory=list)
    rows_read: int = 0
    warnings: list[str] = field(default_factory=list)

    def count(self, path: Path) -> None:
        """Count a sample.

        Raises:
            DamagedLog: There are too many to hold.
        """
        self.rows_read += 1
        if self.rows_read > MAX_SAMPLES:
            raise DamagedLog(path, f"more than {count(MAX_SAMPLES)} samples: too many for one trace", cure="Split it.")


class _CodesysTrace:
    def recognises(self, path: Path) -> bool:
        return _form(path) is not None

    def read(self, path: Path, options: ReadOptions) -> Recording:
        unit = words(options, "CODESYS trace", {"time_unit": tuple(_UNITS)}).get("time_unit")
        if options.role not in (None, "events"):
            raise ConfigError(f"a CODESYS trace cannot be read as {options.role}", cure='Give role = "events".')
        form = _form(path) or "csv"
        trace = {"csv": _of_csv, "trace": _of_xml, "txt": _of_text}[form](path)
        if not any(samples.times for samples in trace.samples.values()):
            first = f"; the first line set aside ({trace.aside[0][0]}): {trace.aside[0][1]}" if trace.aside else ""
            raise DamagedLog(
                path, f"it holds no sample{first}", cure="Record again, and save the trace when it is filled."
            )
        unit = unit or trace.unit
        if unit is None:
            cause = "it does not say whether its times are milliseconds or microseconds"
            raise LogError(path, cause, cure='Give map = { time_unit = "ms" } (or "us") in its source of cell.toml.')
        real = [name for name, samples in trace.samples.items() if not are_states(samples.values)]
        kept = {name: samples for name, samples in trace.samples.items() if name not in real}
        if not kept:
            cause = f"all {len(real)} variables are of real numbers: none is a signal"
            raise DamagedLog(path, cause, cure="Trace the variables of inputs and outputs (BOOL) too.")
        return Recording(
            events=_events(kept, _UNITS[unit]),
            rows_are="row" if form == "trace" else "line",
            rows_read=trace.rows_read,
            set_aside=pl.DataFrame(sorted(trace.aside), schema=SET_ASIDE, orient="row"),
            warnings=(*trace.warnings, *left_out(real), *encoding_notes(path)),
            facts={"form": form, "time": f"{unit} since the trace began", "variables": ", ".join(kept)[:2000]},
        )


def _form(path: Path) -> str | None:
    lines = [line.strip() for line in head_lines(path, 3)]
    if lines and lines[0].replace(" ", "") == "[key];[value]":
        return "csv"
    head = head_of(path).lstrip("\ufeff \t\r\n")
    if head.startswith("<") and "<Trace" in head and ("<TraceConfiguration" in head or "<TraceData" in head):
        return "trace"
    return "txt" if len(lines) == 3 and "Trace" in lines[0] and _TIMES.match(lines[2]) else None


def _events(kept: dict[str, _Samples], seconds: float) -> pl.DataFrame:
    counts = pl.Series([len(samples.times) for samples in kept.values()], dtype=pl.UInt32)
    long = {
        "t_s": np.concatenate([samples.times for samples in kept.values()]) * seconds,
        "signal": pl.DataFrame({"name": list(kept), "count": counts})
        .select(pl.col("name").repeat_by("count"))
        .explode("name")["name"],
        "value": pl.Series([value for samples in kept.values() for value in samples.values], dtype=pl.String),
        "source_row": np.concatenate([samples.rows for samples in kept.values()]),
    }
    return StateChanges().changed(pl.DataFrame(long)).sort("t_s", maintain_order=True)


def _of_csv(path: Path) -> _Trace:
    trace, samples, number = _Trace(), None, 0
    for block in blocks_of(path, file_encoding(path) or "utf-8"):
        lines = block.decode("utf-8", "replace").split("\n")
        for place, raw in enumerate(lines):
            line, last = raw.strip(), place == len(lines) - 1
            number += not last
            if not line:
                continue
            if last:
                trace.count(path)
                trace.aside.append((number + 1, _CUT))
            elif found := _VARIABLE.fullmatch(line):
                samples = None if UNDECODED in line else trace.samples.setdefault(found[1].strip(), _Samples())
                if samples is None:
                    trace.count(path)
                    trace.aside.append((number, "its name has unreadable characters"))
            elif (found := _SAMPLE.fullmatch(line)) and samples is not None and "\0" not in line:
                samples.add(found[1], found[2].strip(), number)
                trace.count(path)
            elif flags := _UNIT_FLAGS.fullmatch(line):
                trace.unit = next((unit for bit, unit in _FLAGS.items() if int(flags[1]) & bit), None)
            elif not _SETTING.fullmatch(line) and line.replace(" ", "") != "[key];[value]":
                trace.count(path)
                trace.aside.append((number, f"neither a setting nor a sample: {line[:40]!r}"))
    return trace


def _of_text(path: Path) -> _Trace:
    line = head_lines(path, 3)[2].strip()
    names = header_names(line, " ")
    found = _TIMES.match(names[0])
    layout = TextLayout(names, " ", 3, encoding=file_encoding(path) or "utf-8")
    rows = read_rows(path, layout, numbers=names[:1], texts=names[1:], required=names[:1])
    trace = _Trace(unit="ms" if found and found[1] == "ms" else "us", rows_read=rows.rows_read)
    for name in names[1:]:
        known = rows.frame.select(names[0], name, "source_row").drop_nulls(name)
        times, rows_of = (known[column].to_numpy() for column in (names[0], "source_row"))
        trace.samples[name] = _Samples(array("d", times), known[name].to_list(), array("q", rows_of))
    trace.aside = list(rows.set_aside.iter_rows())
    return trace


def _of_xml(path: Path) -> _Trace:
    document = _Document(path)
    try:
        for piece in characters_of(path):
            document.parser.Parse(piece.encode("utf-8", "replace"), False)
        document.parser.Parse(b"", True)
    except expat.ExpatError as error:
        message = f"the document is cut or garbled at line {error.lineno}: what is behind it is lost"
        document.trace.warnings.append(message)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror}", cure="Check the path.") from error
    return document.trace


class _Document:
    """Parser of the XML: reads variables and the unit of time, skips everything else, and follows no reference."""

    def __init__(self, path: Path) -> None:
        self.trace = _Trace()
        self.parser = expat.ParserCreate("utf-8")
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._told
        self.parser.StartDoctypeDeclHandler = self.parser.EntityDeclHandler = self._refuse
        self._path, self._name, self._text = path, "", list[str]()
        self._reading, self._told_size = "", 0
        self._lists: dict[str, str] = {}

    def _start(self, tag: str, about: dict[str, str]) -> None:
        if tag == "TraceVariable":
            self._name, self._lists = about.get("VarName", ""), {}
            if UNDECODED in self._name:
                self.trace.warnings.append(f"{self._name!r} has unreadable characters, so it is left out")
                self._name = ""
        wanted = tag in ("Values", "Timestamps") or about.get("Name") == "MicroSeconds"
        self._reading, self._text, self._told_size = (tag if wanted else ""), [], 0

    def _told(self, text: str) -> None:
        if self._reading:
            self._text.append(text)
            self._told_size += len(text)
            if self._told_size > _LONGEST:
                raise DamagedLog(self._path, f"a list of more than {_LONGEST >> 20} MiB", cure="Split the trace.")

    def _end(self, tag: str) -> None:
        text, reading, self._reading = "".join(self._text), self._reading, ""
        if reading and tag in ("Values", "Timestamps"):
            self._lists[tag] = text
        elif reading:
            self.trace.unit = "us" if text.strip().lower() == "true" else "ms"
        if tag == "TraceVariable" and self._name:
            self._take()

    def _take(self) -> None:
        times, values = (self._lists.get(tag, "").split(",") for tag in ("Timestamps", "Values"))
        if len(times) != len(values):
            message = f"{self._name!r}: {len(times)} times and {len(values)} values, so it is left out"
            self.trace.warnings.append(message)
            return
        samples = self.trace.samples.setdefault(self._name, _Samples())
        for row, (time, value) in enumerate(zip(times, values, strict=True)):
            if not time.strip() and not value.strip():
                continue
            self.trace.count(self._path)
            if _TIME.fullmatch(time):
                samples.add(time, value.strip(), row)
            else:
                self.trace.aside.append((row, f"{self._name!r}: {time.strip()[:40]!r} is no time"))

    def _refuse(self, *about: object) -> None:
        cause = "it holds a document type declaration, which may define entities: not read"
        raise DamagedLog(self._path, cause, cure="Remove the <!DOCTYPE ...> at its beginning.")


ADAPTER: Adapter = _CodesysTrace()
