"""The scaling is unknown where the program does not run, whichever adapter read the log."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import Recording
from cyclekit.ingest.validate.validate import examined
from cyclekit.inspect.describe import describe
from cyclekit.schema import ROBOT, conform

if TYPE_CHECKING:
    from pathlib import Path

MAPPED = """
[[sources]]
path = "robot.csv"
adapter = "csv"
role = "robot"

[sources.map]
time = "t"
x = "x"
y = "y"
z = "z"
scaling = "speed"
state = "status"
states = { PAUSED = "paused", RUN = "playing" }
"""


def _logged(folder: Path, header: str, rows: list[str]) -> Path:
    (folder / "robot.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    return folder


def test_a_paused_program_of_a_mapped_table_is_no_safety_stop(tmp_path: Path):
    (tmp_path / "cell.toml").write_text(MAPPED, encoding="utf-8")
    rows = [f"{0.1 * i:.1f},0.5,0,0.4,{'1.0,RUN' if i < 60 else '0.0,PAUSED'}" for i in range(80)]
    (log,) = describe(_logged(tmp_path, "t,x,y,z,speed,status", rows)).logs
    assert log.levels == (1.0,)
    assert log.tables["robot"].known["scaling"] == 60 / 80


def test_a_log_that_is_paused_all_along_has_no_scaling_and_no_level(tmp_path: Path):
    (tmp_path / "cell.toml").write_text(MAPPED, encoding="utf-8")
    rows = [f"{0.1 * i:.1f},0.5,0,0.4,0.0,PAUSED" for i in range(256)]
    (log,) = describe(_logged(tmp_path, "t,x,y,z,speed,status", rows)).logs
    assert (log.levels, "scaling" in log.tables["robot"].known) == ((), False)


def test_the_reader_of_ur_logs_says_the_same(tmp_path: Path):
    names = ["timestamp", *(f"actual_TCP_pose_{i}" for i in range(6))]
    names += ["speed_scaling", "target_speed_fraction", "runtime_state"]
    rows = [f"{1 + 0.008 * i:.3f} 0.5 0 0.4 0 0 0 {'1.0 1.0 2' if i < 600 else '0.0 1.0 4'}" for i in range(800)]
    (log,) = describe(_logged(tmp_path, " ".join(names), rows)).logs
    assert log.adapter == "ur-rtde"
    assert (log.levels, log.tables["robot"].known["scaling"]) == ((1.0,), 600 / 800)


@given(st.lists(st.tuples(st.sampled_from(["playing", "paused", "stopped", None]), st.floats(0, 1)), min_size=1))
def test_every_row_keeps_its_scaling_unless_its_program_is_known_not_to_run(rows: list[tuple[str | None, float]]):
    states, scaling = zip(*rows, strict=True)
    t_s = [0.1 * i for i in range(len(rows))]
    table = pl.DataFrame({"t_s": t_s, "state": pl.Series(states, dtype=pl.String), "scaling": scaling})
    found = examined(Recording(robot=conform(table, ROBOT))).robot
    assert found is not None
    assert found["scaling"].to_list() == [s if state in ("playing", None) else None for state, s in rows]
