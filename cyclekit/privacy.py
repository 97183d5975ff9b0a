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

from cyclekit.atomic import write_parquet

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit.adapter import Recording
    from cyclekit.config import Cell

_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
_DATE = re.compile(r"(?:19|20)\d\d[-_.]?[01]\d[-_.]?[0-3]\d")


def without_names(recording: Recording, *, keep: str | None = None) -> Recording:
    """Return the recording with numbered people, without facts, and with nothing quoted from the log.

    Args:
        recording: As it was read.
        keep: A body that is nobody (the one on the robot's flange) and keeps its name.
    """
    people, skeletons = recording.people, recording.skeletons
    named = [table["person"] for table in (people, skeletons) if table is not None and table.height]
    names = pl.concat(named).drop_nulls().unique(maintain_order=True).to_list() if named else []
    numbers = {name: f"person_{number}" for number, name in enumerate(names, 1)}
    numbers |= {name: name for name in names if name == keep}
    numbered = pl.col("person").replace_strict(numbers, default=None, return_dtype=pl.String)
    people = people.with_columns(numbered) if people is not None and people.height else people
    skeletons = skeletons.with_columns(numbered) if skeletons is not None and skeletons.height else skeletons
    aside = recording.set_aside
    if aside is not None and aside.height:
        aside = aside.with_columns(pl.col("reason").map_elements(_unquoted, return_dtype=pl.String))
    warnings = tuple(map(_unquoted, recording.warnings))
    facts = {name: text for name, text in recording.facts.items() if name == "checksum"}
    return replace(recording, people=people, skeletons=skeletons, set_aside=aside, warnings=warnings, facts=facts)


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
            stamps = pl.read_parquet(file, glob=False)
            write_parquet(stamps.with_columns(pl.col("host_s") - pl.col("host_s").min()), file)
        if entry["clock"]["kind"] != "epoch":
            continue
        clock, shift_s = entry["clock"], entry["first_s"]
        for name in entry["tables"]:
            file = staging / "recordings" / entry["id"] / f"{name}.parquet"
            write_parquet(pl.read_parquet(file, glob=False).with_columns(pl.col("t_s") - shift_s), file)
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
