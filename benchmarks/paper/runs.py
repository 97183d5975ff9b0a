"""Trains and evaluates all entries of the plan; each result is a separate file, so a run can be continued."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from benchmarks.paper.floors import bayes, plug_in
from benchmarks.paper.plan import FLOORS, RIVALS_AHEAD, SCENES, Entry, entries
from benchmarks.paper.rivals import predict_by
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, DatasetError, ShapeError
from cyclekit.learning.networks.metrics import reliability
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.training import train
from cyclekit.learning.windows import Samples, build_samples
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.parallel.one_thread import one_thread
from cyclekit.storage.atomic import write_text

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit.learning.networks.saved import TrainedModel

    Prepare = Callable[[str, int, Path], object]
    Progress = Callable[[float, str], None]

RESULTS = "results"
_CELLS = 25


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes:
        executions: Number of executions per scene and seed.
        seeds: Seeds of simulation, noise, split and training.
        scenes: Names of the scenes.
        steps: Number of steps of every training; None = default.
        only: Only entries whose key contains this text; empty = all.
        done: Use existing results only, run nothing.
    """

    executions: int = 1000
    seeds: tuple[int, ...] = (1, 2, 3)
    scenes: tuple[str, ...] = SCENES
    steps: int | None = None
    only: str = ""
    done: bool = False


class NoisyDataset(Dataset):
    """A dataset with white noise on the operator's position, the same at every read."""

    def __init__(self, dataset: Dataset, delta_m: float, seed: int) -> None:
        """Add noise of `delta_m` per axis, m."""
        super().__init__(dataset.path, dataset.card, dataset.place)
        self._clean, self._delta_m, self._seed = dataset, delta_m, seed

    @cached_property
    def _noisy(self) -> pl.DataFrame:
        frame = self._clean.samples()
        noise = np.random.default_rng(self._seed).normal(0.0, self._delta_m or 0.0, (frame.height, 3))
        columns = [pl.col(f"human_{axis}_m") + pl.Series(noise[:, i]) for i, axis in enumerate("xyz")]
        return frame.with_columns(columns)

    def samples(self, executions: Sequence[str] | None = None, columns: Sequence[str] | None = None) -> pl.DataFrame:
        """Return the samples with noise, as `Dataset.samples`."""
        frame = self._noisy if executions is None else self._noisy.filter(pl.col("execution").is_in(list(executions)))
        return frame if columns is None else frame.select(columns)


def benchmark_paper(
    settings: Settings, out: Path, prepare: Prepare, progress: Progress, engine: Engine = LOCAL
) -> tuple[list[dict[str, Any]], list[str]]:
    """Run the missing entries; return all results, and the failed entries with their reasons.

    A failed training does not stop the others, and is repeated the next time.

    Args:
        settings: Settings of the run.
        out: Output folder; `out/results` holds one JSON file per number.
        prepare: Simulates and ingests `scene` with `seed` into `dataset` of a folder, and writes `truth.json` there,
            unless both exist.
        progress: Called with the share done and the present work.
        engine: Engine for the tasks: first each missing dataset, then each missing number.
    """
    wanted = [
        _Wanted(scene, seed, entry)
        for seed in settings.seeds
        for scene in settings.scenes
        for entry in entries()
        if settings.only in f"{scene}_{entry.key}"
    ]
    if settings.done:
        wanted = [each for each in wanted if _file(settings, out, each).is_file()]
    _cell.cache_clear()
    files = [_file(settings, out, each) for each in wanted]
    missing = [each for each, file in zip(wanted, files, strict=True) if not file.is_file()]
    cells = list(dict.fromkeys((each.scene, each.seed) for each in missing))
    steps, done = len(cells) + len(wanted), len(wanted) - len(missing)
    for made in engine.map(partial(_prepared, prepare, out, settings.executions), cells):
        made.get()
        done += 1
        progress(done / steps, "{}, seed {}: dataset".format(*made.item))
    refused = []
    for judged in engine.map(partial(_judge, settings, out), missing):
        which = f"{judged.item.scene}, seed {judged.item.seed}: {judged.item.entry.key}"
        try:
            judged.get()
        except ConfigError as error:
            refused.append(f"{which}: {error.seen}")
        done += 1
        progress(done / steps, which)
    return [json.loads(file.read_text(encoding="utf-8")) for file in files if file.is_file()], refused


@dataclass(frozen=True)
class _Wanted:
    """One number of the plan to compute."""

    scene: str
    seed: int
    entry: Entry


def _file(settings: Settings, out: Path, each: _Wanted) -> Path:
    steps = settings.steps or "default"
    return out / RESULTS / f"{each.scene}_{settings.executions}_{each.seed}_{steps}_{each.entry.key}.json"


def _folder(out: Path, scene: str, executions: int, seed: int) -> Path:
    return out / f"{scene}-{executions}-{seed}"


def _prepared(prepare: Prepare, out: Path, executions: int, cell: tuple[str, int]) -> None:
    prepare(*cell, _folder(out, cell[0], executions, cell[1]))


@one_thread()
def _judge(settings: Settings, out: Path, each: _Wanted) -> None:
    """Compute one number and write its file; the last cell is cached for the next call."""
    entry = each.entry
    place = _folder(out, each.scene, settings.executions, each.seed) / "dataset"
    cell = _cell(place, entry.delta_m, each.seed, settings.steps)
    about = {"scene": each.scene, "seed": each.seed, "executions": settings.executions}
    file = _file(settings, out, each)
    file.parent.mkdir(parents=True, exist_ok=True)
    write_text(file, json.dumps({**about, **vars(entry), **cell.judge(entry)}) + "\n")


@lru_cache(maxsize=1)
def _cell(place: Path, delta_m: float, seed: int, steps: int | None) -> _Cell:
    return _Cell(place, delta_m, seed, steps)


class _Cell:
    """Data of one scene, seed and noise for training and evaluation."""

    def __init__(self, place: Path, delta_m: float, seed: int, steps: int | None) -> None:
        self.dataset = NoisyDataset(Dataset.open(place), delta_m, seed)
        truth = place.parent / "truth.json"
        if not truth.is_file():
            raise DatasetError(f"{truth}: not there", cure="Remove the folder and run the benchmark again.")
        self.safety = json.loads(truth.read_text(encoding="utf-8"))["safety"]
        self.seed, self.steps, self.delta_m = seed, steps, delta_m

    def judge(self, entry: Entry) -> dict[str, Any]:
        """Return the errors of one entry on the held-out executions."""
        begin = time.perf_counter(), time.process_time()
        if entry.is_network:
            model = train(self.dataset, self._spec(entry))
            rows = self._rows(entry, list(model.card.held_out), model)
            predicted = model.predict(rows.model_inputs)
            result = _errors(predicted, rows) | _of_model(model, rows)
        else:
            learn, rows = (self._rows(entry, names) for names in self._split())
            result = _errors(self._rival(entry, learn, rows), rows)
        took = time.perf_counter() - begin[0], time.process_time() - begin[1]
        return result | {"seconds": round(took[0], 2), "cpu_seconds": round(took[1], 2)}

    def _spec(self, entry: Entry) -> ModelSpec:
        settings: dict[str, Any] = {"features": "positions", **dict(entry.settings)}  # as in the literature
        if self.steps is not None:
            rows = self.dataset.samples().height * 0.72  # share left for training after two splits
            settings["epochs"] = max(round(self.steps / max(rows // 1024, 1)), 1)
        return ModelSpec.of(entry.problem, entry.name, entry.horizon_s or None, seed=self.seed, **settings)

    def _split(self) -> tuple[list[str], list[str]]:
        """Return the training executions (with those for validation), and the test executions."""
        from cyclekit.learning.windows import split_executions

        learn, test = split_executions(self.dataset.executions["execution"].to_list(), seed=self.seed)
        return list(learn), list(test)

    def _rows(self, entry: Entry, names: Sequence[str], model: TrainedModel | None = None) -> Samples:
        history, past = (2, 1) if model is None else model.history, entry.name == RIVALS_AHEAD[-1]
        if past:
            history = ModelSpec.of("ahead", "boosting").at_rate(self.dataset.rate_hz).history or history
        allow = () if model is None else model.weights.known
        frame = self.dataset.samples(list(names))
        levels = self.safety["levels"]
        return build_samples(
            frame,
            entry.problem,
            entry.horizon_s,
            levels,
            rate_hz=self.dataset.rate_hz,
            allow=allow,
            history=history,
            past=past,
        )

    def _rival(self, entry: Entry, learn: Samples, rows: Samples) -> NDArray[np.float64]:
        robot, human = rows.X[:, :3].astype(np.float64), rows.X[:, 3:6].astype(np.float64)
        if entry.name == FLOORS[0]:
            return plug_in(self.safety, robot, human)
        if entry.name == FLOORS[1]:
            return bayes(self.safety, robot, human, self.delta_m)
        names = [rows.executions[i] for i in np.unique(rows.execution)]
        scaling = self.dataset.samples(names)["scaling"].fill_null(1.0).to_numpy()
        if rows.before is None:
            raise ShapeError("a rival's rows need a history of two samples")
        last = scaling[rows.before[:, 0 if entry.problem == "now" else -1]]
        return predict_by(entry.name, learn, rows, self.safety["levels"], last)


def _errors(predicted: NDArray[np.float64], rows: Samples) -> dict[str, Any]:
    error = predicted - rows.scaling
    heat, _, _ = np.histogram2d(rows.scaling, predicted, bins=_CELLS, range=((0, 1), (0, 1)))
    return {
        "mse": float(np.mean(error**2)),
        "bias": float(np.mean(error)),
        "rows": len(rows),
        "variance": float(rows.scaling.var()),
        "heat": heat.astype(int).tolist(),
    }


def _of_model(model: TrainedModel, rows: Samples) -> dict[str, Any]:
    card = model.card
    metrics: dict[str, Any] = {} if card.metrics is None else {
        "mse_argmax": card.metrics.mse_argmax, "accuracy": card.metrics.accuracy
    }  # fmt: skip
    metrics |= {"temperature": card.temperature, "levels": list(model.levels)}
    if model.network == "classifier":
        on = rows.step >= 0
        found = reliability(model.probabilities(rows.X[on]), rows.step[on])
        metrics |= {"calibration_error": found.error, "reliability": vars(found)}
    if model.problem == "now":
        apart = np.linalg.norm(rows.X[:, :3] - rows.X[:, 3:6], axis=1)
        known = np.isfinite(apart)
        edges = np.linspace(0, 4, 81)
        at = np.digitize(apart[known], edges)
        count = np.maximum(np.bincount(at, minlength=82), 1)
        predicted = model.predict(rows.X[known])
        for name, values in (("true", rows.scaling[known]), ("predicted", predicted)):
            metrics[f"by_distance_{name}"] = (np.bincount(at, weights=values, minlength=82) / count).tolist()
        metrics["by_distance_rows"] = np.bincount(at, minlength=82).tolist()
    return metrics
