"""Reads CSV logs polluted by the categories of the Pollock benchmark; counts the outcomes by category.

Each file is a small log of one of eight writers, polluted in one way (tests/reliability/pollute.py), read as by a
command, and compared with the clean log by time. Silently wrong must be 0.

    python benchmarks/pollution.py
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from collections import Counter
from multiprocessing import get_context
from pathlib import Path

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
OUTCOMES = ("right", "right, rows set aside", "refused", "wrong, and said so", "silently wrong", "foreign exception")
_LOCATED = re.compile(r"\bline \d|\bcolumns? |\bheader\b")


def _judge_kind(number: int) -> list[tuple[str, str, str, str, float]]:
    """Return category, outcome, id, reason and seconds of each polluted log of one writer."""
    from reliability.clean_logs import KINDS
    from reliability.judge import judge
    from reliability.pollute import every_polluted_file

    found = []
    with tempfile.TemporaryDirectory() as folder:
        for spoiled in every_polluted_file([KINDS[number]], large_too=True):
            begin = time.perf_counter()
            verdict = judge(spoiled, Path(folder))
            found.append((spoiled.category, verdict.outcome, spoiled.id, verdict.why, time.perf_counter() - begin))
    return found


def main() -> None:
    """Read all polluted logs and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    with get_context("spawn").Pool(parser.parse_args().jobs) as pool:
        found = [one for kind in pool.imap(_judge_kind, range(8)) for one in kind]
    counts = Counter((category, outcome) for category, outcome, *_ in found)
    table = Table("category", "files", *OUTCOMES)
    for category in dict.fromkeys(one[0] for one in found):
        row = [counts[category, outcome] for outcome in OUTCOMES]
        table.add_row(category, str(sum(row)), *map(str, row))
    table.add_row("all", str(len(found)), *(str(sum(1 for one in found if one[1] == name)) for name in OUTCOMES))
    console = Console(width=140)
    console.print(table)
    refused = [one[3] for one in found if one[1] == "refused"]
    located = sum(1 for why in refused if _LOCATED.search(why))
    console.print(f"{located} of {len(refused)} refusals name the line, the columns or the header")
    console.print(f"longest: {max(one[4] for one in found):.1f} s")
    for category, outcome, name, why, _ in found:
        if outcome in OUTCOMES[4:]:
            console.print(f"{outcome}: {category}: {name}: {why[:300]}", markup=False)


if __name__ == "__main__":
    main()
