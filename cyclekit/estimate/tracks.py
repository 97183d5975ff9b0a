"""Logged operator tracks, long enough for any cycle that is rolled out against them.

A track begins where its execution began. Of an operator who comes and goes as he likes, whatever the robot does, all
logs are joined to `circles` and entered at even steps: a cycle may begin at any instant of them.

Where a cycle takes longer than the logged one, the track goes on: with what the operator really did next, if the log
runs on; else with the log that its circle goes on with, or where the operator starts with the cycle with a stretch of
another track that begins in the same state (`continuation`), again and again, so that a cycle may be of any length.

Where the operator was hidden for a moment he was still there: his way is drawn straight from where he was last seen to
where he was seen again. Only where he was away is nobody there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from scipy.special import chdtri, ndtr

from cyclekit.errors import DatasetError, EstimateError
from cyclekit.estimate.circles import Entered, enter
from cyclekit.estimate.continuation import Continuation, Stretch
from cyclekit.estimate.courses import continued
from cyclekit.estimate.safety import OnStates
from cyclekit.people.tracks import OCCLUDED_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.safety import SafetyModel

RUN_ON_S = 5.0
"""The next execution of a session goes on with the same operator if it begins within this time."""
ENTRIES, LEAST_ENTRIES = 8, 4
"""Tracks for each execution in the mean, where the operator's habits do not begin with it and logs form circles; and"""
MANY = 320
"""... no fewer than the latter where these are more than MANY."""
PHASES = 4
"""Instants of each execution at which a course of states is entered then,"""
SHORTEST = 0.1
"""... spread over the length of the shortest ones: no more than this part of them are shorter."""
SAME_SPREAD = 1.65
"""Where starts are like any other instant, the operator's spread at them is within this ratio of that at all times,"""
SURE_Z = 3.5
"""... or within this many standard errors, as is the mean of his position."""
CHANCE = 8.0
"""... and how often he is away and at each task differs by no more standard deviations of chi squared."""
LEAST_FREE = 8
"""Fewer tracks do not tell."""


@dataclass(frozen=True)
class OperatorTracks:
    """K tracks on one grid of time since the cycle began.

    Attributes:
        xyz_m: x_h, shape (K, T, 3), base frame; NaN = nobody there.
        activity: Index into `activities` of what the operator does, shape (K, T); -1 = unknown.
        activities: Names of the operator's tasks.
        logged: Samples of each track that are what its own operator really did, shape (K,).
        executions: Name of the execution behind each track; several tracks can be of one.
        step_s: Time between samples.
        goal_m: g_h, shape (K, T, 3); NaN = unknown; None where it was not asked for.
        phase_free: What `phase_is_free` says of these logs.
        runs_on: Most executions are followed by the next one without a pause, and the operator with them.
        state: What the safety function is asked for in place of x_h, shape (K, T, D), D not 3; None: it is asked for
            x_h.
    """

    xyz_m: NDArray[np.float64]
    activity: NDArray[np.int64]
    activities: tuple[str, ...]
    logged: NDArray[np.int64]
    executions: tuple[str, ...]
    step_s: float
    goal_m: NDArray[np.float64] | None = None
    phase_free: bool = False
    runs_on: bool = False
    state: NDArray[np.float64] | None = None

    @property
    def at_any_instant(self) -> bool:
        """Whether the tracks enter logs at several instants: all of their samples then tell how often he is away."""
        return len(self.executions) > len(set(self.executions))


@dataclass(frozen=True)
class LoggedTrack:
    """What was logged of one execution: x_h (and g_h if asked for), shape (T, 3 or 6), activity (T,), its two ends, s.

    Of an operator who is only known by states: no position, and the states behind it, shape (T, 3 + D).

    `seen`: somebody is, at some time. `away`: the tracker saw all along that nobody is. `followed`: its log is
    never silent for longer than OCCLUDED_S.
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
    phases: int | None = None,
    beginnings: bool = False,
    goals: bool = False,
    model: SafetyModel | None = None,
) -> OperatorTracks:
    """Return the tracks of all complete executions, each at least `horizon_s` long.

    An execution that the tracker's log covers in part only is none of them: where the operator was is not known. One in
    which he was away from begin to end is one, unless it was recorded as a run without operator.

    Args:
        dataset: Where they were logged.
        horizon_s: Longest cycle that will be asked for.
        operator: Only executions in which the operator's tasks begin in this order.
        phases: 1: each execution from its beginning. None: so too, but where `phase_is_free` and no order is asked for
            tracks enter the logs as circles, and courses of states at PHASES instants of each log.
        beginnings: Put the executions from their beginnings before the tracks that enter circles. Of states they come
            first anyway, in the order of the executions.
        goals: Also return g_h.
        model: Whom the tracks are for; one of states gets these in place of positions.

    Raises:
        EstimateError: No execution has an operator track, or none matches `operator`.
    """
    step = 1.0 / dataset.rate_hz
    on_states = isinstance(model, OnStates)
    found = _in_states(dataset, model) if isinstance(model, OnStates) else _names_and_tracks(dataset, goals=goals)
    names, tracks = found
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
    free, length = phase_is_free(tracks), int(np.ceil(horizon_s / step)) + 2
    after, mine = _after(dataset), {name: tracks[name] for name in begins}
    anywhere = operator is None and free and phases is None
    parts = [_on_circles(mine, after, step, length)] if anywhere and not on_states else []
    if beginnings or not parts:
        instants = _instants([len(track.where) for track in mine.values()]) if anywhere and on_states else [0]
        parts.insert(0, _continued(tracks, begins, after, step, length, instants, states=on_states and free, free=free))
    entered = parts[0] if len(parts) == 1 else Entered(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    where, activity, owner, logged = entered
    executions = tuple(begins[k] for k in owner.tolist())
    goal_m, state = (where[..., 3:] if wanted else None for wanted in (goals, on_states))
    return OperatorTracks(
        where[..., :3], activity, tuple(names), logged, executions, step, goal_m, free, _runs_on(dataset), state
    )


def _on_circles(tracks: dict[str, LoggedTrack], after: dict[str, list[str]], step: float, length: int) -> Entered:
    """Return these tracks, joined to circles and entered at even steps; who went on is not joined to another."""
    number = {name: k for k, name in enumerate(tracks)}
    logs, really = [], {}
    for name, track in tracks.items():
        log, following = Stretch(track.where, track.activity), next(iter(after[name]), "")
        if following in tracks and tracks[following].begin_s - track.end_s <= RUN_ON_S:
            really[number[name]] = number[following]
            log = _until(log, track.end_s, tracks[following], step)
        logs.append(log)
    return enter(logs, step, entries=entries_of(len(logs)), length=length, after=really)


def entries_of(executions: int) -> int:
    """Return how many tracks enter the circles of so many logs."""
    return max(LEAST_ENTRIES * executions, min(ENTRIES * executions, MANY))


def _continued(
    tracks: dict[str, LoggedTrack],
    begins: list[str],
    after: dict[str, list[str]],
    step: float,
    length: int,
    instants: Sequence[int],
    *,
    states: bool,
    free: bool,
) -> Entered:
    """Return executions from these samples on, continued with stretches of others."""
    ran_on = [_run_on(tracks, [name, *after[name]], step) for name in begins]
    entries = [(number, min(at, len(tracks[name].where) - 1)) for at in instants for number, name in enumerate(begins)]
    streams = [Stretch(ran_on[k][0].where[at:], ran_on[k][0].activity[at:]) for k, at in entries]
    followed = {name: number for number, name in enumerate(name for name in tracks if tracks[name].followed)}
    pool = [Stretch(tracks[name].where, tracks[name].activity) for name in followed]
    if states:
        where, activity = continued(streams, pool, length)
    else:
        owners = [followed.get(ran_on[k][1], -1) for k, _ in entries]
        where, activity = Continuation(pool, step, phase_free=free).extend(streams, owners, length)
    owner, logged = np.array([k for k, _ in entries]), np.array([len(stream.where) for stream in streams])
    return Entered(where, activity, owner, logged)


def _instants(lengths: Sequence[int]) -> list[int]:
    """Return the samples at which courses of these lengths are entered, the same for all.

    At a part of its own length each would be entered as often as any other. But an execution is long where the
    operator was in the way: such times would be entered more seldom than they come.
    """
    within = int(np.quantile(lengths, SHORTEST, method="lower"))
    return [within * phase // PHASES for phase in range(PHASES)]


def _runs_on(dataset: Dataset) -> bool:
    order = dataset.executions.sort("session", "start_s")
    pause = order.select((pl.col("start_s") - pl.col("end_s").shift().over("session")).alias("pause"))["pause"]
    return bool((pause <= RUN_ON_S).sum() >= 0.8 * max(len(pause) - order["session"].n_unique(), 1))


def phase_is_free(tracks: Mapping[str, LoggedTrack]) -> bool:
    """Tell whether a cycle may begin at any instant of the operator's day.

    That is so if at the beginning, a third and two thirds of the shortest execution he behaves as at any time within
    it: he is away and at each of his tasks as often (CHANCE), the mean of his position is within SURE_Z standard
    errors, its spread within these or SAME_SPREAD.
    """
    usual = [track for track in tracks.values() if track.followed]
    if len(usual) < LEAST_FREE:
        return False
    shortest = min(len(track.where) for track in usual)  # later on there are slow executions alone
    every = Stretch(
        np.concatenate([track.where[:shortest] for track in usual]),
        np.concatenate([track.activity[:shortest] for track in usual]),
    )
    return all(_is_alike(usual, every, at) for at in (0, shortest // 3, 2 * shortest // 3))


def _is_alike(tracks: Sequence[LoggedTrack], every: Stretch, at: int) -> bool:
    """Tell whether the operators at sample `at` of these tracks are like those of every sample."""
    where, doing = np.array([t.where[at, :2] for t in tracks]), np.array([t.activity[at] for t in tracks])
    pairs = zip(_kinds(where, doing), _kinds(every.where, every.activity), strict=True)
    if not all(_is_chance(here, usual) for here, usual in pairs):
        return False
    everywhere, here = (part[np.isfinite(part).all(axis=1)] for part in (every.where[:, :2], where))
    if len(here) < LEAST_FREE:
        return False
    spread, there = everywhere.std(axis=0), here.std(axis=0)
    if not spread.any():  # he is known by states, which are alike
        return True
    off = np.abs(here.mean(axis=0) - everywhere.mean(axis=0)) / np.maximum(spread / np.sqrt(len(here)), 1e-9)
    ratio = np.maximum(there / np.maximum(spread, 1e-9), 1e-9)
    few = np.sqrt((len(here) - 1) / chdtri(len(here) - 1, ndtr(SURE_Z)))  # so far off by chance is the spread of so few
    return bool((off < SURE_Z).all() and (np.abs(np.log(ratio)) < np.log(max(SAME_SPREAD, few))).all())


def _kinds(where: NDArray[np.float64], activity: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return whether each operator is away (N,), and what those do who are there and of whom it is known (M,)."""
    away = np.asarray(np.isnan(where[:, :2]).any(axis=1))
    return np.asarray(away, dtype=np.int64), activity[~away & (activity >= 0)]


def _is_chance(here: NDArray[np.int64], usual: NDArray[np.int64]) -> bool:
    """Tell whether kinds (N,) can have been drawn from those of all samples (M,), by chi squared: see CHANCE."""
    kinds, counts = np.unique(usual, return_counts=True)
    wanted = counts / counts.sum() * len(here) if len(counts) else counts
    if len(kinds) < 2 or not len(here):
        return True
    found = np.array([np.count_nonzero(here == kind) for kind in kinds])
    free = len(kinds) - 1
    return bool(((found - wanted) ** 2 / wanted).sum() <= free + CHANCE * np.sqrt(2.0 * free))


def logged_tracks(dataset: Dataset) -> dict[str, LoggedTrack]:
    """Return what was logged of the operator in each execution, by its name; short gaps are bridged."""
    return _names_and_tracks(dataset, goals=False)[1]


def _names_and_tracks(dataset: Dataset, *, goals: bool) -> tuple[list[str], dict[str, LoggedTrack]]:
    """The operator's tasks, and what was logged of him in each execution."""
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
    for execution, first, last, count in rows.agg(
        first=pl.col("row").first(), last=pl.col("row").last(), count=pl.len()
    ).iter_rows():
        if count != last - first + 1:
            msg = f"{dataset.path}: the samples of execution {execution} do not lie together"
            raise DatasetError(msg, cure="Ingest the logs again into a new folder.")
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
    """Names of the states, and in which ones the operator was in each execution that was not run without him."""
    alone = {one.execution for one in dataset.card.executions if one.reference}
    tracks = {}
    for name, (t_s, state) in model.logged_states(dataset).items():
        if name not in alone:
            where = np.hstack([np.zeros((len(state), 3)), state])
            ends = float(t_s[0]), float(t_s[-1])
            tracks[name] = LoggedTrack(where, state[:, 0].astype(np.int64), *ends, seen=True, away=False, followed=True)
    return list(model.states), tracks


def _bridge(t_s: NDArray[np.float64], xyz_m: NDArray[np.float64], hidden: NDArray[np.bool_]) -> None:
    """Fill in where the operator was while he was `hidden` (T,), in place; xyz_m: (T, 3).

    He is taken to have gone straight from where he was last seen; before the first sight and after the last one of an
    execution to have stood there. What is farther than OCCLUDED_S from any sight stays unknown.
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
    """The two executions that follow each in its session."""
    found: dict[str, list[str]] = {}
    for (_,), rows in dataset.executions.group_by(["session"], maintain_order=True):
        order = rows["execution"].to_list()
        found |= {name: order[number + 1 : number + 3] for number, name in enumerate(order)}
    return found


def _run_on(tracks: dict[str, LoggedTrack], names: list[str], step: float) -> tuple[Stretch, str]:
    """The track of the first of these executions, and of those that follow it without a longer pause; the last one."""
    name, *others = names
    end_s, parts = tracks[name].end_s, [Stretch(tracks[name].where, tracks[name].activity)]
    for following in others:
        if following not in tracks or tracks[following].begin_s - end_s > RUN_ON_S:
            break
        after = tracks[following]
        parts = [*parts[:-1], _until(parts[-1], end_s, after, step), Stretch(after.where, after.activity)]
        end_s, name = after.end_s, following
    return Stretch(*(np.concatenate([getattr(part, of) for part in parts]) for of in ("where", "activity"))), name


def _until(log: Stretch, end_s: float, following: LoggedTrack, step: float) -> Stretch:
    """Return a log that ends then, and the pause until the next one begins: straight there, at the same task."""
    pause = max(0, round((following.begin_s - end_s) / step) - 1)
    weight = (np.arange(1, pause + 1) / (pause + 1))[:, None]
    way = log.where[-1] * (1 - weight) + following.where[0] * weight
    return Stretch(np.concatenate([log.where, way]), np.append(log.activity, np.full(pause, log.activity[-1])))
