"""Ingest of a large UR log, compared with the time that polars needs to read the file and to make the 10 Hz table.

    python benchmarks/csv_ingest.py [--rows 830000] [--repeats 3]

The log has 500 rows per second and 71 columns of full-precision doubles, space-delimited, as written by UR's
`record.py`. Ways: polars reading the file; a minimal pipeline (scan, means of 0.1 s, Parquet) of ten columns and of the
22 that `cyclekit convert` knows, each also with `convert`; `cyclekit ingest` without and with checksums. Each run is a
separate process; ways alternate (A B C, A B C), with compiled bytecode, and the first round is discarded. Each way is
measured from start to end of the process, and again without imports (work alone).
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl

HZ, BLOCK = 500, 50_000
READ = "pl.read_csv({log!r}, separator=' ')"
TEN = ["timestamp", *(f"actual_TCP_{kind}_{i}" for kind in ("pose", "speed") for i in range(3))]
TEN += ["speed_scaling", "target_speed_fraction", "runtime_state"]
KNOWN = [*TEN, *(f"actual_{kind}_{i}" for kind in ("q", "qd") for i in range(6))]
SAMPLED = "tcp_x_m,tcp_y_m,tcp_z_m,tcp_speed_m_s,scaling,slider,state"
"""Columns made from those ten: everything about the robot that a sample needs."""
BARE = """
names = {names!r}
log = pl.scan_csv({log!r}, separator=' ').select(names)
log.group_by((pl.col('timestamp') * 10).floor().alias('bin')).mean().sink_parquet({out!r}, compression='zstd')
"""
POLARS_IMPORTS = "import polars as pl"
CYCLEKIT_IMPORTS = """
import sys, numpy.ma, pyarrow.parquet, scipy.spatial, typer._adapters
from cyclekit.cli import app, run
import cyclekit.ingest.convert, cyclekit.ingest.ingest, cyclekit.storage.parquet
from cyclekit.ingest.registry import adapters
adapters(), app()
"""
"""All imports of the commands, as in a program that calls them a second time."""
TIMED = """
import time
began, used = time.perf_counter(), time.process_time()
{work}
print(time.perf_counter() - began, time.process_time() - used)
"""


def write(file: Path, rows: int) -> None:
    """Write the log: a TCP on a circle, a staircase with ramps, noise."""
    rng = np.random.default_rng(0)
    groups = [
        f"{kind}_{name}" for kind in ("target", "actual") for name in ("q", "qd", "current", "TCP_pose", "TCP_speed")
    ]
    with file.open("wb") as log:
        for begin in range(0, rows, BLOCK):
            t = (begin + np.arange(min(BLOCK, rows - begin))) / HZ
            columns = {"timestamp": 100.0 + t}
            for name in groups:
                columns |= {f"{name}_{i}": np.sin(0.7 * t + i) * 0.3 + rng.normal(0, 1e-4, len(t)) for i in range(6)}
            columns["speed_scaling"] = np.clip(np.round(2 + 2 * np.sin(0.2 * t)) / 4, 0, 1)
            columns["target_speed_fraction"] = np.ones(len(t))
            table = pl.DataFrame(columns).with_columns(
                runtime_state=pl.lit(2), safety_mode=pl.lit(1), robot_mode=pl.lit(7),
                **{f"output_double_register_{i}": pl.Series(rng.normal(0, 1, len(t))) for i in range(5)},
            )  # fmt: skip
            table.write_csv(log, include_header=begin == 0, separator=" ")


def run(words: list[str], bytecode: Path) -> tuple[tuple[float, float, float], str]:
    """Return wall time, CPU time (with children), s, and peak memory, MiB, of a process, and its output."""
    around = {**os.environ, "PYTHONPYCACHEPREFIX": str(bytecode), "PYTHONDONTWRITEBYTECODE": ""}
    began = time.perf_counter()
    process = subprocess.Popen(words, stdout=subprocess.PIPE, env=around, text=True)
    said = process.stdout.read() if process.stdout else ""
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"failed: {words}")
    return (time.perf_counter() - began, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024), said


def ways_of(log: str, out: str) -> dict[str, tuple[list[str], str]]:
    """Return by name the command line of each way, and the program that times its work alone."""
    thin = ["convert", log, "--rate", "10", "--quiet", "--out"]
    into = ["ingest", log, "--quiet", "--out"]
    return {
        "polars reads the whole file": by_polars(READ.format(log=log)),
        "bare polars pipeline, 10 Hz, ten columns": by_polars(BARE.format(names=TEN, log=log, out=out + "1")),
        "`cyclekit convert`, 10 Hz, the same ten": by_cyclekit([*thin, out + "2.parquet", "--columns", SAMPLED]),
        "bare polars pipeline, 10 Hz, 22 columns": by_polars(BARE.format(names=KNOWN, log=log, out=out + "3")),
        "`cyclekit convert`, 10 Hz, every column it knows": by_cyclekit([*thin, out + "4.parquet"]),
        "`cyclekit ingest`, no checksums": by_cyclekit([*into, out + "5", "--no-checksums"]),
        "`cyclekit ingest`": by_cyclekit([*into, out + "6"]),
    }


def by_polars(work: str) -> tuple[list[str], str]:
    """Return command line and timing program for lines of polars."""
    return [sys.executable, "-c", f"{POLARS_IMPORTS}\n{work}"], POLARS_IMPORTS + TIMED.format(work=work)


def by_cyclekit(words: list[str]) -> tuple[list[str], str]:
    """Return command line and timing program for a command of cyclekit."""
    work = f"run({words!r}) and sys.exit('failed')"
    return [sys.executable, "-m", "cyclekit", *words], CYCLEKIT_IMPORTS + TIMED.format(work=work)


def main() -> None:
    """Print a table of medians."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("--rows", type=int, default=830_000)
    ask.add_argument("--repeats", type=int, default=3)
    given = ask.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        log, out = str(Path(scratch) / "robot.csv"), str(Path(scratch) / "out")
        write(Path(log), given.rows)
        ways = ways_of(log, out)
        found: dict[str, list[tuple[float, ...]]] = {name: [] for name in ways}
        for turn in range(given.repeats + 1):
            for name, (words, timed) in ways.items():
                whole, _ = run(words, Path(scratch) / "bytecode")
                clear(out)
                _, said = run([sys.executable, "-c", timed], Path(scratch) / "bytecode")
                clear(out)
                found[name] += [(*whole, *map(float, said.split()[-2:]))] if turn else []
        load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
        about = f"{given.rows} rows, median of {given.repeats}, load at the end {load}"
        print(f"{Path(log).stat().st_size / 1e9:.2f} GB, {about}\n")
        print("| way | s | minimum, s | CPU s | peak MiB | work alone, s | minimum, s | CPU s |")
        print("|---|---|---|---|---|---|---|---|")
        for name, each in found.items():
            seconds, cpu, peak, alone, alone_cpu = np.median(np.array(each), axis=0)
            least, least_alone = min(one[0] for one in each), min(one[3] for one in each)
            work = f"{alone:.2f} | {least_alone:.2f} | {alone_cpu:.2f}"
            print(f"| {name} | {seconds:.2f} | {least:.2f} | {cpu:.2f} | {peak:.0f} | {work} |")


def clear(out: str) -> None:
    """Remove the output: an up-to-date dataset would not be made again."""
    for dataset in (out + "5", out + "6"):
        shutil.rmtree(dataset, ignore_errors=True)


if __name__ == "__main__":
    main()
