"""Small logs as one writer each writes them, in parts that a polluter can take apart: names, rows, delimiter, ends.

Every row is different and so is every value in it, so that a shifted column or a row of another time cannot look right.
The expected tables are not taken from the adapters: `test_pollution` holds them against the cells written here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING

from cyclekit.adapter import ReadOptions

if TYPE_CHECKING:
    from collections.abc import Callable

    from cyclekit.adapter import Adapter

Cells = list[str]
ROWS = 40


@dataclass(frozen=True)
class Kind:
    """What one writer writes, and who reads it.

    Attributes:
        name: Of the writer.
        module: Of the adapter.
        names: Header cells.
        rows: Data cells.
        delimiter: Between cells.
        end: Of a line.
        above: Lines above the names.
        role: Which table of the recording it fills.
        map: Mapping of a CSV of one's own.
        texts: Indices of columns of text.
        decimal_comma: Numbers are written `0,5`.
        time: Index of the column that a row is known by.
        measured: Index of a column of numbers that is read.
    """

    name: str
    module: str
    names: Cells
    rows: list[Cells]
    delimiter: str
    end: str = "\n"
    above: tuple[str, ...] = ()
    role: str = "robot"
    map: dict[str, object] = field(default_factory=dict)
    texts: tuple[int, ...] = ()
    decimal_comma: bool = False
    time: int = 0
    measured: int = 0

    @property
    def adapter(self) -> Adapter:
        return import_module(f"cyclekit_adapters.formats.{self.module}").ADAPTER

    @property
    def is_mapped(self) -> bool:
        return bool(self.map)

    def options(self, **changed: object) -> ReadOptions:
        """Return what the cell file says of this log; keys given replace those of its map."""
        role = self.role if self.is_mapped else None
        mapping = {key: value for key, value in (self.map | changed).items() if value is not None}
        return ReadOptions(role=role, map=mapping if self.is_mapped else {})

    def line(self, cells: Cells) -> str:
        """Return the cells of one row, quoted where they must be."""
        special = (self.delimiter, '"', "\n")
        quoted = [f'"{c.replace(chr(34), chr(34) * 2)}"' if any(s in c for s in special) else c for c in cells]
        return self.delimiter.join(quoted)

    def text(self, rows: list[Cells] | None = None, names: Cells | None = None) -> str:
        """Return the whole log, as the writer writes it."""
        body = [self.line(cells) for cells in (self.rows if rows is None else rows)]
        return "".join(line + self.end for line in [*self.above, self.line(names or self.names), *body])

    def number(self, value: float) -> str:
        text = f"{value:.6f}"
        return text.replace(".", ",") if self.decimal_comma else text

    def more(self, count: int) -> list[Cells]:
        """Return a longer log of this kind: its rows again and again, each at a later time."""
        return _MAKERS[self.name](count).rows


def _value(row: int, column: int) -> float:
    return 0.5 * math.sin(0.02 * row + column) + 0.001 * column


def _ur(name: str, delimiter: str, count: int) -> Kind:
    groups = [(f"actual_q_{i}", i) for i in range(6)] + [(f"actual_TCP_pose_{i}", 10 + i) for i in range(6)]
    groups += [(f"actual_TCP_speed_{i}", 20 + i) for i in range(3)]
    names = ["timestamp", *(cell for cell, _ in groups), "speed_scaling", "target_speed_fraction", "runtime_state"]
    rows = [
        [f"{152.512 + row * 0.008:.6f}", *(f"{_value(row, k):.7f}" for _, k in groups), f"{row % 5 / 4}", "1.0", "2"]
        for row in range(count)
    ]
    return Kind(name, "ur_rtde", names, rows, delimiter, "\r\n", measured=8)


def _robot(count: int) -> Kind:
    names = ["t [ms]", "X [mm]", "Y [mm]", "Z [mm]", "J1 [°]", "OVR [%]", "Q1 [µV]"]
    mapping = {"time": "t [ms]", "time_unit": "ms", "x": "X [mm]", "y": "Y [mm]", "z": "Z [mm]", "length_unit": "mm"}
    mapping |= {"joints": ["J1 [°]"], "joint_unit": "deg", "scaling": "OVR [%]", "scaling_max": 100}
    mapping |= {"decimal": ",", "clock": "uptime"}
    rows = [
        [
            str(5000 + 8 * row),
            *(f"{1000 * _value(row, k):.3f}".replace(".", ",") for k in (1, 2, 3)),
            f"{90 * _value(row, 4):.4f}".replace(".", ","),
            str(25 * (row % 5)),
            f"{_value(row, 5):.2f}".replace(".", ","),
        ]
        for row in range(count)
    ]
    return Kind("robot-csv", "mapped_csv", names, rows, ";", "\r\n", map=mapping, decimal_comma=True, measured=2)


def _people(count: int) -> Kind:
    mapping = {"time": "t", "person": "id", "x": "x", "y": "y", "z": "z", "clock": "epoch"}
    rows = [
        [f"{1.7e9 + row // 2 / 30:.4f}", ("ann", "bo")[row % 2], *(f"{_value(row, k):.5f}" for k in (1, 2, 3))]
        for row in range(count)
    ]
    names = ["t", "id", "x", "y", "z"]
    return Kind("people-csv", "mapped_csv", names, rows, ",", role="people", map=mapping, texts=(1,), measured=3)


def _dated(count: int) -> Kind:
    mapping = {"time": ["date", "clock"], "time_format": "%d.%m.%Y %H:%M:%S%.f", "time_zone": "Europe/Rome"}
    mapping |= {"x": "east", "y": "north"}
    rows = []
    for row in range(count):
        minutes, ms = divmod(50 * row, 60_000)
        clock = f"{8 + minutes // 60:02d}:{minutes % 60:02d}:{ms // 1000:02d}.{ms % 1000:03d}"
        rows.append(["06.03.2025", clock, f"{_value(row, 1):.4f}", f"{_value(row, 2):.4f}", str(row % 3)])
    names = ["date", "clock", "east", "north", "quality"]
    return Kind("people-dated", "mapped_csv", names, rows, "\t", role="people", map=mapping, time=1, measured=3)


def _events(count: int) -> Kind:
    mapping = {"time": "time", "signal": "signal", "value": "value"}
    words = ("goal", "door", "start", "light curtain")
    rows = [[f"{10 + 0.75 * row:.3f}", words[row % 4], f"shelf {row}"] for row in range(count)]
    names = ["time", "signal", "value"]
    return Kind("events-csv", "mapped_csv", names, rows, ",", role="events", map=mapping, texts=(1, 2))


def _kuka(count: int) -> Kind:
    names = ["Timestamp", "X_RIst", "Y_RIst", "Z_RIst", "A_RIst", "Delay", "IPOC"]
    rows = [
        [
            "12:00:01",
            *(f"{1000 * _value(row, k):.3f}" for k in (1, 2, 3)),
            f"{90 * _value(row, 4):.3f}",
            "0",
            str(77000 + 4 * row),
        ]
        for row in range(count)
    ]
    return Kind("kuka", "kuka_rsi", names, rows, ",", time=6, measured=2)


def _motive(count: int) -> Kind:
    about = {"Format Version": "1.23", "Take Name": "morning", "Capture Frame Rate": "100.000000"}
    about |= {"Export Frame Rate": "100.000000", "Total Exported Frames": str(count), "Rotation Type": "Quaternion"}
    about |= {"Length Units": "Meters", "Coordinate Space": "Global"}
    above = (
        ",".join(f"{key},{value}" for key, value in about.items()),
        "",
        ",Type" + ",Rigid Body" * 7,
        ",Name" + ",Operator" * 7,
        ",ID" + ',"6D79"' * 7,
        "," + ",Rotation" * 4 + ",Position" * 3,
    )
    rows = [
        [str(row), f"{row / 100:.6f}", "0.1", "0.2", "0.3", "0.9", *(f"{_value(row, k):.6f}" for k in (1, 2, 3))]
        for row in range(count)
    ]
    names = ["Frame", "Time (Seconds)", "X", "Y", "Z", "W", "X", "Y", "Z"]
    return Kind("motive", "motive", names, rows, ",", "\r\n", above, role="people", time=1, measured=7)


_MAKERS: dict[str, Callable[[int], Kind]] = {
    "ur-space": lambda count: _ur("ur-space", " ", count),
    "ur-comma": lambda count: _ur("ur-comma", ",", count),
    "robot-csv": _robot,
    "people-csv": _people,
    "people-dated": _dated,
    "events-csv": _events,
    "kuka": _kuka,
    "motive": _motive,
}


KINDS = [make(ROWS) for make in _MAKERS.values()]
