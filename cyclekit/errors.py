"""Errors that cyclekit raises on purpose, and their messages.

    CyclekitError
    ├── LogError            a log cannot be used: file, cause and cure
    │   ├── UnknownFormat       no adapter recognises it
    │   ├── DamagedLog          recognised, but damaged
    │   │   └── EmptyLog            recognised, but without rows
    │   ├── MissingColumns      recognised, but a required column is missing
    │   └── BrokenAdapter       the adapter itself failed
    ├── ConfigError         a configuration or sequence file is invalid
    │   └── UnknownName         a name (place, key, task, topic) that does not exist; the nearest one is shown
    ├── DatasetError        the folder is not a dataset, has another version, or lacks required data
    │   └── ReplacedDataset     another process replaced it while it was read
    ├── ModelError          the folder is not a model, or the model does not fit the dataset
    ├── EstimateError       the logs do not allow this estimate
    ├── ShapeError          arrays of inconsistent shapes (an error of the caller)
    ├── WrongType           an argument of a public function has the wrong type (also a TypeError)
    ├── OutputError         an output would replace an input, or a file that cyclekit did not write
    ├── BusyPlace           another process is writing to the same path
    ├── StorageError        a URL cannot be read or written
    │   └── NothingPublished    nothing is published at the URL
    ├── OutsideFolder       a name found in data would lead out of its folder
    ├── EngineError         the cluster cannot be reached, or a task's worker died repeatedly
    └── MissingExtra        an optional package is not installed

A message has three parts: what was found and where, the nearest valid name if there is one, and the cure. They are
combined here, so that all messages have one form. The command line prints them.
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
    """Base class; the command line converts these errors to exit code 1 and one message."""

    def __init__(self, seen: str, *, nearest: str | None = None, cure: str | None = None) -> None:
        """Create the error from the three parts; `str(error)` is the whole message.

        Args:
            seen: What was found, and where (file, key, value).
            nearest: The nearest valid name.
            cure: What the user should do.
        """
        seen = one_line(seen)  # it may quote a log, whose names must not look like a line of the message
        self.seen, self.nearest, self.cure = seen, nearest, cure
        lines = [seen]
        if nearest:
            lines.append(f"  the nearest is {nearest!r}")
        if cure:
            lines.append(f"  {cure}")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[object, ...]:
        """Support pickling with all attributes; the default would call `__init__` with the message."""
        return _restore, (type(self), self.args, self.__dict__)


def _restore(kind: type[CyclekitError], args: tuple[str, ...], state: dict[str, object]) -> CyclekitError:
    error = kind.__new__(kind, *args)
    error.args = args
    error.__dict__.update(state)
    return error


class LogError(CyclekitError):
    """A log file cannot be used."""

    def __init__(self, path: Path, cause: str, *, nearest: str | None = None, cure: str | None = None) -> None:
        """Create the message, with the file first."""
        self.path, self.cause = path, one_line(cause)
        super().__init__(f"{path}: {cause}", nearest=nearest, cure=cure)


class UnknownFormat(LogError):
    """No adapter recognises the file."""


class DamagedLog(LogError):
    """An adapter recognises the file, but it is truncated, corrupt or inconsistent."""


class EmptyLog(DamagedLog):
    """An adapter recognises the file, but it has a header and no rows."""

    def __init__(self, path: Path) -> None:
        """Create the message for a file."""
        super().__init__(path, "a header and no rows", cure="Nothing was recorded: record again or leave it out.")


class MissingColumns(LogError):
    """A column that the adapter needs is missing."""

    def __init__(self, path: Path, missing: Iterable[str], present: Iterable[str], cure: str | None = None) -> None:
        """Create the message with all missing columns, and the present name nearest to the first one."""
        absent = sorted(missing)
        named = ", ".join(repr(name) for name in absent)
        word = "column" if len(absent) == 1 else "columns"
        super().__init__(path, f"no {word} {named}", nearest=nearest(absent[0], present), cure=cure)


class BrokenAdapter(LogError):
    """An adapter raised an unexpected error: a bug of its package."""

    def __init__(self, path: Path, adapter: str, package: str, told: str) -> None:
        """Create the message with log, adapter and package."""
        cause = f"adapter {adapter!r} of package {package!r} failed on it ({told})"
        super().__init__(path, cause, cure=f"Leave the log out, or ask the maintainers of package {package}.")


class ConfigError(CyclekitError):
    """A configuration or sequence file is invalid."""


class UnknownName(ConfigError):
    """A name that does not exist where it is used."""

    def __init__(self, where: str, kind: str, name: str, known: Iterable[str], *, cure: str | None = None) -> None:
        """Create the message with the known names."""
        names = sorted(map(one_line, known))
        text = cure or (f"Known: {', '.join(names)}." if names else f"No {kind} is known here.")
        super().__init__(f"{where}: unknown {kind} {name!r}", nearest=nearest(name, names), cure=text)


class DatasetError(CyclekitError):
    """The folder is not a dataset, or lacks required data."""


class ReplacedDataset(DatasetError):
    """A dataset was replaced by another ingest after it was opened."""

    def __init__(self, path: Path) -> None:
        """Create the message for a dataset at `path`."""
        super().__init__(f"{path}: replaced by another ingest while it was read", cure="Open or run it again.")


class NoLevels(DatasetError):
    """A network that predicts levels is to be trained on a scaling that has none."""


class ModelError(CyclekitError):
    """The folder is not a model, or the model does not fit."""


class EstimateError(CyclekitError):
    """The logs do not allow this estimate."""


class ShapeError(CyclekitError):
    """Arrays of inconsistent shapes."""


class WrongType(CyclekitError, TypeError):
    """An argument of a public function has the wrong type."""

    def __init__(self, function: str, argument: str, value: object, expected: str) -> None:
        """Create the message with argument, value and expected type."""
        text = repr(value)
        shown = text if len(text) <= 60 else f"{text[:57]}..."
        super().__init__(f"{function}(): {argument} = {shown} is of type {type(value).__name__}; expected {expected}")


class OutputError(CyclekitError):
    """An output would replace an input, or a file that cyclekit did not write."""


class BusyPlace(CyclekitError):
    """Another process is writing to the same path."""

    def __init__(self, path: Path, who: str) -> None:
        """Create the message with the path and, if known, the process."""
        super().__init__(
            f"{path}: another cyclekit{who} is writing there",
            cure="Wait until it has finished, or write somewhere else.",
        )


class StorageError(CyclekitError):
    """A URL on shared storage cannot be read or written."""

    def __init__(self, url: str, cause: str, *, cure: str | None = None) -> None:
        """Create the message with the URL first, without credentials and query."""
        scheme, mark, rest = url.partition("?")[0].partition("://")
        super().__init__(f"{scheme}{mark}{rest.rpartition('@')[2]}: {cause}", cure=cure)


class NothingPublished(StorageError):
    """Nothing is published at a URL."""

    def __init__(self, url: str) -> None:
        """Create the message for a URL."""
        super().__init__(url, "nothing is published there", cure="Check the address; `--out` of a command publishes.")


class OutsideFolder(CyclekitError):
    """A name found in data cannot be used as a path."""

    def __init__(self, folder: Path, name: object, why: str) -> None:
        """Create the message with folder, printable name and reason."""
        self.cause = f"{_printable(name)} cannot be used as the name of a file ({why})"
        super().__init__(f"{folder}: {self.cause}", cure="It is damaged or malicious: create or fetch it again.")


class EngineError(CyclekitError):
    """The engine cannot be reached, or the worker of a task died repeatedly."""


class MissingExtra(CyclekitError):
    """An optional package is needed but not installed."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        """Create the message with the install command.

        Args:
            package: The missing package.
            extra: The extra of cyclekit that includes it; several with commas.
            purpose: What needs it.
        """
        super().__init__(
            f"{purpose} needs {package}: not installed", cure=f'Install it: pip install "cyclekit[{extra}]"'
        )


def command_line(*words: object, program: str = "cyclekit") -> str:
    """Return a command line for this operating system, with paths quoted if needed.

    Args:
        words: Arguments of the program.
        program: Name of the program.
    """
    every = [program, *map(str, words)]
    return subprocess.list2cmdline(every) if os.name == "nt" else shlex.join(every)


def _printable(name: object) -> str:
    text = repr(name)
    return text if len(text) <= 120 else f"{text[:120]}…"


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name most similar to `name`; None if none is similar."""
    found = difflib.get_close_matches(name, list(known), n=1, cutoff=0.6)
    return found[0] if found else None
