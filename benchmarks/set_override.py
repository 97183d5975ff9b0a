"""A set override that a program moves with people, and one that a hand turns: is either taken for the other?

Cells of existing scenes, twenty of each kind, as logs of a UR robot. In the first kind `target_speed_fraction` holds
the safety function (zones, a staircase or a line over the distance; a tracker or signals show people), in some cells
times a slider that a hand turned. In the second kind a hand turns the slider: once per execution, per shift, rarely or
at random times; beside a safety function in `speed_scaling`, or without one.

    python benchmarks/set_override.py --work DIR
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import MixedCauses, SimulationOptions, simulate
from cyclekit_sim.rules import Line, Rule

HAND = MixedCauses(None, 0.0, 0, 0.0, None, limit=None, wait_share=0.0, part_signal=False, pauses_per_hour=0.0,
                   stops_per_hour=0.0)  # fmt: skip
SLOW = {"ramp_up_per_s": 0.1, "ramp_down_per_s": 1.0, "latency_s": 0.2}


class SetCell(NamedTuple):
    """A cell: its scene, whether a program moves its slider with people, how a hand turns it, and other options."""

    scene: str
    moved: bool
    every: int = 0
    per_hour: float = 0.0
    options: Mapping[str, Any] = MappingProxyType({})
    executions: int = 20

    @property
    def truth(self) -> str:
        """`people`, `hand` or `both`."""
        by_hand = bool(self.every or self.per_hour)
        return ("both" if by_hand else "people") if self.moved else "hand"


def _line(near_m: float, far_m: float) -> dict[str, Any]:
    return {"rule": Rule(line=Line(near_m, far_m))}


MOVED = (
    SetCell("box-picking", True),
    SetCell("box-picking", True, options={"delta_m": 0.05}),
    SetCell("box-picking", True, options=SLOW),
    SetCell("box-picking", True, options=_line(0.8, 2.4)),
    SetCell("box-picking", True, options=_line(1.0, 2.0) | SLOW),
    SetCell("box-picking", True, options={"people": "signals"}),
    SetCell("laser-zones", True),
    SetCell("laser-zones", True, options=SLOW | {"delta_m": 0.03}),
    SetCell("scanner-fields", True, options=SLOW),
    SetCell("laser-zones", True, options=_line(0.5, 1.8)),
    SetCell("pick-and-package", True),
    SetCell("pick-and-package", True, options=_line(0.5, 1.5) | {"delta_m": 0.02}),
    SetCell("pick-and-package", True, options={"people": "signals"}),
    SetCell("scanner-fields", True),
    SetCell("scanner-visits", True),
    SetCell("box-picking", True, every=1),
    SetCell("box-picking", True, every=10, options=_line(0.8, 2.4)),
    SetCell("box-picking", True, every=5, options={"people": "signals"}),
    SetCell("pick-and-package", True, per_hour=10.0),
    SetCell("scanner-fields", True, per_hour=6.0),
)
TURNED = (
    SetCell("box-picking", False, every=1),
    SetCell("box-picking", False, every=1, options={"people": "signals"}),
    SetCell("box-picking", False, every=5),
    SetCell("box-picking", False, every=10, options=SLOW),
    SetCell("box-picking", False, every=2, options=_line(0.8, 2.4)),
    SetCell("box-picking", False, every=3, options={"rule": Rule(line=Line(0.01, 0.02))}),
    SetCell("laser-zones", False, every=1),
    SetCell("scanner-fields", False, every=2),
    SetCell("box-picking", False, every=5, options={"people": "signals"}),
    SetCell("laser-zones", False, every=10),
    SetCell("laser-zones", False, per_hour=60.0),
    SetCell("laser-zones", False, every=2, options={"rule": Rule(line=Line(0.01, 0.02))}),
    SetCell("pick-and-package", False, every=1),
    SetCell("pick-and-package", False, per_hour=4.0),
    SetCell("pick-and-package", False, per_hour=30.0),
    SetCell("pick-and-package", False, per_hour=10.0, options={"people": "signals"}),
    SetCell("scanner-fields", False, every=1),
    SetCell("scanner-fields", False, every=5),
    SetCell("scanner-visits", False, per_hour=20.0),
    SetCell("scanner-visits", False, every=4),
)


def logs_of(cell: SetCell, out: Path, *, seed: int) -> Path:
    """Simulate a cell; a hand sets the slider to 30 to 100 %."""
    by_hand = replace(HAND, slider=0.3, slider_every=cell.every, slider_turns_per_hour=cell.per_hour)
    causes = by_hand if cell.every or cell.per_hour else None
    settings: dict[str, Any] = {"executions_per_session": 10} | dict(cell.options)
    options = SimulationOptions(moves_slider=cell.moved, causes=causes, **settings)
    return simulate(cell.scene, out, executions=cell.executions, seed=seed, options=options)


def found_of(dataset: Dataset) -> tuple[str, dict[str, Any]]:
    """Return who moved the slider as the dataset says it, and the numbers of its note."""
    told = {one.code: one.values for one in dataset.card.warnings if one.code.startswith("override-")}
    if "override-unknown" in told:
        return "unknown", dict(told["override-unknown"])
    if "override-moved" not in told:
        return "hand", {}
    return ("both" if told["override-moved"]["sliders"] else "people"), dict(told["override-moved"])


def main() -> None:
    """Print a row for each cell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    asked = parser.parse_args()
    table = Table("cell", "scene", "moved by", "found", "changes explained", "changes per hour")
    for kind, cells in (("moved", MOVED), ("turned", TURNED)):
        for number, cell in enumerate(cells):
            name = f"{kind}{number:02d}"
            logs, out = asked.work / "cells" / name, asked.work / f"{name}-dataset"
            if not logs.exists():
                logs_of(cell, logs, seed=500 + number)
            shutil.rmtree(out, ignore_errors=True)
            ingest([logs], out)
            found, values = found_of(Dataset.open(out))
            share = f"{values['share']:.0%}" if "share" in values else "-"
            rate = f"{values['turns'] / values['hours']:.0f}" if values else "-"
            print(name, cell.scene, cell.truth, found, share, rate, sep=" | ", flush=True)
            table.add_row(name, cell.scene, cell.truth, found, share, rate)
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
