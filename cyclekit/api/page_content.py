"""What `write_report` computes for a page: an order search, estimates, changes and the model's evaluation.

The logs may not answer all of it; what they cannot answer is in `refused`, with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, TypedDict, cast

from cyclekit.api.arguments import Place, Progress
from cyclekit.api.estimate import estimate_cycles
from cyclekit.api.evaluate import evaluate_model
from cyclekit.api.given import Sequences, estimator_model, jobs_of, sequences_of
from cyclekit.api.plan import plan_order
from cyclekit.api.whatif import changed_cycles
from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, CyclekitError, EstimateError
from cyclekit.estimate.answers import CycleEstimates, Refusal
from cyclekit.estimate.plan.jobs import Jobs
from cyclekit.estimate.plan.task_orders import TaskJobs
from cyclekit.estimate.whatif.change import Change
from cyclekit.learning.evaluation.evaluate import Evaluation
from cyclekit.learning.networks.cell import refuse_other_cell
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.task_times.saved import TaskTimesModel
from cyclekit.learning.unseen.model import UnseenOperator
from cyclekit.report import Tried

if TYPE_CHECKING:
    from cyclekit.estimate.plan.answer import OrderPlan
    from cyclekit.estimate.plan.task_orders import TaskOrderPlan
    from cyclekit.estimate.validation.check import Check
    from cyclekit.estimate.whatif.answer import WhatIf
    from cyclekit.estimate.whatif.answers import WhatIfAnswers

ORDER = "order found"
"""Name of the order found, among the sequences."""


class PageContent(TypedDict, total=False):
    """Content of a page besides the logs, by the argument names of `compose_report`."""

    estimates: CycleEstimates | tuple[()]
    evaluation: Evaluation | None
    check: Check | None
    what_if: Sequence[Tried]
    planned: OrderPlan | None
    missing: Sequence[str]
    refused: Sequence[Refusal]


class TaskPageContent(TypedDict, total=False):
    """Content of a page of task lists besides the logs, by the argument names of `report_tasks`."""

    estimates: CycleEstimates | None
    planned: TaskOrderPlan | None
    changed: Sequence[WhatIf]
    refused: Sequence[Refusal]


class _Given(TypedDict):
    """Options of a model's estimates, by the argument names of `estimate_cycles`."""

    validate: bool
    other_cell: bool


def of_tasks(
    model: TaskTimesModel,
    data: Dataset,
    sequences: Sequences | None,
    changes: list[Change],
    jobs: Jobs | TaskJobs | Place | None,
    takt_s: float | None,
    earlier: CycleEstimates | None,
) -> TaskPageContent:
    """Return the content of the report of a model of task times, by the argument names of `report_tasks`."""
    wanted = [] if sequences is None else sequences_of(sequences)
    refused = list[Refusal]()
    planned = None
    if jobs is not None:
        order = partial(plan_order, model, data, jobs)
        planned = cast("TaskOrderPlan | None", _searched(order, refused, needed=not wanted))
    asked = [*wanted, *([TaskSequence.of_plan(ORDER, planned.tasks)] if planned else [])]
    if changes and not asked:
        raise ConfigError("changes are tried on sequences, and none are given", cure="Give sequences or jobs.")
    found = earlier
    if asked and (found is None or planned):
        found = estimate_cycles(model, data, asked, takt_s=takt_s)
    changed = changed_cycles(model, data, _answered(asked, found), changes) if changes else None
    refused = [*(found.refused if found else ()), *refused, *(changed.refused if changed else ())]
    return {"estimates": found, "planned": planned, "changed": list(changed or ()), "refused": refused}


def _searched(
    search: Callable[[], OrderPlan | TaskOrderPlan], refused: list[Refusal], *, needed: bool
) -> OrderPlan | TaskOrderPlan | None:
    """Return the result of an order search; None if the logs cannot answer it and something else is asked for."""
    try:
        return search()
    except EstimateError as error:
        if needed:
            raise
        refused.append(Refusal(ORDER, error, "order"))
    return None


def _answered(asked: list[TaskSequence], found: CycleEstimates | None) -> list[TaskSequence]:
    """Return the sequences that have an estimate."""
    names = {each.name for each in found or ()}
    return [each for each in asked if each.name in names]


class Asked:
    """Common inputs of the parts of one page."""

    def __init__(
        self,
        model: TrainedModel | UnseenOperator,
        data: Dataset,
        validate: bool,
        extrapolate: bool,
        other_cell: bool,
        tell: Progress,
    ) -> None:
        refuse_other_cell(model.card, data, other_cell=other_cell)
        self.model, self.data, self.extrapolate, self.tell = model, data, extrapolate, tell
        self.takt_s: float | None = None
        self.given: _Given = {"validate": validate, "other_cell": other_cell}

    def found(
        self,
        sequences: Sequences | None,
        changes: list[Change],
        tried: list[Tried],
        jobs: Jobs | TaskJobs | Place | None,
        estimates: CycleEstimates | None,
        evaluation: Evaluation | None,
    ) -> PageContent:
        """Return the content of the page besides the logs, by the argument names of `compose_report`.

        Raises:
            CyclekitError: A requested part cannot be computed.
        """
        given = [] if sequences is None else sequences_of(sequences)
        refused, planned = list[Refusal](), None
        if jobs is not None:
            planned = cast("OrderPlan | None", _searched(partial(self._planned, jobs), refused, needed=not given))
        wanted = _with_order(given, planned)
        known = {one.name for one in (*(estimates or ()), *(estimates.refused if estimates else ()))}
        if any(each.name not in known for each in wanted):
            estimates = self._estimated(wanted)
        check = estimates.check if estimates else None
        refused = [*(estimates.refused if estimates else ()), *refused]
        if changes:
            if not wanted:
                raise ConfigError("changes are tried on sequences, and none are given", cure="Give sequences or jobs.")
            changed = self._changed(_answered(wanted, estimates), changes, check)
            tried += [Tried.of(each, self.takt_s) for each in changed]
            refused += changed.refused
        missing: list[str] = []
        if evaluation is None and isinstance(self.model, TrainedModel):
            try:
                evaluation = self._evaluated(self.model)
            except CyclekitError as error:  # the evaluation was not requested
                missing.append(f"The model could not be evaluated: {error.seen.removesuffix('.')}.")
        return {
            "estimates": estimates or (),
            "evaluation": evaluation,
            "check": check,
            "what_if": tried,
            "planned": planned,
            "missing": missing,
            "refused": refused,
        }

    def _planned(self, jobs: Jobs | TaskJobs | Place) -> OrderPlan:
        found = plan_order(self.model, self.data, jobs_of(jobs), progress=part_of(self.tell, 0.0, 0.1), **self.given)
        return cast("OrderPlan", found)  # the jobs are places

    def _estimated(self, wanted: list[TaskSequence]) -> CycleEstimates:
        tell = part_of(self.tell, 0.1, 0.2)
        return estimate_cycles(
            self.model, self.data, wanted, takt_s=self.takt_s, extrapolate=self.extrapolate, progress=tell, **self.given
        )

    def _changed(self, wanted: list[TaskSequence], changes: list[Change], check: Check | None) -> WhatIfAnswers:
        tell = part_of(self.tell, 0.2, 0.3)
        return changed_cycles(
            estimator_model(self.model), self.data, wanted, changes, check=check, extrapolate=self.extrapolate,
            progress=tell, **self.given,
        )  # fmt: skip

    def _evaluated(self, model: TrainedModel) -> Evaluation:
        foreign, tell = self.given["other_cell"], part_of(self.tell, 0.3, 0.35)
        return evaluate_model(model, self.data, boosting=False, other_cell=foreign, progress=tell)


def part_of(tell: Progress, begin: float, end: float) -> Callable[[float, str], None]:
    """Return a progress function that covers a part of another."""
    return lambda fraction, text: tell(begin + (end - begin) * min(fraction, 1.0), text)


def _with_order(sequences: list[TaskSequence], planned: OrderPlan | None) -> list[TaskSequence]:
    """Return the sequences with the order found, unless it is one of them."""
    if planned is None:
        return sequences
    order = planned.sequence(ORDER)
    alike = [each for each in sequences if each.places == order.places and each.operator is None]
    if alike:
        return [replace(each, allowance=order.allowance) if each in alike else each for each in sequences]
    names = {each.name for each in sequences}
    name = next(name for n in count(1) if (name := ORDER if n == 1 else f"{ORDER} {n}") not in names)
    return [*sequences, replace(order, name=name)]
