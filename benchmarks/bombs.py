"""Ingests files made to break a reader (tests/reliability/bombs.py) with 1.5 GiB of memory; prints result and time.

python benchmarks/bombs.py
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))


def main() -> None:
    """Make and ingest the files, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="part of the name of a bomb")
    parser.add_argument("--quick", action="store_true", help="without those that take tens of seconds")
    words = parser.parse_args()
    from reliability.bombs import BOMBS, SLOW
    from reliability.hostile import context, ingest_hostile

    table, fresh = Table("bomb", "result", "s", "peak, MiB", "fault"), context()
    for name, make in BOMBS.items():
        if words.only in name and not (words.quick and name in SLOW):
            outcome = ingest_hostile(make, fresh, limit_s=120.0)
            said = "a dataset" if outcome.code == 0 else outcome.said.strip().partition("\n")[0][-90:]
            table.add_row(name, said, f"{outcome.seconds:.1f}", str(outcome.peak_mib), outcome.fault or "none")
    Console(width=180).print(table)


if __name__ == "__main__":
    main()
