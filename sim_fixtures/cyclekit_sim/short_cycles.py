"""Logs of very many short executions, for what grows with their number: six seconds each, written in no time.

The robot leaves its home for two of its four places, and moves at half speed while the operator is near its base. There
are two kinds of logs: `tracker` has one log of the robot and one of the operator's positions; `signals` has no tracker,
but a bit that is on while he is near, outputs and a PLC's step that change with each motion, and a gap in the log after
each execution.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Numbers = NDArray[np.float64]

HZ, TRACKER_HZ = 25, 10
MOTION_S, DWELL_S, PAUSE_S = 0.8, 1.0, 4.0
HOME, PLACES_M = (
    np.array([0.4, 0.0, 0.4]),
    np.array([[0.0, 0.5, 0.3], [0.0, -0.5, 0.3], [0.4, 0.4, 0.2], [0.4, -0.4, 0.2]]),
)
NEAR_M, SLOW = 1.2, 0.5
DESK_M, SHELF_M = np.array([0.9, 0.2, 1.0]), np.array([3.0, 0.5, 1.0])
CELL = {
    "tracker": """[[sources]]
path = "people.txt"
role = "people"
clock_offset_s = 100.0
frame = { xyz_m = [0.0, 0.0, 0.0], yaw_deg = 0.0 }
""",
    "signals": """[[sources]]
path = "plc.csv"
role = "events"
clock_offset_s = 0.0
""",
}


def _operator(seconds: float, rng: np.random.Generator) -> tuple[Numbers, Numbers]:
    """Return times, shape (N,), s, and the operator's positions, (N, 3), m: he walks from desk to shelf and back."""
    stays = rng.uniform(3.0, 12.0, int(seconds / 5) + 4)
    leaves = np.cumsum(stays + 2.0)
    t_s = np.arange(int(seconds * TRACKER_HZ)) / TRACKER_HZ
    knots_s = np.column_stack([leaves - stays, leaves]).ravel()
    share = np.interp(t_s, knots_s, np.repeat(np.arange(len(stays)) % 2, 2))
    return t_s, DESK_M + share[:, None] * (SHELF_M - DESK_M)


def _stops(executions: int, rng: np.random.Generator) -> Numbers:
    """Return where the robot stops, shape (3 N + 1, 3), m: home, two places, home, two places ..."""
    first, other = rng.integers(0, 4, executions), rng.integers(1, 4, executions)
    goals = np.stack([PLACES_M[first], PLACES_M[(first + other) % 4], np.broadcast_to(HOME, (executions, 3))], axis=1)
    return np.concatenate([HOME[None], goals.reshape(-1, 3)])


def write_short_cycles(folder: Path, executions: int, kind: str) -> None:
    """Write the logs of one cell and its cell file; `kind` is `tracker` or `signals`."""
    rng = np.random.default_rng(executions)
    stops_m = _stops(executions, rng)
    legs = len(stops_m) - 1
    seen_s, human_m = _operator(legs * (MOTION_S / SLOW + DWELL_S) + 60.0, rng)
    t_s = np.arange(int(seen_s[-1] * HZ)) / HZ
    near = np.linalg.norm(human_m[:, :2], axis=1) < NEAR_M
    scaling = np.where(near[(t_s * TRACKER_HZ).astype(int)], SLOW, 1.0)
    moved_s = np.concatenate([[0.0], np.cumsum(scaling[:-1]) / HZ])  # programmed time, if it always moved
    begins = np.empty(legs, np.int64)
    row = int(DWELL_S * HZ)
    for motion in range(legs):
        begins[motion] = row
        row = int(np.searchsorted(moved_s, moved_s[row] + MOTION_S)) + int(DWELL_S * HZ)
    t_s, scaling, moved_s = t_s[:row], scaling[:row], moved_s[:row]
    leg = np.searchsorted(begins, np.arange(row), side="right") - 1
    u = np.where(leg < 0, 0.0, np.minimum((moved_s - moved_s[begins[leg]]) / MOTION_S, 1.0))
    way = u**3 * (10 - 15 * u + 6 * u**2)
    tcp_m = stops_m[np.maximum(leg, 0)] + way[:, None] * (stops_m[leg + 1] - stops_m[np.maximum(leg, 0)])
    resting = (leg + 1) % 3 == 0
    number = np.cumsum(resting & (u >= 1.0) & (np.diff(u, prepend=0.0) > 0.0))  # executions done
    later = int(DWELL_S / 2 * HZ)
    gaps = np.concatenate([np.zeros(later), number[:-later]]) if kind == "signals" else 0.0
    stamps_s = 100.0 + t_s + PAUSE_S * gaps
    columns = {"timestamp": stamps_s, **{f"actual_TCP_pose_{axis}": tcp_m[:, axis] for axis in range(3)}}
    columns |= {f"actual_TCP_pose_{axis}": np.zeros(row) for axis in range(3, 6)}
    columns |= {"speed_scaling": scaling, "target_speed_fraction": np.ones(row), "runtime_state": np.full(row, 2)}
    if kind == "signals":
        columns["actual_digital_input_bits"] = np.where(scaling < 1.0, 16, 0)
        columns["actual_digital_output_bits"] = (leg + 1) % 2 + 2 * (u >= 1.0)
        changed = np.flatnonzero(np.diff(leg, prepend=-2))
        events = {"time_s": stamps_s[changed], "signal": ["step"] * len(changed), "value": (leg[changed] + 1) % 6}
        pl.DataFrame(events).write_csv(folder / "plc.csv", float_precision=3)
    else:
        rows = {
            "frame": np.arange(len(seen_s)),
            "id": np.ones(len(seen_s), int),
            "x": human_m[:, 0],
            "y": human_m[:, 1],
        }
        with (folder / "people.txt").open("wb") as log:
            log.write(f"# framerate: {TRACKER_HZ}\n".encode())
            pl.DataFrame(rows).write_csv(log, include_header=False, separator=" ", float_precision=4)
    (folder / "cell.toml").write_text(CELL[kind], encoding="utf-8")
    pl.DataFrame(columns).write_csv(folder / "robot.csv", separator=" ", float_precision=5)
