"""Where on its way to a place the robot waits: at which share of the nominal motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from msgspec.structs import replace

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards.coupling import GateCard

MIN_LOST = 10
"""Number of motions, those with the least safety loss, from which the waiting point short of a place is computed."""


def with_phases(gates: Sequence[GateCard], tasks: pl.DataFrame) -> tuple[GateCard, ...]:
    """Return gates; those of the robot's approaches with the point where it waits.

    Args:
        gates: Gates of both agents.
        tasks: Tasks of the robot, table TASKS.
    """
    phases = _phases(tasks)
    approaches = [gate for gate in gates if _approaches(gate)]
    return tuple(
        replace(gate, phase=_phase(gate, phases, approaches)) if gate in approaches else gate for gate in gates
    )


def _approaches(gate: GateCard) -> bool:
    return gate.agent == "robot" and gate.at == "approach"


def _phase(gate: GateCard, phases: Mapping[str, float], approaches: Sequence[GateCard]) -> float:
    """Return where the robot waits on its way to a place; if it never did, but at places alike, as there."""
    kind = _learned_together(gate)
    if gate.place in phases or not kind:
        return phases.get(gate.place, 0.0)
    alike = [phases[one.place] for one in approaches if one.place in phases and kind & _learned_together(one)]
    return float(np.median(alike)) if alike else 0.0


def _learned_together(gate: GateCard) -> set[tuple[object, ...]]:
    """Return what the conditions of a gate that was learned with others have in common with those of the others."""
    return {(one.agent, one.event, one.back, one.alike, one.lag_s) for one in gate.conditions if one.alike}


def _phases(tasks: pl.DataFrame) -> dict[str, float]:
    """Return per place the share of the nominal motion at which the robot may wait, from motions with least loss."""
    seen = tasks.filter(pl.col("reached_s").is_not_null() & (pl.col("nominal_s") > 0.0)).sort("safety_loss_s")
    part = ((pl.col("reached_s") - pl.col("start_s")) / pl.col("nominal_s")).clip(0.0, 1.0)
    phases = seen.group_by("goal_place").agg(part.head(MIN_LOST).median())
    return {str(place): float(phase) for place, phase in phases.iter_rows()}
