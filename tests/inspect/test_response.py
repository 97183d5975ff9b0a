"""How the safety system answers in time is shown with the dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from cyclekit.cli.facts import page
from cyclekit.ingest.ingest import ingest
from cyclekit.inspect.describe import describe
from cyclekit_sim import SimulationOptions, simulate

if TYPE_CHECKING:
    from pathlib import Path

    from simulated_cells import SimulatedCell

    from cyclekit.inspect.facts import DatasetDescription


def described(folder: Path, options: SimulationOptions, *, keep: int = 1) -> DatasetDescription:
    """Return the dataset of a few executions, with every `keep`-th row of the robot's log."""
    simulate("box-picking", folder / "logs", executions=4, seed=3, options=options)
    for log in (folder / "logs").glob("*/robot.csv"):
        head, *rows = log.read_text().splitlines(keepends=True)
        log.write_text(head + "".join(rows[::keep]))
    return describe(ingest([folder / "logs"], folder / "dataset").dataset)


def test_reaction_time_and_both_ramps_are_shown(tmp_path: Path):
    found = described(tmp_path, SimulationOptions(ramp_up_per_s=0.1, ramp_down_per_s=1.0, latency_s=0.3))
    assert found.response is not None
    assert (found.response.read.latency_s, found.response.read.ramp_up_per_s) == pytest.approx((0.3, 0.1), abs=0.02)
    assert not found.response.few_rows
    shown = page(found)
    assert "reaction time 0.3 s" in shown
    assert "slows by      100 % per second" in shown
    assert "recovers by   10 % per second" in shown
    assert "3 rows" not in shown
    assert "CI" not in shown
    assert found.to_dict()["response"]["down_per_s"] == pytest.approx(1.0, abs=0.02)


def test_a_ramp_with_few_rows_is_told(tmp_path: Path):
    found = described(tmp_path, SimulationOptions(ramp_up_per_s=5.0, ramp_down_per_s=5.0), keep=12)
    assert found.response is not None
    assert found.response.few_rows
    assert "fewer than 3 rows in a ramp" in page(found)
    assert "% per second (95 % CI" in page(found)
    assert found.to_dict()["response"]["up_se_per_s"] > 0.0


def test_a_robot_that_changes_its_speed_at_once_has_no_ramp(boxes: SimulatedCell):
    found = describe(boxes.dataset.path)
    assert found.response is not None
    assert (found.response.read.ramp_up_per_s, found.response.rows) == (None, None)
    assert "recovers by   at once" in page(found)
