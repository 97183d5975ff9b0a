"""Overhead of an engine: fixed, per task, and with one or two workers.

    python benchmarks/engine.py --tasks 2000 --cells 8 --executions 20

Every measurement is a separate process, like a command; the engines alternate, so that other load on the machine
affects all. The work is the ingest of `--cells` cells, one per task. `here` runs without workers. Ray starts its own
cluster and, with --address, uses a running one.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from cyclekit.cli import run
from cyclekit.fleet import load_fleet, run_fleet
from cyclekit.parallel.engine import Engine


def measured(what: str, engine: str, jobs: int, address: str | None, folder: str) -> dict[str, float]:
    """Run one measurement in this process; return seconds, for tasks milliseconds per task."""
    begin = time.perf_counter()
    chosen = Engine("ray", jobs, address) if engine == "ray" else Engine(jobs=jobs)
    if what == "ingest":
        file = Path(folder) / f"{engine}-{jobs}-{os.getpid()}.toml"  # the results go to a folder of this name
        file.write_text((Path(folder) / "cells.toml").read_text(encoding="utf-8"), encoding="utf-8")
        rows = run_fleet(load_fleet(file), ["ingest"], engine=chosen).rows
        assert all(row.state == "done" for row in rows)
        return {"s": time.perf_counter() - begin}
    count = int(what)
    assert sorted(done.get() for done in chosen.map(abs, [0, 1])) == [0, 1]  # a task that does nothing
    first_s = time.perf_counter() - begin
    again = time.perf_counter()
    assert len(list(chosen.map(abs, range(count)))) == count
    return {"s": first_s, "ms": 1e3 * (time.perf_counter() - again) / count}


def in_a_process(*words: object) -> dict[str, float]:
    """Run one measurement in a separate process."""
    typed = [sys.executable, __file__, "--measure", json.dumps([str(word) for word in words])]
    done = subprocess.run(typed, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def cells_in(folder: Path, cells: int, executions: int) -> None:
    """Simulate one cell, and write a fleet file that lists it `cells` times."""
    words = ["simulate", "box-picking", "--out", str(folder / "logs"), "--executions", str(executions), "-q"]
    assert run(words) == 0
    entries = [f'[[cell]]\nname = "cell-{number}"\nsources = ["logs"]\n' for number in range(cells)]
    (folder / "cells.toml").write_text("".join(entries), encoding="utf-8")


def main() -> None:
    """Measure, and print one line per engine."""
    parse = argparse.ArgumentParser()
    parse.add_argument("--tasks", type=int, default=2000)
    parse.add_argument("--cells", type=int, default=8)
    parse.add_argument("--executions", type=int, default=20)
    parse.add_argument("--times", type=int, default=3)
    parse.add_argument("--address")
    parse.add_argument("--measure")
    asked = parse.parse_args()
    if asked.measure:
        what, engine, jobs, address, folder = json.loads(asked.measure)
        print(json.dumps(measured(what, engine, int(jobs), None if address == "None" else address, folder)))
        return
    console = Console()
    kinds = [("here", 1, None), ("local", 2, None), ("ray", 1, None), ("ray", 2, None)]
    if asked.address:
        kinds.append(("ray", 2, asked.address))
    table = Table("engine", "workers", "fixed, s", "per task, ms", f"ingest of {asked.cells} cells, s")
    with tempfile.TemporaryDirectory() as name:
        cells_in(Path(name), asked.cells, asked.executions)
        found: dict[object, list[tuple[float, float, float]]] = {kind: [] for kind in kinds}
        for _ in range(asked.times):
            for kind in kinds:
                engine, jobs, address = kind
                tasks = in_a_process(asked.tasks, engine, jobs, address, name)
                ingest = in_a_process("ingest", engine, jobs, address, name)
                found[kind].append((tasks["s"], tasks["ms"], ingest["s"]))
        for (engine, jobs, address), rows in found.items():  # type: ignore[misc]
            middle = [statistics.median(column) for column in zip(*rows, strict=True)]
            table.add_row(engine + (" (running)" if address else ""), str(jobs), *(f"{value:.2f}" for value in middle))
    console.print(table)


if __name__ == "__main__":
    main()
