"""Finds signals to which the speed reacts, such as the bit of a scanner's field, a door or a mat.

Outputs and registers of the robot are excluded, because the robot sets them itself. A named signal is accepted if the
level changes after nearly each of its changes with a constant delay. A gripper's signal changes independently of the
level; a signal by which the controller reports reduced speed changes with the level or after it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.signals import MAX_VALUES, SignalChanges

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.schema import Bools, Ints, Vector

MIN_CHANGES = 10
"""Minimum number of changes of a signal."""
MIN_DELAY_S, MAX_DELAY_S = 0.02, 1.0
"""Minimum and maximum delay, s, of the level after a signal; the minimum exceeds the error of a mean delay."""
SPREAD_S = 0.1
"""Tolerance, s, within which delays count as equal: the time between two samples."""
FOLLOWED = 0.9
"""Minimum share of a signal's changes that the level must follow."""
_TEXT = "U64"

Signals = dict[tuple[str, float], "NDArray[np.str_]"]


def signals_of(dataset: Dataset, executions: Sequence[str], frame: pl.DataFrame, level: Ints, stretch: Ints) -> Signals:
    """Return the values of signals to which the level may react, by name and delay, shape (N,) each.

    Args:
        dataset: Dataset with the events.
        executions: Executions of the rows.
        frame: Rows of SAMPLES, (N,).
        level: Index of the commanded level, shape (N,); -1 = unknown.
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
    """Return the time from each change of a signal to a change of the level, shape (M,), s; NaN if there was none.

    Args:
        changes: Changes of the signal; those outside of `seen_s` are ignored.
        answers_s: Times at which the level changed, ascending.
        seen_s: Times at which the level is known, ascending.
    """
    at = changes.t_s[1:][changes.value[1:] != changes.value[:-1]]
    at = at[_near(seen_s, at) & _near(seen_s, at + MAX_DELAY_S)]
    if not len(answers_s):
        return np.full(len(at), np.nan)
    after = np.searchsorted(answers_s, at - SPREAD_S).clip(0, len(answers_s) - 1)
    lag = answers_s[after] - at
    return np.asarray(np.where(np.abs(lag) <= MAX_DELAY_S, lag, np.nan))


def fixed_delay(lag_s: Vector) -> float | None:
    """Return the delay at which the level follows a signal, s; None if it does not, or not with a constant delay.

    Args:
        lag_s: Result of `lags_after`.
    """
    if len(lag_s) < MIN_CHANGES or not np.isfinite(lag_s).any():
        return None
    alike = np.abs(lag_s - np.nanmedian(lag_s)) <= SPREAD_S
    delay_s = float(lag_s[alike].mean())
    return round(delay_s, 3) if alike.mean() >= FOLLOWED and delay_s > MIN_DELAY_S else None


def _events(dataset: Dataset, sessions: set[str]) -> dict[str, dict[str, SignalChanges]]:
    """Return the changes of each event with few distinct values, by signal and session."""
    found: dict[str, dict[str, SignalChanges]] = {}
    for record in dataset.recordings:
        if record.session not in sessions or "events" not in record.tables:
            continue
        events = dataset.recorded(record.id, "events")
        known = pl.DataFrame() if events is None else events.drop_nulls(["t_s", "value"]).sort("t_s")
        for (name,), mine in known.group_by("signal", maintain_order=True) if known.height else ():
            if mine["value"].n_unique() <= MAX_VALUES:
                t_s = mine["t_s"].to_numpy() * record.clock.rate + record.clock.offset_s
                found.setdefault(str(name), {})[record.session] = SignalChanges(
                    t_s, mine["value"].to_numpy().astype(str)
                )
    return found


def _near(seen_s: Vector, at_s: Vector) -> Bools:
    """Return which times are within SPREAD_S of one at which the level is known."""
    if not len(seen_s):
        return np.zeros(len(at_s), np.bool_)
    after = np.searchsorted(seen_s, at_s).clip(1, len(seen_s) - 1)
    return np.asarray(np.minimum(np.abs(seen_s[after] - at_s), np.abs(at_s - seen_s[after - 1])) <= SPREAD_S)
