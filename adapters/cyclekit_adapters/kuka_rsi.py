"""KUKA: CSV of RSI values (`X_RIst`, `Y_RIst`, `Z_RIst`, `IPOC`), as people's RSI clients write it.

RSI itself is a stream and has no file format, so the columns are those of the client; the names of the values are
KUKA's. `RIst` is where the robot is (mm, base chosen in the RSI configuration), `RSol` only the set point of the next
cycle. The clock is `IPOC`, the controller's count of milliseconds; a `Timestamp` beside it is the PC's and often has
whole seconds only. RSI does not carry the override: it stays unknown.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import ReadOptions, Recording, StreamingAdapter, whole
from cyclekit.errors import MissingColumns, UnknownName
from cyclekit.schema import ROBOT, conform
from cyclekit_adapters.controller_time import Once, Spread
from cyclekit_adapters.delimited import Rows, read_blocks
from cyclekit_adapters.header_line import column_names, layout_below
from cyclekit_adapters.in_parts import in_parts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_POSITION = ("X_RIst", "Y_RIst", "Z_RIst")
_TIME, _LATE = "IPOC", "Delay"
_OVERRIDES = ("OV_PRO", "OV_ROB", "OV_JOG")
_MM, _MS = 1e-3, 1e-3


class _KukaRsiCsv:
    def recognises(self, path: Path) -> bool:
        names = column_names(path)
        return _TIME in names and any(name in names for name in _POSITION)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        return whole(self.stream(path, options))

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Recording]:
        for key in options.map:
            cure = 'Columns of your own are mapped with adapter = "csv".'
            raise UnknownName("[sources.map] of a KUKA RSI log", "key", key, [], cure=cure)
        layout = layout_below(path)
        if missing := {_TIME, *_POSITION}.difference(layout.names):
            raise MissingColumns(
                path, missing, layout.names, "Let the RSI client write RIst and IPOC, and record again."
            )
        numbers = [_TIME, *_POSITION, *([_LATE] if _LATE in layout.names else [])]
        once, late, cycles = Once(_TIME), Spread((_LATE,)), list[float]()

        def make(rows: Rows) -> Recording:
            rows = once.rows(rows)
            late.add(rows.frame)
            cycles.append(_number(rows.frame[_TIME].diff().median()))
            return Recording(
                robot=_robot(rows.frame),
                clock="uptime",
                rows_are="line",
                rows_read=rows.rows_read,
                set_aside=rows.set_aside,
            )

        def finish(last: Recording) -> Recording:
            facts = {
                "time": "IPOC, milliseconds of the controller",
                "cycle": f"{cycles[0]:g} ms",
                "point": "RIst: the active tool in the base of the RSI configuration, mm",
            }
            said = [*once.warnings(), *_warnings(layout.names, late.most.get(_LATE, 0.0))]
            return replace(last, warnings=tuple(said), facts=facts)

        blocks = read_blocks(path, layout, numbers=numbers, required=[_TIME], any_of=_POSITION)
        yield from in_parts(path, blocks, make, finish)


def _robot(frame: pl.DataFrame) -> pl.DataFrame:
    places = [(pl.col(name) * _MM).alias(f"tcp_{axis}_m") for name, axis in zip(_POSITION, "xyz", strict=True)]
    return conform(frame.select((pl.col(_TIME) * _MS).alias("t_s"), "source_row", *places), ROBOT)


def _warnings(names: tuple[str, ...], late: float) -> list[str]:
    said = ["the speed scaling is not part of RSI and unknown"]
    said += [
        f'column {name!r} is not read here: map it with adapter = "csv" (scaling, scaling_max = 100)'
        for name in names
        if any(override in name.upper() for override in _OVERRIDES)
    ]
    if late:
        said.append(f"the controller counts up to {late:g} late packets: the client was too slow there")
    return said


def _number(value: object) -> float:
    return 0.0 if value is None else float(str(value))


ADAPTER: StreamingAdapter = _KukaRsiCsv()
