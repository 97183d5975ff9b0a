"""What the measurements of `answer.py` share: logged cells with their models, and fresh executions, kept in a folder.

A cell is simulated, ingested and learned once; asked for again it is opened. Fresh executions are the truth: they come
from random streams apart from those of the logs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.dataset import Dataset
from cyclekit.ingest import ingest
from cyclekit.models.saved import TrainedModel, load_model, save_model
from cyclekit.models.spec import ModelSpec
from cyclekit.sequences import TaskSequence
from cyclekit.train import train
from cyclekit_sim import SimulationOptions, random_sequence, simulate, simulate_sequence
from cyclekit_sim.plan import prepare, run_alone
from cyclekit_sim.scenes import BUILT_IN
from cyclekit_sim.truth import task_rows

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

FRESH_SEED = 1_000_000
"""Seeds of the fresh executions start here, far from those of the logs."""
PLAIN = SimulationOptions()
HARD = SimulationOptions(delta_m=0.05, dropout=0.1, log_override=False, clock_offset_s=0.05)
"""Tracker noise, lost frames, no scaling in the log, and 50 ms of clock error that nobody tells."""


@dataclass(frozen=True)
class Logged:
    """A cell that was logged, and what was learned from it."""

    scene: str
    dataset: Dataset
    model: TrainedModel


def logged(
    work: Path, scene: str, executions: int, *, seed: int = 1, options: SimulationOptions = PLAIN, kind: str = "plain"
) -> Logged:
    """Return a logged cell with its `now` model; made once per folder `work`."""
    folder = work / f"{scene}-{executions}-{seed}-{kind}"
    if not (folder / "model" / "model.json").is_file():
        simulate(scene, folder / "logs", executions=executions, seed=seed, options=options)
        dataset = ingest([folder / "logs"], folder / "dataset").dataset
        save_model(folder / "model", train(Dataset.open(dataset), ModelSpec.of(problem="now", seed=0)))
    return Logged(scene, Dataset.open(folder / "dataset"), load_model(folder / "model"))


def newer_logs(work: Path, scene: str, kind: str, *, executions: int = 20, seed: int = 77) -> Dataset:
    """Return logs of other operators, of the scene as it is now in BUILT_IN; made once per folder `work` and kind."""
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


def unseen_sequences(dataset: Dataset, scene: str, count: int) -> list[TaskSequence]:
    """Return `count` random sequences of the scene whose tasks were all logged and which no execution followed."""
    followed = {tuple(entry["places"]) for entry in dataset.card["executions"]}
    tasks = set(dataset.tasks()["task"])
    found: list[TaskSequence] = []
    seed = FRESH_SEED
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
    options: SimulationOptions = PLAIN,
    kind: str = "",
    paired: bool = False,
) -> pl.DataFrame:
    """Return fresh executions of a sequence, one row each; simulated once per folder `work`.

    `paired`: the same operators for every sequence, so that sequences can be compared by few executions.
    """
    import hashlib

    name = hashlib.sha256(" ".join([scene, kind, str(executions), *places]).encode()).hexdigest()[:16]
    name += "-paired" if paired else ""
    file = work / "fresh" / f"{name}.parquet"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        seed = FRESH_SEED + (0 if paired else int(name[:6], 16))
        simulate_sequence(scene, places, executions=executions, seed=seed, options=options).write_parquet(file)
    return pl.read_parquet(file)


def fresh_tasks(work: Path, scene: str, places: Sequence[str], executions: int) -> list[float]:
    """Return the mean duration of each task of a sequence over fresh executions, s; simulated once per folder."""
    import hashlib

    name = hashlib.sha256(" ".join([scene, "tasks", str(executions), *places]).encode()).hexdigest()[:16]
    file = work / "fresh" / f"{name}-tasks.parquet"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        seed = FRESH_SEED + int(name[:6], 16)
        run = prepare(BUILT_IN[scene], seed, PLAIN, executions=executions, places=places)
        pl.DataFrame([row for trace in run_alone(run, run.executions) for row in task_rows(trace, 0.0)]).write_parquet(
            file
        )
    rows = pl.read_parquet(file).with_columns(s=pl.col("end_s") - pl.col("start_s"))
    return rows.group_by("index").agg(pl.col("s").mean()).sort("index")["s"].to_list()
