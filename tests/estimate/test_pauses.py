"""The scaling at which cycles start, where a slow recovery goes on from execution to execution."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import polars as pl
import pytest

from cyclekit.estimate.operator.pauses import starting_scaling

UP_PER_S, PAUSE_S = 0.05, 4.0


def logs(begins: list[float], end: float = 0.5) -> Any:
    """Executions of 10 s, PAUSE_S after each other, that begin at these scalings and end at one."""
    names = [f"e{number}" for number in range(len(begins))]
    start_s = [number * (10.0 + PAUSE_S) for number in range(len(begins))]
    executions = pl.DataFrame({"execution": names, "session": "a", "start_s": start_s})
    scaling = [(begin, None, 0.3, end) for begin in begins]
    rows = pl.DataFrame({"execution": names, "scaling": scaling}, strict=False).explode("scaling")
    return SimpleNamespace(
        executions=executions.with_columns(end_s=pl.col("start_s") + 10.0), samples=lambda columns: rows.select(columns)
    )


def test_a_track_starts_at_the_logged_scaling_of_its_execution():
    found = starting_scaling(logs([0.1, 0.2, 0.9]), ["e2", "e1"], UP_PER_S)
    assert found.tolist() == pytest.approx([0.9, 0.2])


def test_without_a_slow_recovery_nothing_is_kept():
    assert starting_scaling(logs([0.1, 0.2]), ["e1"], None) is None
