"""Answers to a question about several sequences: the estimates, and the sequences without an answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar, overload

from cyclekit.config.sequences import TaskSequence
from cyclekit.errors import EstimateError
from cyclekit.estimate.finding import Finding, light_of, merged
from cyclekit.estimate.gantt import gantt_figure
from cyclekit.estimate.result import SPLIT, CycleEstimate
from cyclekit.text.numbers import counted
from cyclekit.text.plain_text import csv_text
from cyclekit.text.results import Result

if TYPE_CHECKING:
    import polars as pl

    from cyclekit.estimate.validation.check import Check
    from cyclekit.estimate.whatif.change import Change
    from cyclekit.plots.drawing import Drawing

Answer = TypeVar("Answer")

_MEAN = ("name", "expected_s", "expected_low_s", "expected_high_s")


@dataclass(frozen=True)
class Refusal:
    """A sequence, a change or an order search that these logs cannot answer.

    Attributes:
        name: Its name.
        error: The reason.
        kind: What it is.
        sequence: The sequence, if it is one.
    """

    name: str
    error: EstimateError
    kind: Literal["sequence", "change", "order"] = "sequence"
    sequence: TaskSequence | None = None

    @property
    def reason(self) -> str:
        """The reason and its cure in one line."""
        return ". ".join(part for part in (self.error.seen.removesuffix("."), self.error.cure) if part)

    @property
    def why(self) -> str:
        """The reason without the name, for a table that has it in another column."""
        named = (f"change {self.name!r}", *(() if self.sequence is None else (self.sequence.shown,)))
        text = self.reason
        for start in named:
            text = text.removeprefix(f"{start}: ")
        return text

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {self.kind: self.name, "reason": str(self.error)}


@dataclass(frozen=True, repr=False)
class Answers(Result, Sequence[Answer]):
    """The answers to several questions, in order, and the questions without an answer.

    Attributes:
        answers: The answers.
        refused: The questions without an answer, each with its reason.
    """

    answers: tuple[Answer, ...]
    refused: tuple[Refusal, ...] = ()

    @overload
    def __getitem__(self, index: int) -> Answer: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Answer, ...]: ...

    def __getitem__(self, index: int | slice) -> Answer | tuple[Answer, ...]:
        """Return one answer, or a slice of them."""
        return self.answers[index]

    def __len__(self) -> int:
        """Return the number of answers."""
        return len(self.answers)

    def require_all(self) -> Self:
        """Return this object if every question has an answer.

        Raises:
            EstimateError: The reason of the first question without an answer.
        """
        for refusal in self.refused:
            raise refusal.error
        return self

    def require(self, name: str | None) -> None:
        """Refuse a name without an answer.

        Raises:
            EstimateError: The reason why it has none.
        """
        for refusal in self.refused:
            if refusal.name == name:
                raise refusal.error


@dataclass(frozen=True, repr=False)
class CycleEstimates(Answers[CycleEstimate]):
    """The estimates of several sequences, grouped by work, shortest first."""

    @property
    def check(self) -> Check | None:
        """The validation on logged executions that corrected the estimates; None without one."""
        return self[0].check if self.answers else None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is known about the basis of the numbers, the worst first: the traffic light above them."""
        return merged(one.findings for one in self)

    def plot(self) -> Drawing:
        """Return a time chart of the sequences (mean times) as a matplotlib figure."""
        return gantt_figure(self.answers)

    def to_dict(self) -> dict[str, object]:
        """Return everything as plain JSON values."""
        return {
            **light_of(self.findings),
            "sequences": [one.to_dict() for one in self],
            "refused": [one.to_dict() for one in self.refused],
            "check": self.check.to_dict() if self.check else None,
        }

    def to_frame(self) -> pl.DataFrame:
        """Return one row per sequence: mean, 95 % interval, quantiles of single cycles (`q0.05_s`), split; s."""
        import polars as pl

        heads, rows = self._rows()
        return pl.DataFrame(rows, schema=heads, orient="row", infer_schema_length=None)

    def to_csv(self) -> str:
        """Return the frame as CSV."""
        heads, rows = self._rows()
        return csv_text([heads, *rows])

    def _rows(self) -> tuple[list[str], list[list[Any]]]:
        levels = sorted(self[0].quantiles_s) if self.answers else []
        heads = [*_MEAN, "level", *(f"q{level:g}_s" for level in levels), *SPLIT, "support", "tracks", "warnings"]
        rows = [
            [
                *(getattr(one, name) for name in _MEAN),
                one.level,
                *(one.quantiles_s[level] for level in levels),
                *(getattr(one, name) for name in SPLIT),
                *(one.support, one.tracks, " | ".join(one.warnings)),
            ]
            for one in self
        ]
        return heads, rows

    def _lines(self) -> list[str]:
        means = [f"{one.name!r} {one.mean_in_words}" for one in self]
        return [counted(len(self), "sequence"), *means, *(f"not answered: {one.error.seen}" for one in self.refused)]


def together(refused: Sequence[Refusal]) -> EstimateError:
    """Return one error that names everything without an answer."""
    first, *others = {str(one.error): one.error for one in refused}.values()
    if not others:
        return first
    return EstimateError(first.seen, cure="\n".join([first.cure or "", *map(str, others)]).strip())


def refusing(refused: list[Refusal], asked: TaskSequence | Change, error: EstimateError) -> None:
    """Add a sequence or change to `refused`, each reason once."""
    if (asked.name, str(error)) in {(one.name, str(one.error)) for one in refused}:
        return
    if isinstance(asked, TaskSequence):
        refused.append(Refusal(asked.name, error, "sequence", asked))
    else:
        refused.append(Refusal(asked.name, error, "change"))
