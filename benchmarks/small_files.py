"""Ingest of a folder of very many small logs: time per log, with one process and with two.

    python benchmarks/small_files.py [--files 2000]

Each file is one second of a UR log (125 Hz, `record.py`), on a different day of robot time. The ways alternate, each in
a separate process: only reading the bytes, an ingest with one job and with two, and an ingest that is up to date.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import polars as pl
from csv_ingest import run

HZ = 125
READ = "import sys; from pathlib import Path; print(sum(len(f.read_bytes()) for f in Path(sys.argv[1]).iterdir()))"


def write(folder: Path, files: int) -> None:
    """Write the logs: in each the TCP moves from one place to another and stops."""
    t = np.arange(HZ) / HZ
    way = np.clip(t / 0.6, 0.0, 1.0)
    for number in range(files):
        columns = {"timestamp": 86_400.0 * number + t}
        columns |= {f"actual_q_{i}": way * 0.1 * (i + 1) for i in range(6)}
        columns |= {f"actual_TCP_pose_{i}": way * 0.3 + 0.1 * i for i in range(6)}
        table = pl.DataFrame(columns).with_columns(speed_scaling=1.0, target_speed_fraction=1.0, runtime_state=2)
        table.write_csv(folder / f"run_{number:05d}.csv", separator=" ", float_precision=6)


def main() -> None:
    """Print the table."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("--files", type=int, default=2000)
    files = ask.parse_args().files
    with tempfile.TemporaryDirectory() as scratch:
        logs, out = Path(scratch) / "logs", Path(scratch) / "dataset"
        logs.mkdir()
        write(logs, files)
        ingest = [sys.executable, "-m", "cyclekit", "ingest", str(logs), "--out", str(out), "--quiet"]
        ways = {
            "bytes read, nothing else": [sys.executable, "-c", READ, str(logs)],
            "ingest, one job": ingest,
            "ingest again, all is there": ingest,
            "ingest, two jobs": [*ingest, "--jobs", "2"],
        }
        size = sum(file.stat().st_size for file in logs.iterdir())
        print(f"{files} files, {size / 1e6:.0f} MB\n\n| way | s | CPU s | CPU ms per file | peak MiB |")
        print("|---|---|---|---|---|")
        for name, words in ways.items():
            if "jobs" in name:
                shutil.rmtree(out)
            (seconds, cpu, peak), _ = run(words, Path(scratch) / "bytecode")
            print(f"| {name} | {seconds:.1f} | {cpu:.1f} | {1e3 * cpu / files:.2f} | {peak:.0f} |", flush=True)


if __name__ == "__main__":
    main()
