"""What a session shows by itself: the clocks of its recordings, the runs of its robot, and where it stands.

The first of the passes of `derive` over the sessions; each is looked at alone, so that they can be shared out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cyclekit.alignment.recording_clocks import place_in_time
from cyclekit.segmentation.load_runs import load_runs
from cyclekit.segmentation.standstills import find_stops

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from cyclekit.config import Cell, Source
    from cyclekit.dataset.sessions import Session
    from cyclekit.dataset.signals import Read, Stored
    from cyclekit.segmentation.standstills import Stop
    from cyclekit.segmentation.stored_run import StoredRun


@dataclass(frozen=True)
class Look:
    """What one session shows by itself.

    Attributes:
        entries: Entries of its recordings, with `clock` filled in.
        span_s: First and last time of all of them, session seconds.
        runs: Runs of its robot.
        marks: Of each run the rows at which something logged says that a cycle begins.
        stops: Its standstills; their runs are counted from 0 here.
    """

    entries: list[dict[str, Any]]
    span_s: tuple[float, float]
    runs: list[StoredRun]
    marks: list[NDArray[np.int64]]
    stops: list[Stop]


def look_at(
    session: Session, *, sources: Mapping[str, Source | None], read: Read, stored: Stored, cell: Cell, coarse: bool
) -> Look:
    """Look at one session.

    Args:
        session: From `ingest`; its entries get `clock` filled in.
        sources: What the cell file says about each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns), to be read by ranges of rows.
        cell: Execution rule, rates.
        coarse: Align clocks on the operator being near while the robot slows, where nothing else tells.

    Raises:
        ConfigError: Executions are to begin by a register or output that was not logged, or a clock or frame is to be
            found in a way that these logs do not allow.
    """
    place_in_time(session, sources, read, stored, coarse_step_s=1.0 / cell.rate_hz if coarse else None)
    spans = [_span(entry) for entry in session.entries]
    runs, marks = load_runs(session, read, stored, cell)
    stops = [stop for number, run in enumerate(runs) for stop in find_stops(run, number)]
    return Look(session.entries, (min(a for a, _ in spans), max(b for _, b in spans)), runs, marks, stops)


def _span(entry: Mapping[str, Any]) -> tuple[float, float]:
    clock = entry["clock"]
    return (
        entry["first_s"] * clock["rate"] + clock["offset_s"],
        entry["last_s"] * clock["rate"] + clock["offset_s"],
    )
