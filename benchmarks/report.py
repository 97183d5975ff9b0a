"""Time and size of the report of many executions.

    python benchmarks/report.py --executions 1000 --scene laser-zones

First simulates, ingests and trains (minutes; stored in --work and reused), then writes the page by the command: of the
logs alone, with the evaluation of the model, with two sequences, and with the validation of the cycle times. The time
is that of the whole command, including the start of the interpreter.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from cyclekit.dataset.dataset import Dataset

GOAL_S, GOAL_BYTES = 20.0, 5_000_000
OUT = Console(width=120)


def cyclekit(*words: str | Path) -> tuple[float, float]:
    """Run one command; return its wall time and its processor time, s."""
    began_s, before = time.monotonic(), os.times()
    subprocess.run([sys.executable, "-m", "cyclekit", *map(str, words), "--quiet"], check=True)
    after = os.times()
    spent_s = after.children_user + after.children_system - before.children_user - before.children_system
    return time.monotonic() - began_s, spent_s


def made(work: Path, scene: str, executions: int) -> tuple[Path, Path]:
    """Return dataset and model, made if they do not exist."""
    root = work / f"{scene}-{executions}"
    logs, dataset, model = root / "logs", root / "dataset", root / "model"
    if not dataset.exists():
        cyclekit("simulate", scene, "--executions", str(executions), "--out", logs)
        cyclekit("ingest", logs, "--out", dataset)
    if not model.exists():
        cyclekit("train", dataset, "--out", model)
    return dataset, model


def sequences(dataset: Dataset, file: Path) -> Path:
    """Write two logged orders as sequences."""
    orders = list(dict.fromkeys(each.places for each in dataset.card.executions if each.complete))[:2]
    blocks = []
    for number, places in enumerate(orders, start=1):
        names = ", ".join(f'"{place}"' for place in places)
        blocks.append(f'[[sequence]]\nname = "order {number}"\nplaces = [{names}]\n')
    file.write_text("\n".join(blocks), encoding="utf-8")
    return file


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description="The report of many executions: time and size.")
    parser.add_argument("--executions", type=int, default=1000)
    parser.add_argument("--scene", default="laser-zones")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "cyclekit-report")
    asked = parser.parse_args()
    path, model = made(asked.work, asked.scene, asked.executions)
    dataset = Dataset.open(path)
    file = sequences(dataset, asked.work / "sequences.toml")
    hours = float(dataset.executions["duration_s"].sum()) / 3600
    title = f"{asked.scene}: {dataset.executions.height} executions, {dataset.samples().height} samples, {hours:.1f} h"
    table = Table("page", "wall, s", "CPU, s", "size, MB", f"< {GOAL_S:.0f} s and < 5 MB", title=title)
    judged = ["--model", model]
    asks = {
        "the logs alone": [],
        "and the model, judged": judged,
        "and two sequences": [*judged, "--sequences", file, "--no-check"],
        "and their check": [*judged, "--sequences", file],
    }
    for name, options in asks.items():
        page = asked.work / "report.html"
        wall_s, spent_s = cyclekit("report", path, *options, "--out", page)
        size = page.stat().st_size
        kept = "yes" if wall_s < GOAL_S and size < GOAL_BYTES else "NO"
        table.add_row(name, f"{wall_s:.1f}", f"{spent_s:.1f}", f"{size / 1e6:.2f}", kept)
    OUT.print(table)


if __name__ == "__main__":
    main()
