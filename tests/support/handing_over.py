"""Logs of two robots beside each other: one brings parts, the other takes them, and signals say when.

Written as UR's `record.py` writes them, 25 rows a second. Only the numbers are drawn: how long each robot works.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.schema import Floats, Vector

EPOCH_S, RATE_HZ = 1_715_668_200.0, 25.0
BUSY_S, MOVE_S, TAKE_S = 4.0, 1.6, 0.8
"""Mean time of each robot's own work, of a move, and of taking a part, s."""


@dataclass(frozen=True)
class HandingOver:
    """Two robots.

    Attributes:
        parts: How many parts are handed over.
        seed: Draws the times.
        wired: Whose outputs are inputs of the other: of both, of the first one only, or of neither.
        belt_s: The part, and its signal, reach the second robot so much later; the first one does not wait for it.
        even: Whether all parts take equally long.
        plc: Whether a PLC logs the outputs of both, on the clock of the first one.
    """

    parts: int = 24
    seed: int = 1
    wired: str = "both"
    belt_s: float = 0.0
    even: bool = False
    plc: bool = False

    def write(self, folder: Path, *, late_s: float = 0.0, days: int = 0) -> None:
        """Write both logs, of a later day; the clock of the second is late, s."""
        folder.mkdir(parents=True, exist_ok=True)
        brings, takes, until_s = self._times()
        out_a, out_b = brings[:, [1, 2]], takes[:, [1, 2]]
        belt = out_a + self.belt_s + (np.array([0.0, 0.4]) if self.belt_s else 0.0)
        inputs = {"both": (out_b, belt), "first": (None, belt), "neither": (None, None)}[self.wired]
        t_s = np.arange(round(until_s * RATE_HZ)) / RATE_HZ
        robots = (brings, out_a, inputs[0], 0.5, 0.0), (takes, out_b, inputs[1], -0.5, late_s)
        for name, (moves, out, into, side, late) in zip("ab", robots, strict=True):
            log = _robot(t_s, moves, out, into, side).with_columns(pl.col("timestamp") + 86400.0 * days + late)
            log.write_csv(folder / f"robot_{name}.csv", separator=" ")
        if self.plc:
            rows = [
                (EPOCH_S + 86400.0 * days + at_s, signal, value)
                for signal, spans in (("part_there", out_a), ("part_taken", out_b))
                for span in spans
                for value, at_s in zip((1, 0), span, strict=True)
            ]
            trace = pl.DataFrame(sorted(rows), schema=["t", "signal", "value"], orient="row")
            trace.write_csv(folder / "plc.csv", float_precision=3)

    def _times(self) -> tuple[Floats, Floats, float]:
        """Return when each robot sets out, says that it is there, is free, and is back (parts, 4), s, and the end."""
        rng = np.random.default_rng(self.seed)
        brings, takes, free_a, free_b = [], [], 1.0, 1.0
        for _ in range(self.parts):
            busy_a, busy_b = (BUSY_S, BUSY_S) if self.even else BUSY_S * rng.uniform(0.3, 1.7, 2)
            go_a = free_a + busy_a
            there_a = go_a + MOVE_S
            go_b = max(there_a + self.belt_s, free_b) + 0.1
            there_b = go_b + MOVE_S
            done_a = there_a + 1.0 if self.belt_s else there_b + TAKE_S
            brings.append([go_a, there_a, done_a, done_a + MOVE_S])
            takes.append([go_b, there_b, there_b + TAKE_S + 0.3, there_b + TAKE_S + 0.3 + MOVE_S])
            free_a, free_b = brings[-1][3], takes[-1][3] + busy_b
        return np.array(brings), np.array(takes), max(free_a, free_b) + 2.0


def _robot(t_s: Vector, moves: Floats, out: Floats, into: Floats | None, side: float) -> pl.DataFrame:
    """Return the log of a robot that goes from its own place to the common one and back."""
    at = np.zeros(len(t_s))
    for go, there, away, back in moves:
        at += np.clip((t_s - go) / (there - go), 0.0, 1.0) - np.clip((t_s - away) / (back - away), 0.0, 1.0)
    on = [np.zeros(len(t_s), int) if bits is None else _during(t_s, bits) for bits in (out, into)]
    columns = {
        "timestamp": t_s + EPOCH_S, "actual_TCP_pose_0": side * (1.0 - at), "actual_TCP_pose_1": 0.3 + 0.2 * at,
        "actual_TCP_pose_2": 0.4 - 0.1 * at, "speed_scaling": np.ones(len(t_s)),
        "target_speed_fraction": np.ones(len(t_s)), "runtime_state": np.full(len(t_s), 2),
        "actual_digital_output_bits": on[0],
    }  # fmt: skip
    return pl.DataFrame(columns | ({} if into is None else {"actual_digital_input_bits": 2 * on[1]}))


def _during(t_s: Vector, spans: Floats) -> Floats:
    return sum(((t_s >= begin) & (t_s < end)).astype(int) for begin, end in spans)
