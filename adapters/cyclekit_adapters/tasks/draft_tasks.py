"""Draft of a map for a table of tasks whose columns have other names than the usual ones.

What tells tasks from other tables is that each row has two dates, the second never before the first, or one date and a
word that starts or completes something; and words beside them.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.adapter import Draft, Proposal, is_person
from cyclekit_adapters.mapped.draft_names import name_of
from cyclekit_adapters.mapped.draft_times import FoundTime, found_times, seconds_of
from cyclekit_adapters.tasks.lifecycle import TRANSITIONS
from cyclekit_adapters.tasks.task_columns import NEEDED, columns_in
from cyclekit_adapters.times.proof import TimeEvidence
from cyclekit_adapters.times.written_time import is_dated

if TYPE_CHECKING:
    from cyclekit_adapters.mapped.draft_table import DraftTable

_FEWEST = 4
"""A size: a table of fewer rows shows no form. 2 moves no draft of the tests, 8 those of two short tables."""


def task_draft(table: DraftTable) -> Draft | None:
    """Return a proposed map for a table of tasks; None if the table is none, or not in a form that is read."""
    first_line = table.headed and not {"skip_rows", "columns", "encoding"} & set(table.keys)
    if not first_line or table.keys.get("delimiter") not in ("comma", "semicolon", "tab"):
        return None
    times = found_times(table, {name: name_of(name) for name in table.names}, TimeEvidence(before_s=table.before_s))
    dates = [time for time in times if len(time.columns) == 1 and time.decided and is_dated("".join(time.patterns))]
    dates.sort(key=lambda time: table.names.index(time.columns[0]))
    words = {name: cells for name, cells in table.texts.items() if name not in {t.columns[0] for t in dates}}
    steps = [name for name, cells in words.items() if _are_transitions(cells)]
    found = {key: (name, "its name says so") for key, name in columns_in(table.names).items() if key not in NEEDED[2:]}
    if pair := next((pair for pair in combinations(dates, 2) if _are_ends(table, *pair)), None):
        sides = zip(("start", "end"), pair, strict=True)
        found |= {key: (time.columns[0], "never after the end" * (key == "start")) for key, time in sides}
    elif dates and steps:
        found |= {"end": (dates[0].columns[0], "each row starts or completes a task"), "transition": (steps[0], "")}
    else:
        return None
    rest = [name for name in words if name not in {column for column, _ in found.values()}]
    rest.sort(key=lambda name: (not any(map(_is_agent, words[name])), len(set(words[name]))))
    lines = [Proposal(key, name, why) for key, (name, why) in found.items()]
    for key in ("agent", "task", "execution"):
        if key not in found and rest:
            name, alone = rest.pop(0), len(rest) == 0
            sure = any(map(_is_agent, words[name])) if key == "agent" else alone and key == "task"
            lines.append(Proposal(key, name, f"{len(set(words[name]))} different words", sure=sure))
    if len(table.cells[table.names[0]]) < _FEWEST or not any(line.key == "task" for line in lines):
        return None
    left = [name for name in table.names if name not in {line.value for line in lines}]
    return Draft((), tuple(lines), (f"not used: {', '.join(left)}",) if left else ())


def _are_transitions(cells: list[str]) -> bool:
    return len(set(cells)) > 1 and {cell.lower() for cell in cells} <= TRANSITIONS


def _are_ends(table: DraftTable, first: FoundTime, last: FoundTime) -> bool:
    """Return whether one time is never after another, and before it in most rows; unknown ends do not count."""
    took = seconds_of(table, last) - seconds_of(table, first)
    took = took[np.isfinite(took)]
    return bool(len(took) and (took >= 0.0).all() and 2 * (took > 0.0).sum() > len(took))


def _is_agent(word: str) -> bool:
    return is_person(word) or "robot" in word.lower()
