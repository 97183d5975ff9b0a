"""The sequence file: which task sequences are asked for, in which order the robot visits its places.

Whether the places exist and the tasks were ever logged is found out by `estimate`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from cyclekit.config.toml_file import list_at, read_toml
from cyclekit.errors import ConfigError, UnknownName

if TYPE_CHECKING:
    from pathlib import Path

_EXAMPLE = """Add one:
  [[sequence]]
  name = "A"
  places = ["home", "conveyor", "left_1", "home"]"""


@dataclass(frozen=True)
class TaskSequence:
    """What the robot shall do: ordered places, the start first; optionally what the operator does meanwhile.

    `file` is where it was read from, for messages.
    """

    name: str
    places: tuple[str, ...]
    operator: tuple[str, ...] | None = None
    file: Path | None = None

    @property
    def shown(self) -> str:
        """How a message names it: file and name."""
        return f"{self.file}: sequence {self.name!r}" if self.file else f"sequence {self.name!r}"

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks `start->goal` in order."""
        return tuple(f"{a}->{b}" for a, b in pairwise(self.places))


def load_sequences(path: Path) -> list[TaskSequence]:
    """Read a sequence file: `[[sequence]]` with `name` and `places` (or `tasks`), optionally `operator`.

    Raises:
        ConfigError: The file cannot be read, holds no sequence, or a sequence is not one.
    """
    raw = read_toml(path)
    for key in raw:
        if key != "sequence":
            raise UnknownName(str(path), "key", key, ["sequence"])
    entries = list_at(str(path), raw, "sequence")
    if not entries:
        msg = f"{path}: no [[sequence]] in it"
        raise ConfigError(msg, cure=_EXAMPLE)
    found = [_sequence(path, entry, i) for i, entry in enumerate(entries)]
    names = [sequence.name for sequence in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        msg = f"{path}: sequence name {twice[0]!r} is used twice"
        raise ConfigError(msg, cure="Give each sequence a name of its own.")
    return found


def _sequence(path: Path, entry: Mapping[str, Any], index: int) -> TaskSequence:
    where = f"{path} sequence[{index}]"
    if not isinstance(entry, Mapping):
        raise ConfigError(f"{where}: {entry!r} must be a table", cure="Begin each sequence with [[sequence]].")
    for key in entry:
        if key not in {"name", "places", "tasks", "operator"}:
            raise UnknownName(where, "key", key, ["name", "places", "tasks", "operator"])
    if ("places" in entry) == ("tasks" in entry):
        raise ConfigError(f"{where}: needs either places or tasks", cure='places = ["home", "conveyor", "left_1"]')
    if "tasks" in entry:
        places = _joined(where, [str(task) for task in list_at(where, entry, "tasks")])
    else:
        places = tuple(map(str, list_at(where, entry, "places")))
    if len(places) < 2:
        raise ConfigError(f"{where}: a sequence needs at least two places", cure="Name the start, then each goal.")
    operator = tuple(map(str, list_at(where, entry, "operator"))) if "operator" in entry else None
    return TaskSequence(str(entry.get("name", f"sequence {index + 1}")), places, operator, path)


def _joined(where: str, tasks: list[str]) -> tuple[str, ...]:
    pairs = [task.split("->") for task in tasks]
    if bad := [task for task, pair in zip(tasks, pairs, strict=True) if len(pair) != 2 or not all(pair)]:
        raise ConfigError(f"{where}: {bad[0]!r} is not a task", cure="Write a task as 'start->goal'.")
    for before, after in pairwise(pairs):
        if before[1] != after[0]:
            seen = f"{where}: task {'->'.join(after)!r} does not start where {'->'.join(before)!r} ends"
            raise ConfigError(seen, cure="A robot cannot jump: insert the task between them.")
    return (*(pair[0] for pair in pairs), pairs[-1][1]) if pairs else ()
