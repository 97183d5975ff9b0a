"""The checks: implausible rows of a window, and warnings about the whole table.

A check receives window after window (`window`), sets rows aside and counts them. After the last one it returns its
warnings, one sentence each.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.ingest.validate.held_positions import HeldPositions
from cyclekit.ingest.validate.lost_rows import REPEATED
from cyclekit.ingest.validate.motion import PERSON, TCP, WRONG_UNIT, Kind, Places
from cyclekit.ingest.validate.placeholders import Placeholders, rows_of
from cyclekit.ingest.validate.window import HERE, PLACE, judged_rows
from cyclekit.schema import is_joint
from cyclekit.text.numbers import compact, fixed, given

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.ingest.validate.motion import Track
    from cyclekit.schema import Bools, Vector


ANGLE_RAD = 26.0
"""Maximum joint angle, rad: over four turns. A larger value is not in radians."""
SPEED_M_S = 10.0
FASTEST_S = 5e-5
"""Least time between rows of a robot log, s: no controller logs at 20 kHz."""
DAY_S = 86_400.0
_NEAR = 8
_NOBODY = "a person is at exactly {value} m on every axis in {count} of {rows} rows: no person seen; unknown there"
_NO_TOOL = "the TCP jumps to exactly {value} m on every axis in {count} of {rows} rows: no position; unknown there"
_NO_JOINTS = (
    "all joints jump to exactly 0 in {count} of {rows} rows: no position, or a second publisher; the robot's place is "
    "unknown there"
)
LATEST_S = 1e11
"""Maximum time, s: the year 5138, beyond any clock."""


class Checks:
    """Checks common to all tables: rows set aside, non-finite numbers, time.

    Attributes:
        whose: Whose rows they are.
        unit_shown: Whether the log shows the unit of its times, such as written dates do; else it may be another.
    """

    def __init__(self, whose: str) -> None:
        self.whose, self.unit_shown = whose, False
        self._aside: list[pl.DataFrame] = []
        self._not_finite: dict[str, int] = {}
        self._ahead, self._furthest_s = 0, 0.0
        self._period_s: float | None = None

    def check(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return the window without implausible rows."""
        return self.timed(self.finite(frame))

    def warnings(self) -> list[str]:
        """Return the warnings, after the last window."""
        return [*self._number_warnings(), *self._time_warnings()]

    def impossible(self) -> list[str]:
        """Return those of the warnings that mean that a whole column cannot be as it was read."""
        return []

    def neighbours(self, frame: pl.DataFrame) -> int:
        """Return the number of neighbours before and after a row; two are needed, and some may be removed."""
        return _NEAR

    def take_set_aside(self) -> list[pl.DataFrame]:
        """Return the rows set aside since the last call: `source_row`, `reason`."""
        aside, self._aside = self._aside, []
        return aside

    def drop(self, frame: pl.DataFrame, bad: Bools, reason: str) -> pl.DataFrame:
        """Return the rows that are not bad; bad rows that are judged in this window are set aside."""
        if not bad.any():
            return frame
        here = frame.filter(pl.Series(bad) & (frame[PLACE] == HERE))
        if here.height:
            self._aside.append(here.select("source_row", pl.lit(reason).alias("reason")))
        return frame.filter(~bad)

    def without_repeats(self, frame: pl.DataFrame, twice: Bools, alike: str) -> pl.DataFrame:
        """Set aside rows that repeat another one, and those that are only `alike`, with other values."""
        if not twice.any():
            return frame
        first = frame.select(pl.struct(pl.exclude("source_row", PLACE)).is_first_distinct()).to_series().to_numpy()
        same = twice & ~first
        frame = self.drop(frame, same, REPEATED)
        return self.drop(frame, (twice & first)[~same], f"{alike}, and other values")

    def finite(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Replace NaN and infinity by null, and count them; adapters of text logs have already done so."""
        names = [name for name, dtype in frame.schema.items() if dtype.is_float() and name != "t_s"]
        if not names:
            return frame
        hit = [name for name in names if not _is_finite(frame[name])]
        if not hit:
            return frame
        here = frame.filter(pl.col(PLACE) == HERE)
        for name in hit:
            self._not_finite[name] = self._not_finite.get(name, 0) + int((~here[name].is_finite()).sum())
        return frame.with_columns(pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name) for name in hit)

    def timed(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Set rows without a plausible time aside, and count forward jumps of time."""
        frame = self.drop(frame, ~(np.abs(column(frame, "t_s")) < LATEST_S), "its time is not a plausible number")
        steps = np.diff(column(frame, "t_s"))
        far = steps[(steps > DAY_S) & (is_here(frame)[1:])]
        if len(far):
            self._ahead, self._furthest_s = self._ahead + len(far), max(self._furthest_s, float(far.max()))
        if self._period_s is None and (steps > 0).sum() >= 10:
            self._period_s = float(np.median(steps[steps > 0]))
        return frame

    def _number_warnings(self) -> list[str]:
        if not self._not_finite:
            return []
        listed = ", ".join(f"{name} in {count} rows" for name, count in self._not_finite.items())
        return [f"NaN or infinite: {listed}; unknown there"]

    def _time_warnings(self) -> list[str]:
        if not self._ahead:
            return []
        return [
            f"the time of {self.whose} jumps ahead by {fixed(self._furthest_s / DAY_S, 1)} days: nothing was logged in "
            "between, or the clock was set; if it was, split the log there"
        ]

    def _period_warnings(self) -> list[str]:
        period = self._period_s
        if period is not None and period > 1.5:
            unit = "probably milliseconds read as seconds; give time_unit"
            said = "too far apart for its standstills; log it more often" if self.unit_shown else unit
            return [f"robot rows lie {compact(period, 3)} s apart: {said}"]
        if period is not None and period < FASTEST_S:
            said = "check the clock" if self.unit_shown else "check the unit of time and give time_unit"
            return [f"robot rows lie {compact(period, 3)} s apart: {said}"]
        return []


NO_TCP = (
    "the log has joint angles but no TCP, so places and tasks cannot be found: log the TCP pose too "
    '(UR actual_TCP_pose, Franka O_T_EE, KUKA RIst), or name the arm in cell.toml ([robot] model = "UR5e")'
)
"""Warning for a robot log with joint angles only."""


class RobotChecks(Checks):
    """Checks of a robot's rows."""

    def __init__(self) -> None:
        super().__init__("the robot")
        self._places = Places(TCP)
        self._unknown = Placeholders(TCP.columns, _NO_TOOL, robot=True), Placeholders((), _NO_JOINTS, robot=True)
        self._fractions = {"scaling": _OutOfRange(), "slider": _OutOfRange()}
        self._speed = _OutOfRange()
        self._angles: dict[str, _OutOfRange] = {}
        self._joints = self._tcp = False

    def check(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return the window without implausible rows."""
        frame = self.finite(frame)
        for unknown in self._unknown:
            frame = unknown.check(frame)
        frame = scaling_while_playing(self.timed(frame))
        frame = self.without_repeats(frame, repeated(column(frame, "t_s")), "has the time of the row before it")
        bad = stray_times(column(frame, "t_s"))
        frame = self.drop(frame, bad, "its time does not fit between its neighbours")
        frame = placed(self, frame, self._places, tracks(frame))
        for name, seen in self._fractions.items():
            value = column(frame, name)
            frame = seen.check(frame, name, value, (value < 0.0) | (value > 1.001))
        speed = column(frame, "tcp_speed_m_s")
        frame = self._speed.check(frame, "tcp_speed_m_s", speed, (speed > SPEED_M_S) | (speed < 0))
        self._tcp = self._tcp or bool(np.isfinite(column(frame, "tcp_x_m")).any())
        self._joints = self._joints or bool(np.isfinite(column(frame, "q0_rad")).any())
        for name in frame.columns:
            if is_joint(name) and name.endswith("_rad"):
                angle, seen = np.abs(column(frame, name)), self._angles.setdefault(name, _OutOfRange())
                frame = seen.check(frame, name, angle, angle > ANGLE_RAD)
        return frame

    def warnings(self) -> list[str]:
        """Return the warnings, after the last window."""
        messages = [*super().warnings(), *(text for one in self._unknown for text in one.warnings())]
        messages += self._period_warnings()
        still, others = self._places.warnings()
        messages += others
        for name, seen in self._fractions.items():
            if seen.rows:
                percent = 1.5 < seen.most <= 200.0
                likely = "probably percent, set scaling_max = 100" if percent else "not a fraction"
                messages.append(f"{name} reaches {given(seen.most)} in {seen.rows} rows: {likely}; unknown there")
        if self._speed.rows:
            likely = "likely mm/s" if self._speed.in_another_unit else "garbled"
            top, rows = compact(self._speed.most, 4), self._speed.rows
            messages.append(f"tcp_speed_m_s reaches {top} m/s in {rows} rows: {likely}; unknown there")
        messages += self._angle_warnings()
        if self._joints and not self._tcp:
            messages.append(NO_TCP)
        return [*messages, *still]

    def _angle_warnings(self, *, of_whole_columns: bool = False) -> list[str]:
        far = {name: seen for name, seen in self._angles.items() if seen.rows}
        whole = {name: seen for name, seen in far.items() if seen.in_another_unit}
        if not far or (of_whole_columns and not whole):
            return []
        name, seen = min((whole or far).items())
        turned = seen.most <= np.rad2deg(ANGLE_RAD)
        likely = 'probably degrees; set joint_unit = "deg"' if whole and turned else "garbled"
        return [f"{name} reaches {compact(seen.most, 4)} rad in {seen.rows} rows: {likely}; unknown there"]

    def impossible(self) -> list[str]:
        """Return those of the warnings that mean that a whole column cannot be as it was read."""
        off = self._places.impossible() + (self._period_warnings() if (self._period_s or 1.0) < FASTEST_S else [])
        names = [
            name for name, seen in (*self._fractions.items(), ("tcp_speed_m_s", self._speed)) if seen.in_another_unit
        ]
        off += [text for text in self.warnings() if any(text.startswith(f"{name} reaches") for name in names)]
        return off + self._angle_warnings(of_whole_columns=True)


class PeopleChecks(Checks):
    """Checks of the people of a tracker; neighbours are rows of the same person."""

    def __init__(self) -> None:
        super().__init__("a person")
        self._places = Places(PERSON)
        self._no_person, self._held = Placeholders(PERSON.columns, _NOBODY), HeldPositions()

    def neighbours(self, frame: pl.DataFrame) -> int:
        """Return the number of rows that include the neighbours of every person present."""
        if "person" not in frame.columns:
            return _NEAR
        return _NEAR * frame["person"].n_unique()

    def check(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Return the window without implausible rows."""
        frame = self.timed(self._no_person.check(self.finite(frame)))
        groups, times = tracks(frame), column(frame, "t_s")
        if any((np.diff(times[rows]) <= 0.0).any() for rows in groups):  # otherwise no time repeats or is garbled
            frame = self._in_order(frame)
            groups = tracks(frame)
        frame = placed(self, frame, self._places, groups)
        here = frame[judged_rows(frame)]
        self._held.add(column(here, "t_s"), positions(here, PERSON), rows_of(here))
        return frame

    def _in_order(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Set aside repeated times of a person, and single times that do not fit between their neighbours."""
        twice = frame.select(~pl.struct("t_s", "person").is_first_distinct()).to_series().to_numpy()
        frame = self.without_repeats(frame, twice, "has the person and the time of a row before it")
        bad = np.zeros(frame.height, bool)
        for rows in tracks(frame):
            bad[rows] = stray_times(column(frame, "t_s")[rows])
        return self.drop(frame, bad, "its time does not fit between its neighbours")

    def warnings(self) -> list[str]:
        """Return the warnings, after the last window."""
        still, others = self._places.warnings()
        return [*super().warnings(), *self._no_person.warnings(), *self._held.warnings(), *others, *still]

    def impossible(self) -> list[str]:
        """Return those of the warnings that mean that a whole column cannot be as it was read."""
        return self._places.impossible()


class _OutOfRange:
    """Counts implausible values of a column and replaces them by null."""

    def __init__(self) -> None:
        self.rows, self.known, self.most = 0, 0, -np.inf

    @property
    def in_another_unit(self) -> bool:
        """Whether so many values are implausible that the unit of the column is another one."""
        return self.rows > WRONG_UNIT * self.known

    def check(self, frame: pl.DataFrame, name: str, value: Vector, wrong: Bools) -> pl.DataFrame:
        here = is_here(frame)
        self.known += int((np.isfinite(value) & here).sum())
        if not wrong.any():
            return frame
        self.rows += int((wrong & here).sum())
        self.most = max(self.most, float(value[wrong].max()))
        return frame.with_columns(pl.when(pl.Series(~wrong)).then(pl.col(name)).alias(name))


def scaling_while_playing(frame: pl.DataFrame) -> pl.DataFrame:
    """Return robot rows with null scaling where the program is known not to run.

    While a program is paused or stopped, a controller writes any value, mostly 0, which is not a protective stop.
    """
    if not {"scaling", "state"}.issubset(frame.columns) or not (frame["state"] != "playing").any():
        return frame
    halted = (pl.col("state") != "playing").fill_null(value=False)
    return frame.with_columns(pl.when(~halted).then("scaling").alias("scaling"))


def placed(checks: Checks, frame: pl.DataFrame, places: Places, groups: Sequence[Track]) -> pl.DataFrame:
    """Set aside positions out of reach and single implausible jumps."""
    kind: Kind = places.kind
    places.unit_shown = checks.unit_shown
    times, xyz = column(frame, "t_s"), positions(frame, kind)
    beyond = places.out_of_reach(xyz, is_here(frame))
    reason = f"{kind.whose} more than {fixed(kind.reach_m, 0)} m away: implausible position"
    if beyond.any():
        frame = checks.drop(frame, beyond, reason)
        groups = tracks(frame)
        times, xyz = times[~beyond], xyz[:, ~beyond]
    stray = places.strays(times, xyz, groups, is_here(frame))
    places.record_constant(xyz[:, judged_rows(frame)])
    jumped = f"{kind.whose} jumps there and back implausibly fast (faster than {fixed(kind.speed_m_s, 0)} m/s)"
    return checks.drop(frame, stray, jumped)


def column(frame: pl.DataFrame, name: str) -> Vector:
    """Return a column, shape (N,), NaN = unknown; all NaN if the column is missing."""
    if name not in frame.columns:
        return np.full(frame.height, np.nan)
    values = frame.get_column(name)
    return (values if values.dtype == pl.Float64 else values.cast(pl.Float64)).to_numpy()  # null becomes NaN


def positions(frame: pl.DataFrame, kind: Kind) -> Vector:
    """Return the positions of a table, shape (3, N), m."""
    return np.stack([column(frame, name) for name in kind.columns])


def _is_finite(values: pl.Series) -> bool:
    """Return whether no value is NaN or infinite; checked through the sum, unless that overflows."""
    total = values.sum()
    return bool(np.isfinite(float(total))) or bool(values.is_finite().all())


def is_here(frame: pl.DataFrame) -> Bools:
    """Return a mask of the rows of a window that are judged now."""
    return np.asarray(frame[PLACE].to_numpy() == HERE)


def repeated(times: Vector) -> Bools:
    """Return a mask of the rows that repeat the time of the row before."""
    return np.concatenate([[False], np.diff(times) == 0.0])[: len(times)]


def stray_times(times: Vector) -> Bools:
    """Return a mask of rows with a time outside of that of their consistent neighbours: garbled, no restart."""
    bad = np.zeros(len(times), bool)
    if len(times) < 3:
        return bad
    before, here, after = times[:-2], times[1:-1], times[2:]
    back = (after > before) & (here < before)
    ahead = (after > before) & (here > after)
    bad[1:-1] = back | (ahead & ~np.append(back[1:], False))
    return bad


def tracks(frame: pl.DataFrame) -> Sequence[Track]:
    """Return the row numbers of each person, in order; all rows if the table has no persons."""
    if "person" not in frame.columns:
        return [slice(None)]
    grouped = frame.lazy().with_row_index("__row").group_by("person", maintain_order=True).agg("__row").collect()
    rows = grouped["__row"].explode().to_numpy().astype(np.int64)
    return np.split(rows, np.cumsum(grouped["__row"].list.len().to_numpy())[:-1])
