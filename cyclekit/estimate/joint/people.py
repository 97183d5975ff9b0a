"""Where people are in joint cycles, or in which state: by what the operator does in each, or as it was logged."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.errors import EstimateError
from cyclekit.estimate.joint.draws import chosen
from cyclekit.estimate.operator.tracks import logged_courses
from cyclekit.estimate.robot.safety import OnStates

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.cycle.engine import RobotLine
    from cyclekit.estimate.joint.draws import CycleDraws
    from cyclekit.estimate.joint.visits import Segments
    from cyclekit.estimate.joint.walk import UnslowedAgent
    from cyclekit.estimate.robot.safety import SafetyModel
    from cyclekit.schema import Floats, Ints, Vector

BINS = 16
"""So many positions along a motion tell where people were."""
XYZ = ["robot_x_m", "robot_y_m", "robot_z_m"]


class OperatorPositions:
    """Where the operators are, as time goes on."""

    def __init__(self, operator: UnslowedAgent, *, segments: Segments, step_s: float, pace: float = 1.0) -> None:
        """Take what the operator does, his logged positions with the time between them, and how slow he walks."""
        self._operator, self._pace = operator, pace * segments.stretch
        self._xyz_m, self._first, self._count = segments.table()
        self._step_s = step_s
        draws = operator.draws
        kinds = sorted({leg.place for agenda in draws.agendas for leg in agenda.legs if leg.place})
        self.activities = tuple(kinds)
        number = {name: n for n, name in enumerate(kinds)} | {"": len(kinds)}
        legs = draws.own_s.shape[1]
        self._kind = np.full((len(draws.agendas), legs), len(kinds))
        self._starts = np.zeros(len(draws.agendas), dtype=np.int64)
        for a, agenda in enumerate(draws.agendas):
            self._kind[a, : len(agenda.legs)] = [number[leg.place] for leg in agenda.legs]
            self._starts[a] = next((n for n, leg in enumerate(agenda.legs) if leg.start is not None), 0)
        self._leg = np.zeros(len(draws.which), dtype=np.int64)

    def at(self, t_s: float, line: RobotLine, _gone: Vector, /) -> tuple[Floats, Ints]:
        """Return the positions (N, 3) of the operators of the rows under way, and at what they are (N,)."""
        rows = line.row
        draws, times = self._operator.draws, self._operator.times
        agenda = draws.which[rows]
        while True:
            leg = self._leg[rows]
            on = (times.passes_s[rows, leg] <= t_s) & (leg < draws.last[agenda])
            if not on.any():
                break
            self._leg[rows[on]] += 1
        before = np.maximum(leg - 1, 0)
        departs = np.where(leg > 0, times.passes_s[rows, before], 0.0)
        arrives = times.arrives_s[rows, leg]
        walks = t_s < arrives
        starts = self._starts[agenda]
        still = leg < starts  # before his first walk he is where that begins
        segment = np.where(walks, draws.walk[rows, leg], draws.stay[rows, leg])
        segment = np.where(still, draws.walk[rows, starts], segment)
        pace = self._pace[segment]
        since = np.where(still, 0.0, np.where(walks, (t_s - departs) / pace, t_s - arrives)) / self._step_s
        if draws.trips:
            trip = ~still & ~walks & self._operator.on_trip(t_s, rows, leg)
            segment = np.where(trip, draws.trip[rows, leg], segment)
            since = np.where(trip, (t_s - times.works_s[rows, leg]) / self._pace[segment] / self._step_s, since)
        gone_s = t_s - times.passes_s[rows, leg]
        gone = (leg == draws.last[agenda]) & ~still & (gone_s > 0.0)  # he has done his last task
        segment = np.where(gone, draws.after[rows], segment)
        since = np.where(gone, gone_s / self._pace[segment] / self._step_s, since)
        since = np.minimum(since, self._count[segment] - 1)
        whole = since.astype(np.int64)
        row = self._first[segment] + whole
        here, after = self._xyz_m[row], self._xyz_m[row + 1]
        between = here + (after - here) * (since - whole)[:, None]
        return np.where(np.isnan(between), here, between), self._kind[agenda, leg]


class LoggedPeople:
    """People whose tasks no log shows: on each of the robot's motions as they were on a logged one of the same task.

    They follow the robot where they work with it, so what was logged is put at its place in the motion, not in time.
    """

    def __init__(self, logged: LoggedMotions, robot: CycleDraws) -> None:
        """Draw a logged motion for each leg of each row."""
        self.activities, self._logged = logged.activities, logged
        self._first = np.zeros(robot.own_s.shape, np.int64)
        self._bins = np.zeros(robot.own_s.shape, np.int64)
        level = robot.levels("people", 0)
        for number, agenda in enumerate(robot.agendas):
            rows, turns = np.flatnonzero(robot.which == number), Counter[str]()
            moves = [n for n, leg in enumerate(agenda.legs) if leg.way_s > 0.0]
            for n in moves:
                leg = agenda.legs[n]
                task = agenda.tasks[leg.task]
                mine = level if not turns[task] else robot.levels(f"people {task}", turns[task])
                turns[task] += 1
                begin, count = logged.on(task, leg.path_m)
                self._first[rows, n] = begin + BINS * chosen(np.arange(count), mine[rows])
                self._bins[rows, n] = BINS - 1
            for n in range(len(agenda.legs)):  # where it stands as at the end of the motion before
                if moves and n not in moves:
                    before = max((move for move in moves if move < n), default=moves[0])
                    self._first[rows, n] = self._first[rows, before] + (BINS - 1 if before < n else 0)

    def at(self, _t_s: float, line: RobotLine, gone: Vector, /) -> tuple[Floats, Ints]:
        """Return positions (N, 3), m, or states (N, D), of the rows under way, and at what they are (N,)."""
        row = self._first[line.row, line.leg] + np.rint(gone * self._bins[line.row, line.leg]).astype(np.int64)
        return self._logged.state[row], self._logged.activity[row]


class LoggedMotions:
    """Where people were, or in which state, along the logged motions of each task.

    Attributes:
        activities: Names of what they may be at.
    """

    def __init__(self, dataset: Dataset, model: SafetyModel) -> None:
        """Read them.

        Raises:
            EstimateError: It is not known of any execution.
        """
        names, self._tracks = logged_courses(dataset, model)
        self.activities, self._states = tuple(names), isinstance(model, OnStates)
        if not self._tracks:
            seen = f"{dataset.path}: of no execution it is known how people slow the robot"
            raise EstimateError(seen, cure="See what the logs lack: cyclekit inspect DATASET")
        frame = dataset.samples(columns=["execution", *XYZ])
        self._tcp = {str(name): rows.select(XYZ).to_numpy() for (name,), rows in frame.group_by(["execution"])}
        self._step_s, self._motions = 1.0 / dataset.rate_hz, defaultdict[str, list[tuple[str, int, int]]](list)
        wanted = dataset.tasks().filter(pl.col("arrival_s").is_not_null()).sort("execution", "index")
        for task, name, start_s, arrival_s in wanted.select("task", "execution", "start_s", "arrival_s").iter_rows():
            if name in self._tracks:
                begin_s = self._tracks[name].begin_s
                first, last = (max(0, round((at - begin_s) / self._step_s)) for at in (start_s, arrival_s))
                self._motions[task].append((name, first, max(last, first) + 1))
        self._parts: list[tuple[Floats, Ints]] = []
        self._known: dict[tuple[str, bytes], tuple[int, int]] = {}
        self._table: tuple[Floats, Ints] | None = None

    def on(self, task: str, path_m: Floats) -> tuple[int, int]:
        """Return from which row on the motions along a way are, BINS rows each, and how many there are."""
        bins = path_m[np.rint(np.linspace(0.0, len(path_m) - 1.0, BINS)).astype(np.int64)]
        key = (task, bins.tobytes())
        if key not in self._known:
            found = [each for each in self._motions[task] if each[1] < len(self._tracks[each[0]].where)]
            found = found or [(name, 0, len(track.where)) for name, track in self._tracks.items()]
            self._known[key] = (BINS * len(self._parts), len(found))
            self._parts += [self._along(bins, *each) for each in found]
            self._table = None
        return self._known[key]

    @property
    def state(self) -> Floats:
        """Positions or states of all rows."""
        return self._tables[0]

    @property
    def activity(self) -> Ints:
        """At what they are in all rows."""
        return self._tables[1]

    @property
    def _tables(self) -> tuple[Floats, Ints]:
        if self._table is None:
            state, activity = (np.concatenate(part) for part in zip(*self._parts, strict=True))
            self._table = state, activity
        return self._table

    def _along(self, bins: Floats, name: str, first: int, last: int) -> tuple[Floats, Ints]:
        """Return what was logged on one motion where the robot was nearest to each of some positions (BINS, 3)."""
        track, tcp = self._tracks[name], self._tcp[name][first:last]
        near = np.nan_to_num(((bins[:, None] - tcp[None]) ** 2).sum(axis=2), nan=np.inf).argmin(axis=1) + first
        near = np.minimum(near, len(track.where) - 1)
        where = track.where[near]
        return where[:, 3:] if self._states else where[:, :3], track.activity[near]
