"""Implausible positions: out of reach, jumping there and back, or constant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.text.numbers import fixed, given

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.schema import Bools, Vector

    Track = NDArray[np.int64] | slice

STILL_ROWS = 100
"""Minimum number of rows for a warning about a constant value."""
WRONG_UNIT = 0.1
"""Share of a column's known values beyond what can be from which its unit is wrong, not single rows garbled. Half or
twice of it decides no log of the tests: garbled are a few in a hundred, of a wrong unit nearly all."""
NOWHERE_M = 1e9
_THINNED = 8
"""Only each so many rows of a long log are judged by their speed; a size."""
NEAR_M = 0.02
"""Distance from the origin, m, that every person or tool exceeds, because the robot's base or the camera is there."""


@dataclass(frozen=True)
class Kind:
    """Position columns and their plausible limits.

    Attributes:
        speed_m_s: Maximum plausible speed of a robot's TCP or of a person on foot.
        slack_m: Maximum step that is never a jump, whatever its time: clocks jitter, tracks move from head to hip.
        reach_m: Maximum plausible distance: a robot on a gantry, a person in the same hall.
        likely: Likely cause of a lasting jump.
        mixed: What a log holds whose rows go to and fro between two tracks, and the cure.
    """

    whose: str
    columns: tuple[str, str, str]
    speed_m_s: float
    slack_m: float
    reach_m: float
    likely: str
    mixed: str


TCP = Kind(
    *("the TCP", ("tcp_x_m", "tcp_y_m", "tcp_z_m"), 10.0, 0.05, 30.0, "a changed tool, or two recordings in one"),
    "two robots in one table, or two publishers on one topic; read the rows of one (key only of a mapped table), or "
    "record each alone",
)
PERSON = Kind(
    *("a person", ("x_m", "y_m", "z_m"), 20.0, 0.3, 150.0, "a track that changed its person"),
    "several people under one name; map the column of their id (key person of a mapped table)",
)


class Places:
    """Position checks of one table, window after window."""

    def __init__(self, kind: Kind) -> None:
        self.kind, self.unit_shown = kind, False
        self._scale_off: bool | None = None  # True if most of the first positions are out of reach: another unit
        self._far_rows, self._far_m = 0, 0.0
        self._usual_s: float | None = None
        self._jumps, self._to_and_fro = 0, 0
        self._same: Vector | None = None
        self._still, self._seen = True, 0
        self._most_m = 0.0
        self._ways, self._too_fast, self._speeds_m_s = 0, 0, list[float]()

    def out_of_reach(self, xyz: Vector, here: Bools) -> Bools:
        """Return a mask of positions, shape (3, N), out of reach; all False if most are, because then the unit differs.

        Such a table is consistent as a whole, and only the user knows its unit.
        """
        far = _length(_without_nan(np.clip(xyz, -NOWHERE_M, NOWHERE_M)))
        beyond = far > self.kind.reach_m
        if self._scale_off is None and (known := int(np.isfinite(xyz[0]).sum())):
            self._scale_off = bool(beyond.sum() > 0.5 * known)
            self._far_m = float(np.median(far[beyond])) if self._scale_off else 0.0
        if self._scale_off:
            self._far_rows += int((beyond & here).sum())
            return np.zeros(len(far), bool)
        return np.asarray(beyond)

    def strays(self, times: Vector, xyz: Vector, groups: Sequence[Track], here: Bools) -> Bools:
        """Return a mask of single outliers of each track, and count the jumps that remain without them."""
        bad = np.zeros(len(times), bool)
        if self._scale_off:
            return bad
        xyz = np.clip(xyz, -NOWHERE_M, NOWHERE_M)
        for rows in groups:
            stray, jumps = self._of_track(times[rows], xyz[:, rows], here[rows])
            bad[rows] = stray
            self._jumps += jumps
            self._to_and_fro += int((stray[1:] & stray[:-1] & here[rows][1:]).sum())
        return bad

    def _of_track(self, times: Vector, xyz: Vector, here: Bools) -> tuple[Bools, int]:
        bad = np.zeros(len(times), bool)
        seen = np.flatnonzero(np.isfinite(xyz[0]) & np.isfinite(xyz[1]))
        if len(seen) < 2:
            return bad, 0
        t, p = times, xyz
        if len(seen) < len(times):
            t, p = times[seen], xyz[:, seen]
        p = _without_nan(p)
        self._judge_speed(t, p)
        steps = np.diff(t)
        if self._usual_s is None and (steps > 0).any():
            self._usual_s = float(np.median(steps[steps > 0]))
        jump = self._cannot(t, p)
        if not jump.any():
            return bad, 0
        if len(seen) > 2:
            across = ~self._cannot(t, p, apart=2)
            bad[seen[1:-1][jump[:-1] & jump[1:] & across]] = True
        kept = ~bad[seen]
        return bad, int((self._cannot(t[kept], p[:, kept]) & here[seen][kept][1:]).sum())

    def _judge_speed(self, t: Vector, p: Vector) -> None:
        """Record the speeds between rows so far apart that most ways are motion, no noise; none of what stands."""
        t, p = (t, p) if len(t) < _THINNED * STILL_ROWS else (t[::_THINNED], p[:, ::_THINNED])
        while len(t) > STILL_ROWS // 4:
            way, took = _length(np.diff(p)), np.diff(t)
            moved = (way > self.kind.slack_m) & (took > 0.0)
            if moved.mean() > 0.5:
                speeds = way[moved] / took[moved]
                self._ways += len(speeds)
                self._too_fast += int((speeds > self.kind.speed_m_s).sum())
                self._speeds_m_s.append(float(np.median(speeds)))
                return
            t, p = t[::2], p[:, ::2]

    def _cannot(self, t: Vector, p: Vector, apart: int = 1) -> Bools:
        """Return for each row whether the distance to the row `apart` rows later is impossible in that time."""
        step = t[apart:] - t[:-apart]
        way = _length(p[:, apart:] - p[:, :-apart])
        possible = self.kind.slack_m + self.kind.speed_m_s * np.maximum(step, self._usual_s or 0.0)
        return np.asarray((way > possible) & (step > 0))

    def record_constant(self, xyz: Vector) -> None:
        """Record the distance, and whether the position ever changed; a sensor has noise even for a person at rest."""
        known = np.isfinite(xyz[0]) & np.isfinite(xyz[1])
        if not known.all():
            xyz = xyz[:, known]
        if not xyz.shape[1]:
            return
        if self._same is None:
            self._same = xyz[:2, 0].copy()  # a view would keep all the other rows
        self._seen += xyz.shape[1]
        self._most_m = max(self._most_m, -float(np.nanmin(xyz)), float(np.nanmax(xyz)))
        x, y = self._same
        self._still = self._still and bool(((xyz[0] == x) & (xyz[1] == y)).all())

    def impossible(self) -> list[str]:
        """Return the warnings about a wrong unit."""
        kind, found = self.kind, []
        if self._far_rows:
            found.append(
                f"{kind.whose} is {fixed(self._far_m, 0)} m away in {self._far_rows} rows: probably millimetres; "
                'set length_unit = "mm", or correct the unit in the export'
            )
        if self._to_and_fro > WRONG_UNIT * self._seen and not self._far_rows:
            found.append(
                f"{kind.whose} goes to and fro between two tracks in {self._to_and_fro} of {self._seen} rows: "
                f"{kind.mixed}"
            )
        elif self._too_fast > WRONG_UNIT * self._ways and not self._far_rows:
            unit = "of length; give length_unit" if self.unit_shown else "of time; give time_unit, or length_unit"
            found.append(
                f"{kind.whose} moves at {fixed(float(np.median(self._speeds_m_s)), 1)} m/s, which none does (at most "
                f"{fixed(kind.speed_m_s, 0)}): probably another unit {unit}"
            )
        if 0.0 < self._most_m < NEAR_M and self._seen >= STILL_ROWS:
            found.append(
                f"{kind.whose} is never farther than {fixed(1e3 * self._most_m, 1)} mm from the origin on "
                "any axis: probably metres with the unit given as millimetres; correct the unit"
            )
        return found

    def warnings(self) -> tuple[list[str], list[str]]:
        """Return the warning about a constant position, and the others."""
        kind, found = self.kind, self.impossible()
        if self._jumps:
            found.append(
                f"{kind.whose} jumps faster than {fixed(kind.speed_m_s, 0)} m/s {self._jumps} time(s): {kind.likely}"
            )
        if self._same is None or not self._still or self._seen < STILL_ROWS:
            return [], found
        x, y = self._same
        return [
            f"{kind.whose} stays at exactly ({given(x)}, {given(y)}) m in all {self._seen} rows: check the "
            "logged signal"
        ], found


def _without_nan(values: Vector) -> Vector:
    """Return values with 0 for NaN; the same array if it holds none."""
    return np.asarray(np.where(np.isnan(values), 0.0, values)) if np.isnan(values.sum()) else values


def _length(vectors: Vector) -> Vector:
    """Return the lengths of vectors, shape (3, N); computed by rows, several times faster than by columns."""
    x, y, z = vectors
    return np.asarray(np.sqrt(x * x + y * y + z * z))
