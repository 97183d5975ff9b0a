"""Logged cells with their models, and fresh executions, shared by the benchmarks and stored in a folder.

A cell is simulated, ingested and learned once, then reused. Fresh executions are the ground truth; they have other
random streams than the logs.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.networks.saved import TrainedModel, load_model, save_model
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import train
from cyclekit_sim import SimulationOptions, random_sequence, simulate
from cyclekit_sim.choices import LOGGED
from cyclekit_sim.plan import prepare, run_alone
from cyclekit_sim.simulate import set_up
from cyclekit_sim.truth import task_rows

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

FRESH_SEED = 1_000_000
"""First seed of sequences, different from those of the logs."""
JUDGED_SEED = 3_000_000
"""First seed of the sequences and fresh executions of `answer.py`; the method of its intervals was chosen on others."""
PLAIN = SimulationOptions()
HARD = SimulationOptions(delta_m=0.05, dropout=0.1, log_override=False, clock_offset_s=0.05)
"""Tracker noise, lost frames, no scaling in the log, and an undocumented clock error of 50 ms."""


@dataclass(frozen=True)
class Logged:
    """A logged cell with its dataset and model."""

    scene: str
    dataset: Dataset
    model: TrainedModel


def dataset_of(
    work: Path, scene: str, executions: int, *, seed: int = 1, options: SimulationOptions = PLAIN, kind: str = "plain"
) -> Dataset:
    """Return the dataset of a logged cell; made once per folder `work`."""
    folder = work / f"{scene}-{executions}-{seed}-{kind}"
    if not (folder / "dataset").is_dir():
        simulate(scene, folder / "logs", executions=executions, seed=seed, options=options)
        ingest([folder / "logs"], folder / "dataset")
    return Dataset.open(folder / "dataset")


def logged(
    work: Path,
    scene: str,
    executions: int,
    *,
    seed: int = 1,
    options: SimulationOptions = PLAIN,
    kind: str = "plain",
    rules: bool = False,
    epochs: int | None = None,
) -> Logged:
    """Return a logged cell with its `now` model, with `rules` also a rule; made once per folder `work`.

    If the rule replaces the network, few `epochs` are enough.
    """
    dataset = dataset_of(work, scene, executions, seed=seed, options=options, kind=kind)
    folder = dataset.path.parent / ("model-and-rule" if rules else "model")
    if not (folder / "model.json").is_file():
        save_model(folder, train(dataset, ModelSpec.of(problem="now", seed=0, epochs=epochs), rules=rules))
    return Logged(scene, dataset, load_model(folder))


def newer_logs(work: Path, scene: str, kind: str, *, executions: int = 20, seed: int = 77) -> Dataset:
    """Return logs with other operators of the current scene in BUILT_IN; made once per folder `work` and kind."""
    folder = work / f"{scene}-newer-{executions}-{seed}-{kind}"
    if not (folder / "dataset").is_dir():
        simulate(scene, folder / "logs", executions=executions, seed=seed)
        ingest([folder / "logs"], folder / "dataset")
    return Dataset.open(folder / "dataset")


def average_model(work: Path, cell: Logged) -> TrainedModel:
    """Return the cell's average-scaling network (horizon 2 s, the length of a task); trained once."""
    folder = cell.dataset.path.parent / "average"
    if not (folder / "model.json").is_file():
        save_model(folder, train(cell.dataset, ModelSpec.of(problem="average", horizon_s=2.0, seed=0)))
    return load_model(folder)


def unseen_sequences(dataset: Dataset, scene: str, count: int, *, first: int = FRESH_SEED) -> list[TaskSequence]:
    """Return `count` random sequences of the scene that were never logged but whose tasks all were."""
    followed = {entry.places for entry in dataset.card.executions}
    tasks = set(dataset.tasks()["task"])
    found: list[TaskSequence] = []
    seed = first
    while len(found) < count:
        sequence = TaskSequence(f"sequence {len(found) + 1}", tuple(random_sequence(scene, seed)))
        seed += 1
        if sequence.places not in followed and tasks.issuperset(sequence.tasks):
            found.append(sequence)
    return found


def fresh(
    work: Path,
    scene: str,
    places: Sequence[str],
    executions: int,
    *,
    kind: str = "",
    paired: bool = False,
    logged_seed: int | None = None,
    options: SimulationOptions = PLAIN,
) -> pl.DataFrame:
    """Return fresh executions of a sequence, one row per task; simulated once per folder `work`.

    `paired`: the same operators for every sequence, so that few executions suffice to compare sequences. `logged_seed`:
    the operators of the logs of this seed, in a scene that is not recorded in one piece.

    Returns:
        Columns execution, index (of the task), s (duration).
    """
    name = hashlib.sha256(" ".join([scene, kind, str(executions), *places]).encode()).hexdigest()[:16]
    of_logs = "" if logged_seed is None else f"-logged-{logged_seed}"
    file = work / "fresh" / f"{name}{'-paired' if paired else ''}{of_logs}.parquet"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        seed = JUDGED_SEED + (0 if paired else int(name[:6], 16))
        cell, options = set_up(scene, options)  # with the response and the fields of the scene, as in the logs
        run = prepare(cell, seed if logged_seed is None else logged_seed, options, executions=executions, places=places)
        run = run if logged_seed is None else replace(run, domain=LOGGED)
        rows = pl.DataFrame([row for trace in run_alone(run, run.executions) for row in task_rows(trace, 0.0)])
        rows.select("execution", "index", s=pl.col("end_s") - pl.col("start_s")).write_parquet(file)
    return pl.read_parquet(file)


def durations_of(rows: pl.DataFrame) -> NDArray[np.float64]:
    """Return the duration of each of the `fresh` executions, shape (executions,), s."""
    return rows.group_by("execution", maintain_order=True).agg(pl.col("s").sum())["s"].to_numpy()


def means_by_task(rows: pl.DataFrame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the mean duration of each task over `fresh` executions and its standard error, shape (tasks,) each, s."""
    found = rows.group_by("index").agg(mean=pl.col("s").mean(), off=pl.col("s").std() / pl.len().sqrt()).sort("index")
    return found["mean"].to_numpy(), found["off"].to_numpy()
