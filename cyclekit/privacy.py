"""What names a person or tells when somebody was there, taken out of a dataset on demand.

Where an operator stood at which second is personal data in most plants. The estimate needs neither who it was nor the
date: tracks become `person_1`, `person_2` ... in order of appearance, apart for each recording, and a log in epoch
time begins at 0. Positions stay, and file names stay: docs/privacy.md says what that means.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import polars as pl

from cyclekit.tables import shift_times

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit.adapter import Recording
    from cyclekit.config import Cell

_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
_DATE = re.compile(r"(?:19|20)\d\d[-_.]?[01]\d[-_.]?[0-3]\d")


class Nameless:
    """Takes the names out of a recording, part by part: people are numbered, and nothing is quoted from the log."""

    def __init__(self, *, keep: str | None = None) -> None:
        """Begin.

        Args:
            keep: A body that is nobody (the one on the robot's flange) and keeps its name.
        """
        self._keep = keep
        self._numbers: dict[str, str] = {}

    def part(self, recording: Recording) -> Recording:
        """Return a part of the recording with numbered people, and without facts."""
        named = {name: self._numbered(table) for name, table in recording.tables().items() if "person" in table.columns}
        aside = recording.set_aside
        if aside is not None and aside.height:
            aside = aside.with_columns(pl.col("reason").map_elements(_unquoted, return_dtype=pl.String))
        warnings = tuple(map(_unquoted, recording.warnings))
        facts = {name: text for name, text in recording.facts.items() if name == "checksum"}
        return replace(recording, **named, set_aside=aside, warnings=warnings, facts=facts)  # type: ignore[arg-type]

    def _numbered(self, table: pl.DataFrame) -> pl.DataFrame:
        for name in table["person"].drop_nulls().unique(maintain_order=True).to_list():
            if name not in self._numbers:
                self._numbers[name] = name if name == self._keep else f"person_{len(self._numbers) + 1}"
        numbers = pl.col("person").replace_strict(self._numbers, default=None, return_dtype=pl.String)
        return table.with_columns(numbers) if self._numbers else table


def _unquoted(text: str) -> str:
    return _QUOTED.sub("'…'", text)


def without_wall_clock(entries: Sequence[dict[str, Any]], staging: Path) -> None:
    """Let every recording in epoch time begin at 0, its tables under `staging` and its entry alike; hosts' times too.

    How it lies in the time of its session stays the same: what the times lose, the clock's offset gains.
    """
    for entry in entries:
        entry["key"] = ""  # made of the times of files; what is pseudonymised is read again anyway
        if "stamps" in entry["tables"]:
            file = staging / "recordings" / entry["id"] / "stamps.parquet"
            first = pl.scan_parquet(file, glob=False).select(pl.col("host_s").min()).collect().item()
            shift_times(file, first or 0.0, column="host_s")
        if entry["clock"]["kind"] != "epoch":
            continue
        clock, shift_s = entry["clock"], entry["first_s"]
        for name in entry["tables"]:
            shift_times(staging / "recordings" / entry["id"] / f"{name}.parquet", shift_s)
        entry["clock"] = {**clock, "kind": "relative", "offset_s": clock["offset_s"] + clock["rate"] * shift_s}
        entry["first_s"], entry["last_s"] = 0.0, entry["last_s"] - shift_s


def without_what_names(cell: Cell) -> Cell:
    """Return the settings without the names of bodies and without offsets, which would give the time back."""
    unsaid = {"body": None, "clock_offset_s": None, "sync_events": (), "start": None}
    return replace(cell, sources=tuple(replace(s, **unsaid) for s in cell.sources))  # type: ignore[arg-type]


def dated_names(entries: Sequence[dict[str, Any]]) -> list[str]:
    """Say which files carry a date in their name, which stays."""
    paths = [source["path"] for entry in entries for source in entry["sources"] if _DATE.search(source["path"])]
    return [f"the name of {path!r} holds a date, which stays in the dataset; rename the file" for path in paths[:3]]
