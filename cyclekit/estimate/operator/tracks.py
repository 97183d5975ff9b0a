"""Operator tracks from the logs, as long as the longest cycle that is rolled out with them.

A track begins where its execution began: that was logged. That a cycle may as well begin at any other instant of the
operator's day is never assumed. Logs could show it only where it gains nothing: if it holds, the variance that it saves
is that of the difference between the two estimates, by which alone they could tell it from what was logged (Hausman,
Econometrica 46, 1978).

If a cycle takes longer than the logged one, the track continues: with what the operator really did next, if the log
runs on; else with a stretch of another track that begins in the same state (`continuation`), repeatedly, to any length.
A state of signals, or of the robot's speed alone, does not tell what people are at: those who have finished look like
those who come back at once. Then no log tells how they go on after its end: the track of the shortest log continues
with the states in which logs end, as if people stayed so, and intervals cover that. Where logs end at any instant both
have the same mean. (Where they do not, in one of two simulated cells people stayed, in the other they went on.)

While the operator was briefly hidden he was still present: positions are interpolated linearly between the last sight
and the next. Only while he was away is there no operator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.errors import DatasetError, EstimateError
from cyclekit.estimate.operator.continuation import MIN_S, Continuation, Stretch
from cyclekit.estimate.operator.pauses import RUN_ON_S, runs_on, starting_scaling
from cyclekit.estimate.robot.safety import Dynamics, OnStates
from cyclekit.people.tracks import OCCLUDED_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.robot.safety import SafetyModel
    from cyclekit.schema import Ints, Points


MAX_POOLED = 400
"""Maximum number of logs, evenly chosen, whose stretches continue tracks: all ends are held against all of them, which
costs the square of their number, and one of the 15 most similar is drawn. A limit of cost: up to 400 logs it changes
nothing."""


@dataclass(frozen=True)
class OperatorTracks:
    """K tracks on one grid of time since the start of the cycle.

    Attributes:
        xyz_m: x_h, shape (K, T, 3), base frame; NaN = no operator.
        activity: Index into `activities` of the operator's task, shape (K, T); -1 = unknown.
        activities: Names of the operator's tasks.
        logged: Samples of each track that its own operator really did, shape (K,).
        executions: Name of the execution of each track.
        step_s: Time between samples.
        goal_m: g_h, shape (K, T, 3); NaN = unknown; None if not requested.
        runs_on: Whether most executions, with the operator, are followed by the next one without a pause.
        state: Input of the safety function in place of x_h, shape (K, T, D), D not 3; None: its input is x_h.
        scaling: Scaling at the start, shape (K,); NaN or None: as commanded.
        stays: Whether each track continues in the states in which logs end, shape (K,); None: none does.
    """

    xyz_m: NDArray[np.float64]
    activity: NDArray[np.int64]
    activities: tuple[str, ...]
    logged: NDArray[np.int64]
    executions: tuple[str, ...]
    step_s: float
    goal_m: NDArray[np.float64] | None = None
    runs_on: bool = False
    state: NDArray[np.float64] | None = None
    scaling: NDArray[np.float64] | None = None
    stays: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class LoggedTrack:
    """Log of one execution: x_h (and g_h if requested), shape (T, 3 or 6), activity (T,), begin and end, s.

    For an operator known only by states, `where` holds a zero position followed by the state, shape (T, 3 + D).

    `seen`: an operator was seen at some time. `away`: the tracker logged throughout that nobody was present.
    `followed`: the track has no gap longer than OCCLUDED_S.
    """

    where: NDArray[np.float64]
    activity: NDArray[np.int64]
    begin_s: float
    end_s: float
    seen: bool
    away: bool
    followed: bool


def operator_tracks(
    dataset: Dataset,
    *,
    horizon_s: float,
    operator: Sequence[str] | None = None,
    goals: bool = False,
    model: SafetyModel | None = None,
) -> OperatorTracks:
    """Return the tracks of all complete executions, each at least `horizon_s` long.

    Executions that the tracker's log covers only in part are left out, as the operator's position is unknown.
    Executions without an operator from begin to end are included, unless recorded as reference runs without an
    operator.

    Args:
        dataset: The logs.
        horizon_s: Longest cycle that will be requested.
        operator: Use only executions in which the operator's tasks begin in this order.
        goals: Also return g_h.
        model: The model that will use the tracks; one of states gets states in place of positions.
        EstimateError: No execution has an operator track, or none matches `operator`.
    """
    step = 1.0 / dataset.rate_hz
    on_states = isinstance(model, OnStates)
    names, tracks = (
        logged_courses(dataset, model) if model is not None and on_states else _names_and_tracks(dataset, goals=goals)
    )
    complete = set(dataset.executions.filter("complete")["execution"].to_list())
    seen_in = [name for name in tracks if name in complete and tracks[name].seen]
    begins = [name for name in seen_in if tracks[name].followed]
    if begins:
        meant = {one.execution for one in dataset.card.executions if one.reference}
        away = {name for name in complete - meant if name in tracks and tracks[name].away}
        begins = [name for name in tracks if name in away or name in begins]
    else:
        partly = " of its full length" if seen_in else ""
        seen = f"{dataset.path}: no complete execution has an operator track{partly}"
        raise EstimateError(seen, cure="Ingest the tracker's log together with the robot's.")
    if operator is not None:
        begins = _matching(dataset, tracks, begins, names, tuple(operator))
    length = int(np.ceil(horizon_s / step)) + 2
    where, activity, logged, stays = _continued(tracks, begins, _after(dataset), step, length, states=on_states)
    scaling = starting_scaling(dataset, begins, Dynamics.of(dataset.card.dynamics, model).ramp_up_per_s)
    goal_m, state = (where[..., 3:] if wanted else None for wanted in (goals, on_states))
    rest = tuple(names), logged, tuple(begins), step, goal_m, runs_on(dataset), state, scaling
    return OperatorTracks(where[..., :3], activity, *rest, stays=stays)


def _continued(
    tracks: dict[str, LoggedTrack],
    begins: list[str],
    after: dict[str, list[str]],
    step: float,
    length: int,
    *,
    states: bool,
) -> tuple[Points, Ints, Ints, NDArray[np.bool_] | None]:
    """Return tracks, (K, length, 3 or more) and (K, length), samples of each that are its own, (K,), and `stays`."""
    ran_on = [_run_on(tracks, [name, *after[name]], step, states=states) for name in begins]
    whole = [name for name in tracks if tracks[name].followed]
    followed = {name: number for number, name in enumerate(whole[:: -(-len(whole) // MAX_POOLED) or 1])}
    pool = [Stretch(tracks[name].where, tracks[name].activity) for name in followed]
    owners = [followed.get(last, -1) for _, last in ran_on]
    where, activity = Continuation(pool, step).extend([stream for stream, _ in ran_on], owners, length)
    logged = np.array([len(stream.where) for stream, _ in ran_on])
    if not states or not pool:
        return where, activity, logged, None
    stays, spell = np.arange(len(logged)) == logged.argmin(), round(MIN_S / step)
    last = np.random.default_rng(0).integers(len(pool), size=(len(logged), -(-length // spell))).repeat(spell, axis=1)
    ends = [np.array([getattr(stretch, of)[-1] for stretch in pool]) for of in ("where", "activity")]
    for k in np.flatnonzero(stays).tolist():
        some = last[k, : length - min(logged[k], length)]
        where[k, logged[k] :], activity[k, logged[k] :] = ends[0][some], ends[1][some]
    return where, activity, logged, stays


def logged_tracks(dataset: Dataset) -> dict[str, LoggedTrack]:
    """Return the operator's log in each execution, by name; short gaps are bridged."""
    return _names_and_tracks(dataset, goals=False)[1]


def logged_courses(dataset: Dataset, model: SafetyModel) -> tuple[list[str], dict[str, LoggedTrack]]:
    """Return what people may be at, and what was logged of them in each execution: states for a model of states."""
    return _in_states(dataset, model) if isinstance(model, OnStates) else _names_and_tracks(dataset, goals=False)


def _names_and_tracks(dataset: Dataset, *, goals: bool) -> tuple[list[str], dict[str, LoggedTrack]]:
    """Return the names of the operator's tasks, and his log in each execution that was not interrupted."""
    columns = [f"human_{part}{axis}_m" for part in (("", "goal_") if goals else ("",)) for axis in "xyz"]
    samples = dataset.samples(columns=["execution", "t_s", "human_task", "human_gap", *columns])
    names = sorted(name for name in samples["human_task"].unique().to_list() if name is not None)
    where = samples.select(pl.col(columns).cast(pl.Float64).fill_null(np.nan)).to_numpy()
    code = pl.col("human_task").cast(pl.Enum(names)).to_physical().cast(pl.Int64).fill_null(-1)
    activity, t_s = samples.select(code).to_series().to_numpy(), samples["t_s"].to_numpy()
    outside, occluded, absent = (
        (samples["human_gap"] == why).fill_null(value=False).to_numpy() for why in ("outside", "occluded", "absent")
    )
    hidden = outside | occluded
    rows = samples.select("execution", row=pl.int_range(pl.len())).group_by("execution", maintain_order=True)
    tracks: dict[str, LoggedTrack] = {}
    stopped = {one.execution for one in dataset.card.executions if one.interrupted_s}
    for execution, first, last, count in rows.agg(
        first=pl.col("row").first(), last=pl.col("row").last(), count=pl.len()
    ).iter_rows():
        if count != last - first + 1:
            msg = f"{dataset.path}: the samples of execution {execution} do not lie together"
            raise DatasetError(msg, cure="Ingest the logs again into a new folder.")
        if execution in stopped:
            continue
        mine = slice(first, last + 1)
        if hidden[mine].any():
            _bridge(t_s[mine], where[mine, :3], hidden[mine])
        seen = np.isfinite(where[mine, 0])
        followed = bool(seen.all()) or not (outside[mine] & ~seen).any()
        ends = float(t_s[first]), float(t_s[last])
        away = bool(absent[mine].all())
        tracks[str(execution)] = LoggedTrack(where[mine], activity[mine], *ends, bool(seen.any()), away, followed)
    return names, tracks


def _in_states(dataset: Dataset, model: OnStates) -> tuple[list[str], dict[str, LoggedTrack]]:
    """Return the names of the states, and the states in each execution but reference runs and interrupted ones."""
    alone = {one.execution for one in dataset.card.executions if one.reference or one.interrupted_s}
    tracks = {}
    for name, (t_s, state) in model.logged_states(dataset).items():
        if name not in alone:
            where = np.hstack([np.zeros((len(state), 3)), state])
            log = where, state[:, 0].astype(np.int64), float(t_s[0]), float(t_s[-1])
            tracks[name] = LoggedTrack(*log, seen=True, away=False, followed=True)
    return list(model.states), tracks


def _bridge(t_s: NDArray[np.float64], xyz_m: NDArray[np.float64], hidden: NDArray[np.bool_]) -> None:
    """Fill positions xyz_m (T, 3) while the operator was `hidden` (T,), in place.

    He is assumed to move straight from the last sight to the next; before the first and after the last sight of an
    execution, to stand still. Rows farther than OCCLUDED_S from any sight stay unknown.
    """
    known = np.flatnonzero(np.isfinite(xyz_m[:, 0]))
    rows = np.flatnonzero(hidden & np.isnan(xyz_m[:, 0]))
    if len(known) and len(rows):
        after = np.clip(np.searchsorted(known, rows), 1, len(known) - 1) if len(known) > 1 else np.zeros_like(rows)
        apart = np.abs(t_s[known[[np.maximum(after - 1, 0), after]]] - t_s[rows]).min(axis=0)
        rows = rows[apart <= OCCLUDED_S]
        for axis in range(3):
            xyz_m[rows, axis] = np.interp(t_s[rows], t_s[known], xyz_m[known, axis])


def _matching(
    dataset: Dataset, tracks: dict[str, LoggedTrack], begins: list[str], names: list[str], wanted: tuple[str, ...]
) -> list[str]:
    orders = {name: _order(tracks[name].activity, names) for name in begins}
    found = [name for name in begins if orders[name][: len(wanted)] == wanted]
    if not found:
        common = max(orders.values(), key=list(orders.values()).count)
        seen = f"{dataset.path}: no execution has an operator who begins with {', '.join(wanted)}"
        raise EstimateError(seen, nearest=", ".join(common[: len(wanted)]), cure=f"Known: {', '.join(names)}.")
    return found


def _order(activity: NDArray[np.int64], names: list[str]) -> tuple[str, ...]:
    changes = np.flatnonzero(np.diff(activity, prepend=-2))
    return tuple(names[i] for i in activity[changes].tolist() if i >= 0)


def _after(dataset: Dataset) -> dict[str, list[str]]:
    """Return the next two executions after each one in its session."""
    sessions = dataset.executions.group_by("session", maintain_order=True).agg("execution")["execution"].to_list()
    return {name: order[k + 1 : k + 3] for order in sessions for k, name in enumerate(order)}


def _run_on(tracks: dict[str, LoggedTrack], names: list[str], step: float, *, states: bool) -> tuple[Stretch, str]:
    """Return the track of the first execution and those that follow without a longer pause, and the last one's name."""
    name, *others = names
    end_s, parts = tracks[name].end_s, [Stretch(tracks[name].where, tracks[name].activity)]
    for following in others:
        if following not in tracks or tracks[following].begin_s - end_s > RUN_ON_S:
            break
        parts[-1] = _until(parts[-1], end_s, tracks[following], step, states=states)
        parts.append(Stretch(tracks[following].where, tracks[following].activity))
        end_s, name = tracks[following].end_s, following
    return Stretch(*(np.concatenate([getattr(part, of) for part in parts]) for of in ("where", "activity"))), name


def _until(log: Stretch, end_s: float, following: LoggedTrack, step: float, *, states: bool = False) -> Stretch:
    """Return a log extended to the next one: straight to its start, at the last task; a state changes half-way."""
    pause = max(0, round((following.begin_s - end_s) / step) - 1)
    weight = np.arange(1, pause + 1)[:, None] / (pause + 1)
    weight = np.round(weight) if states else weight
    way = log.where[-1] * (1 - weight) + following.where[0] * weight
    doing = np.where(states & (weight[:, 0] > 0), following.activity[0], log.activity[-1])
    return Stretch(np.concatenate([log.where, way]), np.append(log.activity, doing))
