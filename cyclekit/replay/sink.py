"""Writes rows of one execution to a recording: under its entity path, on all timelines.

A recording of several executions has one path per execution.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from cyclekit.replay.execution import ReplayedExecution

EXECUTION, WALL_CLOCK, SESSION, PHASE = "execution", "wall_clock", "session", "path_phase"
"""Timelines: seconds of the execution; time of day in UTC, or seconds of the session if unknown; and the path phase, in
hundredths of a task."""


class Sink:
    """Writes rows of one execution by column, on all timelines."""

    def __init__(
        self, stream: rr.RecordingStream, run: ReplayedExecution, phase: NDArray[np.int64] | None, root: str = ""
    ) -> None:
        """Write below `root` ("" or "name/"); `phase` is the path phase at `run.t_s`, None without known tasks."""
        self.stream, self.run, self.phase, self.root = stream, run, phase, root
        self.rows = 0

    def static(self, path: str, what: rr.AsComponents) -> None:
        """Write data without a time."""
        self.stream.log(self.root + path, what, static=True)

    def columns(self, path: str, t_s: NDArray[np.float64], columns: Iterable[rr.ComponentColumn]) -> None:
        """Write rows at times `t_s` (N,), seconds of the execution."""
        self.stream.send_columns(self.root + path, self.times(t_s), columns)
        self.rows += len(t_s)

    def times(self, t_s: NDArray[np.float64]) -> list[rr.TimeColumn]:
        """Return the columns of all timelines for times `t_s` (N,), seconds of the execution."""
        session_s = t_s + self.run.start_s
        found = [rr.TimeColumn(EXECUTION, duration=t_s)]
        if self.run.epoch_s is None:
            found.append(rr.TimeColumn(SESSION, duration=session_s))
        else:
            found.append(rr.TimeColumn(WALL_CLOCK, timestamp=session_s + self.run.epoch_s))
        if self.phase is not None:
            row = np.clip(np.searchsorted(self.run.t_s, t_s + 1e-9, side="right") - 1, 0, None)
            found.append(rr.TimeColumn(PHASE, sequence=self.phase[row]))
        return found
