"""A small dataset made without the simulator and without ingest, for the tests of what reads a dataset.

The cell: a robot carries boxes from `conveyor` to `left` and `right`; one operator walks between `stack`, `shelf` and
`desk`, and now and then leaves. The safety function is the paper's staircase over the distance, acting at once and as
time scaling. Two sessions, executions back to back with 5 s between them. Everything is exact: no noise, no ramps.
"""

from __future__ import annotations

import itertools
import json
import math
import tempfile
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from cyclekit import schema
from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.storage.atomic import staged, write_parquet

if TYPE_CHECKING:
    from collections.abc import Sequence

LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
THRESHOLDS_M = (1.2, 1.5, 1.9, 2.4)
PLACES = {"conveyor": (0.6, 0.0, 0.4), "left": (0.0, 0.7, 0.3), "right": (0.0, -0.7, 0.3)}
HUMAN_PLACES = {"stack": (1.2, 0.7, 1.0), "shelf": (1.6, -1.0, 1.0), "desk": (3.2, 0.3, 1.0)}
NATIVE_HZ, SAMPLE_HZ = 50, 10
SPEED_M_S, DWELL_S, GAP_S = 0.5, 1.0, 5.0
ROUTE = ("conveyor", "left", "conveyor", "right")


def staircase(robot_m: Sequence[float], human_m: Sequence[float] | None) -> float:
    """Return the true scaling: the level whose distance band holds ||x_r - x_h||; 1 when nobody is there."""
    if human_m is None:
        return LEVELS[-1]
    return LEVELS[sum(math.dist(robot_m, human_m) >= threshold for threshold in THRESHOLDS_M)]


def fabricate_dataset(
    path: Path, executions: int = 4, seed: int = 0, *, rounds: int = 2, operator: bool = True
) -> Dataset:
    """Write a dataset of `executions` executions at `path` and open it.

    Args:
        path: Folder to be made.
        executions: How many; the first half belongs to session `session-1`, the rest to `session-2`.
        seed: Of the operator's walk; the robot does the same every time, apart from its slow-downs.
        rounds: Rounds of conveyor -> left -> conveyor -> right per execution, about 15 s to 60 s each.
        operator: False for a dataset in which nobody is ever there.
    """
    with staged(path) as folder:
        for name, content in _fabricated(executions, seed, rounds, operator).items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
    return Dataset.open(path)


@cache
def _fabricated(executions: int, seed: int, rounds: int, operator: bool) -> dict[str, bytes]:
    """Return the files of a dataset by name, made once in a process."""
    rng = np.random.default_rng(seed)
    starts = {"session-1": 0.0, "session-2": 0.0}
    entries, samples, natives, tasks = [], {s: [] for s in starts}, {s: [] for s in starts}, []
    for number in range(executions):
        session = "session-1" if number < (executions + 1) // 2 else "session-2"
        name = f"{session}/{number + 1:04d}"
        native, done = _execute(name, starts[session], rounds, _Operator(rng) if operator else None)
        end_s = float(done["end_s"][-1])
        entry = {"execution": name, "session": session, "start_s": starts[session], "end_s": end_s, "complete": True}
        entries.append(entry)
        samples[session].append(native.gather_every(NATIVE_HZ // SAMPLE_HZ))
        natives[session].append(native)
        tasks.append(done)
        starts[session] = end_s + GAP_S
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        for session, frames in samples.items():
            if frames:
                write_parquet(_conform(pl.concat(frames)), folder / "samples" / f"{session}.parquet")
                _record(folder / "recordings" / f"{session}-robot", pl.concat(natives[session]))
        write_parquet(schema.conform(pl.concat(tasks), schema.TASKS), folder / "tasks.parquet")
        logs = {
            s: (pl.concat(f).height, sha256(pl.concat(f).write_csv().encode()).hexdigest())
            for s, f in natives.items()
            if f
        }
        card = _card(entries, logs)
        (folder / CARD).write_text(json.dumps(card, indent=1), encoding="utf-8")
        files = [file for file in folder.rglob("*") if file.is_file()]
        return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}


class _Operator:
    """Walks at 1 m/s from place to place with random goals and dwells; on a fifth of the ways, out of the cell."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.at = rng, np.array(HUMAN_PLACES["desk"])
        self.place, self.goal, self.rest_s, self.away = "desk", self.at, 0.0, False

    def step(self, dt_s: float) -> tuple[float, float, float] | None:
        way = self.goal - self.at
        left_m = float(np.linalg.norm(way))
        if left_m > 1e-9:
            self.at = self.at + way * min(1.0, dt_s / left_m)
        elif self.rest_s > 0:
            self.rest_s -= dt_s
        else:
            self.place = str(self.rng.choice([p for p in HUMAN_PLACES if p != self.place]))
            self.goal = np.array(HUMAN_PLACES[self.place]) + np.array([*self.rng.normal(0, 0.15, 2), 0.0])
            self.rest_s, self.away = float(self.rng.uniform(1, 6)), bool(self.rng.random() < 0.2)
        return None if self.away else (float(self.at[0]), float(self.at[1]), float(self.at[2]))


def _execute(name: str, start_s: float, rounds: int, operator: _Operator | None) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Return the samples of one execution at the native rate, and its tasks."""
    route = [*ROUTE * rounds, ROUTE[0]]
    dt_s, tick, rows, tasks = 1 / NATIVE_HZ, 0, [], []
    for index, (start, goal) in enumerate(itertools.pairwise(route)):
        a, b = np.array(PLACES[start]), np.array(PLACES[goal])
        nominal_s = float(np.linalg.norm(b - a)) / SPEED_M_S * 1.875  # peak of a minimum-jerk profile = SPEED_M_S
        begin, arrival, progress, rested = tick, None, 0.0, 0
        while arrival is None or rested < DWELL_S * NATIVE_HZ:
            u = min(progress, 1.0)
            robot = a + (b - a) * (10 * u**3 - 15 * u**4 + 6 * u**5)
            human = operator.step(dt_s) if operator else None
            scaling = staircase(robot.tolist(), human)
            if arrival is None and u >= 1.0:
                arrival = tick
            moving = arrival is None
            human_goal = operator.goal.tolist() if operator and human else [None] * 3
            place = operator.place if operator and human else None
            task, gap = f"{start}->{goal}", None if human else "absent"
            rows.append([tick, *robot, *(human or [None] * 3), *b, *human_goal, scaling, task, place, moving, gap])
            progress, rested, tick = progress + scaling * dt_s / nominal_s, rested + (not moving), tick + 1
        motion_s = (arrival - begin) * dt_s
        loss_s = sum(1 - row[13] for row in rows[begin:arrival]) * dt_s
        edges = [start_s + t * dt_s for t in (begin, arrival, tick)]
        tasks.append([name, index, f"{start}->{goal}", start, goal, *edges, motion_s - loss_s, loss_s, DWELL_S, 0.0])
    done = pl.DataFrame(
        tasks, schema=[name for name in schema.TASKS if name not in schema.ADDED_TO_TASKS], orient="row"
    )
    return _native(name, start_s, rows), done


NOT_ROLLED = {"execution", "t_s", "scaling_origin", "scaling_sd", "scaling_gap", "slider", "step", "lost_to"} | set(
    schema.ADDED_TO_SAMPLES
)


def _native(name: str, start_s: float, rows: list[list[Any]]) -> pl.DataFrame:
    columns = [c for c in schema.SAMPLES if c not in NOT_ROLLED]
    types = {c: schema.SAMPLES[c].dtype for c in columns}
    frame = pl.DataFrame(rows, schema={"tick": schema.I64, **types}, orient="row")
    levels = pl.Series(LEVELS)
    return frame.with_columns(
        execution=pl.lit(name),
        t_s=start_s + pl.col("tick") / NATIVE_HZ,
        scaling_origin=pl.lit("logged"),
        scaling_sd=pl.lit(0.0),
        step=pl.col("scaling").replace_strict(levels, list(range(len(LEVELS))), return_dtype=pl.Int32),
    ).drop("tick")


def _conform(frame: pl.DataFrame) -> pl.DataFrame:
    return schema.conform(frame, schema.SAMPLES)


def _record(folder: Path, native: pl.DataFrame) -> None:
    """Write the robot recording and the tracker recording as ingest would, clocks already in session time."""
    row = pl.int_range(pl.len(), dtype=pl.Int64).alias("source_row")
    robot = native.select(
        "t_s", "scaling", row, tcp_x_m="robot_x_m", tcp_y_m="robot_y_m", tcp_z_m="robot_z_m", state=pl.lit("playing")
    )
    people = native.select("t_s", row, x_m="human_x_m", y_m="human_y_m", z_m="human_z_m", person=pl.lit("1"))
    write_parquet(schema.conform(robot, schema.ROBOT), folder / "robot.parquet")
    write_parquet(schema.conform(people, schema.PEOPLE), folder / "people.parquet")


def _card(entries: list[dict[str, Any]], logs: dict[str, tuple[int, str]]) -> dict[str, Any]:
    def place(xyz_m: tuple[float, float, float], radius_m: float) -> dict[str, Any]:
        return {"xyz_m": list(xyz_m), "radius_m": radius_m, "inferred": False}

    return {
        "schema_version": schema.SCHEMA_VERSION,
        "name": "fabricated",
        "rows": {"samples": 0, "tasks": 10_000},
        "executions": entries,
        "places": {name: place(xyz, 0.1) for name, xyz in PLACES.items()},
        "human_places": {name: place(xyz, 0.5) for name, xyz in HUMAN_PLACES.items()},
        "levels": list(LEVELS),
        "recordings": [
            {
                "id": f"{session}-robot",
                "session": session,
                "sources": [{"path": f"{session}.csv", "sha256": checksum, "size": 0}],
                **{"adapter": "fabricated", "adapter_package": "tests", "adapter_version": "0"},
                "clock": {"kind": "relative", "method": "own", "offset_s": 0.0, "rate": 1.0},
                "frame": {"method": "robot base", "up": "z"},
                **{"up": "z", "joint_names": [], "facts": {}, "key": "", "warnings": []},
                "rows": {"robot": count, "people": count},
                **{"rows_are": "row", "rows_read": count, "rows_set_aside": []},
                **{"first_s": 0.0, "last_s": count / NATIVE_HZ, "duration_s": count / NATIVE_HZ, "rate_hz": NATIVE_HZ},
                "tables": ["robot", "people"],
            }
            for session, (count, checksum) in logs.items()
        ],
    }
