"""Measure the contract: `python -m benchmarks.contract --help`, in the repository's root.

Simulates, ingests, trains and estimates through public functions and writes what came out, beside the truth, as one
JSON. An interrupted run continues: rows that the file has are not measured again. With --compare the exit code is 1 if
a row is worse by more than 0.3 points, the mean by more than 0.05, or the 90 % ranges hold less than 86 or more than
94 % of fresh executions.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from benchmarks.contract.cells import CELLS
from benchmarks.contract.compare import Key, chance_of, error_of, faults, key_of, summary
from benchmarks.contract.measure import row_of
from cyclekit.storage.atomic import write_text

QUICK: list[Key] = [
    ("box-picking", "tracker", 20, 1),
    ("scanner-fields", "signals", 20, 1),
    ("shared-fixture", "signals", 20, 1),
    ("fed-line", "list", 60, 1),
    ("handover", "robot", 20, 1),
    ("waits and rates", "list", 20, 1),
]
"""Rows of the quick contract."""


def wanted_rows() -> list[Key]:
    """Return the rows: each cell and kind with 20 and 60 executions, every third also with 200."""
    pairs: list[tuple[str, str]] = [(name, kind) for name, cell in CELLS.items() for kind in cell.kinds]
    rows = [(*pair, count, 1) for pair in pairs for count in (20, 60)]
    return rows + [(*pair, 200, 1) for pair in pairs[::3]]


def main(words: list[str] | None = None) -> int:
    """Measure, write and compare; return 1 if something is worse than in the file to compare with.

    Args:
        words: Arguments; None = those of the process.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks.contract", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/contract.json"), help="the result")
    parser.add_argument("--work", type=Path, help="folder for logs and truths; default: a temporary one")
    parser.add_argument("--compare", type=Path, help="an earlier result")
    parser.add_argument("--quick", action="store_true", help="a fixed subset, about ten minutes")
    parser.add_argument("--cells", nargs="+", choices=list(CELLS), help="these cells only")
    parser.add_argument("--orders", type=int, default=4, help="orders of each length")
    asked = parser.parse_args(words)
    rows = json.loads(asked.out.read_text(encoding="utf-8")) if asked.out.is_file() else []
    done = {key_of(row) for row in rows}
    wanted = QUICK if asked.quick else wanted_rows()
    wanted = [each for each in wanted if not asked.cells or each[0] in asked.cells]
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        for number, key in enumerate(wanted, 1):
            if key in done:
                continue
            row = row_of(asked.work or Path(temporary), *key, orders=asked.orders)  # type: ignore[arg-type]
            rows.append(row)
            write_text(asked.out, json.dumps(rows, separators=(",", ":")).replace('{"cell"', '\n{"cell"') + "\n")
            told = f"|error| {error_of(row):.2f} %, chance {chance_of(row):.2f} %, {len(row['refused'])} refused"
            print(f"{number} of {len(wanted)}: {', '.join(map(str, key))}: {told}, {row['seconds']}", flush=True)
    measured = [row for row in rows if key_of(row) in set(wanted)]
    print(summary(measured))
    if asked.compare is None:
        return 0
    worse = faults(json.loads(asked.compare.read_text(encoding="utf-8")), measured)
    for fault in worse:
        print(f"worse: {fault}", file=sys.stderr)
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
