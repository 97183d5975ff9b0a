"""Levels and rates of the override in a safety system's own log, without positions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from cyclekit import find_levels, ingest_logs, inspect_logs
from cyclekit.cli.lists import safety_lines
from cyclekit.inspect.lists import SafetySurvey
from cyclekit.scaling.override_log import override_rows, response_of

if TYPE_CHECKING:
    from pathlib import Path


def overrides(count: int = 40, *, up: float = 0.1, down: float = 1.0) -> pl.DataFrame:
    """Return table SAFETY of a log at 30 Hz in whole percent that goes to 0, 50 or 100 %, and stays."""
    rng = np.random.default_rng(3)
    t_s = np.arange(0.0, 16.0 * count, 1 / 30)
    wanted = np.repeat(rng.choice([0.0, 0.5, 1.0], count), 480)[: len(t_s)]
    override, now = np.empty(len(t_s)), 1.0
    for row, goal in enumerate(wanted.tolist()):
        now = min(goal, now + up / 30) if goal > now else max(goal, now - down / 30)
        override[row] = round(now, 2)
    return pl.DataFrame({"t_s": t_s, "override": override})


def test_slow_ramps_are_no_levels_and_their_rates_are_read() -> None:
    found = response_of(override_rows(overrides()))
    assert found.levels == pytest.approx((0.0, 0.5, 1.0), abs=0.005)
    assert (found.down_per_s, found.up_per_s) == pytest.approx((1.0, 0.1), rel=0.05)


def test_a_silence_is_no_change_of_level() -> None:
    whole = overrides()
    change_s = whole.filter(pl.col("override").diff() != 0.0)["t_s"][0]
    rows = override_rows(whole.filter(~pl.col("t_s").is_between(change_s - 1.0, change_s + 11.0)))
    assert rows.run[-1] == 1
    assert response_of(rows).changes == response_of(override_rows(whole)).changes - 1


def test_an_override_that_is_never_held_has_no_levels() -> None:
    t_s = np.arange(0.0, 60.0, 1 / 30)
    assert response_of(override_rows(pl.DataFrame({"t_s": t_s, "override": 0.5 + 0.4 * np.sin(t_s)}))) is None
    assert override_rows(pl.DataFrame({"t_s": [0.0], "override": [1.0]})) is None


def test_levels_and_inspect_answer_from_such_a_log_alone(tmp_path: Path) -> None:
    table = overrides(20).select(Timestamp=pl.col("t_s") + 1.7e9, Safe_Ovr=(100 * pl.col("override")).round())
    (tmp_path / "logs").mkdir()
    table.write_csv(tmp_path / "logs" / "override.csv")
    ingest_logs(tmp_path / "logs", tmp_path / "dataset")
    assert find_levels(tmp_path / "dataset").levels == pytest.approx((0.0, 0.5, 1.0), abs=0.005)
    (found,) = inspect_logs(tmp_path / "dataset").safety.values()
    assert found.response.levels == pytest.approx((0.0, 0.5, 1.0), abs=0.005)
    lines = "\n".join(safety_lines(found))
    assert "50 % (" in lines
    assert "slows by" in lines


def test_a_rate_of_too_few_changes_is_not_called_at_once(tmp_path: Path) -> None:
    few, many = overrides(4), overrides(60, up=np.inf, down=np.inf)
    said = []
    for table in (few, many):
        survey = SafetySurvey()
        survey.add(table.with_columns(distance_m=pl.lit(None, pl.Float64)))
        said.append(safety_lines(survey.facts())[-1])
    assert said[0].endswith("slows by not known, too few changes, recovers by not known, too few changes")
    assert said[1].endswith("slows by at once, recovers by at once")
