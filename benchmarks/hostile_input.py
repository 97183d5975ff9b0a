"""Counts the results of random cards, manifests, cell files, sequence files and names.

Each input is a valid one with one or two values replaced by hostile ones (drawn by Hypothesis), or any JSON, or any
bytes. It is opened as by the commands, in this process, and their output is printed. Counted: tracebacks (any exception
except CyclekitError), data read or written outside of its folder, and unescaped control characters in the output. All
three must be 0.

    python benchmarks/hostile_input.py [--examples 2000] [--seed 0]
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from reliability.hostile_documents import (
    CELL,
    SECRET,
    SEQUENCES,
    TEXTS,
    documents,
    entry_of,
    forged_cards,
    forged_manifests,
    forged_parts,
    manifest_of,
    mostly,
    toml_texts,
)

from cyclekit.cli.facts import page
from cyclekit.cli.terminal import Terminal, say_failure
from cyclekit.config import load_cell
from cyclekit.config.sequences import load_sequences
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import CyclekitError
from cyclekit.ingest.discover import find_all
from cyclekit.inspect.describe import describe
from cyclekit.learning.networks.saved import TrainedModel, save_model
from cyclekit.storage.atomic import write_text
from cyclekit.storage.remote.cache import cached
from cyclekit.storage.remote.folders import local
from cyclekit.storage.remote.manifest import MANIFEST, part_of

RAW = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]|^FORGED", re.MULTILINE)
"""Control characters, characters that reverse text, and forged lines."""
_HEALTH = list(HealthCheck)
URL = "memory://bucket/folder"
TABLE = "t,x,y,z\n" + "".join(f"{k / 10:.1f},0.{k % 10},0,0\n" for k in range(20))


@dataclass
class Count:
    """Counts for one kind of input."""

    inputs: int = 0
    accepted: int = 0
    tracebacks: Counter[str] = field(default_factory=Counter)
    outside: int = 0
    raw: int = 0
    seconds: float = 0.0
    examples: dict[str, str] = field(default_factory=dict)


class Lab:
    """Folders for the inputs, and the test of each kind."""

    def __init__(self, folder: Path) -> None:
        from fabricated import fabricate_dataset

        self.folder = folder
        self.dataset = folder / "in" / "here" / "dataset"
        fabricate_dataset(self.dataset, executions=2, rounds=1)
        outside = folder / "in" / "here" / "outside"
        shutil.copytree(min((self.dataset / "recordings").iterdir()), outside)
        self.model = folder / "in" / "here" / "model"
        save_model(self.model, _model())
        self.logs = folder / "in" / "logs"
        self.memory = _published()
        os.environ["CYCLEKIT_CACHE"] = str(folder / "in" / "cache")

    def kinds(self) -> dict[str, tuple[st.SearchStrategy[Any], Callable[[Any], Iterator[str]]]]:
        """Return by kind the strategy that draws inputs, and the test, which yields what a command would print."""
        card = json.loads((self.dataset / "dataset.json").read_text(encoding="utf-8"))
        card |= {"settings": {"furniture": {"table": {"xyz_m": [0, 0, 0], "size_m": [1, 1, 1], "yaw_deg": 0}}}}
        model = json.loads((self.model / "model.json").read_text(encoding="utf-8"))
        names = st.one_of(st.sampled_from(TEXTS), st.text(min_size=1, max_size=80))
        return {
            "dataset card": (mostly(documents(card), forged_cards(card)), self.open_dataset),
            "model card": (documents(model), self.open_model),
            "manifest": (documents(json.loads(self.memory[MANIFEST])) | forged_manifests(), self.fetch),
            "cell file": (toml_texts(CELL), self.open_cell),
            "sequence file": (toml_texts(SEQUENCES), self.open_sequences),
            "name of a log": (names, self.name_log),
        }

    def open_dataset(self, content: bytes) -> Iterator[str]:
        """Open a dataset with this card, and yield what commands show of it."""
        (self.dataset / "dataset.json").write_bytes(content)
        found = Dataset.open(self.dataset)
        yield page(describe(self.dataset))
        assert found.furniture is not None
        for record in found.recordings:
            there = os.path.normpath(self.dataset / "recordings" / record.id)
            with contextlib.suppress(CyclekitError):
                if found.recorded(record.id, "robot") is not None and not there.startswith(str(self.dataset)):
                    yield SECRET
        found.samples()

    def open_model(self, content: bytes) -> Iterator[str]:
        """Open a model with this card."""
        (self.model / "model.json").write_bytes(content)
        yield page(describe(self.model))

    def fetch(self, content: bytes) -> Iterator[str]:
        """Fetch the folder with this manifest; the parts it names exist."""
        _put(self.memory | {MANIFEST: content} | forged_parts(content, self.memory))
        before = self._beside_the_copy()
        try:
            found = local(URL)
        finally:
            for file in self._beside_the_copy() - before:
                file.unlink()
                yield SECRET
        for file in found.rglob("*"):
            if file.is_file() and file.read_bytes() == SECRET.encode():
                yield SECRET

    def _beside_the_copy(self) -> set[Path]:
        copy_of = cached(URL).parent
        return {file for file in self.folder.rglob("*") if file.is_file() and not file.is_relative_to(copy_of)}

    def open_cell(self, content: bytes) -> Iterator[str]:
        """Read a cell file."""
        file = self.folder / "cell.toml"
        file.write_bytes(content)
        found = load_cell(file)
        json.dumps(found, default=lambda value: vars(value), allow_nan=False)  # as stored in the dataset's card
        yield f"{found.name} {', '.join(found.places)}"

    def open_sequences(self, content: bytes) -> Iterator[str]:
        """Read a sequence file."""
        file = self.folder / "sequences.toml"
        file.write_bytes(content)
        for found in load_sequences(file):
            yield f"{found.shown}: {', '.join(found.tasks)}"

    def name_log(self, name: str) -> Iterator[str]:
        """Find a log with this name, and write a file with this name."""
        shutil.rmtree(self.logs, ignore_errors=True)
        self.logs.mkdir()
        file = self.logs / f"{name.replace('/', '_')}.csv"
        try:
            file.write_text(TABLE, encoding="utf-8")
        except (OSError, ValueError):
            return  # the system allows no such file
        logs, _ = find_all([self.logs], load_cell(_cell_beside(self.logs)))
        for log in logs:
            if not re.fullmatch(r"[A-Za-z0-9_.-]+", log.id) or log.id in (".", ".."):
                yield SECRET
        yield page(describe(self.logs))
        write_text(self.logs / f"{name.replace('/', '_')}.out", "x")


def _cell_beside(folder: Path) -> Path:
    file = folder / "cell.toml"
    columns = 'time = "t", time_unit = "s", x = "x", y = "y", z = "z"'
    source = f'[[sources]]\npath = "*"\nadapter = "csv"\nrole = "robot"\nmap = {{{columns}}}'
    file.write_text(source, encoding="utf-8")
    return file


def _model() -> TrainedModel:
    import numpy as np

    from cyclekit.learning.networks.weights import Weights

    layers = [(np.ones((a, b), np.float32), np.zeros(b, np.float32)) for a, b in ((6, 4), (4, 3))]
    split = {"train": ["a"], "validation": ["b"], "test": ["c"]}
    metrics = {"rows": 3, "mse_mean": 0.1, "mse_argmax": 0.1, "mae": 0.1, "bias": 0.0, "accuracy": 0.9}
    card = {"dataset": "d", "seed": 0, "split": split, "metrics": metrics, "warnings": ["w"], "dropped": {"why": 3}}
    return TrainedModel("now", "classifier", 0.0, (0.0, 0.5, 1.0), Weights(tuple(layers), 1), card)


def _published() -> dict[str, bytes]:
    """Return the objects of a published folder by name, with its manifest, and one outside of the folder."""
    contents = {"a.txt": b"one", "b/c.txt": b"two"}
    files = {name: entry_of(part_of(name, sha256(data).hexdigest()), data) for name, data in contents.items()}
    objects = {files[name]["part"]: data for name, data in contents.items()}
    return {MANIFEST: manifest_of(files), "../secret.txt": SECRET.encode(), **objects}


def _put(objects: dict[str, bytes]) -> None:
    import fsspec

    memory = fsspec.filesystem("memory")
    memory.store.clear()
    for name, content in objects.items():
        memory.pipe_file(f"/bucket/folder/{name}", content)


def attempt(content: object, kind: Callable[[Any], Iterator[str]], count: Count) -> None:
    """Try one input, and count the result."""
    said, errors = io.StringIO(), io.StringIO()
    count.inputs += 1
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(errors):
        terminal = Terminal(json=False, quiet=False)
        try:
            for text in kind(content):
                if text == SECRET:
                    count.outside += 1
                    count.examples.setdefault("outside", repr(content)[:300])
                    continue
                terminal.done({}, text)
                terminal.remark(text)
            count.accepted += 1
        except CyclekitError as error:
            say_failure(str(error), kind=type(error).__name__, as_json=False)
        except Exception as error:  # a traceback for the user
            where = traceback.extract_tb(error.__traceback__)[-1]
            named = f"{type(error).__name__} in {Path(where.filename).name}:{where.lineno}"
            count.tracebacks[named] += 1
            count.examples.setdefault(named, repr(content)[:300])
    if found := RAW.search(said.getvalue() + errors.getvalue()):
        count.raw += 1
        count.examples.setdefault("raw", repr(said.getvalue() + errors.getvalue())[:200] + repr(found[0]))


def _trial(kind: Callable[[Any], Iterator[str]], count: Count) -> Callable[[Any], None]:
    def trial(content: object) -> None:
        attempt(content, kind, count)

    return trial


def run(examples: int, number: int, only: Collection[str] | None = None) -> dict[str, Count]:
    """Try `examples` inputs of each kind (or of some kinds), and return the counts."""
    counts: dict[str, Count] = {}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        lab = Lab(Path(folder))
        for name, (inputs, kind) in lab.kinds().items():
            if only is not None and name not in only:
                continue
            count = counts[name] = Count()

            trial = given(content=inputs)(_trial(kind, count))
            trial = settings(max_examples=examples, database=None, deadline=None, suppress_health_check=_HEALTH)(trial)
            trial = seed(number)(trial)
            began_s = time.perf_counter()
            trial()
            count.seconds = time.perf_counter() - began_s
    return counts


def main() -> None:
    """Try the inputs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--examples", type=int, default=2000, help="inputs of each of six kinds")
    parser.add_argument("--seed", type=int, default=0)
    wanted = parser.parse_args()
    counts = run(wanted.examples, wanted.seed)
    grid = Table("kind", "inputs", "accepted", "tracebacks", "outside", "raw control characters", "s", box=None)
    for name, c in counts.items():
        values = (c.inputs, c.accepted, c.tracebacks.total(), c.outside, c.raw, f"{c.seconds:.0f}")
        grid.add_row(name, *map(str, values))
    Console(width=110).print(grid)
    for name, c in counts.items():
        for what, example in c.examples.items():
            print(f"{name}: {what} ({c.tracebacks.get(what, '')}): {example}")
    sys.exit(any(c.tracebacks or c.outside or c.raw for c in counts.values()))


if __name__ == "__main__":
    main()
