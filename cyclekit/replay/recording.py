"""The replay file: written whole under another name, then put in its place.

Rerun's file is built by column from the arrays of `execution`; what is drawn is the business of `scene` and `curves`.
"""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from typing import TYPE_CHECKING

import rerun as rr

from cyclekit.atomic import replaced
from cyclekit.replay.curves import log_curves
from cyclekit.replay.execution import load_execution
from cyclekit.replay.layout import EXECUTION, SESSION, blueprint
from cyclekit.replay.scene import log_scene

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from cyclekit.dataset import Dataset
    from cyclekit.replay.execution import Execution, PredictsNow


@dataclass(frozen=True)
class ReplayFacts:
    """What was written.

    Attributes:
        path: The file.
        execution: Full name of the execution.
        duration_s: Its length.
        rows: Instants written, over all entities.
        bytes: Size of the file.
        gaps: Stretches of it without any sample.
        notes: What is missing or doubtful, one sentence each.
    """

    path: Path
    execution: str
    duration_s: float
    rows: int
    bytes: int
    gaps: int
    notes: tuple[str, ...]


def write_replay(
    dataset: Dataset,
    execution: str,
    out: Path,
    *,
    model: PredictsNow | None = None,
    progress: Callable[[str], None] | None = None,
) -> ReplayFacts:
    """Write the replay of one execution.

    Args:
        dataset: Where the execution is.
        execution: Its name, or its number counted from 1.
        out: The .rrd file; an existing one is replaced when the new one is complete.
        model: Model of problem `now` whose prediction is plotted beside the log; another problem is noted, not used.
        progress: Called with a short text at each stage.

    Raises:
        UnknownName: The dataset has no such execution.
        CyclekitError: The file cannot be written.
    """
    say = progress or (lambda _text: None)
    say("reading the execution")
    run = load_execution(dataset, execution, model)
    with replaced(out) as temporary:
        say("drawing scene and plots")
        rows = _fill(run, temporary)
    return ReplayFacts(out, run.name, run.duration_s, rows, out.stat().st_size, len(run.gaps), run.notes)


def _fill(run: Execution, file: Path) -> int:
    """Write one execution into `file` and close it; same execution, same recording id."""
    identity = uuid.uuid5(uuid.NAMESPACE_URL, f"cyclekit:{run.cell}:{run.name}")
    stream = rr.RecordingStream("cyclekit", recording_id=identity, send_properties=False)
    memory = stream.memory_recording()  # rerun's own file sink waits for ever when the disk is full
    stream.send_blueprint(blueprint(run))
    stream.send_recording_name(f"{run.cell}, {run.name}")

    def times(t_s: NDArray[np.float64]) -> list[rr.TimeColumn]:
        return [rr.TimeColumn(EXECUTION, duration=t_s), rr.TimeColumn(SESSION, duration=t_s + run.start_s)]

    rows = log_scene(stream, run, times) + log_curves(stream, run, times)
    stream.flush()
    file.write_bytes(memory.drain_as_bytes())
    stream.disconnect()
    return rows
