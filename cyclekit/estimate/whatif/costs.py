"""Cost of each number of the safety function: the change of the expected cycle time with the same operators.

Each number is moved to either side and the same cycles are rolled out again. The steps are larger than the reported
unit: few operators cross a threshold that moves by 1 cm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.estimate.cycle.engine import FINE_STEP_S
from cyclekit.estimate.robot.safety import Dynamics
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.validation.question import Altered
from cyclekit.estimate.whatif.answer import NO_PROOF, paired_savings
from cyclekit.estimate.whatif.separation import margins_of, refuse_other_thresholds
from cyclekit.learning.rules.samples.quantities import outwards, quantities, released, shifted
from cyclekit.text.numbers import exact_percent, signed
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.whatif.separation import Margins, Separation
    from cyclekit.learning.rules.safety import RuleSafety
    from cyclekit.learning.rules.samples.quantities import RulePlace
    from cyclekit.schema import Progress

BY_M = 0.05
"""Step of thresholds, edges and the hysteresis to either side, m."""
BY_RATE = 0.1
"""Step of ramps: the larger of this, in 1/s, and this share of the rate."""
RAMPS = {"recovery": "ramp_up_per_s", "braking": "ramp_down_per_s"}
EDGES = ("x from", "x to", "y from", "y to")


@dataclass(frozen=True)
class ParameterCost:
    """Cost of one number of the safety function.

    Attributes:
        parameter: threshold, edge, hysteresis, reaction time, recovery (ramp up) or braking (ramp down).
        level: Level of its limit, 0 to 1; None if it applies to all limits.
        where: Distance or edge that it applies to.
        value: Value in the logs, in `unit`.
        unit: m, s, or 1/s of the scaling.
        step: Step of the number that has this cost; for thresholds and edges, a region larger by 0.01 m.
        costs_s: Increase of the cycle time, s.
        standard_error_s: Standard error of the increase, from resampled operators.
    """

    parameter: str
    level: float | None
    where: str
    value: float
    unit: str
    step: float
    costs_s: float
    standard_error_s: float


@dataclass(frozen=True)
class SequenceCosts:
    """One sequence: its expected cycle time by the rule, not corrected by logged executions, and the costs."""

    sequence: str
    expected_s: float
    parameters: tuple[ParameterCost, ...]


@dataclass(frozen=True, repr=False)
class SafetyCosts(Result):
    """Costs of the numbers of the safety function, and margins to the protective separation distance.

    Attributes:
        sequences: One for each sequence.
        margins: Margins; None if the separation distance was not requested.
        notes: What is missing, and why.
        safety: Note that this is no safety proof.
    """

    sequences: tuple[SequenceCosts, ...]
    margins: Margins | None = None
    notes: tuple[str, ...] = ()
    safety: str = NO_PROOF

    def _frame_rows(self) -> list[dict[str, object]]:
        return [{"sequence": each.sequence} | vars(one) for each in self.sequences for one in each.parameters]

    def _lines(self) -> list[str]:
        rows = [(each.sequence, one) for each in self.sequences for one in each.parameters]
        told = [
            f"{name!r}, {parameter_label(one)}, {step_label(one)}: {signed(one.costs_s, 3)} s" for name, one in rows
        ]
        return [self.safety, *told]


def parameter_label(cost: ParameterCost) -> str:
    """Return the name of a number of the rule in a row of a table."""
    if cost.level is None:
        return cost.parameter
    return f"{'stop' if cost.level == 0.0 else exact_percent(cost.level)}, {cost.where}"


def step_label(cost: ParameterCost) -> str:
    """Return a step with its sign and unit: `+1 cm`, `+10 ms`, `+10 %/s`."""
    size, unit = {"m": (100, "cm"), "s": (1000, "ms"), "1/s": (100, "%/s")}[cost.unit]
    return f"{signed(size * cost.step, 0)} {unit}"


@dataclass(frozen=True)
class _Moved:
    """A number moved to either side: rule and dynamics of both sides, and the difference between them."""

    cost: ParameterCost
    less: tuple[RuleSafety, Dynamics]
    more: tuple[RuleSafety, Dynamics]
    apart: float


def costs_of(
    safety: RuleSafety,
    dataset: Dataset,
    sequences: Sequence[TaskSequence],
    *,
    separation: Separation | None = None,
    seed: int = 0,
    extrapolate: bool = False,
    other_cell: bool = False,
    progress: Progress | None = None,
) -> SafetyCosts:
    """Roll every sequence out with each number of the rule moved to either side.

    The arguments are described at `cyclekit.cost_of_safety_function`.

    Raises:
        ConfigError: The separation distance does not fit the rule.
        EstimateError: As in `estimate`.
        ModelError: As in `estimate`.
        UnknownName: A place does not exist.
    """
    if separation is not None:
        refuse_other_thresholds(safety.rule, separation)
    tell = progress or (lambda fraction, text: None)
    asked = partial(estimate, seed=seed, extrapolate=extrapolate, other_cell=other_cell, validate=False)

    def rolled(cell: tuple[RuleSafety, Dynamics]) -> dict[str, CycleEstimate]:
        altered = Altered(lambda tasks: tasks, lambda tracks, _: tracks, cell[1])
        return {one.name: one for one in asked(cell[0], dataset, sequences, altered=altered)}

    now = safety, Dynamics.of(dataset.card.dynamics, safety)
    before = rolled(now)
    found: dict[str, list[ParameterCost]] = {name: [] for name in before}
    every = list(_moved(*now))
    for number, moved in enumerate(every):
        tell(number / len(every), parameter_label(moved.cost))
        less, more = (before if cell == now else rolled(cell) for cell in (moved.less, moved.more))
        per = moved.cost.step / moved.apart
        for name, costs in found.items():
            adds, means = paired_savings(more[name], less[name], seed)
            error_s = float(means.std()) * abs(per)
            costs.append(replace(moved.cost, costs_s=float(adds.mean()) * per, standard_error_s=error_s))
    told = tuple(SequenceCosts(one.name, before[one.name].expected_s, tuple(found[one.name])) for one in sequences)
    notes = [f"{name}: the logs show no ramp" for name, key in RAMPS.items() if not getattr(now[1], key)]
    margins = None if separation is None else _margins(safety, separation, told, now[1].latency_s)
    return SafetyCosts(told, margins, tuple(notes))


def _margins(
    safety: RuleSafety, separation: Separation, found: Sequence[SequenceCosts], latency_s: float | None
) -> Margins:
    """Return the margins, each with the mean cost per centimetre over the sequences."""
    rows = [one for each in found for one in each.parameters if one.parameter == "threshold"]
    costs_s: dict[tuple[float | None, str], float] = {}
    for row in rows:
        key = row.level, row.where
        costs_s[key] = costs_s.get(key, 0.0) + row.costs_s / len(found)
    return margins_of(safety.rule, separation, costs_s, latency_s)


def _moved(safety: RuleSafety, dynamics: Dynamics) -> Iterator[_Moved]:
    """Yield every number of the rule and of the response, moved; ramps missing in the logs are left out."""
    limits = safety.rule.limits
    for place, metres in quantities(limits).items():
        if not place.until:
            side = outwards(place)
            less, more = (safety.with_limits(shifted(limits, place, by * side)) for by in (-BY_M, BY_M))
            cost = _unknown(*_place(safety, place), metres.value, "m", 0.01 * side)
            yield _Moved(cost, (less, dynamics), (more, dynamics), 2 * BY_M * side)
    yield from _hysteresis(safety, dynamics)
    late_s = dynamics.latency_s or 0.0
    first = max(0.0, late_s - FINE_STEP_S)  # the latency in a rollout is a whole number of steps
    with_partial_latency, later = (replace(dynamics, latency_s=first + by) for by in (0.0, 2 * FINE_STEP_S))
    cost = _unknown("reaction time", None, "", late_s, "s", 0.01)
    yield _Moved(cost, (safety, with_partial_latency), (safety, later), 2 * FINE_STEP_S)
    for name, key in RAMPS.items():
        if rate := getattr(dynamics, key):
            by = max(BY_RATE, BY_RATE * rate)
            steeper = replace(dynamics, **{key: rate + by})
            cost = _unknown(name, None, "", rate, "1/s", 0.1)
            yield _Moved(cost, (safety, dynamics), (safety, steeper), by)


def _hysteresis(safety: RuleSafety, dynamics: Dynamics) -> Iterator[_Moved]:
    """Yield the hysteresis of all limits together; one of 0 is only increased."""
    inner = quantities(safety.rule.limits)
    if not inner:
        return
    both = [(at, at._replace(until=False)) for at in inner if at.until and at._replace(until=False) in inner]
    margins = [outwards(at) * (inner[at].value - inner[entered].value) for at, entered in both]
    held_m = float(np.median(margins)) if margins else 0.0
    by = min(BY_M, max(held_m, 0.0))
    if margins:
        less, more = (safety.with_limits(released(safety.rule.limits, way)) for way in (-by, BY_M))
    else:
        less, more = safety, safety.with_hysteresis(BY_M)
    cost = _unknown("hysteresis", None, "", held_m, "m", 0.01)
    yield _Moved(cost, (less, dynamics), (more, dynamics), by + BY_M)


def _place(safety: RuleSafety, place: RulePlace) -> tuple[str, float, str]:
    limit = next(limit for limit in safety.rule.limits if limit.scaling == place.level)
    if place.kind == "nearer":
        return "threshold", place.level, limit.within.nearer[place.item].distance
    return "edge", place.level, EDGES[place.edge] if place.kind == "rectangle" else f"{place.kind} {place.edge + 1}"


def _unknown(parameter: str, level: float | None, where: str, value: float, unit: str, per: float) -> ParameterCost:
    return ParameterCost(parameter, level, where, value, unit, per, 0.0, 0.0)
