"""A dataset that an ingest replaces while it is read: what is read is of the old one or of the new one."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

import pytest

from cyclekit.api.arguments import checked
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ReplacedDataset
from cyclekit.ingest.ingest import ingest
from cyclekit.storage.atomic import staged


def made(folder: Path, name: str, rows: int, place_m: float) -> Path:
    """Return the dataset of one log of a robot that goes to and fro."""
    log = folder / name / "run_0.csv"
    log.parent.mkdir()
    lines = [f"{10 + i / 125:.3f} {place_m * (i % 400 > 200):.2f} 0 0.4" for i in range(rows)]
    text = "\n".join(["timestamp " + " ".join(f"actual_TCP_pose_{k}" for k in range(3)), *lines, ""])
    log.write_text(text, encoding="utf-8")
    return ingest([log], folder / f"{name}-dataset").dataset


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("replaced")
    return made(folder, "old", 1200, 0.3), made(folder, "new", 2400, 0.5)


@pytest.fixture
def place(two: tuple[Path, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(two[0], tmp_path / "dataset"))


def put(dataset: Path, place: Path) -> None:
    """Replace the dataset at `place` as an ingest does."""
    with staged(place) as folder:
        shutil.copytree(dataset, folder, dirs_exist_ok=True, copy_function=shutil.copy)  # with times of their own


READS = {
    "samples": lambda data: data.samples(),
    "tasks": lambda data: data.tasks(),
    "a native table": lambda data: data.recorded(data.recordings[0].id, "robot"),
    "part of a native table": lambda data: data.recorded_between(data.recordings[0].id, "robot", 11.0, 12.0),
    "times": lambda data: list(data.times(data.recordings[0].id, "robot")),
    "rows of an execution": lambda data: data.native_robot(data.card.executions[0].execution),
    "a summary of the samples": lambda data: data.summed_up(lambda samples: samples),
    "part of the executions": lambda data: data.only([data.card.executions[0].execution]).tasks(),
}


@pytest.mark.parametrize("what", READS)
def test_an_open_dataset_says_that_it_was_replaced_and_not_that_it_is_damaged(what: str, two, place: Path) -> None:
    data = Dataset.open(place)
    put(two[1], place)
    with pytest.raises(ReplacedDataset, match="replaced by another ingest"):
        READS[what](data)


def rows_of(dataset: Dataset | Path, put_first: list[Path]) -> int:
    """Return the number of samples; each of `put_first` replaces the dataset after it was opened."""
    data = Dataset.of(dataset)
    if put_first:
        put(put_first.pop(), data.path)
    return data.samples().height


def test_a_public_function_begins_again_with_the_new_dataset(two, place: Path) -> None:
    new = Dataset.open(two[1]).samples().height
    assert checked(rows_of)(place, [two[1]]) == new != Dataset.open(two[0]).samples().height
    with pytest.raises(ReplacedDataset):
        checked(rows_of)(Dataset.open(place), [two[0]])


def test_readers_beside_an_ingest_see_one_dataset_or_that_it_was_replaced(two, place: Path) -> None:
    both = {tuple(len(read(Dataset.open(one))) for read in READS.values()) for one in two}
    stopped, seen = threading.Event(), set()

    def replace() -> None:
        number = 0
        while not stopped.wait(0.03):
            number += 1
            put(two[number % 2], place)

    writer = threading.Thread(target=replace)
    writer.start()
    try:
        for _ in range(60):
            try:
                data = Dataset.open(place)
                seen.add(tuple(len(read(data)) for read in READS.values()))
            except ReplacedDataset:
                pass
    finally:
        stopped.set()
        writer.join()
    assert seen <= both
