"""What the tests of the command line share: a terminal to type into, and one small cell, simulated once."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import pytest
from judged_once import judged_once  # noqa: F401 - for every test of this folder
from made_once import made_once, simulated

from cyclekit.cli import run


@dataclass(frozen=True)
class Typed:
    """What came of one command line."""

    code: int
    out: str
    err: str

    @property
    def document(self) -> dict[str, Any]:
        """The one JSON document on standard output."""
        return json.loads(self.out)


class Shell(Protocol):
    def __call__(self, *words: str | Path) -> Typed: ...


@pytest.fixture
def cyclekit(capsys: pytest.CaptureFixture[str]) -> Shell:
    """Type a command line in this process."""

    def typed(*words: str | Path) -> Typed:
        capsys.readouterr()
        code = run([str(word) for word in words])
        out, err = capsys.readouterr()
        return Typed(code, out, err)

    return typed


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six executions of box picking, as vendor files."""
    return simulated(tmp_path_factory, "box-picking", 6, seed=1)


@pytest.fixture(scope="session")
def dataset(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    def make(folder: Path) -> None:
        assert run(["ingest", str(logs), "--out", str(folder / "dataset"), "--quiet"]) == 0

    return made_once(tmp_path_factory, "cli_dataset", make) / "dataset"


@pytest.fixture(scope="session")
def model(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model trained for two seconds: good enough not to be refused, not to be right."""
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.learning.networks.saved import save_model
    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.learning.training import train

    def make(folder: Path) -> None:
        save_model(folder / "model", train(Dataset.open(dataset), ModelSpec.of(epochs=16)))

    return made_once(tmp_path_factory, "cli_model", make) / "model"


@pytest.fixture(scope="session")
def sequences(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sequences of tasks that were logged."""
    from cyclekit.dataset.dataset import Dataset

    tasks = set(Dataset.open(dataset).tasks()["task"])
    back = next(slot for slot in ("left_2", "left_3", "right_2", "right_3", "right_4") if f"{slot}->conveyor" in tasks)
    file = tmp_path_factory.mktemp("asked") / "sequences.toml"
    file.write_text(
        f'[[sequence]]\nname = "one way"\nplaces = ["home", "conveyor", "left_1"]\n'
        f'[[sequence]]\nname = "two boxes"\nplaces = ["home", "conveyor", "{back}", "conveyor", "left_1"]\n',
        encoding="utf-8",
    )
    return file


@pytest.fixture
def jobs(dataset: Path, tmp_path: Path) -> Path:
    """Three slots to be put in order; six orders."""
    from cyclekit.dataset.dataset import Dataset

    logged = Dataset.open(dataset)
    tasks = set(logged.tasks()["task"])
    slots = [n for n in logged.places if f"conveyor->{n}" in tasks and f"{n}->conveyor" in tasks][:3]
    names = ", ".join(f'"{slot}"' for slot in slots)
    file = tmp_path / "jobs.toml"
    file.write_text(f'start = "home"\nvia = "conveyor"\nvisit = [{names}]\n', encoding="utf-8")
    return file
