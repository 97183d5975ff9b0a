"""Answers to a question about several changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit.estimate.answers import Answers
from cyclekit.estimate.finding import Finding, light_of, merged
from cyclekit.estimate.whatif.answer import NO_PROOF, WhatIf

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, repr=False)
class WhatIfAnswers(Answers[WhatIf]):
    """Every sequence under every change.

    Attributes:
        answers: One for each change and sequence, in the order of the changes.
        refused: Sequences that these logs cannot answer in the unchanged cell, and changes that they cannot answer.
        safety: Note that this is no safety proof.
    """

    safety: str = NO_PROOF

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is known about the basis of the numbers, the worst first."""
        return merged(side.findings for one in self for side in (one.before, one.after))

    def to_dict(self) -> dict[str, object]:
        """Return everything as plain JSON values."""
        return {
            "safety": self.safety,
            **light_of(self.findings),
            "answers": [one.to_dict() for one in self],
            "refused": [one.to_dict() for one in self.refused],
        }

    def to_frame(self) -> pl.DataFrame:
        """Return one row per change and sequence, seconds."""
        import polars as pl

        return pl.concat([one.to_frame() for one in self]) if self.answers else pl.DataFrame()

    def _lines(self) -> list[str]:
        lines = [repr(one).partition(": ")[2] for one in self]
        return [self.safety, *lines, *(f"not answered: {one.error.seen}" for one in self.refused)]
