"""Changes tried: cycle times of the same sequences under a change, computed or read from a file.

`helps` reports the savings.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cyclekit.errors import CyclekitError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from cyclekit.estimate.result import CycleEstimate
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

    @staticmethod
    def of(found: WhatIf) -> Tried:
        """Return a result of `whatif` as a row of the page."""
        return _answer(found.to_dict())

    def saves(self, before: Mapping[str, CycleEstimate]) -> tuple[float, float | None, float | None] | None:
        """Return the saving in seconds and its interval.

        Without `saves_s`: against the unchanged estimate of the sequence of that name, without interval; None if there
            is
        none, or if it visits other places.
        """
        if self.saves_s is not None:
            return self.saves_s
        same = before.get(self.sequence)
        if same is None or (self.places and self.places != same.places):
            return None
        return same.expected_s - self.expected_s, None, None

    def surely_saves(self, before: Mapping[str, CycleEstimate]) -> bool:
        """Tell whether the whole interval is a saving; without one, the mean."""
        saves = self.saves(before)
        return saves is not None and (saves[0] if saves[1] is None else saves[1]) > 0


def _answer(entry: Mapping[str, Any]) -> Tried:
    after, saves, support = entry["after"], entry["saves_s"], entry["after"]["support"]
    unknown = support is None or math.isnan(support)  # a safety function that is given holds everywhere
    return Tried(
        str(entry["change"]),
        *_interval(after),
        saves_s=(float(saves[0]), float(saves[1]), float(saves[2])),
        support=None if unknown else float(support),
        limits=tuple(str(text) for text in after["warnings"] if text != entry["safety"]),
        **_what(after),
    )


def _interval(estimate: Mapping[str, Any]) -> tuple[str, float, float, float]:
    low, high = float(estimate["expected_low_s"]), float(estimate["expected_high_s"])
    return str(estimate["name"]), float(estimate["expected_s"]), low, high


def _what(estimate: Mapping[str, Any]) -> dict[str, Any]:
    """Places and operator tasks of the sequence."""
    operator = estimate.get("operator")
    return {"places": tuple(estimate.get("places", ())), "operator": None if operator is None else tuple(operator)}


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
        document = json.loads(file.read_text(encoding="utf-8"))
        return _tried(document, label)
    except OSError as error:
        msg = f"{file}: cannot be read ({error.strerror})"
        raise CyclekitError(msg, cure=cure) from error
    except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        msg = f"{file}: no output of whatif or estimate ({type(error).__name__}: {error})"
        raise CyclekitError(msg, cure=cure) from error


def _tried(document: Mapping[str, Any], label: str | None) -> list[Tried]:
    if "answers" in document:
        return [_answer(entry) for entry in document["answers"]]
    if label is None:
        msg = "an estimate needs the name of its change"
        raise ValueError(msg)
    return [Tried(label, *_interval(entry), **_what(entry)) for entry in document["sequences"]]
