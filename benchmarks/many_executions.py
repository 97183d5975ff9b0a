"""Ingest, train and estimate with 100 to 10,000 executions: does the time grow with their number, or with its square?

    python benchmarks/many_executions.py [--executions 100 1000 10000] [--kinds tracker signals]

The executions of `cyclekit_sim.write_short_cycles` take six seconds each. Each command is a separate process on one
thread; processor time counts, as others may use the machine. The slope is that of its logarithm between this row and
the one above: 1 is linear, 2 is the square.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
from csv_ingest import run

from cyclekit_sim import write_short_cycles

SEQUENCE = """[[sequence]]
name = "a"
places = ["place_1", "place_2", "place_3", "place_1"]
"""


def main() -> None:
    """Print the table, row by row."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("--executions", type=int, nargs="+", default=[100, 1000, 10_000])
    ask.add_argument("--kinds", nargs="+", default=["tracker", "signals"])
    given = ask.parse_args()
    os.environ |= {"POLARS_MAX_THREADS": "1", "OMP_NUM_THREADS": "1"}
    commands = ("ingest", "train", "estimate")
    print("| logs | executions |" + "".join(f" {name}, CPU s | slope |" for name in commands))
    print("|---|---|" + "---|---|" * len(commands))
    for kind in given.kinds:
        before: tuple[int, dict[str, float]] | None = None
        for executions in given.executions:
            took_s = seconds(kind, executions)
            cells = f"| {kind} | {executions} |"
            for name in commands:
                ratio = np.nan if before is None else np.log(took_s[name] / before[1][name])
                slope = "" if before is None else f"{ratio / np.log(executions / before[0]):.2f}"
                cells += f" {took_s[name]:.1f} | {slope} |"
            print(cells, flush=True)
            before = executions, took_s


def seconds(kind: str, executions: int) -> dict[str, float]:
    """Return the processor time of each command, s."""
    with tempfile.TemporaryDirectory() as scratch:
        logs, dataset, model, asked = (str(Path(scratch) / name) for name in ("logs", "dataset", "model", "a.toml"))
        Path(logs).mkdir()
        write_short_cycles(Path(logs), executions, kind)
        Path(asked).write_text(SEQUENCE, encoding="utf-8")
        words = {
            "ingest": ["ingest", logs, "--out", dataset],
            "train": ["train", dataset, "--out", model],
            "estimate": ["estimate", model, asked, "--dataset", dataset],
        }
        bytecode = Path(__file__).parent.parent / "build" / "bytecode"
        return {
            name: run([sys.executable, "-m", "cyclekit", *some, "--quiet"], bytecode)[0][1]
            for name, some in words.items()
        }


if __name__ == "__main__":
    main()
