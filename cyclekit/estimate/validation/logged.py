"""Logged executions as sequences that can be rolled out: with their operator tracks and their standstills."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.config.sequences import TaskSequence
from cyclekit.estimate.cycle.transit import transit_table
from cyclekit.estimate.cycle.walk import simulate
from cyclekit.estimate.robot.nominal import NominalTask, turned_otherwise
from cyclekit.estimate.robot.program import draw_standstills, lay_out
from cyclekit.estimate.robot.safety import Dynamics, SafetyModel, at_once

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.schema import Floats, Vector


OTHERS = 40
"""Number of other operator tracks per execution; twenty suffice for a 90 % interval."""


def only_tracks(tracks: OperatorTracks, names: set[str]) -> OperatorTracks:
    """Return the tracks of these executions, in the same order."""
    kept = [k for k, name in enumerate(tracks.executions) if name in names]
    return replace(
        tracks,
        xyz_m=tracks.xyz_m[kept],
        activity=tracks.activity[kept],
        logged=tracks.logged[kept],
        executions=tuple(tracks.executions[k] for k in kept),
        goal_m=None if tracks.goal_m is None else tracks.goal_m[kept],
        state=None if tracks.state is None else tracks.state[kept],
        scaling=None if tracks.scaling is None else tracks.scaling[kept],
        stays=None if tracks.stays is None else tracks.stays[kept],
    )


def logged_sequences(dataset: Dataset, nominal: Mapping[str, NominalTask]) -> list[TaskSequence]:
    """Return complete executions of known tasks at the usual speed slider as sequences, named after them."""
    found = []
    other = turned_otherwise(dataset)
    for one in dataset.card.executions:
        if one.whole and len(one.places) > 1 and one.execution not in other:
            sequence = TaskSequence(one.execution, one.places)
            if all(task in nominal for task in sequence.tasks):
                found.append(sequence)
    return found


def logged_durations(dataset: Dataset, sequences: Sequence[TaskSequence]) -> Vector:
    """Return the logged durations of these executions, shape (E,), s."""
    durations = dict(dataset.executions.select("execution", "duration_s").iter_rows())
    return np.array([durations[sequence.name] for sequence in sequences])


def with_own_tracks(
    model: SafetyModel,
    dataset: Dataset,
    sequences: Sequence[TaskSequence],
    nominal: Mapping[str, NominalTask],
    tracks: OperatorTracks,
) -> Vector:
    """Roll out each execution with its own operator track and its own standstills.

    Returns:
        Durations, shape (E,), s; inf if a cycle does not end within its track.
    """
    programs = [lay_out(sequence, nominal, dataset) for sequence in sequences]
    by_execution = dataset.tasks().sort("execution", "index").group_by(["execution"], maintain_order=True)
    standstills = {str(name): (rows["dwell_s"] + rows["wait_s"]).to_numpy() for (name,), rows in by_execution}
    own = [np.maximum(standstills[sequence.name], 1e-3)[None] for sequence in sequences]
    track, dynamics = np.array(_own_tracks(sequences, tracks)), Dynamics.of(dataset.card.dynamics, model)
    which = np.arange(len(programs))
    return simulate(model, programs, which, track, own, tracks, dynamics=dynamics, fine=True).duration_s


def _own_tracks(sequences: Sequence[TaskSequence], tracks: OperatorTracks) -> list[int]:
    """Return the index of the track of each execution."""
    index = {name: number for number, name in enumerate(tracks.executions)}
    return [index[sequence.name] for sequence in sequences]


def with_other_tracks(
    model: SafetyModel,
    dataset: Dataset,
    sequences: Sequence[TaskSequence],
    nominal: Mapping[str, NominalTask],
    tracks: OperatorTracks,
    *,
    seed: int = 0,
) -> Floats:
    """Roll out each execution with the operator tracks of the others, shape (E, K), s.

    If s follows the safety function with a delay, the table of arrivals does not apply; each execution is then
    simulated with OTHERS of the tracks.

    Returns:
        Durations; NaN for the own operator track and if not simulated; inf if the cycle does not end within the track.
    """
    own = np.array(_own_tracks(sequences, tracks))
    dynamics = Dynamics.of(dataset.card.dynamics, model)
    if at_once(model, dynamics):
        legs = [lay_out(sequence, nominal, dataset).tasks for sequence in sequences]
        asked = {leg.key: leg for mine in legs for leg in mine}
        others = transit_table(model, asked, tracks).durations([[leg.key for leg in mine] for mine in legs], seed=seed)
        others[np.arange(len(sequences)), own] = np.nan
        return others
    count = len(tracks.executions)
    apart = np.unique(np.linspace(1, count - 1, min(OTHERS, count - 1)).astype(np.int64))
    programs = [lay_out(sequence, nominal, dataset) for sequence in sequences]
    track = (own[:, None] + apart) % count
    drawn: dict[tuple[str, int], Floats] = {}
    standstills = [
        draw_standstills(program, count, seed, drawn)[mine] for program, mine in zip(programs, track, strict=True)
    ]
    which = np.repeat(np.arange(len(programs)), len(apart))
    simulated = simulate(model, programs, which, track.ravel(), standstills, tracks, dynamics=dynamics)
    others = np.full((len(programs), count), np.nan)
    np.put_along_axis(others, track, simulated.duration_s.reshape(track.shape), axis=1)
    return others
