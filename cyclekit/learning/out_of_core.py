"""Datasets larger than memory: subsets of executions, and training rows in files.

Levels, held-out errors and operator tracks need only a large part of the logs: executions are drawn at random until
they have as many rows as fit in memory. Training reads all others: its rows are built from the Parquet files part by
part and appended to plain files, which are memory-mapped and read block by block.
"""

from __future__ import annotations

import os
from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from cyclekit.errors import ConfigError, DatasetError
from cyclekit.learning.windows import Samples

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Singles

_IN_MEMORY_ROWS = 10_000_000
PART_ROWS = 250_000
"""Number of samples that are converted to rows at once."""


def memory_rows() -> int:
    """Return the number of samples processed in memory: 10 million, about 7 GB, or CYCLEKIT_MEMORY_ROWS.

    Raises:
        ConfigError: CYCLEKIT_MEMORY_ROWS is not a number of at least 1000.
    """
    given = os.environ.get("CYCLEKIT_MEMORY_ROWS")
    if not given:
        return _IN_MEMORY_ROWS
    if not given.isdecimal() or int(given) < 1000:
        raise ConfigError(f"CYCLEKIT_MEMORY_ROWS is {given!r}", cure="Set it to a number of samples, 1000 or more.")
    return int(given)


def rows_of(dataset: Dataset) -> int:
    """Return the approximate number of samples of a dataset, from the durations of its executions."""
    seconds = dataset.executions["duration_s"].sum()
    return round(float(seconds) * dataset.rate_hz)


def some_executions(dataset: Dataset, names: Sequence[str], rows: int, *, seed: int = 0) -> tuple[str, ...]:
    """Return random executions with at most `rows` samples in total, but at least one execution, in the given order.

    Args:
        dataset: Dataset of the executions.
        names: Executions to draw from.
        rows: Number of samples.
        seed: Seed; same names and seed give the same choice.
    """
    rate_hz = dataset.rate_hz
    lasts_s = dict(dataset.executions.select("execution", "duration_s").iter_rows())
    order = np.random.default_rng(seed).permutation(len(names))
    ends = np.cumsum([lasts_s[names[number]] * rate_hz for number in order])
    chosen = set(order[: max(int(np.searchsorted(ends, rows, side="right")), 1)].tolist())
    return tuple(name for number, name in enumerate(names) if number in chosen)


def in_memory(dataset: Dataset) -> tuple[Dataset, str | None]:
    """Return the dataset, or a part that fits in memory with a sentence on what was left out.

    At least one execution of each task is kept, however rare. A dataset that is a part already is returned unchanged.
    """
    if dataset.is_part or rows_of(dataset) <= memory_rows():
        return dataset, None
    names = dataset.executions["execution"].to_list()
    chosen = set(some_executions(dataset, names, memory_rows()))
    done = dataset.done_tasks()
    seen = set(done.filter(pl.col("execution").is_in(list(chosen)))["task"])
    rare = done.filter(~pl.col("task").is_in(list(seen))).sort("execution").group_by("task").first()
    chosen |= set(rare["execution"])
    said = (
        f"{len(chosen)} of {len(names)} logged executions were used, drawn at random: the memory is too small for all"
    )
    return dataset.only([name for name in names if name in chosen]), said


def frames(dataset: Dataset, names: Sequence[str], rows: int = PART_ROWS) -> Iterator[pl.DataFrame]:
    """Yield the samples of executions in parts of whole executions with about `rows` samples each."""
    rate_hz = dataset.rate_hz
    lasts_s = dict(dataset.executions.select("execution", "duration_s").iter_rows())
    part: list[str] = []
    held = 0.0
    for name in names:
        part.append(name)
        held += lasts_s[name] * rate_hz
        if held >= rows:
            yield dataset.samples(part)
            part, held = [], 0.0
    if part:
        yield dataset.samples(part)


def in_files(parts: Iterable[Samples], folder: Path) -> Samples:
    """Append rows to files of a folder and return them as memory-mapped arrays.

    Names, times and executions of the rows are not kept; training does not use them.
    """
    columns = _Columns(folder)
    dropped, base, first = Counter[str](), 0, None
    for part in parts:
        first = first or part
        dropped.update(part.dropped)
        columns.add("X", part.X)
        columns.add("step", part.step.astype(np.int64))
        columns.add("scaling", part.scaling.astype(np.float32))
        columns.add("weight", part.weight)
        if part.table is not None and part.before is not None and part.ahead is not None:
            columns.add("table", part.table)
            columns.add("before", part.before + base)
            columns.add("ahead", part.ahead + base)
            base += len(part.table)
    if first is None:
        raise DatasetError("no execution to learn from", cure="Log more executions.")
    found = columns.mapped()
    count = found["scaling"].shape
    unknown, never = np.broadcast_to(np.int64(0), count), np.broadcast_to(np.float64(0), count)
    return Samples(
        found["X"], found["step"], found["scaling"], unknown, (), never, first.inputs,
        found["weight"], found.get("table"), found.get("before"), found.get("ahead"), dict(dropped), in_files=True,
    )  # fmt: skip


def filled(file: Path, shape: tuple[int, int], block: Callable[[slice], Singles]) -> Singles:
    """Return a new array in a file, filled block by block of rows."""
    made = np.memmap(file, np.float32, "w+", shape=shape)
    for first in range(0, shape[0], PART_ROWS):
        part = slice(first, min(first + PART_ROWS, shape[0]))
        made[part] = block(part)
    return made


class _Columns:
    """Arrays in files that rows are appended to."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._known = folder, dict[str, tuple[np.dtype[np.generic], tuple[int, ...], int]]()

    def add(self, name: str, rows: NDArray[np.generic]) -> None:
        _, _, count = self._known.get(name, (rows.dtype, rows.shape[1:], 0))
        self._known[name] = (rows.dtype, rows.shape[1:], count + len(rows))
        with (self._folder / name).open("ab") as file:
            np.ascontiguousarray(rows).tofile(file)

    def mapped(self) -> dict[str, NDArray[Any]]:
        return {
            name: np.memmap(self._folder / name, dtype, "r+", shape=(count, *shape))
            for name, (dtype, shape, count) in self._known.items()
            if count
        }
