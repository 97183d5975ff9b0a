"""Clocks of trackers by the logs: 60 pairs of logs on clocks that are wrong or unknown, and the same on right ones.

    python benchmarks/clocks.py [--pairs 60] [--first 0] [--seed 7000] [--align logs]

Three cells: the distance decides, polygons, fields of a scanner. The tracker's clock is off by up to an hour and drifts
by up to 100 ppm; its frame is known or not, it writes one file or two, the robot's controller restarts or not, the
tracker is noisy and loses frames. Half of the clocks are stated (both since 1970), half unknown. A lag is found if each
file in every part is within 0.1 s in its middle. "Certain and wrong": the log is said to be sure, and the middle is off
by more than that, and by more than three times the stated error. Of right clocks none may be called wrong. The safety
functions have no reaction time (0.1 ms replaces the scenes' own), which no log can tell from the clock.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl
from rich.console import Console
from rich.table import Table

from cyclekit.config import Cell, Frame, Source, load_cell
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import SimulationOptions, simulate
from cyclekit_sim.rules import Limit, Rule

EXECUTIONS, START_S, LEAD_S, EPOCH_S, RESTARTED_S = 10, 152.512, 5.0, 1_700_000_000.0, 20.0
THIN_ROBOT, THIN_TRACKER, HEAD_LINES = 5, 3, 7
GOOD_S = 0.1
AROUND = ((-1.5, -1.6), (1.5, -1.6), (1.5, 1.6), (-1.5, 1.6))
SIDES = tuple(tuple((x, side * y) for x, y in ((-0.9, 0.2), (0.9, 0.2), (0.9, 1.3), (-0.9, 1.3))) for side in (1, -1))
POLYGONS = Rule(limits=(*(Limit(0.0, polygon_m=at, robot_polygon_m=at) for at in SIDES), Limit(0.4, polygon_m=AROUND)))
CELLS = {
    "distance": ("box-picking", {}),
    "polygons": ("box-picking", {"rule": POLYGONS}),
    "fields": ("scanner-fields", {"people": "tracker"}),
}


@dataclass(frozen=True)
class Pair:
    """One pair of logs: the cell, how the clocks differ, and how they were written."""

    cell: str
    seed: int
    late_s: float
    drift: float
    stated: bool
    frame: bool
    files: int
    restart: bool
    noise_m: float
    lost: float
    slow: bool


class Judged(NamedTuple):
    """Whether a lag was found, the largest error in the middle and anywhere, s, and what was said."""

    found: bool
    middle_s: float
    worst_s: float
    certain_and_wrong: bool
    called_wrong: bool


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--pairs", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=7000)
    parser.add_argument("--align", default="logs")
    asked = parser.parse_args()
    rows: dict[str, list[tuple[Judged, Judged]]] = {cell: [] for cell in CELLS}
    for number in range(asked.first, asked.first + asked.pairs):
        pair = drawn(number, asked.seed)
        with tempfile.TemporaryDirectory() as folder:
            wrong, right = measured(pair, Path(folder), asked.align)
        rows[pair.cell].append((wrong, right))
        print(number, pair, wrong, f"right called wrong: {right.called_wrong}", sep=" | ", flush=True)
    table = Table(
        "cell", "pairs", "found", "median error, s", "worst at an end, s", "certain, wrong", "right called wrong"
    )
    for cell, mine in rows.items():
        found = [wrong for wrong, _ in mine if wrong.found]
        table.add_row(
            cell,
            str(len(mine)),
            str(len(found)),
            f"{np.median([one.middle_s for one in found] or [np.nan]):.3f}",
            f"{max([one.worst_s for one in found], default=np.nan):.2f}",
            str(sum(wrong.certain_and_wrong for wrong, _ in mine)),
            str(sum(right.called_wrong for _, right in mine)),
        )
    Console(width=120).print(table)


def drawn(number: int, seed: int) -> Pair:
    """Return a pair at random."""
    rng = np.random.default_rng([seed, number])
    stated = bool(number // 3 % 2)
    return Pair(
        cell=list(CELLS)[number % 3],
        seed=seed + number,
        late_s=float(rng.choice([-1, 1]) * rng.uniform(2.0, 3600.0)),
        drift=float(rng.uniform(-100e-6, 100e-6)),
        stated=stated,
        frame=bool(rng.random() < 0.5),
        files=int(rng.integers(1, 3)),
        restart=not stated and bool(rng.random() < 0.4),
        noise_m=float(rng.uniform(0.0, 0.05)),
        lost=float(rng.uniform(0.0, 0.15)),
        slow=bool(rng.random() < 0.25),
    )


def measured(pair: Pair, folder: Path, align: str) -> tuple[Judged, Judged]:
    """Return what was found of the pair, and of the same logs on right clocks."""
    scene, how = CELLS[pair.cell]
    count = 60 if scene == "scanner-fields" else EXECUTIONS
    ramps = {"ramp_down_per_s": 1.0, "ramp_up_per_s": 0.3} if pair.slow else {}
    options = SimulationOptions(
        delta_m=pair.noise_m, dropout=pair.lost, executions_per_session=count, **how, **ramps, latency_s=1e-4
    )
    made = simulate(scene, folder / "made", executions=EXECUTIONS, seed=pair.seed, options=options)
    wrong = judged(pair, made, folder / "wrong", align, pair.late_s, pair.drift)
    return wrong, judged(pair, made, folder / "right", "", 0.0, 0.0)


def judged(pair: Pair, made: Path, folder: Path, align: str, late_s: float, drift: float) -> Judged:
    """Return what ingest finds and says of the logs, with the tracker's clock off by an offset and a drift."""
    logs = folder / "logs"
    logs.mkdir(parents=True)
    (session,) = made.glob("session_*")
    robot = pl.read_csv(session / "robot.csv", separator=" ")[::THIN_ROBOT]
    since_s = robot["timestamp"].to_numpy() - START_S
    half_s = since_s[len(since_s) // 2]
    shown_s = since_s + (EPOCH_S if pair.stated else START_S)
    if pair.restart:
        shown_s = np.where(since_s < half_s, shown_s, since_s - half_s + RESTARTED_S)
    robot.with_columns(timestamp=pl.Series(shown_s)).write_csv(logs / "robot.csv", separator=" ")
    true_s, xyz_m = track(session / "operator.csv")
    base_s = EPOCH_S if pair.stated else 70_000.0
    log_s = true_s * (1.0 + drift) + base_s + late_s
    if not pair.stated and not late_s:  # a common start that is right
        true_s, log_s, xyz_m = (rows[true_s >= 0.0] for rows in (true_s, log_s, xyz_m))
    for number, rows in enumerate(np.array_split(np.arange(len(log_s)), pair.files)):
        table = pl.DataFrame({"t": log_s[rows], **dict(zip("xyz", xyz_m[rows].T, strict=True))}).fill_nan(None)
        table.write_csv(logs / f"people_{number}.csv", float_precision=4)
    ingest([logs], folder / "d", cell=cell_of(made, pair), **({"align_clocks": align} if align else {}))
    errors, said, sure, aligned_s = [], [], [], 0.0
    recordings = Dataset.open(folder / "d").recordings
    for one in recordings:
        if "people" not in one.tables:
            said += [note.code for note in one.clock.warnings]
            continue
        own = next(other for other in recordings if other.session == one.session and other.clock.method == "own")
        late_part_s = half_s if pair.restart and own.first_s < START_S else 0.0
        begin, end = (float(np.clip(t, late_part_s, since_s[-1])) for t in (true_s[0], true_s[-1]))
        lasts = [one.first_s, one.last_s]
        mine = (np.clip((np.array(lasts) - base_s - late_s) / (1.0 + drift), begin, end)).tolist()
        until = half_s if pair.restart and not late_part_s else since_s[-1]
        mine = [min(mine[0], until), min(mine[1], until)]
        if mine[1] - mine[0] < 60.0:
            continue  # a file that does not belong to this part
        at = np.array([np.mean(mine), *mine])
        seen = one.clock.rate * (at * (1.0 + drift) + base_s + late_s) + one.clock.offset_s
        errors.append(np.abs(seen - (at - late_part_s)))
        aligned_s = max(aligned_s, float(errors[-1][0])) if one.clock.method == "logs" else aligned_s
        codes = [note.code for note in one.clock.warnings]
        said += codes
        test = getattr(one.clock, "test", None)
        certain = one.clock.method == "coarse" if test is None else one.clock.method == "logs" and test.certain
        sure.append(bool(certain and errors[-1][0] > max(GOOD_S, 3.0 * (one.clock.residual_s or 0.0))))
    middle_s, worst_s = max(error[0] for error in errors), max(error.max() for error in errors)
    named = any(code in ("clock-contradicted", "clock-apart", "clock-future") for code in said)
    moved = not late_s and aligned_s > 1.0
    return Judged(bool(middle_s <= GOOD_S), float(middle_s), float(worst_s), any(sure), named or bool(moved))


def track(take: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return true time, s, and position, z up, m, of the frames of a take."""
    lines = take.read_text("utf-8").splitlines()[HEAD_LINES::THIN_TRACKER]
    rows = np.array([[float(cell or "nan") for cell in line.split(",")] for line in lines])
    x, up, z = rows[:, -3:].T
    return rows[:, 1] - LEAD_S, np.column_stack([x, -z, up])


def cell_of(made: Path, pair: Pair) -> Cell:
    """Return the cell file: nothing about the tracker's clock; its frame, if known."""
    cell = load_cell(made / "cell.toml")
    layout = {"delimiter": ",", "time": "t", "x": "x", "y": "y", "z": "z", "time_unit": "s"}
    layout |= {"clock": "epoch" if pair.stated else "uptime"}
    frame = Frame(xyz_m=(1.4, -2.6, -0.8), rotation=turned(35.0)) if pair.frame else None
    people = Source("people_*.csv", adapter="csv", role="people", map=layout, frame=frame)
    return Cell(sources=(Source("robot.csv", role="robot"), people), places=cell.places)


def turned(yaw_deg: float) -> tuple[tuple[float, ...], ...]:
    """Return the rotation about the vertical."""
    cos, sin = float(np.cos(np.deg2rad(yaw_deg))), float(np.sin(np.deg2rad(yaw_deg)))
    return ((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0))


if __name__ == "__main__":
    main()
