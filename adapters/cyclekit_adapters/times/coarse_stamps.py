"""Stamps coarser than the rows: several rows in a row with one time, such as whole seconds of a log at 125 Hz.

The rows of each step of the clock are spread evenly over it. A step that the log cuts (its first and last, and those
beside a gap) is filled at the rate of the whole ones, at its end or at its beginning. Rows that repeat a sample, values
and all, are no such rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.errors import LogError
from cyclekit.text.numbers import compact
from cyclekit_adapters.text.delimited import INDEX
from cyclekit_adapters.times.proof import shown_s
from cyclekit_adapters.times.row_times import T_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit_adapters.text.text_rows import TextRows
    from cyclekit_adapters.times.proof import Vector

    Bools = NDArray[np.bool_]

_SHARED = 0.05
"""Least share of neighbouring rows with one time, from which rows are spread: below it they repeat a stamp by chance.
Half and twice of it change none of the tests of units."""
_DIFFER = 0.5
"""Least share of rows of one time that differ in their values, beside that of other neighbours. Half of it changes none
of the tests of units; with twice of it, which is all rows, few are spread."""
_APART = 3.0
"""Factor by which rows of one time lie farther apart than rows of neighbouring times, if they are of several robots.
Half and twice of it change none of the tests of units."""
_EVEN = 0.2
"""Maximum relative difference of the numbers of rows of most whole steps: loggers on a PC are this uneven, and changes
of a state are far more so. Half and twice of it change none of the tests of units."""
_FEW = 3.0
"""Rows a step up to which their mean tells the rate, not their median, a whole number that garbled stamps do not move.
Half and twice of it change none of the tests of units."""
_LEAST_STEPS = 3
"""Number of whole steps from which a rate is known."""


@dataclass(frozen=True)
class Spread:
    """Where the rows lie within the steps of the clock.

    Attributes:
        step_s: Step of the clock, s.
        rate_hz: Rows per second, of one track.
        later_s: Time to add to the stamp of each row, s, by its number in the log.
        time: Column of the times in s.
    """

    step_s: float
    rate_hz: float
    later_s: NDArray[np.float32]

    time: str = T_S

    def rows(self, rows: TextRows) -> TextRows:
        """Return the rows with their times spread."""
        later = pl.Series(self.later_s[rows.frame[INDEX].to_numpy()].astype(np.float64))
        return replace(rows, frame=rows.frame.with_columns((pl.col(self.time) + later).alias(self.time)))

    @property
    def said(self) -> str:
        """What was done, as a warning."""
        each = f"about {compact(self.rate_hz * self.step_s)} rows share each"
        stamps = f"its stamps are {shown_s(self.step_s)} apart and {each}"
        return f"{stamps}: they are spread evenly, at {compact(self.rate_hz)} Hz"


def share_stamps(stamps: Sequence[str], of: Sequence[str] = ()) -> bool:
    """Return whether neighbouring rows, of one track each if `of` names it, mostly have one time."""
    tracks: dict[str, list[str]] = {}
    for at, stamp in enumerate(stamps):
        tracks.setdefault(of[at] if at < len(of) else "", []).append(stamp)
    pairs = [same for track in tracks.values() for same in map(str.__eq__, track, track[1:])]
    return len(pairs) > 1 and sum(pairs) >= _SHARED * len(pairs)


def spread_of(
    path: Path,
    blocks: Iterable[TextRows],
    values: Sequence[str],
    *,
    track: str | None = None,
    rate_hz: float | None = None,
    ask: bool = True,
    time: str = T_S,
) -> Spread | None:
    """Return where the rows of a log lie within the steps of its clock; None if they do not share its stamps.

    Args:
        path: The log.
        blocks: Its rows, with the column `time` in s.
        values: Columns that change with each sample; none if all are states, which are the same if a row is repeated.
        track: Column of the person, if each has rows of its own.
        rate_hz: Rate of the rows; None = find it.
        ask: Refuse a log whose rate cannot be found.
        time: Column of the times in s.

    Raises:
        LogError: Rows share stamps, but not evenly, and no rate is given; or they are of several robots or people.
    """
    names = [INDEX, time, *dict.fromkeys([*values, *([track] if track else [])])]
    frame = pl.concat([rows.frame.select(names) for rows in blocks])
    if track:
        frame = frame.sort(track, maintain_order=True)
    whose = frame[track].rank("dense").fill_null(0).to_numpy() if track else np.zeros(frame.height)
    t_s, new_track = frame[time].to_numpy(), np.diff(whose, prepend=np.nan) != 0
    same = (np.diff(t_s, prepend=np.nan) == 0) & ~new_track
    if not same.any() or (values and not _differ(frame, values, same, new_track)):
        return None
    first = np.flatnonzero(~same)  # row at which each run of one stamp begins
    count = np.diff(first, append=len(t_s))
    if ask and values and _interleaved(frame, values, first, same):
        cause = (
            "rows of one time lie far apart, rows of neighbouring times do not: several robots or people in one table"
        )
        cure = "Give each robot a file of its own; for people name the column of their id: person, in [sources.map]."
        raise LogError(path, cause, cure=cure)
    ahead = np.diff(t_s[first], append=np.nan)
    ahead[np.append(new_track[first][1:], True)] = np.nan
    steps = ahead[np.isfinite(ahead) & (ahead > 0)]
    if not len(steps):
        return None
    known, often = np.unique(steps.round(6), return_counts=True)
    step_s = float(known[often.argmax()])
    follows = np.abs(ahead - step_s) < 1e-3 * step_s  # the next run is one step later
    preceded = np.append(False, follows[:-1])
    whole = count[follows & preceded]
    middle = float(np.median(whole)) if len(whole) else 0.0
    near = np.abs(whole - middle) <= max(1.0, _EVEN * middle)
    even = len(whole) >= _LEAST_STEPS and float(near.mean()) >= 0.8
    usual = middle if middle > _FEW else float(whole[near].mean()) if even else 0.0
    each = rate_hz * step_s if rate_hz else usual if even else 0.0
    if each < 1.0 + _SHARED:
        if not ask or even or len(t_s) < 1.5 * len(first):
            return None  # the few that repeat a stamp are set aside
        cause = (
            f"several rows have one time ({int(count.min())} to {int(count.max())}, in steps of {shown_s(step_s)}), "
        )
        cause += "too unevenly to tell their rate"
        raise LogError(path, cause, cure="Give rate_hz in its source of the cell file, or log finer times.")
    later = _within(count, follows, preceded, each) * step_s
    by_row = np.zeros(int(frame[INDEX].max()) + 1, np.float32)  # type: ignore[arg-type]  # of an integer column
    by_row[frame[INDEX].to_numpy()] = later
    return Spread(step_s, each / step_s, by_row, time)


def _differ(frame: pl.DataFrame, values: Sequence[str], same: Bools, new_track: Bools) -> bool:
    """Return whether rows of one stamp differ in their values about as often as others, as samples of their own do."""
    differs = pl.any_horizontal(pl.col(name).ne_missing(pl.col(name).shift(1)) for name in values)
    changed = frame.select(differs).to_series().to_numpy()
    within, between = changed[same & ~new_track], changed[~same & ~new_track]
    return bool(within.any() and (not len(between) or within.mean() >= _DIFFER * between.mean()))


def _interleaved(frame: pl.DataFrame, values: Sequence[str], first: NDArray[np.int64], same: Bools) -> bool:
    """Return whether rows of one time are places of several things: each is near its own place at the next time."""
    numbers = frame.select(pl.col(name) for name in values if frame.schema[name].is_float()).to_numpy()
    within = np.linalg.norm(np.diff(numbers, axis=0), axis=1)[same[1:]]
    after = np.linalg.norm(np.diff(numbers[first], axis=0), axis=1)
    within, after = within[np.isfinite(within)], after[np.isfinite(after)]
    return len(within) > 0 and len(after) > 0 and bool(np.median(within) > _APART * np.median(after))


def _within(count: NDArray[np.int64], follows: Bools, preceded: Bools, each: float) -> Vector:
    """Return where each row lies within its step, from 0 to 1, shape (N,).

    Args:
        count: Rows of each run of one stamp.
        follows: The next run is one step later.
        preceded: The previous run is one step earlier.
        each: Rows of a whole step.
    """
    cut = ~(follows & preceded)
    rows = np.where(cut, np.maximum(count, each), count)  # rows that the step had if it was not cut
    begin = np.where(cut & follows, rows - count, 0.0)  # the log begins within it
    number = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    return np.asarray((number + 0.5 + np.repeat(begin, count)) / np.repeat(rows, count), np.float64)
