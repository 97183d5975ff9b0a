"""Section 4: what would help: the bound of any change, the costliest moments, other orders, and what-if results.

Nothing is guessed: every row is an estimate that was made, or a sum over the log. What-if results are estimates of the
same sequences under other conditions, as the command for estimates writes them.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cyclekit.errors import CyclekitError
from cyclekit.report.findings import losses
from cyclekit.report.numbers import decimals_for, fixed, percent, seconds
from cyclekit.report.tables import Table, spell

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import polars as pl

    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.findings import Overview
    from cyclekit.report.texts import Texts


@dataclass(frozen=True)
class WhatIf:
    """One sequence under other conditions.

    Attributes:
        label: What was changed, in the user's words.
        sequence: Name of the sequence.
        expected_s: Mean cycle time.
        low_s, high_s: Its 95 % interval.
    """

    label: str
    sequence: str
    expected_s: float
    low_s: float
    high_s: float


def load_what_if(label: str, file: Path) -> list[WhatIf]:
    """Read the results of one change: a JSON document with `sequences`, as `cyclekit estimate --out x.json` writes it.

    Raises:
        CyclekitError: The file cannot be read, or is no such document.
    """
    cure = "Give the JSON file that `cyclekit estimate … --out FILE.json` wrote for the changed cell."
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        return [
            WhatIf(
                label,
                str(each["name"]),
                float(each["expected_s"]),
                float(each["expected_low_s"]),
                float(each["expected_high_s"]),
            )
            for each in document["sequences"]
        ]
    except OSError as error:
        msg = f"{file}: cannot be read ({error.strerror})"
        raise CyclekitError(msg, cure=cure) from error
    except (ValueError, KeyError, TypeError) as error:
        msg = f"{file}: no estimates ({type(error).__name__}: {error})"
        raise CyclekitError(msg, cure=cure) from error


def section(
    texts: Texts, ranked: Sequence[CycleEstimate], samples: pl.DataFrame, seen: Overview, changes: Sequence[WhatIf]
) -> dict[str, Any]:
    """Return what the template needs for section 4; `ranked` has the fastest sequence first."""
    sentences = [text for text in (_bound(texts, ranked, seen), _order(texts, ranked)) if text]
    tables = [table for table in (_what_if(texts, ranked, changes), _moments(texts, samples, seen)) if table]
    if not changes:
        sentences.append(texts("helps.not_asked"))
    return {"sentences": sentences, "tables": tables, "missing": []}


def _bound(texts: Texts, ranked: Sequence[CycleEstimate], seen: Overview) -> str:
    """What no change of the safety function can beat: the cycle without any slow-down."""
    if ranked:
        best = ranked[0]
        without = seconds(best.expected_s - best.safety_loss_s)
        return texts("helps.bound", name=best.name, without=without, lost=seconds(best.safety_loss_s))
    if seen.lost_s is None or not len(seen.duration_s):
        return ""
    without = seconds(float(seen.duration_s.mean()) - seen.lost_s)
    return texts("helps.bound_logged", without=without, lost=seconds(seen.lost_s))


def _order(texts: Texts, ranked: Sequence[CycleEstimate]) -> str:
    """What the order alone is worth, if that can be told."""
    if len(ranked) < 2:
        return ""
    best, last = ranked[0], ranked[-1]
    if last.expected_low_s <= best.expected_high_s:
        return texts("helps.order_even")
    half = max(best.expected_high_s - best.expected_low_s, last.expected_high_s - last.expected_low_s) / 2
    saved = fixed(last.expected_s - best.expected_s, decimals_for(half))
    return texts("helps.order", best=best.name, last=last.name, saved=saved)


def _what_if(texts: Texts, ranked: Sequence[CycleEstimate], changes: Sequence[WhatIf]) -> Table | None:
    if not changes:
        return None
    now = {each.name: each for each in ranked}
    rows = []
    for change in changes:
        places = decimals_for((change.high_s - change.low_s) / 2)
        before = now.get(change.sequence)
        saved = fixed(before.expected_s - change.expected_s, places) if before else "–"
        interval = f"{fixed(change.low_s, places)} to {fixed(change.high_s, places)}"
        rows.append([change.label, change.sequence, fixed(change.expected_s, places), interval, saved])
    heads = [texts(f"helps.{key}") for key in ("change", "sequence", "expected", "interval", "saved")]
    title = texts("helps.what_if")
    return Table(title, heads, rows, frozenset({2, 3, 4}), silent=True, title=title, after=texts("helps.no_proof"))


def _moments(texts: Texts, samples: pl.DataFrame, seen: Overview) -> Table | None:
    """What both did while most time was lost: where a change of the operator's or the robot's work pays."""
    found = losses(samples, seen.executions)
    if not found:
        return None
    whole = seen.lost_s or sum(each.seconds for each in found)
    rows = [
        [
            texts("helps.unknown") if each.human_task is None else spell(each.human_task),
            fixed(each.seconds, 1),
            percent(each.seconds / whole) if whole else "–",
            texts("helps.worst", task=spell(each.robot_task), seconds=fixed(each.worst_s, 1)),
        ]
        for each in found
    ]
    heads = [texts(f"helps.{key}") for key in ("operator", "lost_head", "part", "robot")]
    title = texts("helps.moments")
    return Table(title, heads, rows, frozenset({1, 2}), silent=True, title=title)
