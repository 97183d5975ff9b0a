"""Universal Robots: a folder of headerless CSV files, one per signal (`log_tool_vector.csv`, `log_q_actual.csv`, ...).

Each row is `seconds, six values`; units are m, rad, m/s; the first column counts from the start of the recording. The
signals are joined on the time of the TCP pose, each with its row nearest in time. Such loggers are often killed while
writing, so files differ in length and end inside a number: a last line without a line end is set aside, and a signal
that ended earlier is unknown from there on. The override is not logged and stays unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, concat_parts
from cyclekit.errors import DamagedLog, LogError, UnknownName
from cyclekit.schema import ROBOT, conform
from cyclekit.text.numbers import fixed
from cyclekit_adapters.text.delimited import TextLayout, TextRows, delimiter_of, joined, read_blocks
from cyclekit_adapters.text.text_blocks import file_encoding, head_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_POSE, _JOINTS, _JOINT_SPEEDS, _SPEED = "log_tool_vector", "log_q_actual", "log_qd_actual", "log_tcp_speed"
_AXES = tuple(f"value_{index}" for index in range(6))
_COLUMNS = {
    _POSE: ("tcp_x_m", "tcp_y_m", "tcp_z_m"),
    _SPEED: ("x_m_s", "y_m_s", "z_m_s"),
    _JOINTS: tuple(f"q{joint}_rad" for joint in range(6)),
    _JOINT_SPEEDS: tuple(f"qd{joint}_rad_s" for joint in range(6)),
}
_LAYOUT = ("t_s", *_AXES)
_NEAR_PERIODS = 0.75  # maximum time difference of a joined value, in periods of its signal
_STANDS = "its time does not increase"


class _UrSplitFolder:
    def recognises(self, path: Path) -> bool:
        return path.is_dir() and any(_looks_right(path / f"{signal}.csv") for signal in (_POSE, _JOINTS))

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return concat_parts(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        for key in options.map:
            raise UnknownName("[sources.map] of a UR folder log", "key", key, [])
        if not path.is_dir():
            raise LogError(path, "is not a folder", cure="Name the folder that holds log_tool_vector.csv.")
        signals = _signals(path)
        lead = next((signals[name] for name in (_POSE, _JOINTS) if name in signals), None)
        if lead is None:
            cure = "Check that the copy is whole; log_tool_vector.csv holds seconds and six values a row."
            raise DamagedLog(path, "neither log_tool_vector.csv nor log_q_actual.csv has a usable row", cure=cure)
        others = [signal for signal in signals.values() if signal is not lead]

        def part(frame: pl.DataFrame) -> Recording:
            for other in others:
                frame = other.joined_to(frame)
            return Recording(
                robot=_robot(frame),
                clock="relative",
                joint_names=tuple(f"actual_q_{joint}" for joint in range(6)) if _JOINTS in signals else (),
                rows_are="line",
                rows_read=sum(signal.taken_rows() for signal in signals.values()),
                set_aside=pl.concat([signal.taken_aside() for signal in signals.values()]),
            )

        last: Recording | None = None
        while (frame := lead.next()) is not None:
            if last is not None:
                yield last
            last = part(frame)
        for other in others:
            other.exhaust()
        rest = part(lead.empty())
        facts = {
            "time_base": f"{lead.name}.csv",
            "signals": ", ".join(f"{name}.csv" for name in signals),
            "start_time": head_of(path / "start_time.csv", 64).partition("\n")[0].strip() or "not logged",
        }
        together = rest if last is None else concat_parts([last, rest])
        yield replace(together, warnings=tuple(_warnings(signals, lead)), facts=facts)


def _looks_right(path: Path) -> bool:
    line, newline, _ = head_of(path, 512).partition("\n")
    try:
        return bool(newline) and len([float(cell) for cell in line.split(delimiter_of(line))]) == len(_LAYOUT)
    except ValueError:
        return False


def _signals(path: Path) -> dict[str, _Signal]:
    """Open the existing files; a file without a usable row counts as absent."""
    found = {name: _Signal(name, path / f"{name}.csv") for name in _COLUMNS if (path / f"{name}.csv").is_file()}
    return {name: signal for name, signal in found.items() if signal.begins()}


@dataclass
class _Signal:
    """One file, read block by block only as far as needed."""

    name: str
    path: Path
    end_s: float | None = None
    _blocks: Iterator[TextRows] = field(init=False)
    _near_s: float = field(init=False)
    _here: pl.DataFrame = field(init=False)
    _rows: int = 0
    _aside: list[pl.DataFrame] = field(default_factory=list)

    def __post_init__(self) -> None:
        delimiter = delimiter_of(head_of(self.path).partition("\n")[0])
        layout = TextLayout(_LAYOUT, delimiter, 0, encoding=file_encoding(self.path) or "utf-8")
        self._blocks = read_blocks(self.path, layout, numbers=_LAYOUT, required=["t_s"])
        self._near_s = _NEAR_PERIODS * _period_s(self.path, delimiter)
        self._here = self.empty()

    def empty(self) -> pl.DataFrame:
        """Return an empty table with the columns of this signal."""
        return self._named(joined([], _LAYOUT).frame)

    def begins(self) -> bool:
        """Return whether there is a usable row; the rows read for this are kept."""
        while (frame := self._take()) is not None:
            if frame.height:
                self._here = frame
                return True
        return False

    def next(self) -> pl.DataFrame | None:
        """Return the next rows; None at the end."""
        if self._here.height:
            frame, self._here = self._here, self.empty()
            return frame
        return self._take()

    def _take(self) -> pl.DataFrame | None:
        rows = next(self._blocks, None)
        if rows is None:
            return None
        before = rows.frame["t_s"].cum_max().shift(1, fill_value=self.end_s)
        if self.end_s is not None:
            before = before.clip(lower_bound=self.end_s)
        goes_on = (before < rows.frame["t_s"]).fill_null(value=True)
        rows = rows.without(~goes_on, _STANDS)
        self._rows += rows.rows_read
        aside = pl.format("{}.csv: {}", pl.lit(self.name), "reason").alias("reason")
        self._aside.append(rows.set_aside.with_columns(aside))
        if rows.frame.height:
            self.end_s = float(rows.frame["t_s"][-1])
        return self._named(rows.frame)

    def _named(self, frame: pl.DataFrame) -> pl.DataFrame:
        columns = [pl.col(axis).alias(column) for axis, column in zip(_AXES, _COLUMNS[self.name], strict=False)]
        return frame.select("t_s", "source_row", *columns)

    def joined_to(self, lead: pl.DataFrame) -> pl.DataFrame:
        """Return the rows of `lead`, each with this signal's row nearest in time."""
        if not lead.height:
            return lead.join(self.empty().drop("source_row"), on="t_s", how="left")
        begin_s, end_s = float(lead["t_s"][0]) - self._near_s, float(lead["t_s"][-1]) + self._near_s
        while (self.end_s is None or self.end_s <= end_s) and (frame := self._take()) is not None:
            self._here = pl.concat([self._here, frame])
        other = self._here.drop("source_row")
        table = lead.join_asof(other, on="t_s", strategy="nearest", tolerance=self._near_s, check_sortedness=False)
        self._here = self._here.filter(pl.col("t_s") >= begin_s)
        return table

    def exhaust(self) -> None:
        """Read the rows after the end of the leading signal, so that they are counted."""
        while self._take() is not None:
            pass

    def taken_rows(self) -> int:
        """Return the number of rows read since the last call."""
        rows, self._rows = self._rows, 0
        return rows

    def taken_aside(self) -> pl.DataFrame:
        """Return the rows set aside since the last call."""
        aside, self._aside = self._aside, []
        return pl.concat([joined([]).set_aside, *aside])


def _period_s(path: Path, delimiter: str) -> float:
    """Return the median time between rows, from the first rows."""
    times = []
    for line in head_of(path).split("\n")[:-1]:
        try:
            times.append(float(line.split(delimiter, 1)[0]))
        except ValueError:
            continue
    steps = [after - before for before, after in pairwise(times) if after > before]
    return median(steps) if steps else 0.0


def _robot(table: pl.DataFrame) -> pl.DataFrame:
    linear = _COLUMNS[_SPEED]
    if set(linear).issubset(table.columns):
        squares = pl.sum_horizontal([pl.col(name) ** 2 for name in linear], ignore_nulls=False)
        table = table.with_columns(tcp_speed_m_s=squares.sqrt()).drop(linear)
    return conform(table, ROBOT)


def _warnings(signals: dict[str, _Signal], lead: _Signal) -> list[str]:
    messages = ["the speed scaling is not logged in this format"]
    end_s = lead.end_s or 0.0
    messages += [
        f"{signal.name}.csv ends at {fixed(signal.end_s, 3)} s, {lead.name}.csv at {fixed(end_s, 3)} s: unknown between"
        for signal in signals.values()
        if signal.end_s is not None and signal.end_s < end_s - 0.1
    ]
    return messages


ADAPTER: StreamingAdapter = _UrSplitFolder()
