"""The sequence file: task sequences to estimate, as the robot's places in order.

`estimate` checks whether the places exist and the tasks were logged.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from cyclekit.config.toml_file import read_toml, refuse_twice, require_list, to_dataclass
from cyclekit.errors import ConfigError
from cyclekit.text.durations import LONGEST_S
from cyclekit.text.numbers import given

if TYPE_CHECKING:
    from collections.abc import Sequence

_EXAMPLE = """Add one:
  [[sequence]]
  name = "A"
  places = ["home", "conveyor", "left_1", "home"]"""
NOT_ITSELF = "Name another task of the plan in after, or leave it out."
PLAN = "plan"
"""First entry of the places of a plan for robot and operator."""
EARLY_S = 1e-3
"""Tolerance for a start slightly below zero, s."""
MOST_ALLOWED = 2.0
"""Maximum allowance: an order that is chosen for half of its cycle time by chance alone is no answer."""


@dataclass(frozen=True)
class PlannedTask:
    """One task of a plan for robot and operator.

    Attributes:
        agent: `robot`, `operator`, or the agent's name in the logs.
        name: Name of the task.
        not_before_s: Earliest start, s after the start of the cycle; None = as soon as possible.
        after: Tasks that must end before it, in addition to learned conditions.
    """

    agent: str
    name: str
    not_before_s: float | None = None
    after: tuple[str, ...] = ()

    @property
    def shown(self) -> str:
        """Name in messages, such as `robot: pick`."""
        return f"{self.agent}: {self.name}"


@dataclass(frozen=True)
class TaskSequence:
    """A task sequence of the robot: places in order, the start first; optionally the operator's places meanwhile.

    `file` is the source, for messages. If the sequence is a plan for robot and operator, `plan` has the tasks of both,
    in order for each agent, and `places` has their names. `allowance` is a factor on the cycle time that `plan` writes:
    the order that comes out shortest of many comes out too short beside the operators that it was chosen with.
    """

    name: str
    places: tuple[str, ...]
    operator: tuple[str, ...] | None = None
    file: Path | None = None
    plan: tuple[PlannedTask, ...] = ()
    allowance: float = 1.0

    @classmethod
    def of_plan(cls, name: str, plan: Sequence[PlannedTask], file: Path | None = None) -> TaskSequence:
        """Return a plan for robot and operator."""
        return cls(name, (PLAN, *(task.shown for task in plan)), file=file, plan=tuple(plan))

    @property
    def shown(self) -> str:
        """Name in messages: file and name."""
        return f"{self.file}: sequence {self.name!r}" if self.file else f"sequence {self.name!r}"

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks `start->goal` in order."""
        return tuple(f"{a}->{b}" for a, b in pairwise(self.places))


def load_sequences(path: Path | str) -> list[TaskSequence]:
    """Read a sequence file: `[[sequence]]` with `name` and `places` (or `tasks`), optionally `operator`.

    A plan for robot and operator has `[[sequence.task]]` instead: `agent`, `name`, `not_before_s`, `after`.

    Raises:
        ConfigError: The file cannot be read, has no sequence, or a sequence is invalid.
    """
    raw = read_toml(path, _EXAMPLE)
    entries = require_list(str(path), raw, "sequence")
    if not entries and not set(raw) - {"sequence"}:
        raise ConfigError(f"{path}: no [[sequence]] in it", cure=_EXAMPLE)
    file = to_dataclass(str(path), raw, _File)
    found = [_sequence(Path(path), entry, i) for i, entry in enumerate(file.sequence)]
    refuse_twice(str(path), "sequence", [sequence.name for sequence in found])
    return found


@dataclass(frozen=True)
class _Task:
    """A task of a plan as written in the file."""

    agent: str
    name: str
    not_before_s: float | None = None
    after: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Entry:
    """A sequence as written in the file."""

    name: str | None = None
    places: tuple[str, ...] | None = None
    tasks: tuple[str, ...] | None = None
    operator: tuple[str, ...] | None = None
    allowance: float = 1.0
    task: tuple[_Task, ...] = ()


@dataclass(frozen=True)
class _File:
    """All keys of a sequence file."""

    sequence: tuple[_Entry, ...] = ()


def _sequence(path: Path, entry: _Entry, index: int) -> TaskSequence:
    where = f"{path} sequence[{index}]"
    if entry.task:
        return _plan(where, entry, index, path)
    if (entry.places is None) == (entry.tasks is None):
        one = "both places and tasks" if entry.places is not None else "no places, tasks or [[sequence.task]]"
        cure = 'places = ["home", "conveyor", "left_1"]; or for both agents [[sequence.task]] agent = ..., name = ...'
        raise ConfigError(f"{where}: {one}", cure=cure)
    places = entry.places if entry.places is not None else _joined(where, entry.tasks or ())
    if len(places) < 2:
        raise ConfigError(f"{where}: a sequence needs at least two places", cure="Name the start, then each goal.")
    if not 1.0 <= entry.allowance <= MOST_ALLOWED:
        seen = f"{where}: allowance = {given(entry.allowance)} is not between 1 and {given(MOST_ALLOWED)}"
        raise ConfigError(seen, cure="Leave it as plan wrote it, or out.")
    name = entry.name or f"sequence {index + 1}"
    return TaskSequence(name, places, entry.operator, path, allowance=entry.allowance)


def _plan(where: str, entry: _Entry, index: int, path: Path) -> TaskSequence:
    """Return a plan for robot and operator.

    Raises:
        ConfigError: It has places too, or an earliest start is invalid.
    """
    if any(part is not None for part in (entry.places, entry.tasks, entry.operator)) or entry.allowance != 1.0:
        msg = f"{where}: [[sequence.task]] together with places, tasks or operator"
        raise ConfigError(msg, cure="Write either: a plan names the tasks of both agents itself.")
    for task in entry.task:
        if task.not_before_s is not None and not -EARLY_S <= task.not_before_s < LONGEST_S:
            msg = f"{where}: not_before_s = {task.not_before_s} of {task.name!r} is not a time since the cycle's start"
            raise ConfigError(msg, cure="Give seconds after the start of the cycle, 0 or more.")
    plan = [
        PlannedTask(
            task.agent, task.name, None if task.not_before_s is None else max(task.not_before_s, 0.0), task.after
        )
        for task in entry.task
    ]
    return TaskSequence.of_plan(entry.name or f"sequence {index + 1}", plan, path)


def _joined(where: str, tasks: tuple[str, ...]) -> tuple[str, ...]:
    pairs = [task.split("->") for task in tasks]
    if bad := [task for task, pair in zip(tasks, pairs, strict=True) if len(pair) != 2 or not all(pair)]:
        raise ConfigError(f"{where}: {bad[0]!r} is not a task", cure="Write a task as 'start->goal'.")
    for before, after in pairwise(pairs):
        if before[1] != after[0]:
            seen = f"{where}: task {'->'.join(after)!r} does not start where {'->'.join(before)!r} ends"
            raise ConfigError(seen, cure="A robot cannot jump: insert the task between them.")
    return (*(pair[0] for pair in pairs), pairs[-1][1]) if pairs else ()
