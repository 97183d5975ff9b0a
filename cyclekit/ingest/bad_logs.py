"""Refuses logs whose loss would change the result in silence: the only one of its kind, and values that cannot be."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cyclekit.dataset.cards import IMPOSSIBLE
from cyclekit.errors import EmptyLog, LogError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards import LogCard
    from cyclekit.ingest.discover import Log

_MAKE_CYCLES = {"robot", "task_list", "safety"}
"""Tables without which a dataset has no executions."""
_ACCEPT = "--accept-bad-logs (in the cell file: accept_bad_logs = true)"


def refuse_bad(
    logs: Sequence[Log], read: Sequence[LogCard], failed: Sequence[LogError], not_read: Sequence[tuple[str, str]]
) -> None:
    """Refuse logs of which the rest would give a wrong or an empty result.

    Args:
        logs: All logs.
        read: Cards of those that were read.
        failed: Errors of the others.
        not_read: Path and reason of these, and of files that no adapter reads.

    Raises:
        LogError: A log cannot be read, and no other of its adapter and source was; no log of the robot or of tasks was
            read, but files were left out; or a column of a log cannot be as it was read.
    """
    ids, paths = {card.id for card in read}, {log.id: log.path for log in logs}
    kinds = [(log.adapter, log.source) for log in logs if log.id in ids]
    lost = {log.path for log in logs if (log.adapter, log.source) not in kinds}
    for error in failed:
        if error.path in lost and not isinstance(error, EmptyLog):
            cure = f"{error.cure or 'Check the file.'} Or go on without it: {_ACCEPT}"
            raise LogError(error.path, f"{error.cause}; no other log of its kind could be read", cure=cure)
    if not_read and not any(_MAKE_CYCLES & set(card.tables) for card in read):
        (path, cause), *more = not_read
        others = f" ({len(more)} more files were not read)" if more else ""
        cure = f"Repair or map it (docs/adapters.md), name it under ignore, or go on without it: {_ACCEPT}"
        raise LogError(Path(path), f"not read: {cause}; and no other log holds the robot or tasks{others}", cure=cure)
    bad = [(paths[card.id], one.text) for card in read for one in card.warnings if one.code == IMPOSSIBLE]
    if bad:
        (file, cannot), *rest = bad
        others = f"; so it is {len(rest)} more time(s) in these logs" if rest else ""
        cure = f"Correct the log, or its map in the cell file (docs/adapters.md), or use it as it is: {_ACCEPT}"
        raise LogError(file, f"{cannot}{others}", cure=cure)
