"""Every error that cyclekit raises on purpose, and the text a person reads.

    CyclekitError
    ├── LogError            a log cannot be used: which file, why, what to do
    │   ├── UnknownFormat       no adapter recognises it
    │   ├── DamagedLog          recognised, but broken where it is read
    │   ├── MissingColumns      recognised, but a needed column is absent
    │   └── BrokenAdapter       the adapter itself failed
    ├── ConfigError         cell.toml or a sequence file says something we cannot follow
    │   └── UnknownName         a name (place, key, task, topic) that does not exist; the nearest one is shown
    ├── DatasetError        the dataset folder is not one, is older or newer, or lacks what is needed
    ├── ModelError          the model folder is not one, is foreign, or does not fit the dataset
    ├── EstimateError       the question cannot be answered from these logs
    ├── ShapeError          arrays that do not fit together (a mistake of the caller)
    ├── WrongType           an argument of a public function is of another type (a TypeError as well)
    ├── OutputError         what is to be written would replace an input, or what cyclekit did not write
    ├── BusyPlace           another process is writing where we were told to write
    ├── StorageError        a URL cannot be read or written
    ├── OutsideFolder       a name found in data would lead out of its folder
    ├── EngineError         the cluster cannot be reached, or a task's worker died again and again
    └── MissingExtra        an optional dependency is not installed

A message has three parts: what was seen and where, the nearest right thing if one is near, and the cure. The parts
are put together here so that every room says it alike. Printing is the command line's business.
"""

from __future__ import annotations

import difflib
import os
import shlex
import subprocess
from collections.abc import Iterable
from pathlib import Path

from cyclekit.text.plain_text import one_line


class CyclekitError(Exception):
    """Root of the tree; the command line turns any of these into exit code 1 and one message."""

    def __init__(self, seen: str, *, nearest: str | None = None, cure: str | None = None) -> None:
        """Keep the three parts; `str(error)` is the whole message.

        Args:
            seen: What was found, and where (file, key, value).
            nearest: The right thing that is nearest to what was found.
            cure: What the person should do now.
        """
        seen = one_line(seen)  # it may quote a log: a name there must not look like a line of ours
        self.seen, self.nearest, self.cure = seen, nearest, cure
        lines = [seen]
        if nearest:
            lines.append(f"  the nearest is {nearest!r}")
        if cure:
            lines.append(f"  {cure}")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[object, ...]:
        """Let an error cross from a worker process as it is; the default would call `__init__` with the message."""
        return _restore, (type(self), self.args, self.__dict__)


def _restore(kind: type[CyclekitError], args: tuple[str, ...], state: dict[str, object]) -> CyclekitError:
    error = kind.__new__(kind, *args)
    error.args = args
    error.__dict__.update(state)
    return error


class LogError(CyclekitError):
    """A log file cannot be used."""

    def __init__(self, path: Path, cause: str, *, nearest: str | None = None, cure: str | None = None) -> None:
        """Name the file first: people look for the file, then for the reason."""
        self.path, self.cause = path, one_line(cause)
        super().__init__(f"{path}: {cause}", nearest=nearest, cure=cure)


class UnknownFormat(LogError):
    """No adapter recognises the file."""


class DamagedLog(LogError):
    """An adapter recognises the file, but it is cut, garbled or contradicts itself."""


class EmptyLog(DamagedLog):
    """An adapter recognises the file, but nothing was recorded: a header and no rows."""

    def __init__(self, path: Path) -> None:
        """Name the file."""
        super().__init__(path, "a header and no rows", cure="Nothing was recorded: record again or leave it out.")


class MissingColumns(LogError):
    """A column that the adapter needs is absent."""

    def __init__(self, path: Path, missing: Iterable[str], present: Iterable[str], cure: str | None = None) -> None:
        """Show every missing column at once, and the nearest present name of the first one."""
        absent = sorted(missing)
        named = ", ".join(repr(name) for name in absent)
        word = "column" if len(absent) == 1 else "columns"
        super().__init__(path, f"no {word} {named}", nearest=nearest(absent[0], present), cure=cure)


class BrokenAdapter(LogError):
    """An adapter raised what no adapter should; a bug of its package."""

    def __init__(self, path: Path, adapter: str, package: str, told: str) -> None:
        """Name the log, then whose fault it is."""
        cause = f"adapter {adapter!r} of package {package!r} failed on it ({told})"
        super().__init__(path, cause, cure=f"Leave the log out, or ask the maintainers of package {package}.")


class ConfigError(CyclekitError):
    """A configuration or sequence file cannot be followed."""


class UnknownName(ConfigError):
    """A name that does not exist where it is used."""

    def __init__(self, where: str, kind: str, name: str, known: Iterable[str], *, cure: str | None = None) -> None:
        """Say which names would have been understood, so that nobody has to look them up."""
        names = sorted(map(one_line, known))
        text = cure or (f"Known: {', '.join(names)}." if names else f"No {kind} is known here.")
        super().__init__(f"{where}: unknown {kind} {name!r}", nearest=nearest(name, names), cure=text)


class DatasetError(CyclekitError):
    """The folder is no dataset, or not one that this question can be asked of."""


class ModelError(CyclekitError):
    """The folder is no model, or the model does not fit."""


class EstimateError(CyclekitError):
    """The logs do not hold an answer to this question."""


class ShapeError(CyclekitError):
    """Arrays that do not fit together."""


class WrongType(CyclekitError, TypeError):
    """An argument of a public function is of a type that it does not take."""

    def __init__(self, function: str, argument: str, value: object, expected: str) -> None:
        """Name the argument, what came and what was expected."""
        text = repr(value)
        shown = text if len(text) <= 60 else f"{text[:57]}..."
        super().__init__(f"{function}(): {argument} = {shown} is of type {type(value).__name__}; expected {expected}")


class OutputError(CyclekitError):
    """What is to be written would replace an input, or what cyclekit did not write."""


class BusyPlace(CyclekitError):
    """Another process is writing at the same place."""

    def __init__(self, path: Path, who: str) -> None:
        """Name the place and, where it is known, the process."""
        super().__init__(
            f"{path}: another cyclekit{who} is writing there",
            cure="Wait until it has finished, or write somewhere else.",
        )


class StorageError(CyclekitError):
    """A place on shared storage cannot be read or written."""

    def __init__(self, url: str, cause: str, *, cure: str | None = None) -> None:
        """Name the URL first, without what may be secret in it."""
        scheme, mark, rest = url.partition("?")[0].partition("://")
        super().__init__(f"{scheme}{mark}{rest.rpartition('@')[2]}: {cause}", cure=cure)


class NothingPublished(StorageError):
    """Nothing is published at a URL."""

    def __init__(self, url: str) -> None:
        """Name the URL."""
        super().__init__(url, "nothing is published there", cure="Check the address; `--out` of a command publishes.")


class OutsideFolder(CyclekitError):
    """A name that was found in data cannot be used as a path."""

    def __init__(self, folder: Path, name: object, why: str) -> None:
        """Name the folder, the name as it can be printed, and what is wrong with it."""
        self.cause = f"{_printable(name)} cannot be used as the name of a file ({why})"
        super().__init__(
            f"{folder}: {self.cause}", cure="It is damaged or crafted to do harm: make it again, or get it again."
        )


class EngineError(CyclekitError):
    """The engine that was asked for cannot be reached, or lost what it was at again and again."""


class MissingExtra(CyclekitError):
    """An optional dependency is needed and not installed."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        """Name the command that installs it.

        Args:
            package: What is missing.
            extra: The extra of cyclekit that brings it; several with commas.
            purpose: What needs it.
        """
        super().__init__(
            f"{purpose} needs {package}: not installed", cure=f'Install it: pip install "cyclekit[{extra}]"'
        )


def command_line(*words: object, program: str = "cyclekit") -> str:
    """Return a command as it can be typed on this system, paths with blanks in quotes.

    Args:
        words: What follows the program.
        program: Its name.
    """
    every = [program, *map(str, words)]
    return subprocess.list2cmdline(every) if os.name == "nt" else shlex.join(every)


def _printable(name: object) -> str:
    text = repr(name)
    return text if len(text) <= 120 else f"{text[:120]}…"


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name most like `name`, or None when none is alike."""
    found = difflib.get_close_matches(name, list(known), n=1, cutoff=0.6)
    return found[0] if found else None
