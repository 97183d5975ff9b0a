"""Identify a path given by mistake, so that an error can name what it is and the command that takes it."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING

from cyclekit.errors import command_line

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

DATASET_CARD, MODEL_CARD = "dataset.json", "model.json"
_TAKEN_BY = {
    "sequence": ("a sequence file", ("estimate", "MODEL", "{}", "--dataset", "DATASET")),
    "change": ("a file of changes", ("whatif", "MODEL", "SEQUENCES.toml", "{}", "--dataset", "DATASET")),
    "visit": ("a jobs file", ("plan", "MODEL", "{}", "--dataset", "DATASET")),
    "cell": ("a fleet file", ("fleet", "all", "{}")),
}
"""Kinds of TOML files by a key unique to each: description, and arguments of the command that takes one."""
_CELL_FILE = ("a cell file", ("ingest", "LOGS", "--cell", "{}", "--out", "DATASET"))


def kind_of_path(path: Path) -> str:
    """Return a short description of what is at a path: `a dataset`, `a model`, `a folder of models`, ..."""
    if path.is_dir():
        if (path / DATASET_CARD).is_file():
            return "a dataset"
        if (path / MODEL_CARD).is_file():
            return "a model"
        return "a folder of models" if any(path.glob(f"*/{MODEL_CARD}")) else "another folder"
    if not path.exists():
        return "nothing"
    return "a TOML file" if path.suffix.lower() == ".toml" else "a file"


def instead_of(path: Path, wanted: str, card: str, cures: Mapping[str, str]) -> tuple[str, str]:
    """Return what is at a path where a folder was expected, and the cure.

    Args:
        path: The path.
        wanted: Name of what was expected.
        card: File that such a folder holds.
        cures: Kind of path -> cure; `nothing` = there is none, `else` = any other kind.
    """
    found = kind_of_path(path)
    if found == "nothing":
        return f"{path}: no such folder", cures[found]
    seen = f"{path}: {found}, and a {wanted} was expected (a folder with {card})"
    if found == "a TOML file":
        name, taken_by = kind_of_toml(path)
        return seen, f"It looks like {name}: {taken_by}"
    return seen, cures.get(found, cures["else"])


def kind_of_toml(path: Path) -> tuple[str, str]:
    """Return the kind of a TOML file, and the command that takes it."""
    try:
        keys = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        keys = {}
    name, words = next((found for key, found in _TAKEN_BY.items() if key in keys), _CELL_FILE)
    return name, command_line(*(path if word == "{}" else word for word in words))
