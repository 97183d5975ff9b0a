"""The operator's segments of executions in which he stays at known places, one after the other."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import polars as pl

from cyclekit.estimate.joint.visits import Segments

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    import pytest

    from cyclekit.dataset.cards import CouplingCard
    from cyclekit.dataset.dataset import Dataset

COLUMNS = ("agent", "agent_name", "execution", "index", "goal_place", "arrival_s", "end_s")


def one_track(
    logged: Dataset,
    patch: pytest.MonkeyPatch,
    stays: Sequence[tuple[str, float]],
    coupling: CouplingCard | None,
    *,
    walks_s: float = 1.0,
    until_s: float = np.inf,
    missed: Collection[int] = (),
    lost: bool = False,
) -> Segments:
    """Return the segments of execution "1": stays at places of a dataset for some seconds each, walks between.

    Args:
        logged: The dataset with these places.
        patch: Replaces the logged tracks.
        stays: Place and seconds of each stay.
        coupling: Who waits for whom.
        walks_s: Duration of each walk, s.
        until_s: When the execution ends, s; its tasks go on.
        missed: Numbers of the stays that are not known as such.
        lost: Whether the tracker loses him at each arrival.
    """
    visits, where = _visits(logged, "1", stays, walks_s, missed, lost=lost)
    rows = round(min(until_s, _length_s(stays, walks_s)) * logged.rate_hz) + 1
    return _segments(logged, patch, visits, {"1": where[:rows]}, coupling)


def many_tracks(
    logged: Dataset, patch: pytest.MonkeyPatch, executions: Sequence[Sequence[tuple[str, float]]]
) -> Segments:
    """Return the segments of several executions, named by their numbers; walks take 1 s. See `one_track`."""
    visits, tracks = [], {}
    for number, stays in enumerate(executions):
        rows, tracks[str(number)] = _visits(logged, str(number), stays, 1.0)
        visits += rows
    return _segments(logged, patch, visits, tracks, None)


def _length_s(stays: Sequence[tuple[str, float]], walks_s: float) -> float:
    return sum(stays_s + walks_s for _, stays_s in stays)


def _visits(
    logged: Dataset,
    execution: str,
    stays: Sequence[tuple[str, float]],
    walks_s: float,
    missed: Collection[int] = (),
    *,
    lost: bool = False,
) -> tuple[list[tuple[object, ...]], np.ndarray]:
    """Return the rows of his tasks in one execution, and his positions (N, 3), m."""
    at_s, rows, where = 0.0, list[tuple[object, ...]](), list[np.ndarray]()
    for number, (name, stays_s) in enumerate(stays):
        if number not in missed:
            rows.append(("operator", None, execution, len(rows), name, at_s, at_s + stays_s))
        there = [np.array(logged.human_places[name].xyz_m)] * round((stays_s + walks_s) * logged.rate_hz)
        where += [np.full(3, np.nan), *there[1:]] if lost else there
        at_s += stays_s + walks_s
    return rows, np.array(where)


def _segments(
    logged: Dataset,
    patch: pytest.MonkeyPatch,
    rows: Sequence[tuple[object, ...]],
    where: Mapping[str, np.ndarray],
    coupling: CouplingCard | None,
) -> Segments:
    visits = pl.DataFrame(rows, COLUMNS, orient="row")
    executions = tuple(
        msgspec.structs.replace(logged.card.executions[0], execution=name, complete=True, reference=False)
        for name in where
    )
    card = msgspec.structs.replace(logged.card, executions=executions)
    stub = SimpleNamespace(
        rate_hz=logged.rate_hz, human_places=logged.human_places, card=card, every_task=lambda: visits
    )
    tracks = {name: SimpleNamespace(where=one, begin_s=0.0, seen=True) for name, one in where.items()}
    patch.setattr("cyclekit.estimate.joint.visits.logged_tracks", lambda _: tracks)
    return Segments(stub, coupling)  # type: ignore[arg-type]  # a stub
