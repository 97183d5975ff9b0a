"""First pass over a session: clocks of its recordings, runs of its robot, standstills.

It needs no other session, so sessions can be distributed to workers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit.alignment.recording_clocks import place_in_time
from cyclekit.dataset.sessions import LogGroup, Session
from cyclekit.scaling.safety_override import override_of
from cyclekit.segmentation.load_runs import load_runs
from cyclekit.segmentation.standstills import Standstill, find_standstills

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.config import Cell, Source
    from cyclekit.dataset.signals import Read, Stored
    from cyclekit.scaling.safety_override import SafetyOverride
    from cyclekit.schema import Ints
    from cyclekit.segmentation.stored_run import StoredRun


@dataclass(frozen=True)
class FirstPassResult:
    """Result of the first pass over one session.

    Attributes:
        session: Its recordings, in one clock; the indices of its runs are set later.
        runs: Runs of its robot.
        marks: Rows of each run at which a logged signal marks the start of a cycle.
        standstills: Its standstills; their runs are numbered from 0.
        slider: Least and largest value of the logged slider; None if it was not logged.
        override: Override logged by its safety system; None if not logged, or if the robot's log has the scaling.
    """

    session: Session
    runs: list[StoredRun]
    marks: list[Ints]
    standstills: list[Standstill]
    slider: tuple[float, float] | None
    override: SafetyOverride | None


def first_pass(
    group: LogGroup, *, sources: Mapping[str, Source | None], read: Read, stored: Stored, cell: Cell
) -> FirstPassResult:
    """Run the first pass over one session.

    Args:
        group: The logs of the session.
        sources: Section of the cell file for each recording, by id.
        read: Returns a native table of a recording (id, table), None if it has none.
        stored: Opens the robot table of a recording (id, columns) for reading by row ranges.
        cell: Execution rule, rates.

    Raises:
        ConfigError: Executions begin by a register or output that was not logged, or the logs do not allow the given
            way to find a clock or frame.
    """
    recordings = place_in_time(group, sources, read, stored)
    starts, ends = zip(*(recording.span_s for recording in recordings), strict=True)
    span_s = (min(starts), max(ends))
    session = Session(group.name, recordings, group.reference, span_s=span_s, nobody_logged=group.nobody_logged)
    runs, marks = load_runs(session, read, stored, cell)
    standstills = [standstill for number, run in enumerate(runs) for standstill in find_standstills(run, number)]
    override = None if all(run.knows_scaling for run in runs) else override_of(session, read)
    known = [found for run in runs if (found := run.slider_range) is not None]
    slider = (min(low for low, _ in known), max(high for _, high in known)) if known else None
    return FirstPassResult(session, runs, marks, standstills, slider, override)
