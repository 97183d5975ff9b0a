"""One small simulation per scene, ingested once, for all tests of the core; and small robot logs written by hand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from ingested import ROUND_TRIP
from made_once import made_once, simulated
from stated_clocks import are_tested as clocks_are_tested

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest import registry
from cyclekit.ingest.ingest import ingest

EXECUTIONS = {"box-picking": 4, "pick-and-package": 4, "laser-zones": 6, "scanner-visits": 6}
ROBOT_START_S = 152.512
"""What the simulated controller's clock shows when a session begins."""


@dataclass(frozen=True)
class SimulatedCell:
    """Logs with their truth, and the dataset made of them."""

    scene: str
    logs: Path
    dataset: Dataset

    @cached_property
    def executions(self) -> pl.DataFrame:
        """The true executions, one row each."""
        return pl.read_parquet(self.logs / "truth" / "executions.parquet")

    @cached_property
    def tasks(self) -> pl.DataFrame:
        """The true tasks."""
        return pl.read_parquet(self.logs / "truth" / "tasks.parquet")

    @cached_property
    def samples(self) -> pl.DataFrame:
        """The truth at 10 Hz."""
        return pl.read_parquet(self.logs / "truth" / "samples.parquet")

    @property
    def routes(self) -> list[list[str]]:
        """The places of every true execution."""
        return [row.split(",") for row in self.executions["sequence"]]

    @property
    def routes_found(self) -> list[list[str]]:
        """The places of every execution that the dataset holds."""
        return [list(entry.places) for entry in self.dataset.card.executions]


class Cells:
    """Simulated cells, made when first asked for and kept for the session; to be read, not changed."""

    def __init__(self, factory: pytest.TempPathFactory) -> None:
        self._factory = factory
        self._opened: dict[tuple[Path, bool], SimulatedCell] = {}

    def __call__(self, scene: str, executions: int | None = None, *, seed: int = 3, **options: Any) -> SimulatedCell:
        logs = self.logs(scene, executions, seed=seed, **options)
        key = logs, clocks_are_tested()
        if key not in self._opened:
            name = f"{logs.parent.name}_dataset{'_of_tested_clocks' * key[1]}"
            made = made_once(self._factory, name, lambda place: ingest([logs], place / "dataset")) / "dataset"
            self._opened[key] = SimulatedCell(scene, logs, Dataset.open(made))
        return self._opened[key]

    def logs(self, scene: str, executions: int | None = None, *, seed: int = 3, **options: Any) -> Path:
        """Return the logs of a cell, without a dataset made of them."""
        return simulated(self._factory, scene, executions or EXECUTIONS[scene], seed, **options)


@pytest.fixture(scope="session")
def cells(tmp_path_factory: pytest.TempPathFactory) -> Cells:
    return Cells(tmp_path_factory)


@pytest.fixture(scope="session")
def boxes(cells: Cells) -> SimulatedCell:
    """The box-picking cell."""
    return cells("box-picking")


@pytest.fixture
def robot_log() -> Any:
    """Return a writer of UR logs: a robot that goes along the x axis, 125 rows a second.

    `robot_log(path, [("stand", s), ("move", x_m), ("halt", s), ...])`: stand so long free, go to x at 0.5 m/s, be
    halted so long where it is. `("flip", n)` turns output n. ("creep", s): the scaling rises from 0 to 0.3 meanwhile,
    and the robot goes on no faster than its noise. Speeds are those of the position.
    """

    def write(path: Path, doing: list[tuple[str, float]], *, scaling: bool = True, x_m: float = 0.0) -> Path:
        rows, t, outputs = [], 10.0, 0
        for what, amount in doing:
            if what == "flip":
                outputs ^= 1 << int(amount)
                continue
            steps = round((abs(amount - x_m) / 0.5 if what == "move" else amount) * 125)
            speed = (amount - x_m) / steps * 125 if what == "move" and steps else 0.0
            for step in range(steps):
                free = {"halt": 0.0, "creep": 0.3 * step / steps}.get(what, 1.0)
                rows.append((t, x_m, speed, free, outputs))
                t, x_m = t + 0.008, x_m + speed * 0.008
        rows.append((t, x_m, 0.0, *rows[-1][3:]))
        t_s, x, v, s, bits = (pl.Series(column) for column in zip(*rows, strict=True))
        columns = {"timestamp": t_s}
        columns |= {f"actual_TCP_pose_{i}": x if i == 0 else 0.0 * x for i in range(6)}
        columns |= {f"actual_TCP_speed_{i}": v if i == 0 else 0.0 * v for i in range(6)}
        columns |= {f"actual_q_{i}": x if i == 0 else 0.0 * x for i in range(6)}
        if scaling:
            columns |= {"speed_scaling": s, "target_speed_fraction": 0.0 * s + 1.0}
        if bits.n_unique() > 1:
            columns["actual_digital_output_bits"] = bits
        columns["runtime_state"] = pl.Series([2] * len(rows))
        path.parent.mkdir(parents=True, exist_ok=True)
        pl.DataFrame(columns).write_csv(path, separator=" ", line_terminator="\r\n", float_precision=7)
        return path

    return write


@pytest.fixture
def motive_log() -> Any:
    """Return a writer of Motive logs, z up already turned away: points are (x, y, z) with z up, 50 Hz from 0."""

    def write(path: Path, points: list[tuple[float, float, float] | None], *, name: str = "Operator") -> Path:
        about = "Format Version,1.23,Take Name,t,Capture Frame Rate,50.0,Export Frame Rate,50.0"
        about += f",Total Exported Frames,{len(points)},Rotation Type,Quaternion,Length Units,Meters"
        lines = [about + ",Coordinate Space,Global", "", ",Type" + ",Rigid Body" * 7, ",Name" + f",{name}" * 7]
        lines += [",ID" + ',"6D79"' * 7, "," + ",Rotation" * 4 + ",Position" * 3, "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z"]
        for frame, point in enumerate(points):
            cells = (
                ["0.0", "0.0", "0.0", "1.0", *(f"{v:.6f}" for v in (point[0], point[2], -point[1]))]
                if point
                else [""] * 7
            )
            lines.append(",".join([str(frame), f"{frame / 50:.6f}", *cells]))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\r\n".join(lines) + "\r\n", encoding="utf-8", newline="")
        return path

    return write


@pytest.fixture
def three_runs(tmp_path: Path, robot_log: Any) -> Path:
    """A folder of three robot logs."""
    for number in range(3):
        robot_log(tmp_path / "logs" / f"run_{number}.csv", [*ROUND_TRIP, ("stand", 0.1 * number)])
    return tmp_path / "logs"


@pytest.fixture
def large(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every log counts as one that takes long to read."""
    monkeypatch.setattr("cyclekit.ingest.read.resume.WORTH_BYTES", 0)


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the logs that adapters read while the test runs."""
    names: list[str] = []
    for entry in registry.adapters().values():
        for method in ("read", "stream"):
            read = getattr(entry.adapter, method, None)

            def counted(path: Path, options: Any, read: Any = read) -> Any:
                names.append(path.name)
                return read(path, options)

            if read is not None:
                monkeypatch.setattr(entry.adapter, method, counted, raising=False)
    return names


@pytest.fixture
def logs(tmp_path: Path, robot_log: Any) -> Path:
    """Two logs, one of which was cut in its last line."""
    whole = robot_log(tmp_path / "logs" / "a.csv", ROUND_TRIP)
    cut = robot_log(tmp_path / "logs" / "b.csv", ROUND_TRIP)
    cut.write_bytes(cut.read_bytes()[:-9])
    assert whole.is_file()
    return tmp_path / "logs"
