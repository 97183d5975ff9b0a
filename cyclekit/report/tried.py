"""Changes tried: cycle times of the same sequences under a change, computed or read from a file.

`helps` reports the savings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from cyclekit.errors import CyclekitError
from cyclekit.estimate.result import CycleEstimate

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from cyclekit.estimate.whatif import WhatIf


@dataclass(frozen=True)
class Tried:
    """One sequence under one change.

    Attributes:
        label: Name of the change, as the user wrote it.
        sequence: Name of the sequence.
        expected_s: Mean cycle time.
        low_s, high_s: Its 95 % interval.
        saves_s: Saving with its 95 % interval over common operator tracks; None where only the estimate is known.
        support: Share of the cycle near logged positions; None where unknown.
        limits: What limits the number, one sentence each.
        places: Ordered places of the sequence, the start first; empty where unknown.
        operator: Operator tasks of the sequence; None if it names none.
        within: Share of its cycles within the takt, with its 95 % interval; None where that is not known.
    """

    label: str
    sequence: str
    expected_s: float
    low_s: float
    high_s: float
    saves_s: tuple[float, float, float] | None = None
    support: float | None = None
    limits: tuple[str, ...] = ()
    places: tuple[str, ...] = ()
    operator: tuple[str, ...] | None = None
    within: tuple[float, float, float] | None = None

    @staticmethod
    def of(found: WhatIf | _Answer, takt_s: float | None = None) -> Tried:
        """Return a result of `whatif` as a row of the page, compared with a takt if one is given."""
        after, support = found.after, found.after.support
        known = support is not None and not math.isnan(support)  # a safety function that is given holds everywhere
        return Tried(
            found.change,
            *_times(after),
            saves_s=found.saves_s,
            support=support if known else None,
            limits=tuple(text for text in after.warnings if text != found.safety),
            places=after.places,
            operator=after.operator,
            within=None if takt_s is None or not isinstance(after, CycleEstimate) else after.within(takt_s),
        )

    def saves(self, before: Mapping[str, CycleEstimate]) -> tuple[float, float | None, float | None] | None:
        """Return the saving in seconds and its interval.

        Without `saves_s`: against the unchanged estimate of the sequence of that name, without interval; None if there
        is none, or if it visits other places.
        """
        if self.saves_s is not None:
            return self.saves_s
        same = before.get(self.sequence)
        if same is None or (self.places and self.places != same.places):
            return None
        return same.expected_s - self.expected_s, None, None

    def surely_saves(self, before: Mapping[str, CycleEstimate]) -> bool:
        """Return whether the whole interval is a saving; without an interval, whether the mean is."""
        saves = self.saves(before)
        return saves is not None and (saves[0] if saves[1] is None else saves[1]) > 0


class _Estimate(msgspec.Struct):
    """A sequence in a file of `whatif` or `estimate`."""

    name: str
    expected_s: float
    expected_low_s: float
    expected_high_s: float
    support: float | None = None
    warnings: tuple[str, ...] = ()
    places: tuple[str, ...] = ()
    operator: tuple[str, ...] | None = None


class _Answer(msgspec.Struct):
    """An answer in a file of `whatif`."""

    change: str
    after: _Estimate
    saves_s: tuple[float, float, float]
    safety: str


class _Document(msgspec.Struct):
    """A file of `whatif`, which has answers, or of `estimate`, which has sequences."""

    answers: tuple[_Answer, ...] | None = None
    sequences: tuple[_Estimate, ...] | None = None


def _times(of: CycleEstimate | _Estimate) -> tuple[str, float, float, float]:
    return of.name, of.expected_s, of.expected_low_s, of.expected_high_s


def load_tried(file: Path, label: str | None = None) -> list[Tried]:
    """Read the output of `cyclekit whatif --out x.json` or `cyclekit estimate --out x.json`.

    Args:
        file: The JSON document.
        label: Name of the change; needed for estimates, while answers of `whatif` bring their own.

    Raises:
        CyclekitError: The file cannot be read, or is not such a document.
    """
    cure = (
        "Give the file of `cyclekit whatif … --out FILE.json`, or LABEL=FILE.json with the file of `cyclekit estimate`."
    )
    try:
        document = msgspec.json.decode(file.read_bytes(), type=_Document)
    except OSError as error:
        raise CyclekitError(f"{file}: cannot be read ({error.strerror})", cure=cure) from error
    except (ValueError, RecursionError) as error:
        raise CyclekitError(f"{file}: not an output of whatif or estimate ({error})", cure=cure) from error
    if document.answers is not None:
        return [Tried.of(each) for each in document.answers]
    if document.sequences is None or label is None:
        why = "no answers and no sequences" if label else "an estimate needs the name of its change"
        raise CyclekitError(f"{file}: not an output of whatif ({why})", cure=cure)
    return [Tried(label, *_times(each), places=each.places, operator=each.operator) for each in document.sequences]
