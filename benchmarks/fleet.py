"""Runs `cyclekit fleet all` on many simulated cells and measures the memory of the driver.

    python benchmarks/fleet.py --cells 100 --executions 20 --jobs 2

Every cell is simulated with its own seed, or only the first --distinct of them. The resident memory of the command's
first process (the driver) and of all its processes is read twenty times per second. Run it with fewer and with more
cells: the driver's memory must not grow.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from cyclekit.cli import run


def cells_in(folder: Path, count: int, executions: int, epochs: int, distinct: int) -> Path:
    """Simulate the missing cells, and write the fleet file."""
    text = f'[fleet]\nname = "Benchmark"\nout = "out-{count}"\n' + (f"epochs = {epochs}\n" if epochs else "")
    for number in range(count):
        name, logs = f"cell-{number:03d}", f"logs/cell-{number % (distinct or count):03d}"
        if not (folder / logs / "cell.toml").is_file():
            words = ["simulate", "box-picking", "--out", str(folder / logs), "--seed", str(number), "-q"]
            assert run([*words, "--executions", str(executions)]) == 0
        text += f'[[cell]]\nname = "{name}"\nsources = ["{logs}"]\n'
    file = folder / f"fleet-{count}.toml"
    file.write_text(text, encoding="utf-8")
    return file


def memory_mb(process: int) -> float:
    """Return the resident memory of a process, MB; 0 if it has ended."""
    try:
        status = Path(f"/proc/{process}/status").read_text(encoding="ascii")
    except OSError:
        return 0.0
    lines = [line for line in status.splitlines() if line.startswith("VmRSS")]
    return int(lines[0].split()[1]) / 1024 if lines else 0.0


def children_of(process: int) -> list[int]:
    """Return the child processes of a process."""
    try:
        return [int(word) for word in Path(f"/proc/{process}/task/{process}/children").read_text().split()]
    except OSError:
        return []


def main() -> None:
    """Run the command and print its time and memory."""
    parse = argparse.ArgumentParser()
    parse.add_argument("--cells", type=int, default=8)
    parse.add_argument("--executions", type=int, default=20)
    parse.add_argument("--distinct", type=int, default=0, help="Number of simulated cells; the others use their logs.")
    parse.add_argument("--epochs", type=int, default=0, help="Epochs per training; 0 = by the number of rows.")
    parse.add_argument("--jobs", type=int, default=2)
    parse.add_argument("--engine", default="local")
    parse.add_argument("--work", type=Path, help="Folder for the cells.")
    asked = parse.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work = asked.work or Path(temporary)
        file = cells_in(work, asked.cells, asked.executions, asked.epochs, asked.distinct)
        logs_mb = sum(f.stat().st_size for f in (work / "logs").rglob("*") if f.is_file()) / 1e6
        words = ["fleet", "all", str(file), "--jobs", str(asked.jobs), "--engine", asked.engine]
        begin, driver_mb, all_mb = time.perf_counter(), list[float](), 0.0
        command = subprocess.Popen([sys.executable, "-m", "cyclekit", *words])
        while command.poll() is None:
            driver_mb.append(memory_mb(command.pid))
            all_mb = max(all_mb, driver_mb[-1] + sum(memory_mb(child) for child in children_of(command.pid)))
            time.sleep(0.05)
        took_s = time.perf_counter() - begin
        tenth = max(len(driver_mb) // 10, 1)
        print(
            f"{asked.cells} cells of {asked.executions} executions, logs {logs_mb:.0f} MB, {asked.jobs} {asked.engine}"
        )
        print(f"exit code {command.returncode}, {took_s:.0f} s, {took_s / asked.cells:.1f} s per cell")
        print(f"driver: {max(driver_mb[: 2 * tenth]):.0f} MB in the first fifth, {max(driver_mb):.0f} MB at most")
        print(f"driver and its workers: {all_mb:.0f} MB at most")


if __name__ == "__main__":
    main()
