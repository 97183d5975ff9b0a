"""The clock of a PLC's trace beside a robot's log: its signals tell what the robot does, but only at the true lag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from cyclekit.config import Cell, Source, load_cell
from cyclekit.dataset.cards import RecordingCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import SimulationOptions, simulate

pytestmark = pytest.mark.tests_clocks

EPOCH_S, UPTIME_S, PLC_S = 1_700_000_000.0, 20.0, 41.3
BELT = "part_passes"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Light curtains, a mat, the gripper and a belt in a PLC's trace, four minutes of it."""
    folder = tmp_path_factory.mktemp("plc") / "made"
    options = SimulationOptions(plc_trace="wide", executions_per_session=60)
    return simulate("light-curtain", folder, executions=4, seed=4, options=options)


def trace(
    made: Path, folder: Path, late_s: float = 0.0, *, since: float = EPOCH_S, from_s: float = 0.0, only: str = ""
) -> RecordingCard:
    """Return what ingest says of the trace, whose clock is late and whose log begins after some time."""
    clock = "epoch" if since == EPOCH_S else "uptime"
    robot = pl.read_csv(made / "session_000" / "robot.csv", separator=" ")[::5]
    trace = pl.read_csv(made / "session_000" / "plc.csv", separator=";", decimal_comma=True)
    (folder / "logs").mkdir()
    timestamp = pl.col("timestamp") - robot["timestamp"][0] + since
    robot.with_columns(timestamp=timestamp).write_csv(folder / "logs" / "robot.csv", separator=" ")
    true_s = trace["Time [ms]"].to_numpy() / 1e3 - PLC_S
    rows = []
    for tag in [only] if only else [name for name in trace.columns if name not in ("Time [ms]", "belt_speed")]:
        on = np.where(true_s < from_s, -1, trace[tag].cast(pl.String).str.to_lowercase().to_numpy() == "true")
        at = np.flatnonzero((np.diff(on, prepend=-1) != 0) & (true_s >= from_s))
        rows += [(true_s[row] + late_s + since, tag, int(on[row])) for row in at.tolist()]
    table = pl.DataFrame(sorted(rows), schema=["t", "signal", "value"], orient="row")
    table.write_csv(folder / "logs" / "plc.csv", float_precision=3)
    layout = {"delimiter": ",", "time": "t", "time_unit": "s", "clock": clock, "signal": "signal", "value": "value"}
    sources = (Source("robot.csv", role="robot"), Source("plc.csv", adapter="csv", role="events", map=layout))
    ingest([folder / "logs"], folder / "d", cell=Cell(sources=sources, places=load_cell(made / "cell.toml").places))
    return next(one for one in Dataset.open(folder / "d").recordings if "robot" not in one.tables)


def test_a_trace_on_another_computers_clock_is_named_with_the_line_that_mends_it(made: Path, tmp_path: Path) -> None:
    clock = trace(made, tmp_path, 37.0).clock
    (said,) = [one for one in clock.warnings if one.code == "clock-contradicted"]
    assert said.values["offset_s"] == pytest.approx(-37.0, abs=0.1)
    assert "its signals explain" in said.text
    assert "sync, in cell.toml" in said.text
    assert clock.offset_s == -EPOCH_S  # places and executions rest on it already


def test_a_trace_that_was_started_later_is_named(made: Path, tmp_path: Path) -> None:
    clock = trace(made, tmp_path, since=UPTIME_S, from_s=50.0).clock
    assert clock.test is not None
    assert (clock.method, clock.test.certain) == ("assumed-common-start", True)
    assert {one.code for one in clock.warnings} == {"clock-contradicted", "clock-assumed"}


def test_a_trace_on_the_right_clock_is_confirmed(made: Path, tmp_path: Path) -> None:
    clock = trace(made, tmp_path).clock
    assert clock.test is not None
    assert clock.test.certain
    assert clock.test.lag_s == pytest.approx(0.0, abs=0.1)
    assert not clock.warnings


def test_a_belt_that_has_nothing_to_do_with_the_robot_proves_no_clock(made: Path, tmp_path: Path) -> None:
    clock = trace(made, tmp_path, 37.0, only=BELT).clock
    assert clock.test is None or not clock.test.certain
    assert "clock-contradicted" not in {one.code for one in clock.warnings}
