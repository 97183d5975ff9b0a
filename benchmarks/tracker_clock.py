"""A tracker whose clock nothing relates to the robot's: what the slow-downs tell, against the true offset.

    python benchmarks/tracker_clock.py [--scenes box-picking,laser-zones,...] [--executions 9,30] [--seed 6]

Each cell has three sessions. The tracker starts up to a minute after the robot, or together with it; nothing says so.
The error is found offset minus true offset: the reaction time of the safety function is part of it. With a common
start, nothing may be moved, whatever the reaction time.
"""

from __future__ import annotations

import argparse
import re
import shutil
import tempfile
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import SimulationOptions, simulate

SCENES = ("box-picking", "pick-and-package", "scanner-visits", "laser-zones")
SESSIONS, FRAME_S, LEAD_S, HEAD_LINES = 3, 1 / 60, 5.0, 7
RESPONSES = {
    "at once": SimulationOptions(),
    "0.3 s late, 10 %/s, hysteresis": SimulationOptions(
        latency_s=0.3, ramp_down_per_s=1.0, ramp_up_per_s=0.1, hysteresis_m=0.1
    ),
    "noise 0.03 m, scaling inferred": SimulationOptions(delta_m=0.03, dropout=0.1, log_override=False),
}


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=list(SCENES))
    parser.add_argument("--executions", type=lambda text: [int(one) for one in text.split(",")], default=[9, 30])
    parser.add_argument("--seed", type=int, default=6)
    asked = parser.parse_args()
    table = Table("scene", "executions", "response", "started apart: error, s", "started together: moved, s")
    rng = np.random.default_rng(asked.seed)
    for scene, executions, (name, how) in product(asked.scenes, asked.executions, RESPONSES.items()):
        with tempfile.TemporaryDirectory() as folder:
            logs = simulated(scene, Path(folder), executions, asked.seed, how)
            apart = judged(logs, rng.uniform(0.7, 60.0, SESSIONS).round(2).tolist())
            together = judged(logs, [0.0] * SESSIONS)
        row = scene, str(executions), name, apart, together
        table.add_row(*row)
        print(*row, sep=" | ", flush=True)
    Console(width=140).print(table)


def simulated(scene: str, folder: Path, executions: int, seed: int, how: SimulationOptions) -> Path:
    """Return a folder of logs of several sessions, with nothing about the tracker's clock in the cell file."""
    logs = folder / "logs"
    for number in range(SESSIONS):
        options = replace(how, tracker_xyz_m=(1.4, -2.6, -0.8), tracker_yaw_deg=35.0)
        one = simulate(
            scene, folder / str(number), executions=executions // SESSIONS, seed=seed + 100 * number, options=options
        )
        shutil.copytree(one / "session_000", logs / f"session_{number}")
        (logs / f"session_{number}" / "events.csv").unlink(missing_ok=True)
    text = re.sub(r"^clock_offset_s.*$", "", (folder / "0" / "cell.toml").read_text("utf-8"), flags=re.MULTILINE)
    kept = [part for part in text.split("[[sources]]") if 'role = "events"' not in part.partition("[places")[0]]
    places = "[places" + text.partition("[places")[2]
    text = "[[sources]]".join(kept)
    (logs / "cell.toml").write_text(text if "[places" in text else text + places, "utf-8")
    return logs


def judged(logs: Path, late_s: list[float]) -> str:
    """Return the error of each session's clock, s; `-` where a common start is assumed."""
    work = Path(tempfile.mkdtemp(dir=logs.parent))
    here = shutil.copytree(logs, work / "logs")
    for number, late in enumerate(late_s):
        cut(here / f"session_{number}" / "operator.csv", late)
    ingest([here], work / "dataset")
    people = [one for one in Dataset.open(work / "dataset").recordings if "people" in one.tables]
    people.sort(key=lambda one: one.session)
    fits = zip(people, late_s, strict=True)
    return " ".join(f"{one.clock.offset_s - late:+.3f}" if one.clock.method == "coarse" else "-" for one, late in fits)


def cut(take: Path, late_s: float) -> None:
    """Let a take begin some time after the robot's log."""
    lines = take.read_text("utf-8").splitlines()
    first = round((LEAD_S + late_s) / FRAME_S)
    rows = [line.split(",", 2)[2] for line in lines[HEAD_LINES + first :]]
    frames = [f"{number},{number * FRAME_S:.6f},{row}" for number, row in enumerate(rows)]
    take.write_text("\n".join([*lines[:HEAD_LINES], *frames]) + "\n", "utf-8")


if __name__ == "__main__":
    main()
