"""Prints results on standard output and everything else on standard error.

Each command has one `Terminal`. It shows progress while the library works, then the result: as text, or as one JSON
document.
"""

from __future__ import annotations

import shutil
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer

from cyclekit.text.numbers import duration, percent
from cyclekit.text.plain_json import json_text
from cyclekit.text.plain_text import one_line, visible

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from cyclekit.schema import Progress

PATIENCE_S = 2.0
"""Time to the first line of progress without a terminal, s; doubled for each further line."""

FORESEEN = 0.1
"""Minimum fraction of the work for which a remaining time is told: before, it rests on too little. Half of it tells it
sooner and less surely, twice of it later."""

MIN_TEXT = 12
"""Minimum width of a text column, characters."""


@dataclass(frozen=True)
class Terminal:
    """Output of one command, as text or JSON."""

    json: bool
    quiet: bool

    @contextmanager
    def progress(self, title: str) -> Iterator[Progress]:
        """Show progress and remaining time; yield the callback for the library.

        Args:
            title: Name of the work, a few words.
        """
        if self.quiet:
            yield lambda _fraction, _text: None
        elif sys.stderr.isatty():
            yield from _drawn(title)
        else:
            with _Lines(title) as lines:
                yield lines

    def remark(self, text: str) -> None:
        """Print a remark on standard error; nothing with --quiet."""
        if not self.quiet:
            _say(text, err=True)

    def warnings(self, texts: Sequence[str]) -> None:
        """Print warnings about the result on standard error."""
        for text in texts:
            self.remark(f"warning: {one_line(text)}")

    def done(self, document: Mapping[str, Any], text: str) -> None:
        """Print the result of a command that writes files: the document with --json, else the text unless --quiet."""
        if self.json:
            write_json(document)
        elif not self.quiet:
            _say(text)

    def answer(self, document: Mapping[str, Any], *parts: str) -> None:
        """Print the requested answer, also with --quiet: the document with --json, else the parts."""
        if self.json:
            write_json(document)
        else:
            _say("\n\n".join(part for part in parts if part))


def _say(text: str, *, err: bool = False) -> None:
    """Print sentences, wrapped between words in a terminal."""
    stream = sys.stderr if err else sys.stdout
    width = shutil.get_terminal_size().columns
    _print("\n".join(_fitted(line, width) for line in text.split("\n")) if stream.isatty() else text, err=err)


def _fitted(line: str, width: int) -> str:
    """Return a line wrapped between words at `width`; a command to copy is not wrapped."""
    import textwrap

    if len(line) <= width or line.startswith("next: "):
        return line
    indent = " " * (len(line) - len(line.lstrip(" ")) + 2 * line.lstrip(" ").startswith("- "))
    lines = textwrap.TextWrapper(max(width, 40), subsequent_indent=indent, replace_whitespace=False)
    lines.break_long_words = lines.break_on_hyphens = False
    return lines.fill(line)


def _print(text: str, *, err: bool = False) -> None:
    """Print text with terminal control characters escaped."""
    typer.echo(visible(text), err=err)


def write_json(document: Mapping[str, Any]) -> None:
    """Write one JSON document to standard output; NaN and infinity become null."""
    _print(json_text(document, ascii_only=True))


def say_failure(message: str, *, kind: str, as_json: bool, code: int = 1) -> int:
    """Print the error message of a failed command, and return the exit code."""
    if as_json:
        write_json({"error": {"kind": kind, "message": message}})
    _say(message if code == 130 else f"error: {message}", err=True)
    return code


def say_usage(error: typer.TyperException, *, as_json: bool) -> int:
    """Print the error of the command line, and return exit code 2."""
    message = error.format_message()
    if as_json:
        write_json({"error": {"kind": "Usage", "message": message}})
    context = getattr(error, "ctx", None)
    if context is not None:
        _print(context.get_usage(), err=True)
        _print(f"Try '{context.command_path} --help'.", err=True)
    _say(f"error: {message}", err=True)
    return 2


def columns(most: int = 80) -> int:
    """Return the width of the output, characters: that of the terminal (or COLUMNS), at most `most`."""
    return max(40, min(most, shutil.get_terminal_size((most, 24)).columns))


def table(header: Sequence[str], rows: Sequence[Sequence[str]], *, title: str = "") -> str:
    """Return a plain table of at most 80 columns, fewer in a narrow terminal.

    The first column is text, the others are right-aligned numbers.

    Args:
        header: Heading of each column; a column whose heading ends in a blank is left-aligned text.
        rows: Cells as text; each row has as many as the header.
        title: Line above the table.
    """
    from rich.cells import cell_len

    header, *rows = [[one_line(cell) for cell in row] for row in (header, *rows)]
    texts = [index == 0 or name.endswith(" ") for index, name in enumerate(header)]
    longest = [max(map(cell_len, column)) for column in zip(header, *rows, strict=True)]
    body = ""
    if sum(longest) + 2 * len(longest) > columns():
        header = [name if left else name.replace(" ", "\n") for name, left in zip(header, texts, strict=True)]
        numbers = [[*header[at].split("\n"), *(row[at] for row in rows)] for at, left in enumerate(texts) if not left]
        room = columns() - sum(2 + max(map(cell_len, column)) for column in numbers)
        if room < MIN_TEXT * sum(texts):
            body = _stacked(header, rows, texts) if numbers and room >= 0 else _listed(header, rows)
    body = body or _grid(header, rows, texts)
    return f"{title}\n{body}" if title else body


def _grid(header: Sequence[str], rows: Sequence[Sequence[str]], texts: Sequence[bool]) -> str:
    """Return a table with its texts folded and its numbers in one line each."""
    import io

    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    grid = Table(box=None, pad_edge=False, show_edge=False, padding=(0, 2, 0, 0))
    for name, left in zip(header, texts, strict=True):
        grid.add_column(name.strip(), justify="left" if left else "right", overflow="fold", no_wrap=not left)
    for row in rows:
        grid.add_row(*map(Text, row))  # as Text: rich would parse `[a]` in a path as a style
    page = io.StringIO()
    Console(file=page, width=columns(), markup=False, highlight=False, emoji=False, no_color=True).print(grid)
    return "\n".join(line.rstrip() for line in page.getvalue().splitlines())


def _stacked(header: Sequence[str], rows: Sequence[Sequence[str]], texts: Sequence[bool]) -> str:
    """Return a table for a narrow terminal, with the texts of each row on a separate line above its numbers."""
    numbers = [["", *(cell for cell, left in zip(row, texts, strict=True) if not left)] for row in (header, *rows)]
    lines = _grid(numbers[0], numbers[1:], [True] + [False] * (len(numbers[0]) - 1)).split("\n")
    head = len(lines) - len(rows)
    for row, line in zip(rows, lines[head:], strict=True):
        named = [f"{header[at].strip()}: {row[at]}" for at in range(1, len(row)) if texts[at] and row[at]]
        lines += [bullet([", ".join([row[0], *named])], mark=""), line]
    return "\n".join(lines[:head] + lines[head + len(rows) :])


def _listed(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table whose columns do not fit beside each other: each row as `heading: cell, heading: cell`."""
    names = [" ".join(name.split()) for name in header]
    return bullet([", ".join(map(": ".join, zip(names, row, strict=True))) for row in rows])


class _Forecast:
    """Remaining time: at each report in proportion to what was spent until then; from there on it runs down.

    The longer a step takes, the later the next report comes: in proportion to what is spent by now, the same fraction
    would promise more and more time.
    """

    def __init__(self) -> None:
        self.began_s, self.fraction, self.total_s = time.monotonic(), 0.0, 0.0

    @property
    def spent_s(self) -> float:
        return time.monotonic() - self.began_s

    def report(self, fraction: float) -> None:
        if fraction > self.fraction:
            self.fraction, self.total_s = fraction, self.spent_s / fraction

    @property
    def left(self) -> str:
        """The remaining time as text; empty before a tenth is done, and once it is over."""
        left_s = self.total_s - self.spent_s
        return f"about {duration(left_s)} left" if self.fraction >= FORESEEN and left_s > 0.0 else ""


class _Lines:
    """Progress as lines, for output that cannot be redrawn: after 2 s, 4 s, 8 s ..., so that a log stays short.

    A thread prints them also while the work does not report.
    """

    def __init__(self, title: str) -> None:
        self.title, self.next_s, self.forecast = title, PATIENCE_S, _Forecast()
        self.text = ""
        self.turn, self.done = threading.Lock(), threading.Event()
        self.watch = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> _Lines:
        self.watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.done.set()
        self.watch.join()

    def __call__(self, fraction: float, text: str) -> None:
        self.text = text
        self.forecast.report(fraction)
        self._say()

    def _watch(self) -> None:
        while not self.done.wait(PATIENCE_S / 4):
            self._say()

    def _say(self) -> None:
        with self.turn:
            spent_s, fraction = self.forecast.spent_s, self.forecast.fraction
            if spent_s < self.next_s or fraction >= 1:
                return
            self.next_s = spent_s * 2
            far = f"{percent(fraction)} after {duration(spent_s)}" if fraction > 0 else duration(spent_s)
            left = f", {told}" if (told := self.forecast.left) else ""
            _print(f"{self.title}: {far}{left}  {one_line(self.text)}".rstrip(), err=True)


def _drawn(title: str) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        ProgressColumn,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
    )
    from rich.table import Column
    from rich.text import Text

    forecast = _Forecast()

    class Left(ProgressColumn):
        def render(self, task: object) -> Text:
            return Text(forecast.left)

    rest = Column(ratio=1, no_wrap=True, overflow="ellipsis")
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=16),
        TaskProgressColumn(),
        TextColumn("{task.fields[rate]}", markup=False),
        TimeElapsedColumn(),
        Left(),
        TextColumn("{task.fields[text]}", markup=False, table_column=rest),
    )
    console = Console(stderr=True, markup=False, highlight=False, emoji=False)
    with Progress(*columns, console=console, transient=True, expand=True) as bar:
        task = bar.add_task(title, total=None, text="", rate="")  # pulses until the work reports its progress

        def show(fraction: float, text: str) -> None:
            forecast.report(fraction)
            spent_s = max(forecast.spent_s, 1e-9)
            rate = f"{percent(fraction / spent_s)}/s" if fraction > 0 else ""
            if fraction > 0:
                bar.update(task, total=1.0, completed=min(fraction, 1.0))
            bar.update(task, text=one_line(text), rate=rate)

        yield show


def bullet(texts: Sequence[str], *, mark: str = "- ", width: int = 80) -> str:
    """Return a list of texts, each with its mark, wrapped at `width` characters or that of the terminal."""
    import textwrap

    mark = one_line(mark)
    lines = textwrap.TextWrapper(columns(width), initial_indent=mark, subsequent_indent=" " * len(mark))
    return "\n".join(map(lines.fill, texts))


def write_out(file: Path, content: str | Mapping[str, Any]) -> None:
    """Write text, or a document as JSON, atomically: the file is either the old or the new one.

    Raises:
        CyclekitError: The file cannot be written.
    """
    from cyclekit.storage.atomic import write_text

    write_text(file, content if isinstance(content, str) else json_text(content, ascii_only=True) + "\n")
