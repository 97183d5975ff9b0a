"""Writes the replay file: completely under a temporary name, then renamed.

The file is built by column from the arrays of `execution`; `scene` and `curves` write the contents.
"""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from typing import TYPE_CHECKING

import rerun as rr

from cyclekit.dataset.cards import TrainingCard
from cyclekit.errors import CyclekitError
from cyclekit.learning.networks.cell import refuse_other_cell
from cyclekit.parallel.one_thread import one_thread
from cyclekit.replay.compare import comparison
from cyclekit.replay.curves import HUES, log_curves
from cyclekit.replay.execution import load_execution
from cyclekit.replay.layout import blueprint, opening
from cyclekit.replay.phase import common_order, path_phase
from cyclekit.replay.prediction_errors import Miss, prediction_errors
from cyclekit.replay.scene import log_scene
from cyclekit.replay.sink import Sink
from cyclekit.storage.atomic import replaced
from cyclekit.text.numbers import fixed
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.replay.execution import ReplayedExecution
    from cyclekit.replay.floor import PredictsNow
    from cyclekit.replay.layout import Focus, Opening
    from cyclekit.replay.phase import Order

MAX_EXECUTIONS = len(HUES)
"""Maximum number of executions side by side."""


@dataclass(frozen=True, repr=False)
class ReplayFacts(Result):
    """Result of `write_replay`; its frame has one row per stretch in which prediction and log differ most.

    Attributes:
        path: Path of the file.
        execution: Full name of the (first) execution.
        executions: Names of all executions.
        duration_s: Duration of the longest, s.
        rows: Number of rows written, over all entities.
        bytes: Size of the file, bytes.
        gaps: Number of gaps without samples.
        notes: Missing or doubtful data, one sentence each.
        misses: Stretches of the first execution in which prediction and log differ most.
        first: Interval to play first.
    """

    path: Path
    execution: str
    executions: tuple[str, ...]
    duration_s: float
    rows: int
    bytes: int
    gaps: int
    notes: tuple[str, ...]
    misses: tuple[Miss, ...]
    first: Opening | None

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        every = {"replay": str(self.path), **super().to_dict()}
        return {name: value for name, value in every.items() if name not in ("path", "rows", "gaps", "first")}

    def _frame_rows(self) -> list[dict[str, object]]:
        return [dict(vars(miss)) for miss in self.misses]

    def _lines(self) -> list[str]:
        return [f"{self.path}: execution {', '.join(self.executions)}, {fixed(self.duration_s, 1)} s", *self.notes]


@one_thread()
def write_replay(
    dataset: Dataset,
    execution: str | Sequence[str],
    out: Path,
    *,
    model: PredictsNow | None = None,
    at: Focus = "slowdown",
    other_cell: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> ReplayFacts:
    """Write the replay of one execution, or of several side by side; arguments as of `cyclekit.write_replay`.

    A model of another problem than `now` is not used, with a note.

    Raises:
        UnknownName: The dataset has no such execution.
        ModelError: The model is of another cell.
        CyclekitError: Too many executions, `at` is after the end, or the file cannot be written.
    """
    say = progress or (lambda _part, _text: None)
    dataset.require_positions()
    if model is not None:
        refuse_other_cell(getattr(model, "card", TrainingCard()), dataset, other_cell=other_cell)
    wanted = [execution] if isinstance(execution, str) else list(execution)
    names = [dataset.find_execution(name) for name in wanted]
    if not 1 <= len(set(names)) <= MAX_EXECUTIONS:
        msg = f"{len(names)} executions side by side"
        raise CyclekitError(msg, cure=f"Name 1 to {MAX_EXECUTIONS} of them: more are not readable on one screen.")
    runs: list[ReplayedExecution] = []
    for number, name in enumerate(dict.fromkeys(names)):
        say(0.7 * number / len(names), f"reading {name}")
        runs.append(load_execution(dataset, name, model))
    order = common_order(runs)
    first = opening(runs, order, at)
    with replaced(out) as temporary:
        rows = _fill(runs, order, first, temporary, lambda part, text: say(0.7 + 0.3 * part, text))
    notes = dict.fromkeys(note for run in runs for note in run.notes)
    return ReplayFacts(
        path=out,
        execution=runs[0].name,
        executions=tuple(run.name for run in runs),
        duration_s=max(run.duration_s for run in runs),
        rows=rows,
        bytes=out.stat().st_size,
        gaps=sum(len(run.gaps) for run in runs),
        notes=tuple(notes),
        misses=tuple(prediction_errors(runs[0])),
        first=first,
    )


def _fill(
    runs: Sequence[ReplayedExecution],
    order: Order,
    first: Opening | None,
    file: Path,
    say: Callable[[float, str], None],
) -> int:
    """Write the executions into `file` and close it; the same executions have the same recording id."""
    names = " and ".join(run.name for run in runs)
    identity = uuid.uuid5(uuid.NAMESPACE_URL, f"cyclekit:{runs[0].cell}:{names}")
    stream = rr.RecordingStream("cyclekit", recording_id=identity, send_properties=False)
    memory = stream.memory_recording()  # rerun's file sink hangs when the disk is full
    stream.send_blueprint(blueprint(runs, order, first))
    stream.send_recording_name(f"{runs[0].cell}, {names}")
    rows = 0
    for number, run in enumerate(runs):
        say(number / len(runs), f"drawing {run.name}")
        alone = len(runs) == 1
        sink = Sink(stream, run, path_phase(run, order), "" if alone else f"{number + 1}/")
        log_scene(sink)
        log_curves(sink, None if alone else number)
        rows += sink.rows
    if len(runs) > 1:
        text = rr.TextDocument(comparison(runs), media_type=rr.MediaType.MARKDOWN)
        stream.log("comparison", text, static=True)
    stream.flush()
    file.write_bytes(memory.drain_as_bytes())
    stream.disconnect()
    return rows
