"""State of parallel programs: the running segment of each, its nominal time, and the ends of segments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cyclekit_sim.arm import Array
from cyclekit_sim.program import MOVE, Ints, Program


class ProgramState:
    """N programs, each followed by an endless standstill; flat index = base + segment."""

    def __init__(self, programs: Sequence[Program], cycle_s: float) -> None:
        width = max(len(program.kind) for program in programs) + 1
        shape = (len(programs), width)
        length_s, rows_per_s = np.full(shape, np.inf), np.zeros(shape)
        row, moving = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=bool)
        for n, program in enumerate(programs):
            count = len(program.kind)
            length_s[n, :count] = program.length_s
            row[n, :count] = program.row
            row[n, count:] = program.row[-1]
            if program.rows_per_s[-1] > 0:
                row[n, count:] += round(program.length_s[-1] * program.rows_per_s[-1])
            rows_per_s[n, :count] = program.rows_per_s
            moving[n, :count] = program.kind == MOVE
        self._lengths_s, self._rows, self._all_rows_per_s = length_s.ravel(), row.ravel(), rows_per_s.ravel()
        self._movings, self._cycle_s = moving.ravel(), cycle_s
        self._base = np.arange(len(programs)) * width
        self._last = np.array([len(program.kind) for program in programs])
        self.ends_s = np.full(shape, np.nan)
        self.begin_at(np.zeros(len(programs), dtype=np.int64), np.zeros(len(programs)))

    def begin_at(self, segment: Ints, nominal_s: Array) -> None:
        """Set the running segments (N,) and nominal times in them."""
        self.segment, self.nominal_s = segment, nominal_s
        self._look_up()

    def _look_up(self) -> None:
        """Look up the properties of the running segments, valid until one of them ends."""
        self._flat = flat = self._base + self.segment
        self.running = self.segment < self._last  # which programs are unfinished (N,)
        self.row, self.rows_per_s, self._length_s = self._rows[flat], self._all_rows_per_s[flat], self._lengths_s[flat]
        self._moving = self._movings[flat]
        self._find_waiting()

    def _find_waiting(self) -> None:
        """Find the numbers of the running programs whose segment has no end yet."""
        self.waiting = np.flatnonzero(np.isinf(self._length_s) & self.running)

    @property
    def share_done(self) -> float:
        """Fraction of all segments done."""
        return float(np.mean(self.segment / self._last))

    def release(self, which: Ints, at_s: Array) -> None:
        """Set the real end times of the running segments of these programs; a time in the past ends them at once."""
        begin_s = np.where(self.segment[which] > 0, self.ends_s[which, self.segment[which] - 1], 0.0)
        length_s = np.maximum(at_s - begin_s, 0.0)
        self._lengths_s[self._flat[which]] = self._length_s[which] = length_s
        self._find_waiting()

    def advance(self, t_s: float, pace: Array, standing: Array | float) -> None:
        """Advance by one cycle from `t_s`: moves at the rate `pace` (N,), other segments at the rate `standing`."""
        dt, segment = self._cycle_s, self.segment
        rate = np.where(self._moving, pace, standing)
        left, step = self._length_s - self.nominal_s, rate * dt
        self.nominal_s = self.nominal_s + step
        ending = step >= left
        if ending.any():
            self.segment = segment + ending
            self._look_up()
            for n in np.flatnonzero(ending).tolist():
                used = left[n] / rate[n]
                self.ends_s[n, segment[n]] = t_s + used
                self.nominal_s[n] = (dt - used) * (pace[n] if self._moving[n] else 1.0)
