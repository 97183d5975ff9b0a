"""A small simulated cell to ask about, a model that knows its true safety function, and hand-made operator tracks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from made_once import made_once, simulated

from cyclekit.config import Cell, Source
from cyclekit.dataset.cards import CouplingCard, TrainingCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.validation.check import Check, check_rollout
from cyclekit.ingest.ingest import ingest

LEVELS, THRESHOLDS_M = (0.0, 0.25, 0.5, 0.75, 1.0), (1.2, 1.5, 1.9, 2.4)


class TrueStaircase:
    """Has of a trained model what a rollout asks of one; predicts the paper's staircase over the distance."""

    problem = "now"

    def __init__(self) -> None:
        self.card = TrainingCard()

    def predict(self, positions: np.ndarray) -> np.ndarray:
        apart_m = np.linalg.norm(positions[:, :3].astype(float) - positions[:, 3:], axis=1)
        return np.array(LEVELS)[np.searchsorted(THRESHOLDS_M, apart_m, side="left")]


class Constant:
    """Predicts one scaling wherever robot and operator are."""

    problem = "now"

    def __init__(self, scaling: float) -> None:
        self.card = TrainingCard()
        self.scaling = scaling

    def predict(self, positions: np.ndarray) -> np.ndarray:
        return np.full(len(positions), self.scaling)


class Coupled(Constant):
    """A model that was trained where one agent waits for the other."""

    def __init__(self, card: CouplingCard) -> None:
        super().__init__(1.0)
        self.card = TrainingCard(coupling=card)


@pytest.fixture(scope="session")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Sixteen executions of the box-picking cell."""
    logs = simulated(tmp_path_factory, "box-picking", 16, seed=4)
    made = made_once(tmp_path_factory, "sixteen_dataset", lambda place: ingest([logs], place / "dataset"))
    return Dataset.open(made / "dataset")


@pytest.fixture(scope="session")
def check(logged: Dataset) -> Check:
    """What the true safety function gives on them."""
    return check_rollout(TrueStaircase(), logged)


@pytest.fixture(scope="session")
def truth(tmp_path_factory: pytest.TempPathFactory) -> pl.DataFrame:
    """The true tasks of these executions."""
    return pl.read_parquet(simulated(tmp_path_factory, "box-picking", 16, seed=4) / "truth" / "tasks.parquet")


@pytest.fixture
def staircase() -> TrueStaircase:
    return TrueStaircase()


@pytest.fixture
def constant() -> type[Constant]:
    return Constant


def robot_text(halts_s: Sequence[float]) -> str:
    """Write a UR log: for each halt, 0 -> 1 m at 0.5 m/s with that halt in the middle, 0.6 s there, back, 0.6 s."""
    rows, t, x = [], 0.0, 0.0
    for halt in [None, *halts_s]:
        for goal, stand, speed in (
            [(0.0, 0.6, 0.0)] if halt is None else [(0.5, halt, 0.5), (1.0, 0.6, 0.5), (0.0, 0.6, -0.5)]
        ):
            for _ in range(round(abs(goal - x) / 0.5 * 125)):
                rows.append((t, x, speed, 1.0))
                t, x = t + 0.008, x + speed * 0.008
            x = goal
            for _ in range(round(stand * 125)):
                rows.append((t, x, 0.0, 0.0 if goal == 0.5 else 1.0))
                t += 0.008
    names = ["timestamp", *(f"actual_TCP_pose_{i}" for i in range(6)), *(f"actual_TCP_speed_{i}" for i in range(6))]
    names += [*(f"actual_q_{i}" for i in range(6)), "speed_scaling", "target_speed_fraction", "runtime_state"]
    lines = [" ".join(names)]
    for t, x, v, s in rows:
        lines.append(" ".join(map(str, [f"{t:.3f}", f"{x:.6f}", *[0] * 5, v, *[0] * 11, s, 1.0, 2])))
    return "\r\n".join(lines) + "\r\n"


@pytest.fixture
def hand_made(tmp_path: Path):
    """Return a maker of datasets: per session, the halts of its robot and its operator's track (t_s -> x, y)."""

    def made(sessions: Mapping[str, tuple[Sequence[float], Mapping[float, tuple[float, float]]]]) -> Dataset:
        for name, (halts, track) in sessions.items():
            folder = tmp_path / "logs" / name
            folder.mkdir(parents=True)
            (folder / "robot.csv").write_text(robot_text(halts), encoding="utf-8", newline="")
            t_s = np.arange(0.0, max(track), 0.02)
            x, y = (np.interp(t_s, list(track), [point[k] for point in track.values()]) for k in range(2))
            pl.DataFrame({"t": t_s, "x": x, "y": y, "z": 0 * x + 0.2}).write_csv(folder / "operator.csv")
        columns = {"time": "t", "time_unit": "s", "x": "x", "y": "y", "z": "z", "length_unit": "m"}
        source = Source("*/operator.csv", "csv", "people", clock_offset_s=0.0, map=columns)
        return Dataset.open(ingest([tmp_path / "logs"], tmp_path / "dataset", cell=Cell(sources=(source,))).dataset)

    return made
