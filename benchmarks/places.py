"""Tasks lost or invented in `scanner-visits`: override logged or not, places named or not, cell shifted and turned.

    python benchmarks/places.py --executions 25

Each row simulates the cell again. A true task is lost if the dataset has no task with these places at its index in the
execution; the converse is an invented task. Unnamed places are matched by their positions.
"""

from __future__ import annotations

import argparse
import dataclasses
import difflib
import tempfile
from pathlib import Path

import numpy as np
import polars as pl
from any_length import HARD, SCENE
from rich.console import Console
from rich.table import Table

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import simulate
from cyclekit_sim.scenes import BUILT_IN

OUT = Console(width=120)


def moved(shift_m: float, turn_deg: float) -> None:
    """Move the scene in BUILT_IN: shift it along all axes, and turn it about the robot's base."""
    scene = ORIGINAL
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))

    def at(p: tuple[float, float, float]) -> tuple[float, float, float]:
        return (c * p[0] - s * p[1] + shift_m, s * p[0] + c * p[1] + shift_m, p[2] + shift_m)

    BUILT_IN[SCENE] = dataclasses.replace(scene, places={name: at(xyz) for name, xyz in scene.places.items()})


ORIGINAL = BUILT_IN[SCENE]


def counted(work: Path, executions: int, seed: int, *, logged: bool, named: bool) -> tuple[int, int, int]:
    """Return the numbers of true tasks, of lost and of invented ones."""
    options = dataclasses.replace(HARD, log_override=logged, log_outputs=False, encoder_noise_rad=2e-5)
    simulate(SCENE, work / "logs", executions=executions, seed=seed, options=options)
    cell = work / "logs" / "cell.toml"
    if not named:
        text = cell.read_text(encoding="utf-8").split("\n[places.")[0] + "\n"
        cell.write_text(text, encoding="utf-8")
    dataset = Dataset.open(ingest([work / "logs"], work / "dataset").dataset)
    truth = pl.read_parquet(work / "logs" / "truth" / "executions.parquet")
    where = {name: np.array(xyz) for name, xyz in BUILT_IN[SCENE].places.items()}
    names = {
        name: min(where, key=lambda known: float(np.linalg.norm(where[known] - np.array(place.xyz_m))))
        for name, place in dataset.places.items()
    }
    found = {entry.session: [names[p] for p in entry.places] for entry in dataset.card.executions}
    total = lost = invented = 0
    for session, sequence in truth.select("session", "sequence").iter_rows():
        true, seen = sequence.split(","), found.get(session, [])
        total += len(true) - 1
        for kind, a, b, c, d in difflib.SequenceMatcher(None, true, seen, autojunk=False).get_opcodes():
            if kind != "equal":
                lost, invented = lost + b - a, invented + d - c
    return total, lost, invented


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--executions", type=int, default=25)
    parser.add_argument("--seed", type=int, default=5)
    asked = parser.parse_args()
    table = Table("shift, mm", "turn, deg", "override", "places", "tasks", "lost", "invented")
    for shift, turn in ((0.0, 0.0), (3.3e-3, 0.0), (5e-3, 0.0), (0.0, 30.0)):
        moved(shift, turn)
        for logged in (True, False):
            for named in (True, False):
                with tempfile.TemporaryDirectory() as folder:
                    counts = counted(Path(folder), asked.executions, asked.seed, logged=logged, named=named)
                row = [
                    f"{1e3 * shift:g}",
                    f"{turn:g}",
                    "logged" if logged else "inferred",
                    "named" if named else "found",
                ]
                table.add_row(*row, *map(str, counts))
    OUT.print(table)


if __name__ == "__main__":
    main()
