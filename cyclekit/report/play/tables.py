"""What the script needs to roll out any order of the logged tasks: tasks, tracks, rule, and what corrects the result.

Everything comes from the functions of `estimate`, so the script draws nothing at random and fits nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from cyclekit.estimate.cycle.engine import FINE_STEP_S, SUPPORT_EVERY_S, TIME_STEP_S
from cyclekit.estimate.cycle.spread import logged_support
from cyclekit.estimate.interludes import most_s, robot_interludes
from cyclekit.estimate.operator.tracks import OperatorTracks, operator_tracks
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.robot.program import standstills_of
from cyclekit.estimate.robot.safety import Dynamics, OnStates, SafetyModel, at_once, is_fast
from cyclekit.estimate.robot.signal_states import on_states_of
from cyclekit.estimate.robot.support import HUMAN_M, ROBOT_M
from cyclekit.estimate.robot.work_dwells import MIN_EXECUTIONS, StandstillKind
from cyclekit.estimate.statistics.resample import RESAMPLES, TOGETHER, resampled_alike
from cyclekit.estimate.statistics.same_work import Work
from cyclekit.estimate.validation.history import TaskTimes
from cyclekit.estimate.whatif.alter import AWAY, LOOKED_AT, grid_positions
from cyclekit.learning.out_of_core import in_memory
from cyclekit.learning.rules.safety import RuleSafety, distances_of
from cyclekit.learning.rules.samples.distances import TO_LINK
from cyclekit.learning.rules.samples.quantities import RulePlace, quantities
from cyclekit.report.play.packed import each_once, in_steps, in_units, numbers_in_steps, units_per_metre
from cyclekit.report.play.scaling_grid import scaling_grid, thinned
from cyclekit.report.play.scaling_table import scaling_table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit.dataset.cards.task_model import InterludeCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.estimate.robot.work_dwells import Group
    from cyclekit.estimate.validation.check import Check
    from cyclekit.report.inputs import PageInputs
    from cyclekit.schema import Floats

    Arrays = dict[str, NDArray[Any]]
    Tables = tuple[dict[str, Any], Arrays]

SEED = 0
"""Seed of the estimates on the page."""
LONGER = 3.5
"""Length of the tracks as a multiple of the longest sequence at full speed; slower cycles are not known."""
NOBODY = 2**16 - 1
"""Number of the cell of an operator who is absent."""
MOVED_M = 0.5
"""Maximum shift of a threshold to either side, m."""


def playable(page: PageInputs) -> SafetyModel | str:
    """Return the model that a page can be played with, or the name of the text that says why it cannot."""
    model = page.answers
    if not isinstance(model, SafetyModel):
        return "unseen" if page.unseen else "no_model"
    if model.problem != "now":
        return "not_now"
    return model


def played_alone(page: PageInputs) -> list[list[CycleEstimate]]:
    """Return the sequences of the robot alone, one list per order of the operator: each has its own tracks."""
    found: dict[tuple[str, ...] | None, list[CycleEstimate]] = {}
    for each in page.ranked:
        if each.estimator == "rollout" and not each.plan:
            found.setdefault(each.operator, []).append(each)
    return list(found.values())


def tables_of(page: PageInputs, model: SafetyModel, shown: Sequence[CycleEstimate]) -> Tables:
    """Return facts (plain JSON values) and arrays of a page's sequences.

    Args:
        page: What the page is made of.
        model: What answers for it, as `playable` has found.
        shown: Sequences of the robot alone, with the same order of the operator.

    Raises:
        CyclekitError: There is no operator track, or the tables would be too large.
    """
    dataset, _ = in_memory(page.dataset)
    model, check = on_states_of(model, dataset), shown[0].check
    legs = nominal_tasks(dataset)
    nominal_s = max(each.nominal_s + each.dwell_s + each.wait_s for each in shown)
    operator = shown[0].operator
    tracks = operator_tracks(dataset, horizon_s=LONGER * nominal_s, operator=operator, model=model)
    arrays: Arrays = {}
    facts = settings_of(page, model, dataset, tracks) | scaling_source(model, dataset, legs, tracks, arrays)
    facts["kind"] = "robot"
    facts["operator"] = operator
    facts["fewest"] = MIN_EXECUTIONS
    facts["sequences"] = [
        {"name": each.name, "robot": list(each.places), "allowance": each.allowance} for each in shown
    ]
    facts["legs"] = _legs(legs, arrays, len(tracks.executions), [each.places for each in shown])
    facts["check"] = _corrected(check, dataset, tracks, legs, arrays, pooled=operator is None)
    return facts, arrays


def settings_of(page: PageInputs, model: SafetyModel, dataset: Dataset, tracks: OperatorTracks) -> dict[str, Any]:
    """Return names, takt, the grid of the tracks, and the time steps and the response of the rollout."""
    dynamics = Dynamics.of(dataset.card.dynamics, model)
    return {
        "labels": {name: dataset.label(name) for name in (*dataset.places, *dataset.human_places)},
        "takt_s": page.takt_s,
        "tracks": {
            "count": len(tracks.executions),
            "step_s": tracks.step_s,
            "logged": tracks.logged.tolist(),
            "stays": None if tracks.stays is None else tracks.stays.tolist(),
            "scaling": None if tracks.scaling is None else [None if s != s else s for s in tracks.scaling.tolist()],
        },
        "dynamics": vars(dynamics),
        "step": {"coarse_s": TIME_STEP_S, "fine_s": FINE_STEP_S, "support_s": SUPPORT_EVERY_S},
        "follows": not at_once(model, dynamics),
        "often": is_fast(model),
        "away": {"part": AWAY, "points": LOOKED_AT},
        "interludes": interludes_told(robot_interludes(dataset)),
    }


def interludes_told(interludes: Sequence[InterludeCard]) -> list[dict[str, Any]]:
    """Return the interludes of the logs, each with the most that it adds to a task before which it may come, s."""
    return [{"agent": one.agent, "task": one.task, "before": one.before, "most_s": most_s(one)} for one in interludes]


def scaling_source(
    model: SafetyModel, dataset: Dataset, legs: Mapping[str, NominalTask], tracks: OperatorTracks, arrays: Arrays
) -> dict[str, Any]:
    """Put the rule, the network or the table of the scaling into `arrays`; return its facts.

    Raises:
        EstimateError: The tables would be too large.
    """
    dynamics, paths = Dynamics.of(dataset.card.dynamics, model), [leg.xyz_m for leg in legs.values()]
    if isinstance(model, OnStates):
        return {"rule": scaling_table(model, paths, tracks, arrays)}
    people_m, which = each_once(tracks.xyz_m.reshape(-1, 3))  # tracks of one log hold the same positions
    arrays["who"] = numbers_in_steps(which)
    if isinstance(model, RuleSafety):
        if TO_LINK in distances_of(model.rule):
            arrays["poses"] = np.array([pose.tcp_m for pose in model.rule.poses], np.float32)
            arrays["joints"] = np.array([pose.joints_m for pose in model.rule.poses], np.float32)
        return _positions(dataset, paths, people_m, arrays) | {"rule": _rule(model)}
    positions = _positions(dataset, paths, people_m, arrays, spots=False)
    rows = [thinned(leg) for leg in legs.values()]
    return positions | {"rule": scaling_grid(model, dynamics, rows, people_m, arrays)}


def _positions(
    dataset: Dataset, legs: list[Floats], people_m: Floats, arrays: Arrays, *, spots: bool = True
) -> dict[str, Any]:
    """Put positions of robot and operator into `arrays`, and which pairs were logged; return their facts."""
    paths = np.concatenate(legs)
    unit = units_per_metre(people_m, paths)
    arrays["people"], arrays["paths"] = (in_steps(in_units(xyz_m, unit)) for xyz_m in (people_m, paths))
    return {"per_metre": unit, "support": _support(dataset, paths, people_m, arrays, spots=spots)}


def _rule(model: RuleSafety) -> dict[str, Any]:
    """Return the rule, and which of its thresholds and zones a slider moves."""
    rule, without = model.rule, model.card.scaling_without_operator
    moves = [move for limit in rule.limits for move in _moves(limit.scaling, quantities(rule.limits))]
    return {
        "limits": msgspec.to_builtins(rule.limits),
        "law": msgspec.to_builtins(rule.law),
        "fastest": rule.levels[-1],
        "lags": model.lags,
        "slows_alone": model.slows_alone,
        "alone": 1.0 if without is None else without,
        "moves": moves,
        "fixed": None if moves else "fixed_rule",
    }


def _moves(level: float, known: Mapping[RulePlace, Any]) -> list[dict[str, Any]]:
    """Return the threshold and the zone of a level, each if there is exactly one, as `LimitChange` names them."""
    found: list[dict[str, Any]] = []
    at = RulePlace(level, until=False, kind="nearer", item=0)
    if at in known and at._replace(item=1) not in known:
        value = known[at].value
        bounds = [max(0.0, value - MOVED_M), value + MOVED_M]
        found.append({"level": level, "kind": "threshold_m", "value": value, "bounds": bounds})
    edges = [known.get(RulePlace(level, until=False, kind="rectangle", item=0, edge=edge)) for edge in range(4)]
    alone = RulePlace(level, until=False, kind="rectangle", item=1)
    sides = [(edges[0], edges[1]), (edges[2], edges[3])]  # an edge that was never crossed stays where it is
    axes = [axis for axis, (low, high) in enumerate(sides) if low is not None or high is not None]
    if axes and not any(alone._replace(edge=edge) in known for edge in range(4)):
        wide_m = [high.value - low.value for low, high in sides if low is not None and high is not None]
        narrow = min(wide_m, default=np.inf)
        least = max(-MOVED_M, -0.45 * narrow)
        found.append({"level": level, "kind": "zone", "value": 0.0, "bounds": [least, MOVED_M], "axes": axes})
    return found


def _legs(
    legs: Mapping[str, NominalTask], arrays: Arrays, count: int, shown: Sequence[Sequence[str]]
) -> dict[str, Any]:
    """Return each task with its place in `paths` (points, 3) and in `stands` (occurrences of tasks, tracks).

    If its standstills depend on the work, `of_work` has those of each group of executions.
    """
    stands: list[NDArray[np.float64]] = []
    found, first = {}, 0
    for name, leg in legs.items():
        start, _, goal = name.partition("->")
        often = max(1, *(min(places.count(start), places.count(goal)) for places in shown))

        def stands_of(leg: NominalTask, often: int = often) -> dict[str, Any]:
            stands.extend(standstills_of(leg, count, SEED, occurrence) for occurrence in range(often))
            means = {"dwell_s": leg.dwell_s, "wait_s": leg.wait_s}
            return {**means, "stands": len(stands) - often, "logged": len(leg.standstill_s)}

        found[name] = {
            **{"name": name, "nominal_s": leg.nominal_s, "first": first, "points": len(leg.xyz_m)},
            **stands_of(leg),
            "of_work": [{"group": _group(group), **stands_of(leg.of_group(group))} for group in leg.by_work],
        }
        first += len(leg.xyz_m)
    arrays["stands"] = np.array(stands, np.float32)
    return found


def _group(group: Group) -> dict[str, Any]:
    """Return a group of executions for the script, which names it by this kind, start and places."""
    if isinstance(group, Work):
        return {"kind": "work", "start": group.start, "places": group.visits}
    if isinstance(group, StandstillKind):  # no order is of it
        return {"kind": "kind", "start": None, "places": [str(group.number), str(group.executions)]}
    return {"kind": "places" if isinstance(group, frozenset) else "order", "start": None, "places": list(group)}


def _support(dataset: Dataset, paths: Floats, people: Floats, arrays: Arrays, *, spots: bool) -> dict[str, Any]:
    """Put the cells of points and of people's positions into `arrays`; return how many cells of operators there are.

    `support` (R, H) says which pairs of cells were logged. The operator is away where he slows the robot nowhere:
    that is asked at `spots`, a decimetre apart, as `whatif` does.
    """
    absent = ~np.isfinite(people[:, 0])
    on_floor = np.where(np.isnan(people), 0.0, people)  # an unknown height is that of the floor there
    robots, arrays["robot_cells"] = _numbered(np.floor(paths / ROBOT_M))
    humans, arrays["people_cells"] = _numbered(np.floor(on_floor / HUMAN_M), absent)
    middles = (robots + 0.5) * ROBOT_M, (humans + 0.5) * HUMAN_M
    rows, columns = np.repeat(middles[0], len(humans), axis=0), np.tile(middles[1], (len(robots), 1))
    arrays["support"] = logged_support(dataset).near_logged(rows, columns).astype(np.uint8)
    if spots:
        at, spots_m = grid_positions(people)
        arrays["people_spots"] = np.where(absent, NOBODY, at).astype(np.uint16)
        arrays["spots"] = spots_m.astype(np.float32)
    return {"operators": len(humans)}


def _numbered(
    cells: NDArray[np.float64], absent: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.uint16]]:
    """Return the cells that occur (C, 3), and the number of the cell of each row (N,); NOBODY where `absent`."""
    found, number = np.unique(cells, axis=0, return_inverse=True)
    return found, (number if absent is None else np.where(absent, NOBODY, number)).astype(np.uint16)


def _corrected(
    check: Check | None,
    dataset: Dataset,
    tracks: OperatorTracks,
    legs: Mapping[str, NominalTask],
    arrays: Arrays,
    *,
    pooled: bool,
) -> dict[str, Any]:
    """Return the corrections of a rollout: bias, logged durations of tasks (`pooled`), and resampled executions."""
    executions, which = np.unique(np.array(tracks.executions), return_inverse=True)
    together = TOGETHER if tracks.runs_on else 1
    arrays["execution"] = which.astype(np.uint16)
    arrays["drawn"] = resampled_alike(tracks.executions, executions.tolist(), SEED, together=together).astype(np.uint8)
    judged = len(check.residuals) if check else 2
    drawn = np.random.default_rng(SEED + 1).standard_t(max(judged - 1, 1), RESAMPLES)
    arrays["errors"] = drawn.astype(np.float32)
    if check is None:
        alone = {"factor": 1.0, "network_error": 0.0, "unseen_error": 0.0, "spread": 1.0, "doubted_bias": 0.0}
        return {**alone, "order_error": None, "history": {}}
    if check.level is not None:
        arrays["level"] = check.level.resampled(tracks, SEED).astype(np.float32)
    arrays["residuals"] = check.residuals_of(len(tracks.executions)).astype(np.float32)
    names = ("factor", "network_error", "unseen_error", "spread", "doubted_bias", "order_error")
    fields = {name: getattr(check, name) for name in names}
    return {**fields, "history": _history(check, dataset, tracks, legs, together, arrays) if pooled else {}}


def _history(
    check: Check,
    dataset: Dataset,
    tracks: OperatorTracks,
    legs: Mapping[str, NominalTask],
    together: int,
    arrays: Arrays,
) -> dict[str, float]:
    """Return what each task took in the logs, s; `history` (tasks, resamples) in the resamples; empty: not weighed."""
    if check.order_error is None:
        return {}
    times = TaskTimes(dataset)
    weights = resampled_alike(tracks.executions, times.executions, SEED, together=together)
    known = [name for name in legs if times.knows([name])]
    arrays["history"] = np.array([times.resampled_s([name], weights) for name in known], np.float32)
    return {name: times.sum_s([name]) for name in known}
