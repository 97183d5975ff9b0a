"""KUKA: CSV of RSI values (`X_RIst`, `Y_RIst`, `Z_RIst`, `IPOC`), as people's RSI clients write it.

RSI itself is a stream and has no file format, so the columns are those of the client; the names of the values are
KUKA's. `RIst` is where the robot is (mm, base chosen in the RSI configuration), `RSol` only the set point of the next
cycle. The clock is `IPOC`, the controller's count of milliseconds; a `Timestamp` beside it is the PC's and often has
whole seconds only. RSI does not carry the override: it stays unknown.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import MissingColumns, UnknownName
from cyclekit.schema import ROBOT, conform
from cyclekit_adapters.controller_time import clock_warnings, once
from cyclekit_adapters.delimited import read_rows
from cyclekit_adapters.header_line import column_names, layout_below

if TYPE_CHECKING:
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
        for key in options.map:
            cure = 'Columns of your own are mapped with adapter = "csv".'
            raise UnknownName("[sources.map] of a KUKA RSI log", "key", key, [], cure=cure)
        layout = layout_below(path)
        if missing := {_TIME, *_POSITION}.difference(layout.names):
            raise MissingColumns(
                path, missing, layout.names, "Let the RSI client write RIst and IPOC, and record again."
            )
        numbers = [_TIME, *_POSITION, *([_LATE] if _LATE in layout.names else [])]
        rows, repeated = once(read_rows(path, layout, numbers=numbers, required=[_TIME]).or_refuse(path), _TIME)
        return Recording(
            robot=_robot(rows.frame),
            clock="uptime",
            rows_read=rows.rows_read,
            set_aside=rows.set_aside,
            warnings=tuple(_warnings(rows.frame, layout.names, repeated)),
            facts={
                "time": "IPOC, milliseconds of the controller",
                "cycle": f"{_number(rows.frame[_TIME].diff().median()):g} ms",
                "point": "RIst: the active tool in the base of the RSI configuration, mm",
            },
        )


def _robot(frame: pl.DataFrame) -> pl.DataFrame:
    places = [(pl.col(name) * _MM).alias(f"tcp_{axis}_m") for name, axis in zip(_POSITION, "xyz", strict=True)]
    return conform(frame.select((pl.col(_TIME) * _MS).alias("t_s"), "source_row", *places), ROBOT)


def _warnings(frame: pl.DataFrame, names: tuple[str, ...], repeated: int) -> list[str]:
    said = [*clock_warnings(frame[_TIME], repeated), "the speed scaling is not part of RSI and unknown"]
    said += [
        f'column {name!r} is not read here: map it with adapter = "csv" (scaling, scaling_max = 100)'
        for name in names
        if any(override in name.upper() for override in _OVERRIDES)
    ]
    if _LATE in frame.columns and (late := _number(frame[_LATE].max())):
        said.append(f"the controller counts up to {late:g} late packets: the client was too slow there")
    return said


def _number(value: object) -> float:
    return 0.0 if value is None else float(str(value))


ADAPTER: Adapter = _KukaRsiCsv()
