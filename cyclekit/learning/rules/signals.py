"""Signals that the speed answers to: the bit of a scanner's field, a door, a mat.

What the robot sets itself is no cause: its outputs and its register are not looked at. Of named events, a signal is
believed where the level changes after nearly every change of it, always the same time later. That of a gripper changes
whatever the level does; one by which the controller only tells that it is slow changes with the level or after it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.signals import MOST_VALUES, SignalChanges

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Bools, Ints, Vector

LEAST_CHANGES = 10
LEAST_DELAY_S, MOST_DELAY_S = 0.02, 1.0
"""A cause comes before its effect, by more than the error of the mean of some changes."""
SPREAD_S = 0.1
"""A delay is the same within this: the time between two samples."""
FOLLOWED = 0.9
"""The level must follow this part of the changes of a signal."""
_TEXT = "U64"

Signals = dict[tuple[str, float], "NDArray[np.str_]"]


def signals_of(dataset: Dataset, executions: Sequence[str], frame: pl.DataFrame, level: Ints, stretch: Ints) -> Signals:
    """Return the values of signals that the level may answer to, by name and delay, shape (N,) each.

    Args:
        dataset: Whose events.
        executions: Of the rows.
        frame: Rows of SAMPLES, (N,).
        level: Index of the commanded level, -1 = unknown, shape (N,).
        stretch: Number of the unbroken stretch, shape (N,).
    """
    sessions = dict(zip(*(dataset.executions[name].to_list() for name in ("execution", "session")), strict=True))
    session = frame["execution"].replace_strict({name: sessions[name] for name in executions}).to_numpy()
    t_s, known = frame["t_s"].to_numpy(), level >= 0
    changed = (level[1:] != level[:-1]) & known[1:] & known[:-1] & (np.diff(stretch) == 0)
    answers_s, of = ((t_s[1:] + t_s[:-1]) / 2)[changed], session[1:][changed]
    found: Signals = {}
    for name, by_session in _events(dataset, {sessions[each] for each in executions}).items():
        lags = [
            lags_after(changes, answers_s[of == each], t_s[known & (session == each)])
            for each, changes in by_session.items()
        ]
        if (delay_s := fixed_delay(np.concatenate(lags))) is not None:
            values = np.zeros(len(t_s), _TEXT)
            for each, changes in by_session.items():
                values[session == each] = changes.at(t_s[session == each] - delay_s)
            found[name, delay_s] = values
    return found


def lags_after(changes: SignalChanges, answers_s: Vector, seen_s: Vector) -> Vector:
    """Return how long after each change of a signal the level changed, shape (M,), s; NaN where it did not.

    Args:
        changes: Of the signal; those outside of `seen_s` tell nothing.
        answers_s: When the level changed, ascending.
        seen_s: When the level is known, ascending.
    """
    at = changes.t_s[1:][changes.value[1:] != changes.value[:-1]]
    at = at[_near(seen_s, at) & _near(seen_s, at + MOST_DELAY_S)]
    if not len(answers_s):
        return np.full(len(at), np.nan)
    after = np.searchsorted(answers_s, at - SPREAD_S).clip(0, len(answers_s) - 1)
    lag = answers_s[after] - at
    return np.asarray(np.where(np.abs(lag) <= MOST_DELAY_S, lag, np.nan))


def fixed_delay(lag_s: Vector) -> float | None:
    """Return after which time the level follows a signal, s; None where it does not, or not always the same later.

    Args:
        lag_s: Of `lags_after`.
    """
    if len(lag_s) < LEAST_CHANGES or not np.isfinite(lag_s).any():
        return None
    alike = np.abs(lag_s - np.nanmedian(lag_s)) <= SPREAD_S
    delay_s = float(lag_s[alike].mean())
    return round(delay_s, 3) if alike.mean() >= FOLLOWED and delay_s > LEAST_DELAY_S else None


def _events(dataset: Dataset, sessions: set[str]) -> dict[str, dict[str, SignalChanges]]:
    """Return the changes of each named event by signal and session, those with few values."""
    found: dict[str, dict[str, SignalChanges]] = {}
    for record in dataset.recordings:
        if record.session not in sessions or "events" not in record.tables:
            continue
        events = dataset.recorded(record.id, "events")
        known = pl.DataFrame() if events is None else events.drop_nulls(["t_s", "value"]).sort("t_s")
        for (name,), mine in known.group_by("signal", maintain_order=True) if known.height else ():
            if mine["value"].n_unique() <= MOST_VALUES:
                t_s = mine["t_s"].to_numpy() * record.clock.rate + record.clock.offset_s
                found.setdefault(str(name), {})[record.session] = SignalChanges(
                    t_s, mine["value"].to_numpy().astype(str)
                )
    return found


def _near(seen_s: Vector, at_s: Vector) -> Bools:
    """Return which times lie beside one at which the level is known."""
    if not len(seen_s):
        return np.zeros(len(at_s), np.bool_)
    after = np.searchsorted(seen_s, at_s).clip(1, len(seen_s) - 1)
    return np.asarray(np.minimum(np.abs(seen_s[after] - at_s), np.abs(at_s - seen_s[after - 1])) <= SPREAD_S)
