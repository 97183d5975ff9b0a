"""The operator's segments of one execution in which he stays at known places, one after the other."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import polars as pl

from cyclekit.estimate.joint.visits import Segments

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

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
    at_s, rows, where = 0.0, list[tuple[object, ...]](), list[np.ndarray]()
    for number, (name, stays_s) in enumerate(stays):
        if number not in missed:
            rows.append(("operator", None, "1", len(rows), name, at_s, at_s + stays_s))
        there = [np.array(logged.human_places[name].xyz_m)] * round((stays_s + walks_s) * logged.rate_hz)
        where += [np.full(3, np.nan), *there[1:]] if lost else there
        at_s += stays_s + walks_s
    visits = pl.DataFrame(rows, COLUMNS, orient="row")
    execution = msgspec.structs.replace(logged.card.executions[0], execution="1", complete=True, reference=False)
    card = msgspec.structs.replace(logged.card, executions=(execution,))
    stub = SimpleNamespace(
        rate_hz=logged.rate_hz, human_places=logged.human_places, card=card, every_task=lambda: visits
    )
    rows_m = np.array(where)[: round(min(until_s, at_s) * logged.rate_hz) + 1]
    track = SimpleNamespace(where=rows_m, begin_s=0.0, seen=True)
    patch.setattr("cyclekit.estimate.joint.visits.logged_tracks", lambda _: {"1": track})
    return Segments(stub, coupling)  # type: ignore[arg-type]  # a stub
