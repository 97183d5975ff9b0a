"""Removal of names and dates from a dataset, on request.

An operator's position with a time is personal data in most plants. Estimates need neither the name nor the date. Tracks
become `person_1`, `person_2` ... in order of appearance, logs `recording_1`, `recording_2` ... in order of their paths,
and every recording starts at 0, whatever its clock: the values decide, not the clock kind of the adapter. Of free text
(tasks, outcomes, signals and their values) only numbers, known words and words of the cell file remain. Positions
remain; docs/privacy.md explains the consequences.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import polars as pl
from msgspec import structs

from cyclekit.dataset.cards.notes import changed
from cyclekit.errors import ConfigError, LogError
from cyclekit.ingest.free_text import GONE, NUMBER, ODD, Words, without_times
from cyclekit.storage.parquet import shift_times

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cyclekit.adapter import Recording
    from cyclekit.config import Cell
    from cyclekit.dataset.cards import Note, RecordingCard
    from cyclekit.ingest.discover import Log

_SHIFTED = {"task_list": ("t_s", "end_s", "planned_start_s", "planned_end_s")}
"""Time columns of tables that have others than `t_s`."""
_NEAR_0_S = 3600.0
"""Start time, s, below which a recording holds no time of day."""
YEAR_S = 366 * 86400.0
"""Minimum difference, s, that indicates two clocks and so reveals the date."""
_QUOTED = re.compile(r"(?<!\w)(?:'(?:\\.|[^'\\])*'|\"(?:\\.|[^\"\\])*\")(?!\w)")
_ENDINGS = (".bag", ".bin", ".c3d", ".csv", ".db3", ".gz", ".json", ".jsonl", ".log", ".mcap", ".tsv", ".txt", ".xml")
"""File endings that are kept, because they show the format and no name."""


class Nameless:
    """Removes the names from a recording, part by part: numbers people, and removes quotes from the log."""

    def __init__(self, *, keep: str | None = None, words: Words | None = None) -> None:
        """Set up without any names.

        Args:
            keep: A body that is no person (the one on the robot's flange) and keeps its name.
            words: Which words of free text remain.
        """
        self._keep, self._words = keep, words or Words()
        self._numbers: dict[str, str] = {}
        self._execution_numbers: dict[str, str] = {}
        self._spans: dict[str, tuple[float, float]] = {}

    def part(self, recording: Recording) -> Recording:
        """Return a part of the recording with numbered people and without facts."""
        tables = recording.tables()
        changed = {name: self._numbered(table) for name, table in tables.items() if "person" in table.columns}
        if "task_list" in tables:
            changed["task_list"] = self._nameless_tasks(tables["task_list"])
        if "safety" in tables:
            changed["safety"] = tables["safety"].with_columns(self._executions(tables["safety"]))
        if "events" in tables:
            changed["events"] = self._without_words(tables["events"], "signal", "value")
        for name, table in tables.items():
            if table.height:
                first, last = self._spans.get(name, (float("inf"), -float("inf")))
                low, high = table["t_s"].min(), table["t_s"].max()
                self._spans[name] = min(first, float(low)), max(last, float(high))  # type: ignore[arg-type]
        aside = recording.set_aside
        if aside is not None and aside.height:
            aside = aside.with_columns(pl.col("reason").map_elements(self._said, return_dtype=pl.String))
        warnings = tuple(map(self._said, recording.warnings))
        facts = {name: self._said(text) for name, text in recording.facts.items() if name == "checksum"}
        joints = tuple(map(self._words.hidden, recording.joint_names))
        return replace(recording, **changed, set_aside=aside, warnings=warnings, facts=facts, joint_names=joints)  # type: ignore[arg-type]

    def check(self, path: Path) -> None:
        """Refuse a log whose clock was set during recording, because the size of that step reveals the date.

        Raises:
            LogError: Its times span more than a year.
        """
        first = min((span[0] for span in self._spans.values()), default=0.0)
        last = max((span[1] for span in self._spans.values()), default=0.0)
        if last - first > YEAR_S:
            cause = (
                "its times lie more than a year apart, so its clock was set while it recorded; that reveals the date"
            )
            raise LogError(path, cause, cure="Split the log there, or ingest without --pseudonymise.")

    def _nameless_tasks(self, table: pl.DataFrame) -> pl.DataFrame:
        """Return a task list with numbered operators and executions, also within task names."""
        operators = table.filter(pl.col("agent") == "operator")["agent_name"].drop_nulls().unique(maintain_order=True)
        for name in operators:
            self._numbers.setdefault(name, f"person_{len(self._numbers) + 1}")
        table = table.with_columns(self._executions(table))
        return self._without_words(table, "agent_name", "task", "outcome")

    def _without_words(self, table: pl.DataFrame, *columns: str) -> pl.DataFrame:
        """Return a table whose texts keep no words but known ones, and numbers in place of people."""
        people = {name: number for name, number in self._numbers.items() if name != self._keep}

        def instead(text: str) -> str:
            return people.get(text) or self._words.hidden(text, people)

        for column in columns:
            new = {text: instead(text) for text in table[column].drop_nulls().unique(maintain_order=True)}
            table = (
                table.with_columns(pl.col(column).replace_strict(new, default=None, return_dtype=pl.String))
                if new
                else table
            )
        return table

    def _executions(self, table: pl.DataFrame) -> pl.Expr:
        """Return the execution column with numbers: execution names show their time, and sometimes a person."""
        for name in table["execution"].drop_nulls().unique(maintain_order=True):
            self._execution_numbers.setdefault(name, f"execution_{len(self._execution_numbers) + 1}")
        if not self._execution_numbers:
            return pl.col("execution")
        return pl.col("execution").replace_strict(self._execution_numbers, default=None, return_dtype=pl.String)

    def _numbered(self, table: pl.DataFrame) -> pl.DataFrame:
        for name in table["person"].drop_nulls().unique(maintain_order=True).to_list():
            if name not in self._numbers:
                self._numbers[name] = name if name == self._keep else f"person_{len(self._numbers) + 1}"
        numbers = pl.col("person").replace_strict(self._numbers, default=None, return_dtype=pl.String)
        return table.with_columns(numbers) if self._numbers else table

    def _said(self, text: str) -> str:
        people = {name: GONE for name in self._numbers if name != self._keep}
        text = _without(_QUOTED.sub(f"'{GONE}'", text), people)
        return without_times(ODD.sub(lambda found: self._words.hidden(found[0], people), text))


def _without(text: str, names: dict[str, str]) -> str:
    """Return a text with names replaced; names of one or two characters are ambiguous and remain."""
    for name in sorted(names, key=len, reverse=True):
        if len(name) > 2 and name in text:
            text = re.sub(rf"(?<!\w){re.escape(name)}(?!\w)", names[name].replace("\\", r"\\"), text)
    return text


def numbered_logs(logs: Sequence[Log]) -> list[Log]:
    """Return the logs with neutral ids."""
    digits = len(str(len(logs)))
    return [replace(log, id=f"recording_{number:0{digits}d}") for number, log in enumerate(logs, 1)]


def shown_as(log: Log) -> str:
    """Return the replacement for a file name of a numbered log: its number and the format's ending."""
    return f"{log.id}{_ending(log.shown)}"


def _ending(name: str) -> str:
    kept = [suffix for suffix in PurePosixPath(name).suffixes[-2:] if suffix.lower() in _ENDINGS]
    return "".join(kept)


@dataclass(frozen=True)
class Names:
    """Names used in an ingest of numbered logs, and their replacements."""

    logs: Sequence[Log]
    roots: Sequence[Path]
    cell: Cell

    def said(self, text: str) -> str:
        """Return a sentence without names of files and bodies, and without times."""
        return without_times(_without(text, self._known()))

    def notes(self, notes: Iterable[Note]) -> list[Note]:
        """Return notes without names of files and bodies, and without times."""
        return [changed(one, self.said, lambda value: value) for one in notes]

    def not_read(self, files: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
        """Return the files not read, with reasons, under neutral names."""
        found = []
        for number, (name, reason) in enumerate(files, 1):
            new = f"not_read_{number}{_ending(name)}"
            mine = {name: new, PurePosixPath(name).name: new}
            found.append((new, self.said(_QUOTED.sub(f"'{GONE}'", _without(reason, mine)))))
        return found

    def settings(self) -> Cell:
        """Return the settings without names of files and bodies, and without offsets, which would reveal the time.

        The cell's name is kept unless it is only that of a folder or file.
        """
        sources = [
            replace(
                one, path=f"source_{number}", body=None, sees_as=None, clock_offset_s=None, sync_events=(), start=None,
                same_clock_as=None, map={},
            )
            for number, one in enumerate(self.cell.sources, 1)
        ]  # fmt: skip
        folders = {name for root in self.roots for name in (*root.resolve().parts, root.resolve().stem)}
        name = "cell" if self.cell.name in folders else self.cell.name
        return replace(self.cell, name=name, sources=tuple(sources), ignore=(), reference=())

    def _known(self) -> dict[str, str]:
        known = dict.fromkeys((*self.cell.ignore, *self.cell.reference), GONE)
        for number, source in enumerate(self.cell.sources, 1):
            known[source.path] = f"source_{number}"
            known |= {name: GONE for name in (source.body, source.same_clock_as) if name}
        for log in self.logs:
            new = shown_as(log)
            names = {str(log.path), log.shown, log.path.name, PurePosixPath(log.shown).stem}
            known |= dict.fromkeys(names, new)
        return known


def take_out(
    recordings: Sequence[RecordingCard], names: Names, staging: Path, copies: Mapping[str, str]
) -> list[RecordingCard]:
    """Shift every recording to start at 0, in its tables under `staging` and in its card, and rename its files.

    Its position in the session's time is unchanged: the clock offset compensates the shift. Host stamps are removed,
    because they serve only the clocks, which are known by now. `copies` maps the id of each additional recording of a
    shared log to the id of that log.

    Raises:
        ConfigError: Two recordings of a session are years apart: the clock of one was not set.
    """
    logs = {log.id: log for log in names.logs}
    return [
        _without_time(one, logs[copies.get(one.id, one.id)], names, staging / "recordings" / one.id)
        for one in recordings
    ]


def _without_time(card: RecordingCard, log: Log, names: Names, folder: Path) -> RecordingCard:
    if "stamps" in card.tables:
        (folder / "stamps.parquet").unlink()
    tables = tuple(name for name in card.tables if name != "stamps")
    for name in tables if card.first_s else ():
        for column in _SHIFTED.get(name, ("t_s",)):
            shift_times(folder / f"{name}.parquet", card.first_s, column=column)
    offset_s = card.clock.offset_s + card.clock.rate * card.first_s
    if abs(offset_s) > YEAR_S:
        seen = f"{log.shown}: begins more than a year apart from the robot's log; one of their clocks was not set"
        raise ConfigError(seen, cure="Give its clock_offset_s in the cell file, or leave the log out.")
    kind = "relative" if card.clock.kind == "epoch" else card.clock.kind
    said = partial(_said, names=names, span_s=(card.first_s, card.last_s))
    numbered = (f"{log.id}/file_{number}{_ending(one.path)}" for number, one in enumerate(card.sources, 1))
    paths = [shown_as(log)] if len(card.sources) == 1 else numbered
    operator = card.operator
    return structs.replace(
        card,
        tables=tables,
        rows={name: count for name, count in card.rows.items() if name != "stamps"},
        clock=structs.replace(card.clock, kind=kind, offset_s=offset_s, warnings=said(card.clock.warnings)),
        operator=None if operator is None else structs.replace(operator, warnings=said(operator.warnings)),
        warnings=said(card.warnings),
        listed=said(card.listed),
        first_s=0.0,
        last_s=card.last_s - card.first_s,
        key="",  # derived from paths and times of files; pseudonymised logs are always read again
        sources=tuple(structs.replace(one, path=path) for one, path in zip(card.sources, paths, strict=True)),
    )


def _said(notes: Iterable[Note], *, names: Names, span_s: tuple[float, float]) -> tuple[Note, ...]:
    """Return notes without names and times.

    If a recording does not start near 0, its own times are also removed: they are seconds of the day, or of a
    controller.
    """

    def number(value: float) -> float | str:
        return GONE if span_s[0] >= _NEAR_0_S and span_s[0] <= value <= span_s[1] else value

    return tuple(changed(one, lambda text: names.said(_without_span(text, span_s)), number) for one in notes)


def _without_span(text: str, span_s: tuple[float, float]) -> str:
    first_s, last_s = span_s
    if first_s < _NEAR_0_S:
        return text

    def said(found: re.Match[str]) -> str:
        return GONE if first_s <= float(found[0].replace(",", "")) <= last_s else found[0]

    return NUMBER.sub(said, text)
