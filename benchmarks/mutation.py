"""Reads logs with random damage; prints the outcomes by adapter.

Logs of every kind written by the tests, and those in the folder CYCLEKIT_SAMPLES. Only cyclekit's errors may be raised,
and no reading may take longer than 20 s.

    python benchmarks/mutation.py --each 120
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import sys
import tempfile
import zlib
from collections import Counter
from multiprocessing import get_context
from pathlib import Path

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
OUTCOMES = ("read", "read, rows set aside", "refused", "foreign exception")
Found = tuple[str, str, str, float, str, int]


def _of_log(task: tuple[str, str, dict[str, bytes], object, int]) -> list[Found]:
    """Return adapter, outcome, damage, seconds, reason and peak MiB for each mutant of one log."""
    from reliability.mutate import mutants
    from reliability.reading import read_log

    name, adapter, files, options, count = task
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for file, data in files.items():
            for at, (harm, harmed) in enumerate(
                mutants(data, zlib.crc32(f"{name}{file}".encode()), count // len(files))
            ):
                place = Path(folder) / "log"
                place.mkdir()
                for other, whole in files.items():
                    (place / other).write_bytes(harmed if other == file else whole)
                result = read_log(place / file if len(files) == 1 else place, adapter, options)  # type: ignore[arg-type]
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
                found.append(
                    (adapter, result.outcome, f"{name}/{file} #{at}: {harm}", result.seconds, result.why, peak)
                )
                shutil.rmtree(place)
    return found


def tasks(folder: Path, each: int) -> list[tuple[str, str, dict[str, bytes], object, int]]:
    """Return the logs to damage: those of the tests, and the samples if they exist."""
    from reliability.own_logs import own_logs

    from cyclekit.adapter import ReadOptions
    from cyclekit.ingest.registry import find_logs

    found = [(log.name, log.adapter, log.files, log.options, each) for log in own_logs(folder)]
    samples = os.environ.get("CYCLEKIT_SAMPLES")
    for path, reader in find_logs(Path(samples)) if samples else []:
        if path.suffix == ".md":
            continue
        files = {path.name: path.read_bytes()} if path.is_file() else {f.name: f.read_bytes() for f in path.iterdir()}
        adapter = reader.name if reader else {".bag": "rosbag", ".json": "zed"}.get(path.suffix, "ur-nist")
        options = ReadOptions(rate_hz=100.0) if adapter == "pose-rows" else ReadOptions()
        found.append((f"sample {path.name}", adapter, files, options, each))
    return found


def main() -> None:
    """Damage and read the logs, print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=120, help="mutants of each log")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--only", default="", help="part of the name of a log or an adapter")
    words = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        wanted = [task for task in tasks(Path(folder), words.each) if words.only in f"{task[0]} {task[1]}"]
    with get_context("spawn").Pool(words.jobs, maxtasksperchild=1) as pool:
        found = [one for log in pool.imap_unordered(_of_log, wanted, chunksize=1) for one in log]
    table = Table("adapter", "mutants", *OUTCOMES, "longest, s", "peak, MiB")
    for adapter in [*sorted({one[0] for one in found}), ""]:
        mine = [one for one in found if one[0] == adapter or not adapter]
        counts = Counter(one[1] for one in mine)
        row = [len(mine), *(counts[name] for name in OUTCOMES), f"{max(one[3] for one in mine):.1f}"]
        table.add_row(adapter or "all", *map(str, row), str(max(one[5] for one in mine)))
    console = Console(width=140)
    console.print(table)
    for _, outcome, harm, seconds, why, _ in found:
        if outcome == "foreign exception" or seconds > 20.0:
            console.print(f"\n{harm} ({seconds:.1f} s)\n{why}", markup=False)


if __name__ == "__main__":
    main()
