"""Whether the tracker's frame fits the slow-downs: a wrong or forgotten `frame` makes every distance wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.alignment.calibrate import frame_line
from cyclekit.alignment.frame_check import ChangeRows, LevelRows, propose_frame
from cyclekit.config import Frame
from cyclekit.dataset.cards import note
from cyclekit.people.activity import person_tracks
from cyclekit.people.tracks import at_times

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cyclekit.alignment.frame_check import FrameProposal
    from cyclekit.config import Cell, Source
    from cyclekit.dataset.cards import Note
    from cyclekit.dataset.cards.recording import FrameCard
    from cyclekit.dataset.signals import Read
    from cyclekit.derive.second_pass import SecondPassResult
    from cyclekit.people.tracks import PersonTrack
    from cyclekit.scaling.agreement import PositionsBeforeChanges
    from cyclekit.scaling.response import Changes, LevelChange
    from cyclekit.schema import Floats, Ints, Vector

MAX_EXECUTIONS, MAX_SAMPLES = 60, 3000
"""Maximum numbers for the check, evenly spread."""
ON_LEVEL = 0.01
"""Tolerance of a scaling that is on a level."""
MAX_PEOPLE = 6
LATENCIES_S = np.arange(0.0, 0.65, 0.05)
"""Reaction times that are tried, s."""
MAX_CHANGES = 400
"""Maximum number of changes of level per session."""
MAX_SPREAD_M = 0.03
"""Spread of the distances at changes of level, m, at which a frame is right without further search."""
_ROBOT = ["robot_x_m", "robot_y_m", "robot_z_m"]
_COLUMNS = ["execution", "t_s", "scaling", *_ROBOT, "human_x_m", "human_y_m"]


def frame_notes(
    sessions: Sequence[SecondPassResult],
    changes: Sequence[Changes],
    levels: Sequence[float],
    folder: Path,
    sources: Mapping[str, Source | None],
    read: Read,
    cell: Cell,
) -> list[Note]:
    """Return a note if the tracker's frame does not fit the slow-downs, with the frame that does, where one is certain.

    Args:
        sessions: The sessions, with their samples in files.
        changes: Changes of level of each session, and where operator and TCP were.
        levels: Levels of the scaling, ascending.
        folder: Folder of the files.
        sources: Entry of each recording in the cell file, by id.
        read: Returns a native table of a recording (id, table).
        cell: Cell with the bridged gap length.
    """
    logs = [one for each in sessions for one in each.recordings if "people" in one.tables]
    frames = {(one.frame.method, one.frame.xyz_m, one.frame.rotation) for one in logs}
    samples = _samples(sessions, levels, folder) if len(frames) == 1 and len(levels) > 1 else None
    if samples is None or not samples.height or _agrees([one.positions for one in changes]):
        return []
    tcp_m, level = samples.select(_ROBOT).to_numpy(), samples["level"].to_numpy()
    people_m = np.full((len(level), MAX_PEOPLE, 3), np.nan)
    before: list[tuple[Floats, Floats, Ints]] = []
    for one, mine in zip(sessions, changes, strict=True):
        rows = np.flatnonzero(samples["execution"].is_in([card.execution for card in one.cards]).to_numpy())
        if len(rows):
            tracks = person_tracks(one.recordings, sources, read)
            people_m[rows] = _people(tracks, samples["t_s"].to_numpy()[rows], cell.bridge_s)
            before.append(_before(one, mine.changes, tracks, folder, cell.bridge_s))
    seen = np.isfinite(people_m[..., 0]).any(axis=1)
    changed = ChangeRows.of(*(np.concatenate([part[k] for part in before], axis=1 if k < 2 else 0) for k in range(3)))
    measured = logs[0].frame.method == "cell-file"
    found = propose_frame(LevelRows(tcp_m[seen], people_m[seen], level[seen]), changed, near=measured)
    if found is not None:
        line = frame_line(_corrected(logs[0].frame, found))
        return [
            note("frame-doubtful", spread_m=found.present_m, then_m=found.spread_m, moved_m=found.moved_m, line=line)
        ]
    if not measured and "base_frame" not in logs[0].facts:
        return [note("frame-assumed")]
    return []


def _agrees(positions: Sequence[PositionsBeforeChanges]) -> bool:
    """Return whether changes of level come at equal distances in the present frame."""
    kind = np.concatenate([one.change_kind for one in positions])
    for name in ("apart_m", "floor_apart_m"):
        apart = np.concatenate([getattr(one, name) for one in positions])
        off = [np.abs(mine - np.median(mine, axis=0)) for mine in (apart[kind == one] for one in np.unique(kind))]
        if off and np.nanmedian(np.concatenate(off), axis=0).min() <= MAX_SPREAD_M:
            return True
    return False


def _before(
    session: SecondPassResult,
    changes: Sequence[LevelChange],
    tracks: Sequence[PersonTrack],
    folder: Path,
    bridge_s: float,
) -> tuple[Floats, Floats, Ints]:
    """Return TCP (L, C, 3) and people (L, C, K, 3) before the changes of a session, m, and the kinds of these, (C,)."""
    with_level = [change for change in changes if change.step >= 0]
    with_level = with_level[:: max(1, -(-len(with_level) // MAX_CHANGES))]
    rows = (
        pl.scan_parquet(folder / f"{session.part}.parquet", glob=False)
        .select("execution", "t_s", *_ROBOT)
        .filter(pl.col("execution").is_in([card.execution for card in session.cards]))
        .drop_nulls()
        .sort("t_s")
        .collect(engine="streaming")
    )
    at_s = np.array([change.t_s for change in with_level])[None] - LATENCIES_S[:, None]
    sampled_s = rows["t_s"].to_numpy()
    tcp_m = [np.interp(at_s, sampled_s, rows[name].to_numpy()) for name in _ROBOT]
    order = np.argsort(at_s, axis=None)
    people_m = np.empty((at_s.size, MAX_PEOPLE, 3))
    people_m[order] = _people(tracks, at_s.ravel()[order], bridge_s)
    people_m = people_m.reshape(*at_s.shape, MAX_PEOPLE, 3)
    kind = np.array([2 * change.step + change.rises for change in with_level], np.int64)
    known_people = np.isfinite(people_m[..., 0]).any(axis=2).all(axis=0)
    return np.stack(tcp_m, axis=2)[:, known_people], people_m[:, known_people], kind[known_people]


def _samples(sessions: Sequence[SecondPassResult], levels: Sequence[float], folder: Path) -> pl.DataFrame | None:
    """Return some samples on a level with known positions; None without any."""
    chosen = [card.execution for one in sessions for card in one.cards]
    chosen = chosen[:: max(1, -(-len(chosen) // MAX_EXECUTIONS))]
    parts = dict.fromkeys(one.part for one in sessions if one.samples)
    if not parts:
        return None
    rows = [
        pl.scan_parquet(folder / f"{part}.parquet", glob=False)
        .select(_COLUMNS)
        .filter(pl.col("execution").is_in(chosen))
        .drop_nulls()
        .collect(engine="streaming")
        for part in parts
    ]
    found = pl.concat(rows)
    steps, scaling = np.array(levels), found["scaling"].to_numpy()
    level = np.abs(scaling[:, None] - steps).argmin(axis=1)
    found = found.with_columns(level=level)
    found = found.filter(np.abs(scaling - steps[level]) <= ON_LEVEL)
    return found.gather_every(max(1, -(-found.height // MAX_SAMPLES)))


def _people(tracks: Sequence[PersonTrack], t_s: Vector, bridge_s: float) -> Floats:
    """Return where people are at each time, shape (T, MAX_PEOPLE, 3), m; NaN = nobody."""
    here = np.full((max(len(tracks), MAX_PEOPLE), len(t_s), 3), np.nan)
    for number, track in enumerate(tracks):
        here[number] = at_times(track, t_s, bridge_s=bridge_s)
    order = np.argsort(np.isnan(here[..., 0]), axis=0, kind="stable")[:MAX_PEOPLE]
    return np.asarray(np.take_along_axis(here, order[..., None], axis=0).transpose(1, 0, 2))


def _corrected(card: FrameCard, by: FrameProposal) -> Frame:
    """Return a log's frame after a correction."""
    cos, sin = np.cos(np.radians(by.yaw_deg)), np.sin(np.radians(by.yaw_deg))
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    origin = np.array(card.xyz_m or Frame().xyz_m)
    x, y, z = (turn @ origin + np.array(by.xyz_m)).tolist()
    first, second, third = (tuple(row) for row in (turn @ np.array(card.rotation or Frame().rotation)).tolist())
    return Frame((x, y, z), (first, second, third))
