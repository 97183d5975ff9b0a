"""A tracker's frame that is missing or wrong in the cell file: what the slow-downs propose, against the true frame.

    python benchmarks/tracker_frame.py [--scenes box-picking,laser-zones,...] [--executions 20,60] [--seed 5]

Each cell is simulated with its tracker at another pose, and ingested three times: without a frame, with one that is
wrong by 5 degrees and 0.2 m, and with the right one. The error is the median distance between the operator's positions
by the proposed and by the true frame.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import polars as pl
from rich.console import Console
from rich.table import Table

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import SimulationOptions, simulate

SCENES = ("box-picking", "pick-and-package", "scanner-visits", "laser-zones")
Pose = tuple[tuple[float, float, float], float]
"""Position, m, and yaw, deg."""
RESPONSES = {
    "at once": SimulationOptions(),
    "slow, hysteresis": SimulationOptions(latency_s=0.3, ramp_down_per_s=1.0, ramp_up_per_s=0.1, hysteresis_m=0.1),
    "noise 0.03 m": SimulationOptions(delta_m=0.03, dropout=0.1),
}


def frame_text(xyz_m: tuple[float, float, float], yaw_deg: float) -> str:
    """Return the line of the cell file."""
    return f"frame = {{ xyz_m = {list(xyz_m)}, yaw_deg = {yaw_deg} }}"


def placed(points_m: np.ndarray, xyz_m: list[float], yaw_deg: float) -> np.ndarray:
    """Return points (N, 2) of the tracker's floor in the base frame."""
    cos, sin = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    return np.asarray(points_m @ np.array([[cos, sin], [-sin, cos]]) + np.array(xyz_m[:2]))


def proposal(dataset: Dataset) -> tuple[str, list[float] | None]:
    """Return the note on the frame and the proposed numbers."""
    for one in dataset.card.warnings:
        if one.code == "frame-doubtful":
            return one.code, [float(number) for number in re.findall(r"-?\d+\.\d+", str(one.values["line"]))]
        if one.code == "frame-assumed":
            return one.code, None
    return "", None


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=list(SCENES))
    parser.add_argument("--executions", type=lambda text: [int(one) for one in text.split(",")], default=[20, 60])
    parser.add_argument("--seed", type=int, default=5)
    asked = parser.parse_args()
    table = Table("scene", "executions", "response", "missing: error, m", "wrong: error, m", "right")
    rng = np.random.default_rng(asked.seed)
    for scene, executions, (name, how) in product(asked.scenes, asked.executions, RESPONSES.items()):
        x, y = rng.uniform(-3.0, 3.0, 2).round(3).tolist()
        pose = (x, y, -0.8), round(float(rng.uniform(-180.0, 180.0)), 2)
        with tempfile.TemporaryDirectory() as folder:
            options = replace(how, tracker_xyz_m=pose[0], tracker_yaw_deg=pose[1])
            logs = simulate(scene, Path(folder) / "logs", executions=executions, seed=asked.seed, options=options)
            cells = [judged(logs, frame, pose) for frame in (None, wrong(pose), pose)]
        table.add_row(scene, str(executions), name, *cells)
        print(scene, executions, name, *cells, sep=" | ", flush=True)
    Console(width=120).print(table)


def wrong(pose: Pose) -> Pose:
    """Return a pose that is off by 5 degrees and 0.2 m."""
    (x, y, z), yaw_deg = pose
    return (x + 0.2, y, z), yaw_deg + 5.0


def judged(logs: Path, frame: Pose | None, true: Pose) -> str:
    """Return the error of the frame that is proposed for logs with a frame in their cell file, m, or the note."""
    cell, line = logs / "cell.toml", "# frame = missing" if frame is None else frame_text(*frame)
    text = re.sub(r"^(# )?frame = .*$", line, cell.read_text(encoding="utf-8"), flags=re.MULTILINE)
    cell.write_text(text, encoding="utf-8")
    dataset = Path(tempfile.mkdtemp(dir=logs.parent)) / "dataset"
    ingest([logs], dataset)
    code, found = proposal(Dataset.open(dataset))
    if found is None:
        return code or "no note"
    samples = pl.read_parquet(dataset / "samples" / "*.parquet", columns=["human_x_m", "human_y_m"])
    own = samples.drop_nulls().to_numpy()
    own = own if frame is None else unplaced(own, *frame)
    off = placed(own, found[:3], found[3]) - placed(own, list(true[0]), true[1])
    return f"{np.median(np.linalg.norm(off, axis=1)):.3f}"


def unplaced(points_m: np.ndarray, xyz_m: tuple[float, float, float], yaw_deg: float) -> np.ndarray:
    """Return points (N, 2) of the base frame on the tracker's floor."""
    return placed(points_m - np.array(xyz_m[:2]), [0.0, 0.0], -yaw_deg)


if __name__ == "__main__":
    main()
