"""The days of the logs, and changes in the last month.

Robots and trackers seldom log the date. It is taken from the path of the log (2026-11-03 or 20261103), else from the
modification time of the file.
"""

from __future__ import annotations

import datetime as dt
import re
from typing import TYPE_CHECKING

from cyclekit.dataset.cards import SplitCard
from cyclekit.errors import OutsideFolder
from cyclekit.learning.evaluation.drift import Drift, drift_between
from cyclekit.storage.safe_path import safe_path

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.learning.networks.saved import TrainedModel

MONTH = dt.timedelta(days=30)
_DATE = re.compile(r"(?<!\d)(20\d\d)([-_.]?)(\d\d)\2(\d\d)(?!\d)")


def day_in(path: str) -> dt.date | None:
    """Return the last date in a path; None if there is none."""
    for year, _, month, day in reversed(_DATE.findall(path)):
        try:
            return dt.date(int(year), int(month), int(day))
        except ValueError:
            continue
    return None


def days_of(dataset: Dataset, roots: Sequence[Path]) -> dict[str, dt.date]:
    """Return the day of every session whose logs can be found.

    Args:
        dataset: Dataset of these logs.
        roots: The files and folders given to `ingest`.
    """
    bases = [root if root.is_dir() else root.parent for root in roots]
    found: dict[str, dt.date] = {}
    for entry in dataset.recordings:
        day = day_in(entry.shown) or _written(entry.shown, bases)
        if day is not None:
            found[entry.session] = max(found.get(entry.session, day), day)
    return found


def _written(shown: str, bases: Sequence[Path]) -> dt.date | None:
    """Return the day in a log's path, else of its last change; its shown name may begin with the folder of logs."""
    parts = shown.split("/")
    for base in bases:
        for first in range(len(parts)):
            try:
                file = safe_path(base, *parts[first:], follow_links=True)
            except OutsideFolder:
                continue
            if file.is_file():
                whole = day_in(file.as_posix())
                return whole or dt.datetime.fromtimestamp(file.stat().st_mtime, tz=dt.UTC).date()
    return None


def since_last_month(model: TrainedModel, dataset: Dataset, days: Mapping[str, dt.date]) -> Drift | str:
    """Compare the last month of logs with those before; return a sentence with the reason if that is not possible.

    The errors of the model are compared on executions that were not used for training.

    Args:
        model: A model of problem `now`, trained on these logs or on the earlier ones.
        dataset: All logs.
        days: The day of every session.
    """
    newest = max(days.values(), default=None)
    if newest is None:
        return "the days of the logs are not known"
    begin = newest - MONTH
    sessions = {one.execution: one.session for one in dataset.card.executions}
    dated = {name: days[session] for name, session in sessions.items() if session in days}
    before = [name for name, day in dated.items() if day <= begin]
    after = [name for name, day in dated.items() if day > begin]
    if not before:
        return "the logs cover less than a month"
    split = model.card.split or SplitCard()
    learned = {*split.train, *split.validation}
    judged = [[name for name in part if name not in learned] for part in (before, after)]
    if min(map(len, judged)) < 2:
        return "too few executions that were not used for training, before or within the last month"
    return drift_between(model, dataset.only(before), dataset.only(after), judged[0], judged[1])


def since_training(model: TrainedModel, dataset: Dataset) -> Drift | None:
    """Compare executions newer than the training with those held out from it; None with fewer than two of either."""
    split = model.card.split or SplitCard()
    known = {*split.train, *split.validation, *split.test}
    names = dataset.executions["execution"].to_list()
    newer = [name for name in names if name not in known]
    older = [name for name in names if name in known]
    held_out = [name for name in split.test if name in names]
    if len(newer) < 2 or len(held_out) < 2:
        return None
    return drift_between(model, dataset.only(older), dataset.only(newer), held_out, newer)
