"""The progress that an estimate tells holds: its fractions are those of the work, in calls instead of seconds."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pytest
from fabricated import ROUTE, fabricate_dataset
from known_cells import TrueStaircase

from cyclekit.config.sequences import TaskSequence
from cyclekit.estimate.rollout import estimate

if TYPE_CHECKING:
    from pathlib import Path


def told_by_an_estimate(folder: Path, count: int) -> list[tuple[float, float]]:
    """Return the share of all calls of Python that are made, and the fraction told then."""
    calls, told = 0, list[tuple[int, float]]()

    def counted(_frame: object, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    logged = fabricate_dataset(folder, executions=16, seed=count)
    asked = [TaskSequence(f"{number}", (*ROUTE * 3, *ROUTE[: number + 1])) for number in range(count)]
    before = sys.getprofile()
    sys.setprofile(counted)
    try:
        estimate(TrueStaircase(), logged, asked, other_cell=True, progress=lambda done, _: told.append((calls, done)))
    finally:
        sys.setprofile(before)
    return [(at / calls, done) for at, done in told]


@pytest.mark.parametrize("count", [1, 3])
def test_the_remaining_time_of_an_estimate_is_within_a_factor_of_two(tmp_path: Path, count: int):
    told_by_an_estimate(tmp_path / "first", count)  # imports what it needs
    inside = [(at, done) for at, done in told_by_an_estimate(tmp_path / "dataset", count) if 0.1 <= at <= 0.9]
    assert inside
    assert all((1 - at) / 2 <= at * (1 - done) / done <= 2 * (1 - at) for at, done in inside), inside
