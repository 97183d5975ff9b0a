"""The unit of a column of counts, proven by evidence or left open: the only place that decides it.

Every unit is a candidate. Evidence excludes candidates: dates that cannot be, intervals between rows and speeds that no
robot or person has, a second time in the same row, and sampling intervals that no logger uses beside one that many
use. A unit in the column's name is taken if nothing contradicts it. What remains is proven if it is one, and is
otherwise named, for the user to choose.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.text.numbers import compact
from cyclekit_adapters.times.units import COUNTED, DATED, EARLIEST_S, FRAME, LATEST_S, Unit

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Vector = NDArray[np.float64]
    Exclude = Callable[[Unit], str | None]

_MOTION_STEP_S = (2e-4, 60.0)
"""Intervals between rows of robots and people, s: no controller logs at more than 5 kHz, no path is logged each minute.
Half and twice of them change none of the tests of units."""
_DENSE, _DENSE_STEP_S = 0.1, 1.2
"""A path whose median step is at most this share of its span was logged at intervals of at most so many seconds.
Half and twice of the share change none of the tests of units."""
_EVENT_STEP_S = 1e-3
"""Least median interval between rows of events and states, s: a PLC's cycle. Half and twice change no test of units."""
_DATE_STEP_S = 600.0
"""Median interval of rows up to which a large number that is a date in one unit alone is that date, s; beyond it, a
count of 11 to 20 days in ms may look like one in s since 1970. Half and twice of it change no test of units."""
_UPTIME_S = 3.2e7
"""Longest time since the zero of a clock of its own, s: a year. Half changes no test of units; with twice, a count of
WinCC's days is one of ms too."""
_TASKS_S = (0.1, 86_400.0)
"""Range of the median duration of tasks, s: from a gripper's stroke to a day."""
_SPEEDS = {"robot": (0.02, 8.0), "people": (0.1, 5.0)}
"""Speed that the fastest hundredth of the rows has, m/s or rad/s: a slow gluing robot and the fastest joint; a person
who walks at all, and one who runs. Half of them changes no test of units; with twice, one contradiction is missed."""
_MOVES = {"robot": 0.05, "people": 1.0}
"""Least span of a path, m or rad, that is judged by its speed. Half and twice of it change no test of units."""
_USUAL_S = np.array(
    [s * 10.0**e for e in range(-4, 2) for s in (1.0, 2.0, 2.5, 5.0)]
    + [0.004, 0.008, 0.012, 0.016, 0.024, 0.032, 0.04]
    + [1.0 / hz for hz in (24, 29.97, 30, 48, 59.94, 60, 72, 75, 90, 119.88, 120, 144, 150, 180, 240, 300, 360)]
)
"""Sampling intervals that controllers, cameras and trackers have, s."""
_EXACT = 1e-3
"""Relative precision to which a median interval is a usual one: that of times written with three digits."""
_SAMPLES = 10
"""Intervals from which rows are known to come at one. Half and twice of it change no test of units."""
_TWO_TIMES = 0.02
"""Maximum relative difference of two times of one row; units differ by 60 or more, the drift of clocks is below 1 %."""
_TICKS = {"10 ns", "100 ns", "10 us", "1/100 s", "1/10 s", "filetime", "ticks"}
"""Units of which only whole numbers are counted."""
_NO_DATE, _NO_GPS = "no date of 2000 to 2099", "the name says nothing of GPS"
_FRACTIONS = "it has fractions"
_WINCC = re.compile(r"time_?ms", re.IGNORECASE)


@dataclass(frozen=True)
class TimeEvidence:
    """What a table says of one of its columns.

    Attributes:
        named: Unit in the column's name, or None; `column`: that name.
        others: Other times of the same rows: name, seconds (N,), and whether they are since 1970.
        path: Positions or joint angles in the rows, shape (N, D), m or rad; None if unknown.
        of: What moves along the path, `robot` or `people`; None for events and states.
        before_s: Date of the file, s since 1970; None if unknown.
        lasts: Durations in the same unit, such as the ends of tasks less their starts; empty if there are none.
    """

    column: str = ""
    named: Unit | None = None
    others: Sequence[tuple[str, Vector, bool]] = ()
    path: Vector | None = None
    of: str | None = None
    before_s: float | None = None
    lasts: Sequence[float] = ()


@dataclass(frozen=True)
class Proof:
    """The candidates that are left.

    Attributes:
        left: Units, the most likely first; also those that remain beside a contradiction. A count of rows is FRAME.
        why: Evidence, in a few words; for several units what each would mean.
        contradiction: Why none is left, as a sentence; otherwise empty.
    """

    left: tuple[Unit, ...]
    why: str
    contradiction: str = ""
    excluded: dict[str, str] = field(default_factory=dict)

    @property
    def unit(self) -> Unit | None:
        """The unit, if it is proven."""
        return self.left[0] if len(self.left) == 1 and not self.contradiction else None

    @property
    def question(self) -> str:
        """What is open, for a refusal."""
        return self.contradiction or f"its unit may be {_listed([unit.name for unit in self.left])} ({self.why})"


def file_date(path: Path) -> float | None:
    """Return when a file was written, s since 1970; None if that cannot be known (archives may drop dates)."""
    try:
        written_s = path.stat().st_mtime
    except OSError:
        return None
    return written_s if written_s > EARLIEST_S else None


def dated_unit(number: float, before_s: float | None = None) -> Unit | None:
    """Return the unit in which a number is a date of a log; None if it is in none or several, or may be an uptime in s.

    Args:
        number: The count.
        before_s: Date of the file: of several dates those after it (and a day) are none.
    """
    dates = _dates() if number > _UPTIME_S else []
    units = [unit for unit in dates if unit.name != "gps" and _is_date(number, unit)]
    past = [unit for unit in units if before_s is None or _when(number, unit) <= before_s + 86_400.0]
    units = past or units
    return units[0] if len(units) == 1 else None


def contradicted(unit: Unit, values: Vector, others: Sequence[tuple[str, Vector, bool]]) -> str | None:
    """Return why a stated unit of numbers, shape (N,), cannot be, by other times of the same rows; None if it can."""
    return _other_time(unit, values, others)


def prove(values: Vector, evidence: TimeEvidence) -> Proof:
    """Return the units that the numbers of a column, shape (N,), may have; NaN is unknown."""
    known = np.isfinite(values)
    steps = np.diff(values[known])
    if not known.any():
        return Proof((), "", "it holds no number")
    step = float(np.median(np.abs(steps[steps != 0]))) if (steps != 0).any() else 0.0
    middle = float(np.median(values[known]))
    candidates = [*COUNTED.values(), *_dates()]
    if len(steps) and (steps == 1.0).all() and values[known][0] % 1 == 0.0:
        candidates.append(Unit(FRAME, np.nan, about="a count of rows or cycles"))
    named = evidence.named
    if named is not None and named.name not in {*COUNTED, *DATED}:
        candidates.append(named)
    rules: list[Exclude] = [
        lambda unit: _FRACTIONS if unit.name in _TICKS and (values[known] % 1 != 0).any() else None,
        lambda unit: _no_date(unit, middle, values[known], named),
        lambda unit: _no_interval(unit, step, evidence),
        lambda unit: None if unit.seconds == getattr(named, "seconds", None) else no_duration(unit, evidence.lasts),
        lambda unit: _other_time(unit, values, evidence.others),
        lambda unit: _no_speed(unit, values, evidence),
    ]
    excluded: dict[str, str] = {}
    left: list[Unit] = []
    for unit in candidates:
        reason = next((reason for rule in rules if (reason := rule(unit))), None)
        if reason is None:
            left.append(unit)
        else:
            excluded.setdefault(_key(unit), reason)
    left, late = _before(left, middle, evidence.before_s)
    if late:
        excluded |= dict.fromkeys(map(_key, late), "its dates would be after the file's own")
    if named is not None:
        return _by_name(named, left, excluded, evidence, step)
    dated = [unit for unit in left if unit.zero_s is not None]
    if len(dated) == 1 and middle > _UPTIME_S and step * dated[0].seconds <= _DATE_STEP_S:
        left = dated  # no clock of its own counts so much
    usual = [unit for unit in left if unit.name == FRAME or _is_usual(step * unit.seconds)]
    if (evidence.of or _is_even(steps)) and usual and not any(unit.zero_s is not None for unit in left):
        left = usual
    if not left:
        return Proof((), "", _contradicted(excluded, evidence), excluded)
    return Proof(
        tuple(sorted(left, key=lambda unit: _unlikely(unit, step))), _why(left, step, evidence, excluded), "", excluded
    )


def _dates() -> list[Unit]:
    return [*(COUNTED[name].since_1970() for name in ("s", "ms", "us", "ns", "days")), *DATED.values()]


def _key(unit: Unit) -> str:
    return f"{unit.name} since 1970" if unit.zero_s == 0.0 else unit.name


def _when(number: float, unit: Unit) -> float:
    return number * unit.seconds + float(unit.zero_s or 0.0)


def _is_date(number: float, unit: Unit) -> bool:
    return EARLIEST_S <= _when(number, unit) <= LATEST_S


def _before(left: list[Unit], middle: float, before_s: float | None) -> tuple[list[Unit], list[Unit]]:
    """Return the units without dates after the file's own, and the others."""
    if before_s is None:
        return left, []
    late = [unit for unit in left if unit.zero_s is not None and _when(middle, unit) > before_s + 86_400.0]
    return [unit for unit in left if unit not in late], late


def _no_date(unit: Unit, middle: float, values: Vector, named: Unit | None) -> str | None:
    if unit.zero_s is not None:
        if unit.name == "gps" and (named is None or named.name != "gps"):
            return _NO_GPS
        return None if _is_date(middle, unit) else _NO_DATE
    if unit.name == FRAME:
        return None
    far = float(np.abs(values).max()) * unit.seconds
    if far > _UPTIME_S:
        return f"{compact(far / 86_400.0 / 365.25, 3)} years since its zero"
    return None


def _no_interval(unit: Unit, step: float, evidence: TimeEvidence) -> str | None:
    if not step or unit.name == FRAME:
        return None
    if evidence.of is None and unit.seconds == getattr(evidence.named, "seconds", None):
        return None  # events may be as near and as far as they like
    interval_s, (least, most) = step * unit.seconds, _MOTION_STEP_S if evidence.of else (_EVENT_STEP_S, np.inf)
    if evidence.of and _is_dense(evidence.path):
        most = _DENSE_STEP_S
    if not least * (1 - _EXACT) <= interval_s <= most:
        return f"its rows would lie {shown_s(interval_s)} apart"
    return None


def no_duration(unit: Unit, lasts: Sequence[float]) -> str | None:
    """Return why durations of tasks cannot be in a unit; None if they can."""
    if unit.name == FRAME:
        return None
    known = [abs(count) for count in lasts if np.isfinite(count) and count != 0.0]
    took_s = float(np.median(known)) * unit.seconds if known else _TASKS_S[0]
    return None if _TASKS_S[0] <= took_s <= _TASKS_S[1] else f"its tasks would take {shown_s(took_s)}"


def _is_dense(path: Vector | None) -> bool:
    if path is None:
        return False
    with np.errstate(over="ignore"):
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    moved = steps[np.isfinite(steps) & (steps > 0)]
    return len(moved) > 0 and float(np.median(moved)) <= _DENSE * _span(path)


def _span(path: Vector) -> float:
    known = path[np.isfinite(path).all(axis=1)]
    return float((known.max(axis=0) / 2 - known.min(axis=0) / 2).max()) * 2 if len(known) else 0.0


def _no_speed(unit: Unit, values: Vector, evidence: TimeEvidence) -> str | None:
    """Exclude units in which the path would be run too fast, or, over several rows and above noise, too slowly."""
    path, of = evidence.path, evidence.of
    if path is None or of is None or unit.name == FRAME or _span(path) < _MOVES[of]:
        return None
    least, most = _SPEEDS[of]
    fast = _fastest(path, values * unit.seconds, 1)
    if fast is not None and fast > most:
        return (
            f"it would move at {compact(fast, 3)} m/s"
            if path.shape[1] < 4
            else f"its joints would turn at {compact(fast, 3)} rad/s"
        )
    shared = len(values) // max(1, len(np.unique(values)))  # rows of one stamp
    slow = _fastest(path, values * unit.seconds, max(1, len(path) // 100, 5 * shared * (shared > 1)))
    if slow is not None and slow < least:
        return (
            f"it would never move faster than {compact(slow, 2)} m/s"
            if path.shape[1] < 4
            else f"only {compact(slow, 2)} rad/s"
        )
    return None


def _fastest(path: Vector, t_s: Vector, rows: int) -> float | None:
    """Return the 99 % quantile of the speeds over so many rows."""
    with np.errstate(over="ignore", invalid="ignore"):
        ran, took = np.linalg.norm(path[rows:] - path[:-rows], axis=1), t_s[rows:] - t_s[:-rows]
    known = np.isfinite(ran) & (took > 0)
    return float(np.quantile(ran[known] / took[known], 0.99)) if known.any() else None


def _other_time(unit: Unit, values: Vector, others: Sequence[tuple[str, Vector, bool]]) -> str | None:
    """Exclude units in which a column runs faster or slower than another time of the same rows."""
    for name, t_s, dated in others:
        both = np.isfinite(t_s) & np.isfinite(values)
        if both.sum() < 2 or unit.name == FRAME:
            continue
        theirs, ours = t_s[both] - t_s[both][0], (values[both] - values[both][0]) * unit.seconds
        coarse_s = float(np.abs(np.diff(theirs))[np.diff(theirs) != 0].min(initial=np.inf))
        if not np.isfinite(coarse_s) or float(np.abs(theirs).max()) < 3.0 * coarse_s:
            continue  # too short beside its resolution
        allowed = _TWO_TIMES * np.abs(theirs) + min(coarse_s, 1.0)
        if float((np.abs(ours - theirs) > allowed).mean()) > _TWO_TIMES:
            return f"{name} runs {_times(float(np.abs(theirs).max()), float(np.abs(ours).max()))}"
        if dated and unit.zero_s is not None and abs(_when(float(values[both][0]), unit) - t_s[both][0]) > 86_400.0:
            return f"{name} is another date"
    return None


def _times(theirs: float, ours: float) -> str:
    return f"{compact(theirs / ours, 3)} times as fast" if ours else "on"


def _by_name(named: Unit, left: list[Unit], excluded: dict[str, str], evidence: TimeEvidence, step: float) -> Proof:
    """Return the unit in the name if nothing contradicts it; else that which a second time in the row proves."""
    mine = [unit for unit in left if unit.seconds == named.seconds and (named.zero_s is None or unit == named)]
    mine = [unit for unit in mine if unit.zero_s is not None] or mine
    if mine:
        why = f"its name says {named.name}; steps of {compact(step, 6)} are {shown_s(step * named.seconds)}"
        why += f", {mine[0].about} by its size" if mine[0].zero_s is not None else ""
        return Proof(tuple(mine), why, "", excluded)
    reason = excluded.get(named.name) or "the evidence excludes it"
    said = f"its name says {named.name}, but then {reason}"
    if named.name == "ms" and _WINCC.search(evidence.column) and (counted := [u for u in left if u.name == "wincc"]):
        return Proof(tuple(counted), f"{said}; it counts {counted[0].about}", "", excluded)
    if evidence.others and len(left) == 1:
        return Proof(tuple(left), f"{said}; {evidence.others[0][0]} beside it agrees with {left[0].said}", "", excluded)
    left = sorted(left, key=lambda unit: _unlikely(unit, step))
    may = f"; it may be {_listed([unit.name for unit in left])}" if left else ""
    return Proof(tuple(left), said, said + may, excluded)


def _contradicted(excluded: dict[str, str], evidence: TimeEvidence) -> str:
    """Return why no unit is left: what those of dates, or else those of counts, would mean."""
    dated = [_key(unit) for unit in _dates()]
    dates = [key for key in dated if excluded.get(key, _NO_DATE) not in (_NO_DATE, _NO_GPS, _FRACTIONS)]
    most = "; ".join(f"{name}: {excluded[name]}" for name in dates or ("ms", "s", "min") if name in excluded)
    mixed = ": rows of several robots or people in one table?" if "move at" in most or "turn at" in most else ""
    return f"no unit of time fits it ({most}){mixed}"


def _is_even(steps: Vector) -> bool:
    """Return whether rows come at one interval: samples, as those of a path, and no changes."""
    usual = float(np.median(steps)) if len(steps) >= _SAMPLES else 0.0
    return usual > 0.0 and bool((np.abs(steps - usual) < _EXACT * usual).mean() > 1.0 - _TWO_TIMES)


def _is_usual(interval_s: float) -> bool:
    return bool((np.abs(_USUAL_S / interval_s - 1.0) < _EXACT).any()) if interval_s > 0 else False


_LIKELY = (FRAME, "s", "ms", "us", "ns", "min", "1/10 s", "1/100 s", "100 ns")


def _unlikely(unit: Unit, step: float) -> tuple[bool, bool, int]:
    place = _LIKELY.index(unit.name) if unit.name in _LIKELY else len(_LIKELY)
    return (unit.zero_s is None, unit.name != FRAME and not _is_usual(step * unit.seconds), place)


def _why(left: Sequence[Unit], step: float, evidence: TimeEvidence, excluded: dict[str, str]) -> str:
    if len(left) == 1 and left[0].zero_s is not None:
        return f"{_key(left[0]) if left[0].zero_s == 0.0 else left[0].said}, by its size{_beside(evidence)}"
    if not step:
        return "its rows do not tell"
    order = [unit for unit in sorted(left, key=lambda unit: _unlikely(unit, step)) if unit.name != FRAME]
    counts = "it rises by 1 in every row: row numbers or cycles (with rate_hz); " if len(order) < len(left) else ""
    if len(left) == 1 and order:
        other = f" (s: {excluded['s']})" if order[0].name != "s" and "s" in excluded else ""
        interval = f"steps of {compact(step, 6)} are {shown_s(step * order[0].seconds)} in {order[0].name}"
        return f"{interval}; no other unit fits{other}{_beside(evidence)}"
    each = ", ".join(f"{shown_s(step * unit.seconds)} if {_key(unit)}" for unit in order)
    cycles = "" if counts or step % 1.0 or len(left) == 1 else ", another time if cycles (4 ms, for example)"
    return f"steps of {compact(step, 6)}: {counts}{each}{cycles}"


def _beside(evidence: TimeEvidence) -> str:
    return f"; {evidence.others[0][0]} agrees" if evidence.others else ""


def _listed(names: Sequence[str]) -> str:
    return " or ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else "".join(names)


def shown_s(seconds: float) -> str:
    """Return an interval with a unit that suits it."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if abs(seconds) >= size:
            return f"{compact(seconds / size)} {unit}"
    return f"{compact(seconds / 1e-9)} ns"
