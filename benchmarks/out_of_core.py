"""Peak memory of training by size of the dataset, in memory and in files, optionally with a limit.

    python benchmarks/out_of_core.py --copies 20 80 320

One simulated dataset is copied `--copies` times into a larger one (each copy a separate session). A model is trained on
it for one epoch, and a sequence estimated, in separate processes: once with everything in memory, once with a limited
number of samples (CYCLEKIT_MEMORY_ROWS). Printed is the peak anonymous memory; the system can reclaim memory of mapped
files. With --limit-mb, a process that needs more data memory fails.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import polars as pl
from rich.console import Console
from rich.table import Table

from cyclekit.api.train import Training, train_at
from cyclekit.cli import run
from cyclekit.learning.networks.spec import ModelSpec

UNDER_A_LIMIT = """
import resource, sys
from cyclekit.cli import main

limit = int(sys.argv[1]) << 20
if limit:
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
if sys.argv[2] != "train":
    main(sys.argv[2:])
from cyclekit.dataset.dataset import Dataset
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import train

train(Dataset.open(sys.argv[3]), ModelSpec.of(epochs=1))
"""


def enlarged(dataset: Path, copies: int, out: Path) -> Path:
    """Write a dataset that contains another one several times, without the recordings."""
    card = json.loads((dataset / "dataset.json").read_text(encoding="utf-8"))
    del card["files"], card["card_blake3"]  # checksums of the original samples
    frame, tasks = pl.read_parquet(dataset / "samples"), pl.read_parquet(dataset / "tasks.parquet")
    (out / "samples").mkdir(parents=True)
    entries = []
    for number in range(copies):
        name = pl.format("c{}.{}", pl.lit(f"{number:04d}"), pl.col("execution"))
        frame.with_columns(execution=name).write_parquet(out / "samples" / f"c{number:04d}.parquet", compression="zstd")
        entries += [
            {**entry, "execution": f"c{number:04d}.{entry['execution']}", "session": f"c{number:04d}"}
            for entry in card["executions"]
        ]
    many = [tasks.with_columns(execution=pl.format("c{}.{}", pl.lit(f"{n:04d}"), "execution")) for n in range(copies)]
    pl.concat(many).write_parquet(out / "tasks.parquet")
    shutil.copy(dataset / "quarantine.parquet", out)
    rows = {"samples": frame.height * copies, "tasks": tasks.height * copies}
    (out / "dataset.json").write_text(json.dumps({**card, "executions": entries, "rows": rows}), encoding="utf-8")
    return out


def peak_mb(words: list[str], rows: int, limit_mb: int) -> tuple[float, float, int]:
    """Run a command line; return its peak anonymous memory (MB), seconds, and exit code."""
    environment = {**os.environ, "CYCLEKIT_MEMORY_ROWS": str(rows)}
    begin, most = time.perf_counter(), 0
    command = subprocess.Popen(
        [sys.executable, "-c", UNDER_A_LIMIT, str(limit_mb), *words],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    while command.poll() is None:
        try:
            status = Path(f"/proc/{command.pid}/status").read_text(encoding="ascii")
        except OSError:
            break
        most = max([most, *(int(line.split()[1]) for line in status.splitlines() if line.startswith("RssAnon"))])
        time.sleep(0.02)
    return most / 1024, time.perf_counter() - begin, command.wait()


def main() -> None:
    """Measure, and print one row per size and way."""
    parse = argparse.ArgumentParser()
    parse.add_argument("--copies", type=int, nargs="+", default=[20, 80])
    parse.add_argument("--executions", type=int, default=40)
    parse.add_argument("--memory-rows", type=int, default=200_000)
    parse.add_argument("--limit-mb", type=int, default=0)
    asked = parse.parse_args()
    table = Table("samples", "Parquet, MB", "way", "exit code", "anonymous memory, MB", "s")
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        logs = ["simulate", "box-picking", "--out", str(work / "logs"), "--executions", str(asked.executions), "-q"]
        assert run(logs) == 0
        assert run(["ingest", str(work / "logs"), "--out", str(work / "one"), "-q"]) == 0
        train_at(Training(str(work / "one"), ModelSpec.of(epochs=2), str(work / "model")))
        places = '["home", "conveyor", "left_1", "conveyor"]'
        (work / "sequence.toml").write_text(f'[[sequence]]\nname = "a"\nplaces = {places}\n', encoding="utf-8")
        for copies in asked.copies:
            dataset = enlarged(work / "one", copies, work / f"times-{copies}")
            samples = json.loads((dataset / "dataset.json").read_text(encoding="utf-8"))["rows"]["samples"]
            parquet_mb = sum(file.stat().st_size for file in dataset.rglob("*.parquet")) / 1e6
            asking = ["estimate", str(work / "model"), str(work / "sequence.toml"), "--dataset", str(dataset), "-q"]
            commands = {
                "train": ["train", str(dataset)],
                "estimate": [*asking, "--no-check", "--out", str(work / "estimate.json")],
            }
            for command, words in commands.items():
                for way, rows in (("in memory", 10**9), ("in files", asked.memory_rows)):
                    most, took_s, code = peak_mb(words, rows, asked.limit_mb)
                    told = [f"{samples:,}", f"{parquet_mb:.0f}", f"{command} {way}", str(code)]
                    table.add_row(*told, f"{most:.0f}", f"{took_s:.0f}")
            shutil.rmtree(dataset)
    Console().print(table)


if __name__ == "__main__":
    main()
