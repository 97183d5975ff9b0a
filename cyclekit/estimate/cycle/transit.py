"""Table of arrivals: when a task arrives, by start time and track. With it, any order is a few look-ups.

If s depends on the present positions only, a motion that starts later never arrives earlier, and the order before a
task affects it only through its start time. So each task is simulated once from every start on every track, and ten
thousand orders cost no more network time than one. `walk` simulates what the table leaves out (latency, ramps,
hysteresis, safety loss per activity).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.time_grid import samples_in
from cyclekit.estimate.cycle.walk import Rolled
from cyclekit.estimate.robot.program import standstills_of
from cyclekit.estimate.robot.safety import SafetyModel, scaling_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.estimate.operator.tracks import OperatorTracks
    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.schema import Floats, Ints, Progress, Singles

PATH_S = 0.1
"""Nominal time between the points of a motion at which s is evaluated, s."""
HUMAN_M = 0.06
"""Edge of the cells of operator positions, m; enlarged until there are at most MAX_CELLS."""
MAX_CELLS = 8_000
NO_HEIGHT_M = 1000.0
"""Value in place of an unknown height in the computation of cells, m."""
START_S = 0.2
"""Time between starts, s, at samples of the track; arrivals are interpolated between them."""
SEQUENCES_AT_ONCE = 256


@dataclass(frozen=True)
class TransitTable:
    """Arrivals of every task from every start on K tracks.

    Attributes:
        names: Names of the tasks.
        arrival_s: Shape (tasks, K, starts), s since the start of the track; inf: not within the track.
        start_s: Time between starts.
        tasks: The nominal tasks.
    """

    names: tuple[str, ...]
    arrival_s: Singles
    start_s: float
    tasks: tuple[NominalTask, ...]
    _drawn: dict[tuple[int, int, int], Floats] = field(default_factory=dict, repr=False)

    def durations(self, sequences: Sequence[Sequence[str]], *, seed: int = 0) -> Floats:
        """Return the duration of each sequence of tasks on each track, shape (sequences, K), s.

        A cycle that does not end within its track has duration inf.
        """
        parts = [
            self._some(sequences[first : first + SEQUENCES_AT_ONCE], seed)
            for first in range(0, len(sequences), SEQUENCES_AT_ONCE)
        ]
        return np.concatenate(parts)

    def rolled(self, tasks: Sequence[str], *, seed: int = 0) -> Rolled:
        """Return the cycles of one sequence of tasks, split by task; activities, support and splices are unknown."""
        code = {name: index for index, name in enumerate(self.names)}
        count = self.arrival_s.shape[1]
        time, seen = np.zeros(count), Counter[str]()
        standstills, safety = np.empty((1, len(tasks))), np.empty((1, len(tasks)))
        for leg, name in enumerate(tasks):
            task = code[name]
            arrival = self.arrive(np.array([task]), time[None])[0]
            stand = self._stands(task, seen[name], seed)
            seen[name] += 1
            safety[0, leg] = float(np.mean(arrival - time)) - self.tasks[task].nominal_s
            standstills[0, leg] = stand.mean()
            time = arrival + stand
        unknown = float("nan")
        return Rolled(time, standstills, safety, np.zeros(0), unknown, unknown, simulated=False)

    def _some(self, sequences: Sequence[Sequence[str]], seed: int) -> Floats:
        code = {name: index for index, name in enumerate(self.names)}
        count = self.arrival_s.shape[1]
        time = np.zeros((len(sequences), count))
        longest = max(len(sequence) for sequence in sequences)
        occurrence = [dict.fromkeys(sequence, 0) for sequence in sequences]
        for place in range(longest):
            rows = np.array([i for i, sequence in enumerate(sequences) if len(sequence) > place])
            tasks = [sequences[i][place] for i in rows.tolist()]
            standstills = np.empty((len(rows), count))
            for row, (i, name) in enumerate(zip(rows.tolist(), tasks, strict=True)):
                standstills[row] = self._stands(code[name], occurrence[i][name], seed)
                occurrence[i][name] += 1
            time[rows] = self.arrive(np.array([code[name] for name in tasks]), time[rows]) + standstills
        return time

    def _stands(self, task: int, occurrence: int, seed: int) -> Floats:
        key = task, occurrence, seed
        if key not in self._drawn:
            self._drawn[key] = standstills_of(self.tasks[task], self.arrival_s.shape[1], seed, occurrence)
        return self._drawn[key]

    def arrive(self, task: Ints, start_s: Floats) -> Floats:
        """Return arrival times of tasks (N,) with start times `start_s` (N, K), s; shape (N, K)."""
        starts = self.arrival_s.shape[2]
        place = np.minimum(start_s / self.start_s, starts - 1.001)
        below = place.astype(np.int64)
        flat = (task[:, None] * self.arrival_s.shape[1] + np.arange(self.arrival_s.shape[1])) * starts + below
        table = self.arrival_s.reshape(-1)
        early, late = table[flat], table[flat + 1]
        way = place - below
        with np.errstate(invalid="ignore"):
            found = np.where(np.isfinite(late), early + (late - early) * way, np.inf)
        return np.where(start_s <= (starts - 1) * self.start_s, found, np.inf)


def transit_table(
    model: SafetyModel, tasks: Mapping[str, NominalTask], tracks: OperatorTracks, *, progress: Progress | None = None
) -> TransitTable:
    """Simulate every task from every start on every track.

    Memory: 4 bytes per task, track and start, plus 4 bytes per point of a motion and cell of positions.
    """
    tell = progress or (lambda fraction, text: None)
    cell_of, cells = cells_of(tracks)
    names = tuple(sorted(tasks))
    arrivals = []
    for number, name in enumerate(names):
        tell(number / len(names), f"simulating {name}")
        arrivals.append(_arrivals(model, tasks[name], cell_of, cells, tracks.step_s))
    start_s = _every(tracks.step_s) * tracks.step_s
    return TransitTable(names, np.stack(arrivals), start_s, tuple(tasks[name] for name in names))


def _every(step_s: float) -> int:
    """Return the number of track samples between starts."""
    return samples_in(START_S, 1 / step_s)


def cells_of(tracks: OperatorTracks, edge_m: float = HUMAN_M) -> tuple[Ints, Floats]:
    """Return the cell of every sample (K, T) and the mean position per cell (C, 3); the last is NaN: no operator.

    If the operator is known by states, a cell is a state rounded to a hundredth. Samples with unknown heights share
    cells of the floor, and the mean height of these is unknown.
    """
    if tracks.state is not None:
        states, numbers = np.unique(
            np.round(tracks.state, 2).reshape(-1, tracks.state.shape[2]), axis=0, return_inverse=True
        )
        return numbers.reshape(tracks.state.shape[:2]), states
    flat = tracks.xyz_m.reshape(-1, 3)
    seen = np.isfinite(flat[:, :2]).all(axis=1)
    edge = edge_m
    while True:
        index = np.floor(np.nan_to_num(flat[seen], nan=NO_HEIGHT_M) / edge).astype(np.int64) + (1 << 19)
        packed = (index[:, 0] << 40) | (index[:, 1] << 20) | index[:, 2]
        _, cell = np.unique(packed, return_inverse=True)
        count = int(cell.max(initial=-1)) + 1
        if count <= MAX_CELLS:
            break
        edge *= 2**0.5
    size = np.maximum(np.bincount(cell, minlength=count), 1)
    means = np.stack([np.bincount(cell, flat[seen, axis], minlength=count) / size for axis in range(3)], axis=1)
    cell_of = np.full(len(flat), count, dtype=np.int64)
    cell_of[seen] = cell
    return cell_of.reshape(tracks.xyz_m.shape[:2]), np.concatenate([means, np.full((1, 3), np.nan)])


def _arrivals(model: SafetyModel, task: NominalTask, cell_of: Ints, cells: Floats, step_s: float) -> Singles:
    """Return when the motion from each start ends, shape (K, starts), s; inf: not within the track."""
    points = max(1, round(task.nominal_s / PATH_S))
    middle = (np.arange(points) + 0.5) / points * (len(task.xyz_m) - 1)
    path = task.xyz_m[np.rint(middle).astype(np.int64)]
    count = len(cells)
    table = scaling_of(model, np.repeat(path, count, axis=0), np.tile(cells, (points, 1))).astype(np.float32)
    tracks, samples = cell_of.shape
    begins = np.arange(0, samples - 1, _every(step_s))
    arrival = np.full(tracks * len(begins), np.inf, dtype=np.float32)
    row, sample = np.divmod(np.arange(tracks * len(begins)), len(begins))
    at = row * samples + begins[sample]  # current position in the flattened tracks
    end = (row + 1) * samples - 1
    done_s, rate = np.zeros(len(at), dtype=np.float32), np.ones(len(at), dtype=np.float32)
    which, flat, per_s = np.arange(len(at)), cell_of.ravel(), points / task.nominal_s
    passed = 0.0
    while len(which):
        point = np.minimum(((done_s + rate * (step_s / 2)) * per_s).astype(np.int64), points - 1)
        rate = table[point * count + flat[at]]
        ahead = done_s + rate * step_s
        there = ahead >= task.nominal_s
        if there.any():
            used = (task.nominal_s - done_s[there]) / rate[there]
            arrival[which[there]] = begins[sample[which[there]]] * step_s + passed + used
        passed += step_s
        keep = ~there & (at + 1 < end)
        which, done_s, rate, at, end = which[keep], ahead[keep], rate[keep], at[keep] + 1, end[keep]
    return arrival.reshape(tracks, len(begins))
