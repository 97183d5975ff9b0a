"""The runs of all sessions, with a set override that moves with people or with the program in their scaling."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cyclekit.dataset.cards import note
from cyclekit.derive.log_clocks import with_tested_clocks
from cyclekit.derive.set_override.mover import STILL, Verdict, mover_of
from cyclekit.derive.set_override.rows import override_rows
from cyclekit.segmentation.standstills import find_standstills
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.config import Cell, Source
    from cyclekit.dataset.cards import Note
    from cyclekit.dataset.sessions import Session
    from cyclekit.dataset.signals import Read, Stored
    from cyclekit.derive.first_pass import FirstPassResult
    from cyclekit.derive.over_sessions import Passes
    from cyclekit.schema import Vector
    from cyclekit.segmentation.standstills import Standstill
    from cyclekit.segmentation.stored_run import StoredRun

STEP_S, MAX_ROWS = 0.2, 20_000
"""Least time between two rows of the evidence, s, and their greatest number."""
ALWAYS = (np.array([-np.inf]), np.ones(1))


class MovedOverrides(NamedTuple):
    """First results of all sessions, and notes on who moved their set override."""

    results: list[FirstPassResult]
    warnings: list[Note]


def with_moved_overrides(
    passes: Passes,
    results: Sequence[FirstPassResult],
    sessions: Sequence[Session],
    *,
    sources: Mapping[str, Source | None],
    read: Read,
    stored: Stored,
    cell: Cell,
    by_logs: bool,
) -> MovedOverrides:
    """Return the results of the first pass, with a set override as part of the scaling if no hand moves it.

    Args:
        passes: Runs the work on the sessions.
        results: Results of the first pass.
        sessions: The sessions, with the numbers of their runs.
        sources: Section of the cell file for each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns).
        cell: What the cell file says of it.
        by_logs: Align clocks by the logs also where that is not certain, and against what is stated.
    """
    ends = [one.slider for one in results if one.slider is not None]
    if not ends or max(high for _, high in ends) - min(low for low, _ in ends) <= 2.0 * STILL:
        return MovedOverrides(list(results), [])
    moved = [run.with_hand(*ALWAYS) for one in results for run in one.runs]
    aligned = with_tested_clocks(passes, sessions, moved, sources, read, stored, asked=by_logs)
    total_s = sum(run.time_at(run.rows - 1) - run.time_at(0) for run in moved)
    step_s = max(STEP_S, total_s / MAX_ROWS)
    work = [(session, one.runs) for session, one in zip(aligned, results, strict=True)]
    look = partial(override_rows, step_s=step_s, sources=sources, read=read, stored=stored, cell=cell)
    rows = passes.over(look, work, "motion", "set override")
    found = mover_of(rows, step_s, cell.set_override)
    if found.mover in ("hand", "unknown"):
        return MovedOverrides(list(results), [_told(found)] if found.mover == "unknown" else [])
    hands = [ALWAYS] * len(rows)
    if found.hand is not None:
        hands = [_turns(one.t_s, hand) for one, hand in zip(rows, found.hand, strict=True)]
    runs = [[run.with_hand(*hand) for run in one.runs] for one, hand in zip(results, hands, strict=True)]
    standstills = passes.over(_standstills, runs, "motion", "standstills")
    both = zip(results, runs, standstills, strict=True)
    return MovedOverrides([replace(one, runs=mine, standstills=still) for one, mine, still in both], [_told(found)])


def _standstills(runs: Sequence[StoredRun]) -> list[Standstill]:
    return [standstill for number, run in enumerate(runs) for standstill in find_standstills(run, number)]


def _turns(t_s: Vector, hand: Vector) -> tuple[Vector, Vector]:
    """Return the times from which a slider stands at a value, and the values, shape (K,) each."""
    turned = np.flatnonzero(np.diff(hand, prepend=np.nan) != 0.0)
    return (t_s[turned], hand[turned]) if len(turned) else ALWAYS


def _told(found: Verdict) -> Note:
    share = {} if found.share is None else {"share": max(found.share, 0.0)}
    hands = [] if found.hand is None else np.unique(np.concatenate(found.hand)).tolist()
    sliders = ", ".join(fixed(value, 2) for value in hands[:8])
    told: dict[str, str | float] = {"turns": found.turns, "hours": found.hours, "sliders": sliders, **share}
    codes = {"people": "override-moved", "program": "override-of-program"}
    return note(codes.get(found.mover, "override-unknown"), **told)
