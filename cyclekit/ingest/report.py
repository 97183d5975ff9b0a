"""Report of an ingest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl

from cyclekit.dataset.cards import texts
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from cyclekit.dataset.cards import DatasetCard, RecordingCard


@dataclass(frozen=True, repr=False)
class IngestReport(Result):
    """Result of an ingest.

    Attributes:
        dataset: Its folder on this machine.
        place: Path or URL of the dataset, as requested.
        recordings_new: Number of recordings read.
        recordings_kept: Number of recordings reused from the old dataset without reading their logs.
        not_read: Files found but not used, with reasons.
        said: What the user must know before trusting the dataset: name of a recording (empty if it concerns all) and a
            sentence.
        unchanged: The dataset was up to date; nothing was read or written.
    """

    dataset: Path
    place: str
    recordings_new: int
    recordings_kept: int
    executions: int
    tasks: int
    samples: int
    not_read: tuple[tuple[str, str], ...]
    said: tuple[tuple[str, str], ...]
    unchanged: bool

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user must know before trusting the dataset, one sentence each."""
        return tuple(f"{name}: {text}" if name else text for name, text in self.said)

    def to_dict(self) -> dict[str, object]:
        """Return the report as plain JSON values."""
        not_read = [{"path": path, "reason": reason} for path, reason in self.not_read]
        found = {name: value for name, value in vars(self).items() if name != "said"}
        return {**found, "dataset": self.place, "not_read": not_read, "warnings": list(self.warnings)}

    def to_frame(self) -> pl.DataFrame:
        """Return one row per file that was not read."""
        return pl.DataFrame(list(self.not_read), schema={"path": pl.String, "reason": pl.String}, orient="row")

    def _lines(self) -> list[str]:
        counts = f"{self.executions} executions, {self.tasks} tasks, {self.samples} samples"
        kept = f", {self.recordings_kept} kept" if self.recordings_kept else ""
        read = f"recordings: {self.recordings_new} read{kept}; files not read: {len(self.not_read)}"
        return [f"{self.place}: {counts}", read]


def report_of(out: Path, card: DatasetCard, *, new: int, kept: int, unchanged: bool) -> IngestReport:
    """Return the report on a dataset in `out`, with `new` recordings read and `kept` recordings reused."""
    said = [("", text) for text in texts(card.warnings)]
    said += [(_shown(one), text) for one in card.recordings for text in one.said]
    return IngestReport(
        dataset=out,
        place=str(out),
        recordings_new=new,
        recordings_kept=kept,
        executions=len(card.executions),
        tasks=card.rows.tasks,
        samples=card.rows.samples,
        not_read=tuple((one.path, one.reason) for one in card.not_read),
        said=tuple(said),
        unchanged=unchanged,
    )


def _shown(card: RecordingCard) -> str:
    """Return the name of a recording in messages: its file, or its id for a folder that is one log."""
    return card.shown if len(card.sources) == 1 else card.id
