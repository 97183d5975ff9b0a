"""What cannot be: values of a recording that no cell produces, found, named with the likely cure, and kept out.

Many containers have no checksum, so a flipped bit or a slip of units passes every reader; only the values can give it
away. A row whose time or position is impossible beside its neighbours is set aside; a column that looks wrong as a
whole (millimetres read as metres) is named and left as it is, because only a person knows. The thresholds are far
beyond what people and robots do. Reading is the adapters' business, time and frame that of `derive`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.adapter import Recording

    Vector = NDArray[np.float64]
    Mask = NDArray[np.bool_]

TCP_M_S, PERSON_M_S = 10.0, 20.0
"""Nothing at the end of a robot arm, and nobody on foot, is faster."""
TCP_SLACK_M, PERSON_SLACK_M = 0.05, 0.3
"""A step shorter than this is no jump however short the time: clocks jitter, tracks move from head to hip."""
TCP_REACH_M, PERSON_REACH_M = 30.0, 150.0
"""Farther away than this is no robot on a gantry, and nobody in the same hall."""
ANGLE_RAD = 26.0
"""Over four turns: no joint angle in radians."""
STILL_ROWS = 100
"""A value that stays the same over fewer rows says nothing."""
DAY_S = 86_400.0
LATEST_S = 1e11
"""The year 5138: no clock shows that."""
NOWHERE_M = 1e9


@dataclass(frozen=True)
class _Points:
    """Which columns are a position, and what is possible there."""

    whose: str
    columns: tuple[str, str, str]
    speed_m_s: float
    slack_m: float
    reach_m: float


_TCP = _Points("the TCP", ("tcp_x_m", "tcp_y_m", "tcp_z_m"), TCP_M_S, TCP_SLACK_M, TCP_REACH_M)
_PERSON = _Points("a person", ("x_m", "y_m", "z_m"), PERSON_M_S, PERSON_SLACK_M, PERSON_REACH_M)


class _Findings:
    """What is said of one recording, and the rows that it loses."""

    def __init__(self) -> None:
        self.warnings: list[str] = []
        self.aside: list[pl.DataFrame] = []

    def drop(self, frame: pl.DataFrame, bad: Mask, reason: str) -> pl.DataFrame:
        """Set the rows of a mask aside and return the others."""
        if not bad.any():
            return frame
        self.aside.append(_reasons(frame.filter(bad).select("source_row", reason=pl.lit(reason))))
        return frame.filter(~bad)


def examined(recording: Recording) -> Recording:
    """Return the recording without its impossible rows and values, which it lists and names.

    Args:
        recording: As an adapter returned it; columns may be absent.
    """
    found = _Findings()
    robot = None if recording.robot is None else _robot(recording.robot, found)
    people = None if recording.people is None else _people(recording.people, found)
    events = None if recording.events is None else _with_time(_numbered(recording.events), "an event", found)
    before = [] if recording.set_aside is None else [_reasons(recording.set_aside)]
    aside = pl.concat([*before, *found.aside]) if before or found.aside else None
    said = tuple(text for text in found.warnings if text not in recording.warnings)
    warnings = (*recording.warnings, *said)
    return replace(recording, robot=robot, people=people, events=events, set_aside=aside, warnings=warnings)


def _reasons(set_aside: pl.DataFrame) -> pl.DataFrame:
    return set_aside.select(pl.col("source_row").cast(pl.Int64), pl.col("reason").cast(pl.String))


def _robot(frame: pl.DataFrame, found: _Findings) -> pl.DataFrame:
    frame = _with_time(_numbered(_finite(frame, found)), "the robot", found)
    times = _column(frame, "t_s")
    frame = found.drop(frame, _repeated(times), "repeats the time of the row before it")
    frame = found.drop(frame, _stray_times(_column(frame, "t_s")), "its time does not fit between its neighbours")
    _name_periods(_column(frame, "t_s"), "robot", found)
    frame = _placed(frame, _TCP, found)
    frame = _fractions(frame, found)
    frame = _speeds(frame, found)
    _name_angles(frame, found)
    _name_still(frame, _TCP, found)
    return frame


def _people(frame: pl.DataFrame, found: _Findings) -> pl.DataFrame:
    frame = _with_time(_numbered(_finite(frame, found)), "a person", found)
    twice = frame.select(~pl.struct("t_s", "person").is_first_distinct()).to_series().to_numpy()
    frame = found.drop(frame, twice, "repeats person and time of a row before it")
    bad = np.zeros(frame.height, bool)
    for rows in _tracks(frame):
        bad[rows] = _stray_times(_column(frame, "t_s")[rows])
    frame = found.drop(frame, bad, "its time does not fit between its neighbours")
    frame = _placed(frame, _PERSON, found)
    _name_still(frame, _PERSON, found)
    return frame


def _numbered(frame: pl.DataFrame) -> pl.DataFrame:
    return frame if "source_row" in frame.columns else frame.with_columns(source_row=pl.lit(None, pl.Int64))


def _column(frame: pl.DataFrame, name: str) -> Vector:
    if name not in frame.columns:
        return np.full(frame.height, np.nan)
    return frame[name].cast(pl.Float64).fill_null(np.nan).to_numpy()


def _finite(frame: pl.DataFrame, found: _Findings) -> pl.DataFrame:
    """Make NaN and infinities unknown; adapters of text logs have done so already."""
    names = [name for name, dtype in frame.schema.items() if dtype.is_float() and name != "t_s"]
    if not names:
        return frame
    counts = frame.select((pl.col(name).is_nan() | pl.col(name).is_infinite()).sum() for name in names).row(0)
    wrong = {name: count for name, count in zip(names, counts, strict=True) if count}
    if not wrong:
        return frame
    told = ", ".join(f"{name} in {count} rows" for name, count in wrong.items())
    found.warnings.append(f"NaN or infinite: {told}; unknown there")
    return frame.with_columns(pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name) for name in wrong)


def _with_time(frame: pl.DataFrame, whose: str, found: _Findings) -> pl.DataFrame:
    times = _column(frame, "t_s")
    frame = found.drop(frame, ~(np.abs(times) < LATEST_S), "its time is no number that a clock shows")
    steps = np.diff(_column(frame, "t_s"))
    ahead = int((steps > DAY_S).sum())
    if ahead:
        found.warnings.append(
            f"the time of {whose} jumps ahead by {steps.max() / DAY_S:.1f} days: a clock set while recording, or two "
            "recordings in one file; split the log there"
        )
    return frame


def _repeated(times: Vector) -> Mask:
    return np.concatenate([[False], np.diff(times) == 0.0])[: len(times)]


def _stray_times(times: Vector) -> Mask:
    """Rows whose time lies outside that of their neighbours, which fit each other: a garbled number, no restart."""
    bad = np.zeros(len(times), bool)
    if len(times) < 3:
        return bad
    before, here, after = times[:-2], times[1:-1], times[2:]
    back = (after > before) & (here < before)
    ahead = (after > before) & (here > after)
    bad[1:-1] = back | (ahead & ~np.append(back[1:], False))
    return bad


def _name_periods(times: Vector, whose: str, found: _Findings) -> None:
    steps = np.diff(times)
    steps = steps[steps > 0]
    if len(steps) < 10:
        return
    period = float(np.median(steps))
    if period > 1.5:
        found.warnings.append(f"{whose} rows lie {period:.3g} s apart: milliseconds taken for seconds? give time_unit")
    elif period < 5e-5:
        found.warnings.append(f"{whose} rows lie {period:.3g} s apart: is the unit of time right? give time_unit")


def _tracks(frame: pl.DataFrame) -> Sequence[NDArray[np.int64]]:
    """Row numbers of each person, in order."""
    if "person" not in frame.columns:
        return [np.arange(frame.height)]
    grouped = frame.with_row_index("__row").group_by("person", maintain_order=True).agg("__row")
    return [np.asarray(rows, np.int64) for rows in grouped["__row"].to_list()]


def _placed(frame: pl.DataFrame, kind: _Points, found: _Findings) -> pl.DataFrame:
    """Set aside positions out of reach and single positions that nothing can have jumped to; name the rest."""
    xyz = np.column_stack([np.clip(_column(frame, name), -NOWHERE_M, NOWHERE_M) for name in kind.columns])
    far = np.linalg.norm(np.nan_to_num(xyz), axis=1)
    beyond = far > kind.reach_m
    if beyond.sum() > 0.5 * max(1, np.isfinite(xyz[:, 0]).sum()):
        found.warnings.append(
            f"{kind.whose} is {np.median(far[beyond]):.0f} m away in {int(beyond.sum())} rows: likely millimetres; "
            'say length_unit = "mm", or the unit in the export'
        )
        return frame  # as a whole it is consistent, and only a person knows what it is
    frame = found.drop(frame, beyond, f"{kind.whose} more than {kind.reach_m:.0f} m away: no such place")
    xyz, times = xyz[~beyond], _column(frame, "t_s")
    bad, jumps = np.zeros(frame.height, bool), 0
    for rows in _tracks(frame):
        stray, left = _stray_positions(times[rows], xyz[rows], kind)
        bad[rows], jumps = stray, jumps + left
    if jumps:
        likely = "a track that changed its person" if kind is _PERSON else "a changed tool, or two recordings in one"
        found.warnings.append(f"{kind.whose} jumps faster than {kind.speed_m_s:.0f} m/s {jumps} time(s): {likely}")
    return found.drop(
        frame, bad, f"{kind.whose} cannot have jumped there and back (faster than {kind.speed_m_s:.0f} m/s)"
    )


def _stray_positions(times: Vector, xyz: Vector, kind: _Points) -> tuple[Mask, int]:
    """Return which rows are single stray positions, and how many jumps remain without them."""
    bad = np.zeros(len(times), bool)
    seen = np.flatnonzero(np.isfinite(xyz[:, :2]).all(axis=1))
    if len(seen) < 2:
        return bad, 0
    t, p = times[seen], np.nan_to_num(xyz[seen])
    steps = np.diff(t)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    jump = _jumps(t, p, usual, kind)
    if len(seen) > 2:
        across = ~_jumps(t, p, usual, kind, apart=2)
        bad[seen[1:-1][jump[:-1] & jump[1:] & across]] = True
    kept = ~bad[seen]
    return bad, int(_jumps(t[kept], p[kept], usual, kind).sum())


def _jumps(t: Vector, p: Vector, usual_s: float, kind: _Points, apart: int = 1) -> Mask:
    """Tell of each row and the one `apart` rows later whether the way between them is impossible."""
    step = t[apart:] - t[:-apart]
    way = np.linalg.norm(p[apart:] - p[:-apart], axis=1)
    possible = kind.slack_m + kind.speed_m_s * np.maximum(step, usual_s)
    return np.asarray((way > possible) & (step > 0))


def _fractions(frame: pl.DataFrame, found: _Findings) -> pl.DataFrame:
    for name in ("scaling", "slider"):
        value = _column(frame, name)
        wrong = (value < 0.0) | (value > 1.001)
        if wrong.any():
            top = float(np.nanmax(value))
            likely = "likely percent, say scaling_max = 100" if 1.5 < top <= 200.0 else "no fraction"
            found.warnings.append(f"{name} reaches {top:g} in {int(wrong.sum())} rows: {likely}; unknown there")
            frame = frame.with_columns(pl.when(pl.Series(~wrong)).then(pl.col(name)).alias(name))
    return frame


def _speeds(frame: pl.DataFrame, found: _Findings) -> pl.DataFrame:
    speed = _column(frame, "tcp_speed_m_s")
    wrong = (speed > TCP_M_S) | (speed < 0)
    if not wrong.any():
        return frame
    top = float(speed[np.isfinite(speed)].max())
    likely = "likely mm/s" if wrong.sum() > 0.1 * np.isfinite(speed).sum() else "garbled"
    found.warnings.append(f"tcp_speed_m_s reaches {top:.4g} m/s in {int(wrong.sum())} rows: {likely}; unknown there")
    known = pl.when(pl.Series(~wrong)).then(pl.col("tcp_speed_m_s"))
    return frame.with_columns(known.alias("tcp_speed_m_s"))


def _name_angles(frame: pl.DataFrame, found: _Findings) -> None:
    for name in frame.columns:
        if name.startswith("q") and name.endswith("_rad") and (np.abs(_column(frame, name)) > ANGLE_RAD).any():
            found.warnings.append(f'{name} exceeds {ANGLE_RAD:.0f} rad: likely degrees; say joint_unit = "deg"')
            return


def _name_still(frame: pl.DataFrame, kind: _Points, found: _Findings) -> None:
    """Name a position that never changes by a hair; a real sensor has noise, even of somebody who stands still."""
    xyz = np.column_stack([_column(frame, name) for name in kind.columns[:2]])
    xyz = xyz[np.isfinite(xyz).all(axis=1)]
    if len(xyz) >= STILL_ROWS and (xyz == xyz[0]).all():
        x, y = xyz[0]
        found.warnings.append(
            f"{kind.whose} stays at exactly ({x:g}, {y:g}) m in all {len(xyz)} rows: is the right signal logged?"
        )
