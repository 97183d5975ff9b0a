"""What the script needs where robot and operator wait for each other: gates, walks and stays, tasks and the rule.

The script puts the agendas of `estimate.joint` together itself, draws the same numbers, and walks every cycle.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import CouplingCard
from cyclekit.errors import EstimateError
from cyclekit.estimate.joint.answer import CYCLES, RESAMPLES, pace_errors, resample_counts, session_shifts
from cyclekit.estimate.joint.check import JointCheck
from cyclekit.estimate.joint.draws import NEAR
from cyclekit.estimate.joint.legs import Gates, event_kind, precedence_needs
from cyclekit.estimate.joint.levels import WALK, WORK, Levels
from cyclekit.estimate.joint.plans import Planner
from cyclekit.estimate.joint.repetitions import cycles_per_resample
from cyclekit.estimate.joint.roll import LEFT_OUT, REST_S, TIMES, JointCell
from cyclekit.estimate.joint.shares import MIN_WAIT_S
from cyclekit.estimate.operator.tracks import OperatorTracks
from cyclekit.estimate.robot.nominal import nominal_tasks
from cyclekit.estimate.whatif.coupled import shown as wait_name
from cyclekit.learning.coupling.events.trips import soonest_s
from cyclekit.learning.coupling.pace.common_pace import MAX_SHARE
from cyclekit.learning.coupling.pace.pace import OUTLIER
from cyclekit.learning.out_of_core import in_memory
from cyclekit.report.play.tables import SEED, scaling_source, settings_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.config.sequences import PlannedTask
    from cyclekit.dataset.cards import SourceCard
    from cyclekit.dataset.cards.coupling import CommonPaceCard
    from cyclekit.estimate.joint.visits import Segments
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.robot.nominal import NominalTask
    from cyclekit.estimate.robot.safety import SafetyModel
    from cyclekit.estimate.validation.check import Check
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.play.tables import Arrays, Tables
    from cyclekit.schema import Floats

PACES = (0.8, 1.5)
"""Minimum and maximum factor on the speed of the operator."""
MAX_PARTS = 10
"""Maximum number of parts of a source in advance, unless the cell has more."""


def played_together(page: PageInputs, *, waits: bool) -> list[CycleEstimate]:
    """Return the sequences that both agents were rolled out for: all where one waits for the other, else the plans."""
    return [each for each in page.ranked if each.estimator == "rollout" and (waits or each.asked)]


def tables_of_both(page: PageInputs, model: SafetyModel, shown: Sequence[CycleEstimate]) -> Tables:
    """Return facts (plain JSON values) and arrays for sequences of both agents.

    Raises:
        CyclekitError: There is no operator track, or the tables would be too large.
    """
    card = model.card.coupling or CouplingCard()
    dataset, _ = in_memory(page.dataset)
    legs = nominal_tasks(dataset)
    cell = JointCell(model, dataset, card)
    if cell.unseen:
        seen = "no log shows the operator, and without his places other orders cannot be played here"
        raise EstimateError(seen, cure="Ask estimate, plan and whatif.")
    arrays: Arrays = {}
    planner = Planner(cell, legs)
    sequences = [_sequence(each, planner) for each in shown]
    went = [{"robot": robot, "operator": operator} for robot, operator in planner.logged_orders]
    went += _composed(planner, [each for each in shown if not each.asked and each.operator is None])
    orders = [each["operator"] for each in sequences]
    places = {place for order in orders for place in order or ()}
    if None in orders:
        places |= {place for each in went for place in each["operator"]}
    places |= {gate.wait_at for gate in card.gates if gate.wait_at is not None}
    walks, stays = _drawn(cell.segments, sorted(places), in_order=bool(card.common and card.common.walk))
    trips = _trips(cell.segments, sorted(places), card)
    ways = [numbers for goals in walks.values() for numbers in goals.values()]
    after = {place: cell.segments.after(place).tolist() for place in sorted(places)}
    xyz_m, segments = _used(cell.segments, [*ways, *stays.values(), *trips.values(), *after.values()])
    nothing = np.zeros((1, len(xyz_m)), np.int64)
    tracks = OperatorTracks(xyz_m[None], nothing, (), np.array([len(xyz_m)]), ("",), 1.0 / dataset.rate_hz)
    facts = settings_of(page, model, dataset, tracks) | {
        "kind": "both",
        "seed": SEED,
        "executions": cell.executions,
        "cycles": CYCLES,
        "rest_s": REST_S,
        "times": TIMES,
        "left_out": LEFT_OUT,
        "midway_s": MIN_WAIT_S,
        "sequences": sequences,
        "gates": _gates(card),
        "sources": [_source(each) for each in card.sources],
        "work_s": {place: np.round(works, 4).tolist() for place, works in cell.work_s.items()},
        "first_stays_s": {place: np.round(stays, 4).tolist() for place, stays in cell.first_stays_s.items()},
        "walks": walks,
        "stays": stays,
        "after": after,
        "trips": trips,
        "near_trips": NEAR,
        "segments": segments,
        "common": _common(card.common, arrays),
        "went": went if None in orders else [],
        "waited_for": sorted(planner.waited_for),
        "paces": PACES,
        "most_parts": MAX_PARTS,
    }
    source = scaling_source(model, dataset, legs, tracks, arrays)
    gates = Gates(card)
    paced = max(pace_errors(cell, planner, [_asked_as(shown[0])], seed=SEED).values(), default=0.0)
    corrected = _corrected(shown[0].check, cycles_per_resample(cell), arrays, paced)
    facts |= source | {"legs": _legs(legs, gates), "check": corrected}
    return facts, arrays


def _composed(planner: Planner, shown: Sequence[CycleEstimate]) -> list[dict[str, Any]]:
    """Return composed orders as if logged, once per number of coupled visits; none if their order matters as well."""
    if len(planner.waited_for) != 1:
        return []
    (place,) = planner.waited_for
    by_count = {each.places[1:].count(place): each.places for each in shown}
    return [
        {"robot": places, "operator": order}
        for places in by_count.values()
        for order in planner.composed(TaskSequence("", places))
    ]


def _asked_as(each: CycleEstimate) -> TaskSequence:
    """Return what an estimate was asked of."""
    if each.asked:
        return TaskSequence.of_plan(each.name, each.asked)
    return TaskSequence(each.name, each.places, each.operator)


def _sequence(each: CycleEstimate, planner: Planner) -> dict[str, Any]:
    """Return the work of each agent; `operator` None: what operators did in logged executions of this work."""
    if not each.asked:
        return {"name": each.name, "robot": each.places, "operator": each.operator, "both": False}
    plan = TaskSequence.of_plan(each.name, each.asked)
    names = [task.name for task in plan.plan if task.agent == "robot"]
    operator = [task.name for task in plan.plan if task.agent == "operator"]
    found = {"name": each.name, "robot": planner.chained(names, plan.shown), "operator": operator, "both": True}
    if any(task.after or task.not_before_s for task in each.asked):
        found["asked"] = _asked(each.asked, plan.shown)
    return found


def _asked(plan: Sequence[PlannedTask], where: str) -> dict[str, list[dict[str, Any]]]:
    """Return the tasks of each agent with earliest start and predecessors; `number` identifies a task of the plan."""
    tasks: dict[str, list[dict[str, Any]]] = {"robot": [], "operator": []}
    numbers = defaultdict[tuple[str, str], list[int]](list)
    for number, task in enumerate(plan):
        numbers[task.agent, task.name].append(number)
    for number, needs in precedence_needs(plan, where).items():
        task = plan[number]
        events = [need.event for need in needs]
        after = [{"number": numbers[who, name][turn], "agent": who, "name": name} for who, name, _, turn in events]
        planned = {"number": number, "name": task.name, "after": after, "not_before_s": task.not_before_s or 0.0}
        tasks[task.agent].append(planned)
    return tasks


def _common(common: CommonPaceCard | None, arrays: Arrays) -> dict[str, Any] | None:
    """Return what durations of one cycle share; put the normal scores and the shifts of the sessions into `arrays`."""
    if common is None:
        return None
    arrays["normal"] = Levels(SEED, CYCLES).scores.astype(np.float32)
    if (shifts := session_shifts(SEED, common)) is not None:
        arrays["shifts"] = shifts.astype(np.float32)
    spread = {name: getattr(common, name) for name in ("work", "walk", "together")}
    return spread | {"keys": (WORK, WALK), "most": MAX_SHARE, "outlier": OUTLIER}


def _drawn(
    segments: Segments, places: list[str], *, in_order: bool
) -> tuple[dict[str, dict[str, list[int]]], dict[str, list[int]]]:
    """Return the numbers of the walks between any two places, the shortest first if in order, and of the stays."""
    walks: dict[str, dict[str, list[int]]] = {start: {} for start in ("", *places)}
    for start, goal in product(("", *places), places):
        found = segments.walk(start, goal)
        order = np.argsort(segments.durations_s(found), kind="stable") if in_order else np.arange(len(found))
        walks[start][goal] = found[order].tolist()
    return walks, {place: segments.stay(place).tolist() for place in places}


def _trips(segments: Segments, places: Sequence[str], card: CouplingCard) -> dict[str, list[int]]:
    """Return the numbers of the trips from each place, the shortest first; empty where he makes none."""
    if all(gate.trip is None for gate in card.gates):
        return {}
    found = {place: segments.trip(place) for place in places}
    return {place: some[np.argsort(segments.durations_s(some))].tolist() for place, some in found.items()}


def _used(segments: Segments, lists: Sequence[list[int]]) -> tuple[Floats, list[list[float]]]:
    """Return the positions of these segments (M, 3); renumber them.

    Also returned are first row, count, and duration now relative to the logged one, of each.
    """
    xyz_m, first, count = segments.table()
    used = sorted({0, *(number for numbers in lists for number in numbers)})
    anew = {number: n for n, number in enumerate(used)}
    for numbers in lists:
        numbers[:] = [anew[number] for number in numbers]
    rows = [xyz_m[first[number] : first[number] + count[number] + 1] for number in used]
    begins = np.cumsum([0, *(len(each) for each in rows[:-1])])
    stretch = segments.stretch[used].tolist()
    told = zip(begins.tolist(), count[used].tolist(), stretch, strict=True)
    return np.concatenate(rows), [[begin, length, round(longer, 6)] for begin, length, longer in told]


def _said(*event: str) -> str:
    """Return an event as the draws name it."""
    return str(event)


def _source(source: SourceCard) -> dict[str, Any]:
    fields = {name: getattr(source, name) for name in ("signal", "gap_s", "first_s", "buffer", "taken_by")}
    kind = "arrives" if source.inferred else "set"
    return {**fields, "kind": kind, "said": _said("robot", source.taken_by, "leaves")}


def _gates(card: CouplingCard) -> list[dict[str, Any]]:
    found = []
    told = ("agent", "place", "back", "needed", "together", "common", "lag_s")
    for gate in card.gates:
        conditions = [
            {
                **{name: getattr(one, name) for name in told},
                "soonest_s": soonest_s(one.lag_s),
                "kind": event_kind(one),
                "said": _said(one.agent, one.place, event_kind(one)),
                "turns": {name: getattr(one.turns, name) for name in ("every", "first", "event_every", "event_first")},
            }
            for one in gate.conditions
        ]
        of_gate = ("agent", "at", "place", "phase", "own_s", "wait_at", "wait_from")
        fields = {name: getattr(gate, name) for name in of_gate}
        own_by = [{"side": one.side, "place": one.place, "own_s": one.own_s} for one in gate.own_by]
        of_trip = ("places", "waiting", "free", "took_s", "late_s")
        trip = gate.trip and {name: getattr(gate.trip, name) for name in of_trip}
        found.append({**fields, "own_by": own_by, "name": wait_name(gate), "conditions": conditions, "trip": trip})
    return found


def _legs(legs: Mapping[str, NominalTask], gates: Gates) -> dict[str, Any]:
    """Return each task with its place in the points."""
    found, first = {}, 0
    for name, leg in legs.items():
        own = gates.own_s("robot", name.partition("->")[2])
        found[name] = {
            "nominal_s": leg.nominal_s,
            "first": first,
            "points": len(leg.xyz_m),
            "stands_s": np.round(leg.standstill_s, 4).tolist() if own is None else [],
            "logged": len(leg.standstill_s),
        }
        first += len(leg.xyz_m)
    return found


def _corrected(check: Check | None, count: int, arrays: Arrays, paced: float) -> dict[str, float]:
    """Return the corrections of a rollout, with the error of his latest pace; put resamples into `arrays`."""
    judged = len(check.residuals) if check else 2
    arrays["drawn"] = resample_counts(SEED, count).astype(np.uint8)
    arrays["errors"] = np.random.default_rng(SEED + 1).standard_t(max(judged - 1, 1), RESAMPLES).astype(np.float32)
    if not isinstance(check, JointCheck):
        return {"factor": 1.0, "model_error": paced, "doubted_bias": 0.0, "widening": 1.0}
    for name in ("scores", "ranks"):
        if told := getattr(check, name):
            arrays[name] = np.array(told, np.float32)
    told = {name: getattr(check, name) for name in ("factor", "doubted_bias", "widening", "least_spread")}
    return {**told, "model_error": float(np.hypot(check.model_error, paced))}
