"""The cost of an ingest grows with the number of executions, not with its square; the progress that it tells holds."""

from __future__ import annotations

import sys
from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest

from cyclekit.ingest.ingest import ingest
from cyclekit_sim import write_short_cycles

if TYPE_CHECKING:
    from pathlib import Path

FEW, TIMES = 30, 3


def _ingested(folder: Path, executions: int, kind: str) -> tuple[Counter[str], list[tuple[int, float]]]:
    """Return how often each function of Python was called, and the fraction told after how many calls."""
    logs, calls, told = folder / f"{executions}", Counter[str](), list[tuple[int, float]]()
    logs.mkdir()
    write_short_cycles(logs, executions, kind)

    def count(frame: Any, event: str, _: object) -> None:
        if event == "call":
            calls[f"{frame.f_code.co_filename}:{frame.f_code.co_qualname}"] += 1

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        ingest(logs, folder / f"{executions}.dataset", progress=lambda done, _: told.append((calls.total(), done)))
    finally:
        sys.setprofile(before)
    return calls, told


@pytest.mark.parametrize("kind", ["tracker", "signals"])
def test_calls_grow_with_the_executions_and_the_remaining_time_told_holds(tmp_path: Path, kind: str) -> None:
    few, _ = _ingested(tmp_path, FEW, kind)
    many, told = _ingested(tmp_path, FEW * TIMES, kind)
    square = {
        name: (few[name], calls)
        for name, calls in many.items()
        if calls > 1.7 * TIMES * max(few[name], FEW)
        and "/cyclekit/" in name.replace("\\", "/").split("/site-packages/")[-1]  # ours, wherever the environment is
    }
    assert square == {}
    whole = many.total()  # the clock of this test: it runs alike on every machine
    left = [(1 - at / whole, at / whole * (1 - f) / f) for at, f in told if 0.1 <= at / whole <= 0.9]
    assert len(left) >= 3
    assert all(actual / 2 <= promised <= actual * 2 for actual, promised in left), left
