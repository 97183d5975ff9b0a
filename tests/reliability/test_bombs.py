"""Files made to break a reader are ingested, each for real: a dataset or one message, soon, within 1.5 GiB.

`benchmarks/bombs.py` does the same with all of them; here are those that take little time.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import pytest

if sys.platform != "linux":
    pytest.skip("memory is limited and measured by Linux", allow_module_level=True)

from reliability.bombs import BOMBS
from reliability.hostile import MEMORY_MIB, Outcome, context, ingest_hostile

if TYPE_CHECKING:
    from pathlib import Path

QUICK = (
    pytest.param("mcap of 262 kB with a chunk of 8 GiB", marks=pytest.mark.slow),
    "mcap whose sizes are 2**63",
    "ROS 1 bag whose every length is 4 GiB",
    "db3 whose header says 2**31 pages",
    "metadata.yaml that names itself a billion times",
    pytest.param("gzip CSV of 2 GiB without a line end", marks=pytest.mark.slow),
    "workbook with a cell in the last row and column",
    pytest.param("workbook of a few kB with a sheet of 1 GB", marks=pytest.mark.slow),
    "17,000 columns",
    pytest.param("1,000,000 columns", marks=pytest.mark.slow),
    pytest.param("header line of 100 MB", marks=pytest.mark.slow),
    pytest.param("line of 1 GB of NULs below a header", marks=pytest.mark.slow),
    "C3D that announces 10**9 frames of 65,535 points",
    "JSON nested 100,000 deep",
    "JSON with numbers of a million digits",
    "log whose time jumps ahead by 300 years",
    "people seen once in 300 years",
    "cell file nested 100,000 deep",
    "folder with links in circles",
    "folder with a pipe, a socket and devices",
    "device named as the log",
    "names that are no text",
)


@pytest.fixture(scope="module")
def fresh() -> Any:
    return context()


@pytest.mark.parametrize("name", QUICK)
def test_a_bomb_is_ingested_or_refused_within_its_memory(name: str, fresh: Any):
    outcome = ingest_hostile(BOMBS[name], fresh)
    assert outcome.fault == "", outcome


def test_a_bomb_that_goes_off_would_be_noticed(fresh: Any, monkeypatch: pytest.MonkeyPatch):
    def no_bomb(folder: Path) -> Path:
        return BOMBS["17,000 columns"](folder)

    assert ingest_hostile(no_bomb, fresh, limit_s=0.001).fault.startswith("no end")
    monkeypatch.setattr("reliability.hostile.MEMORY_MIB", 10)
    assert ingest_hostile(no_bomb, fresh).fault.endswith("MiB")
    assert Outcome(1, "Traceback (most recent call last)", 1.0, 100).fault
    assert Outcome(1, "error: a\nerror: b", 1.0, 100).fault
    assert Outcome(0, "", 1.0, MEMORY_MIB + 1).fault
