"""The reaction time by which the positions explain the commanded level, where the places of changes do not tell it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest

from cyclekit.derive.reaction_time import reaction_time
from cyclekit.scaling.response import SafetyResponse

if TYPE_CHECKING:
    from pathlib import Path

NO_RAMPS = SafetyResponse(None, None, None, None, 0, None)
STEP_S = 0.1


def walk(seconds: float, rng: np.random.Generator) -> np.ndarray:
    """An operator on the floor, shape (T, 2), every 10 ms: to and fro at changing speed."""
    legs = [np.array([2.0, 2.0])]
    points = []
    while 0.01 * len(points) < seconds:
        goal, speed = rng.uniform(-2.0, 2.5, 2), rng.uniform(0.3, 1.6)
        count = max(2, int(np.linalg.norm(goal - legs[-1]) / speed / 0.01))
        points += list(np.linspace(legs[-1], goal, count))
        legs.append(goal)
    return np.array(points)[: int(seconds / 0.01)]


def samples(folder: Path, late_s: float, *, rule: bool = True, heights: bool = True) -> list[Any]:
    """Write the samples of ten executions whose level is 0 inside of a corner of the floor, so long ago."""
    rng, frames = np.random.default_rng(5), []
    for number in range(10):
        at = walk(80.0, rng)
        inside = (at[:, 0] < 0.4) & (at[:, 1] < 0.9)
        scaling = np.where(np.roll(inside, round(late_s / 0.01)), 0.25, 1.0)
        if not rule:
            scaling = np.repeat(rng.choice([0.25, 1.0], len(at) // 100 + 1), 100)[: len(at)]
        rows = slice(100, None, 10)  # 10 Hz
        t_s = 0.01 * np.arange(len(at))[rows] + 1000.0 * number
        frames.append(
            pl.DataFrame(
                {
                    "execution": [f"one.{number}"] * len(t_s),
                    "t_s": t_s,
                    "scaling": scaling[rows],
                    "human_gap": pl.Series([None] * len(t_s), dtype=pl.String),
                    **{f"robot_{axis}_m": rng.normal(0.0, 0.3, len(t_s)) for axis in "xyz"},
                    "human_x_m": at[rows, 0] + rng.normal(0.0, 0.01, len(t_s)),
                    "human_y_m": at[rows, 1] + rng.normal(0.0, 0.01, len(t_s)),
                    "human_z_m": np.full(len(t_s), 1.0 if heights else np.nan),
                }
            )
        )
    pl.concat(frames).write_parquet(folder / "one.parquet")
    cards = [SimpleNamespace(execution=f"one.{number}") for number in range(10)]
    return [SimpleNamespace(part="one", samples=sum(map(len, frames)), cards=cards)]


@pytest.mark.parametrize("late_s", [0.1, 0.22, 0.5])
@pytest.mark.parametrize("heights", [True, False])
def test_the_reaction_time_to_a_zone_is_the_one_that_explains_the_level(tmp_path: Path, late_s: float, heights: bool):
    made = samples(tmp_path, late_s, heights=heights)
    assert reaction_time(made, (0.25, 1.0), NO_RAMPS, tmp_path) == pytest.approx(late_s, abs=0.03)


def test_a_safety_system_that_answers_at_once_has_none(tmp_path: Path):
    assert reaction_time(samples(tmp_path, 0.0), (0.25, 1.0), NO_RAMPS, tmp_path) is None


def test_levels_that_have_nothing_to_do_with_the_operator_tell_none(tmp_path: Path):
    assert reaction_time(samples(tmp_path, 0.2, rule=False), (0.25, 1.0), NO_RAMPS, tmp_path) is None


def test_one_level_tells_none(tmp_path: Path):
    assert reaction_time(samples(tmp_path, 0.2), (1.0,), NO_RAMPS, tmp_path) is None
