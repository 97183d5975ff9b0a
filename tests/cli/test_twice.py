"""A command that is run again replaces what it wrote: nothing of ours is taken for somebody else's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from .conftest import Shell


def _slow(words: str) -> Any:
    """A page or a picture; quick: test_guard, on a smaller cell."""
    return pytest.param(words, marks=pytest.mark.slow)


COMMANDS = [
    "estimate MODEL SEQUENCES --dataset DATASET --no-check --extrapolate --out OUT.json",
    "estimate MODEL SEQUENCES --dataset DATASET --no-check --extrapolate --out OUT.csv",
    "plan MODEL JOBS --dataset DATASET --no-check --out OUT.toml",
    "whatif MODEL SEQUENCES CHANGES --dataset DATASET --no-check --extrapolate --out OUT.json",
    _slow("zones MODEL DATASET --out OUT.svg"),
    "levels DATASET --picture OUT.svg",
    _slow("levels DATASET --picture OUT.png"),
    _slow("levels DATASET --picture OUT.pdf"),
    _slow("report DATASET --out OUT.html"),
    _slow("report DATASET --out OUT.md"),
    _slow("report DATASET --out OUT.json"),
    "report DATASET --out OUT.csv",
    "replay DATASET --execution 1 --out OUT.rrd",
    "export MODEL --out OUT.onnx",
    "convert LOG --rate 5 --out OUT.csv",
    "convert LOG --rate 5 --out OUT.parquet",
]


@pytest.mark.parametrize("words", COMMANDS)
def test_a_command_that_is_run_again_replaces_its_own_output(
    words: str, model: Path, dataset: Path, logs: Path, sequences: Path, jobs: Path, tmp_path: Path, cyclekit: Shell
):
    changes = tmp_path / "changes.toml"
    changes.write_text('[[change]]\nname = "seldom"\nfrequency = 0.9\n', encoding="utf-8")
    log = next(logs.rglob("robot.csv"))
    named = {"MODEL": model, "DATASET": dataset, "SEQUENCES": sequences, "JOBS": jobs, "CHANGES": changes, "LOG": log}
    typed = [named.get(word, tmp_path / word if word.startswith("OUT") else word) for word in words.split()]
    for _ in range(2):
        done = cyclekit(*typed, "--quiet")
        assert done.code == 0, done.err
