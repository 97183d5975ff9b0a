"""The scaling at which cycles start, where a slow recovery goes on from execution to execution."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest

from cyclekit.estimate.operator.pauses import MIN_PAUSES, starting_scaling

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


def starts(begins: list[float], instants: list[int]) -> Any:
    names = [f"e{number + 1}" for number in range(len(instants))]
    return starting_scaling(logs(begins), names, np.array(instants), UP_PER_S)


KEPT = [0.5 + UP_PER_S * PAUSE_S] * (MIN_PAUSES + 1)


def test_a_track_from_the_beginning_starts_at_the_logged_scaling():
    assert starts([0.1, 0.2, 0.9], [0, 0]).tolist() == pytest.approx([0.2, 0.9])


def test_a_track_from_another_instant_starts_at_the_scaling_of_that_instant_after_a_usual_pause():
    found = starts(KEPT, [0, 2, 3, 9, 1])  # sample 9 is in the pause, the scaling of sample 1 is unknown
    assert found == pytest.approx([0.7, 0.5, 0.7, 0.7, np.nan], nan_ok=True)


@pytest.mark.parametrize("begins", [[1.0] * (MIN_PAUSES + 1), KEPT[:MIN_PAUSES]], ids=["reset", "too few"])
def test_where_executions_do_not_keep_the_scaling_other_instants_start_as_commanded(begins: list[float]):
    assert starts(begins, [0, 2]) == pytest.approx([begins[1], np.nan], nan_ok=True)


def test_without_a_slow_recovery_nothing_is_kept():
    assert starting_scaling(logs(KEPT), ["e1"], np.array([0]), None) is None
