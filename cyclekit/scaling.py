"""Which scaling each run has: the one that was logged, else the one that its motion tells."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.account import halts_at_places, slowest_speed
from cyclekit.override import infer_overrides
from cyclekit.stand import stands_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cyclekit.dataset import Place
    from cyclekit.engine import Engine
    from cyclekit.motion import Run
    from cyclekit.override import Reference
    from cyclekit.segment import Execution
    from cyclekit.session import Session


def with_scaling(
    runs: Sequence[Run],
    executions: Sequence[Execution],
    places: Mapping[str, Place],
    sessions: Sequence[Session],
    progress: Callable[[float, str], None],
    engine: Engine,
) -> tuple[list[Run], list[str]]:
    """Return the runs, with the scaling inferred where none was logged, and what is to be said about that.

    Args:
        runs: All runs.
        executions: Their executions, from `segment`.
        places: All places.
        sessions: Which runs were recorded with nobody in the cell.
        progress: Told fraction and text.
        engine: Who infers.
    """
    silent = [number for number, run in enumerate(runs) if not run.knows_scaling]
    if not silent:
        return list(runs), []
    alone = [number for session in sessions if session.reference for number in session.runs]
    parts, references = infer_overrides(runs, executions, alone, lambda done: progress(done, "speed override"), engine)
    said = "no log holds a" if len(silent) == len(runs) else f"{len(silent)} of {len(runs)} runs hold no"
    said += " valid speed scaling"
    if not references:
        return list(runs), [f"{said}, and no motion repeats, so it could not be inferred either"]
    done = [run if run.knows_scaling else run.with_scaling(found) for run, found in zip(runs, parts, strict=True)]
    slowest = slowest_speed([part.scaling for n in silent for part in sorted(parts[n], key=lambda part: part.first)])
    mine = [execution for execution in executions if execution.run in set(silent)]
    halts = halts_at_places(done, mine, stands_of(done, mine, places), slowest)
    for number in silent:
        done[number] = runs[number].with_scaling([*parts[number], *halts[number]])
    return done, [f"{said}: inferred from velocity ratios against {_how(references)}"]


def _how(references: Mapping[str, Sequence[Reference]]) -> str:
    """Say what the references are."""
    flat = [reference for found in references.values() for reference in found]
    alone = sum(reference.alone for reference in flat)
    slowed = sorted(task for task, found in references.items() if any(reference.slowed < 1.0 for reference in found))
    many = f"{len(flat)} motions"
    how = f"runs without the operator ({many})" if alone == len(flat) else f"the fastest repetitions ({many})"
    if 0 < alone < len(flat):
        how = f"runs without the operator ({alone} motions) and the fastest repetitions ({len(flat) - alone} motions)"
    seen = f"; never seen at full speed, so unknown: {', '.join(slowed)}" if slowed else ""
    return how + seen
