"""What a session shows by itself: the clocks of its recordings, the runs of its robot, and where it stands.

The first of the passes of `derive` over the sessions; each is looked at alone, so that they can be shared out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit.alignment.recording_clocks import place_in_time
from cyclekit.dataset.sessions import LogGroup, Session
from cyclekit.scaling.safety_override import override_of
from cyclekit.segmentation.load_runs import load_runs
from cyclekit.segmentation.standstills import Stop, find_stops

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.config import Cell, Source
    from cyclekit.dataset.signals import Read, Stored
    from cyclekit.scaling.safety_override import SafetyOverride
    from cyclekit.schema import Ints
    from cyclekit.segmentation.stored_run import StoredRun


@dataclass(frozen=True)
class Look:
    """What one session shows by itself.

    Attributes:
        session: Its recordings, in one clock; the numbers of its runs are still to come.
        runs: Runs of its robot.
        marks: Of each run the rows at which something logged says that a cycle begins.
        stops: Its standstills; their runs are counted from 0 here.
        override: What its safety system logged; None = nothing, or its robot's log holds the scaling itself.
    """

    session: Session
    runs: list[StoredRun]
    marks: list[Ints]
    stops: list[Stop]
    override: SafetyOverride | None


def look_at(
    group: LogGroup, *, sources: Mapping[str, Source | None], read: Read, stored: Stored, cell: Cell, coarse: bool
) -> Look:
    """Look at one session.

    Args:
        group: The logs of the session.
        sources: What the cell file says about each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns), to be read by ranges of rows.
        cell: Execution rule, rates.
        coarse: Align clocks on the operator being near while the robot slows, where nothing else tells.

    Raises:
        ConfigError: Executions are to begin by a register or output that was not logged, or a clock or frame is to be
            found in a way that these logs do not allow.
    """
    step_s = 1.0 / cell.rate_hz if coarse else None
    recordings = place_in_time(group, sources, read, stored, coarse_step_s=step_s)
    starts, ends = zip(*(recording.span_s for recording in recordings), strict=True)
    span_s = (min(starts), max(ends))
    session = Session(group.name, recordings, group.reference, span_s=span_s, nobody_logged=group.nobody_logged)
    runs, marks = load_runs(session, read, stored, cell)
    stops = [stop for number, run in enumerate(runs) for stop in find_stops(run, number)]
    override = None if all(run.knows_scaling for run in runs) else override_of(session, read)
    return Look(session, runs, marks, stops, override)
