"""Expected cycle time of task sequences, by one of these estimators.

rollout   simulation of the learned safety function with logged operator tracks (`walk`, `transit`), or of both agents
          if one waits for the other (`joint`)
average   the paper's method: the mean scaling over a task's horizon (`estimators`)
history   sums of logged task durations (`estimators`)
nominal   no operator in the cell (`estimators`)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from cyclekit.errors import EstimateError, ModelError, UnknownName
from cyclekit.estimate.cycle.estimators import ESTIMATORS
from cyclekit.estimate.cycle.walk import Rolled, roll_out
from cyclekit.estimate.cycles import cycles_of
from cyclekit.estimate.entry import entry_of
from cyclekit.estimate.interludes import robot_interludes, robot_order, with_interludes
from cyclekit.estimate.joint.answer import estimate_both, waits_are_known
from cyclekit.estimate.joint.check import JointCheck
from cyclekit.estimate.limits import (
    coarse_of,
    limits_of_cycles,
    limits_of_logs,
    no_answer,
    refuse_biased,
    refuse_unknown_mover,
    validated,
    with_work,
)
from cyclekit.estimate.operator.tracks import OperatorTracks
from cyclekit.estimate.ranked import Unranked, ranked
from cyclekit.estimate.robot.nominal import NominalTask, nominal_tasks
from cyclekit.estimate.robot.program import Program, lay_out
from cyclekit.estimate.robot.signal_states import on_states_of
from cyclekit.estimate.soundness import findings_of
from cyclekit.estimate.statistics.resample import TOGETHER, resampled
from cyclekit.estimate.validation.means import (
    BesideRollout,
    history_of,
    level_of,
    means_of,
    order_effect_for,
    visit_effect_for,
)
from cyclekit.estimate.validation.question import LAID_OUT, ROLLED, VALIDATED, Altered, Question
from cyclekit.learning.networks.cell import refuse_other_cell, trained_on
from cyclekit.learning.out_of_core import in_memory
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.parallel.one_thread import one_thread

if TYPE_CHECKING:
    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.robot.safety import SafetyModel
    from cyclekit.estimate.validation.check import Check
    from cyclekit.schema import Floats, Progress

    _Refuse = Callable[[TaskSequence, EstimateError], None]

__all__ = ["ESTIMATORS", "estimate", "lay_out", "roll_out"]


@one_thread()
def estimate(
    model: SafetyModel,
    dataset: Dataset,
    sequences: Sequence[TaskSequence],
    *,
    estimator: str | None = None,
    quantiles: Sequence[float] = (0.05, 0.5, 0.95),
    takt_s: float | None = None,
    seed: int = 0,
    extrapolate: bool = False,
    validate: bool = True,
    check: Check | None = None,
    other_cell: bool = False,
    altered: Altered | None = None,
    engine: Engine = LOCAL,
    refused: Callable[[TaskSequence, EstimateError], None] | None = None,
    progress: Progress | None = None,
) -> list[CycleEstimate]:
    """Return the expected cycle time of each sequence, grouped by work, shortest first.

    Every command, the fleet and Python call this function, so that one question has one number. A rollout is validated
    on logged executions and corrected by its bias there; the same executions are used for every caller.

    The arguments are described at `cyclekit.estimate_cycles`. In addition: an `altered` cell is simulated in this
    process without a validation. `refused` is called with each sequence that these logs cannot answer and the reason;
    the others are answered as if only they were asked for. Without it the error of the first such sequence is raised.

    Raises:
        ModelError: The model does not predict what the estimator needs, was trained on another cell, or has a large
            bias on the logged executions.
        UnknownName: A place or the estimator does not exist.
        EstimateError: A task was never logged, there is no operator track, or the support is too low.
    """
    dataset.require_positions()
    if short := [each for each in sequences if len(each.places) < 2]:
        raise EstimateError(f"{short[0].shown}: fewer than two places", cure="Name the start, then each goal.")
    refuse_unknown_mover(dataset)
    chosen = _chosen(model, estimator)
    model = on_states_of(model, dataset)
    if ESTIMATORS[chosen].needs is not None:
        refuse_other_cell(model.card, dataset, other_cell=other_cell)
    ask = Question(model, dataset, chosen, tuple(quantiles), takt_s, seed, extrapolate, check, altered, engine)
    both = [each for each in sequences if chosen == "rollout" and (each.plan or waits_are_known(model, altered))]
    others = [each for each in sequences if each not in both]
    found, done = list[Unranked](), 0
    for estimated, some in ((estimate_both, both), (_estimate_robot, others)):

        def tell(fraction: float, text: str, first: int = done, count: int = len(some)) -> None:
            if progress is not None:
                progress((first + fraction * count) / len(sequences), text)

        if some:
            found += estimated(
                ask, some, validate=validate, other_cell=other_cell, refuse=refused or _raised, tell=tell
            )
        done += len(some)
    logged = robot_interludes(dataset) if found else ()
    return ranked([one._replace(entry=with_interludes(one.entry, logged, robot_order(one.entry))) for one in found])


def _estimate_robot(
    ask: Question,
    sequences: Sequence[TaskSequence],
    *,
    validate: bool,
    other_cell: bool,
    refuse: _Refuse,
    tell: Progress,
) -> list[Unranked]:
    """Return estimates of the robot alone, beside logged operators; the arguments are those of `estimate_both`."""
    model, altered, chosen, check = ask.model, ask.altered, ask.estimator, ask.check
    dataset, left_out = in_memory(ask.dataset)
    wanted = None if altered else {task for sequence in sequences for task in sequence.tasks}
    nominal: Mapping[str, NominalTask] = nominal_tasks(dataset, wanted)
    nominal = altered.tasks(nominal) if altered else nominal
    programs = _laid_out(sequences, nominal, dataset, refuse)
    if not programs:
        return []
    tell(LAID_OUT, "validating on logged executions")
    unknown = ""
    if isinstance(check, JointCheck):  # the bias of another kind of rollout
        check = None
    if chosen != "rollout":
        check = None
    elif check is None and validate and altered is None:
        check, unknown = validated(model, dataset, levels=ask.quantiles, seed=ask.seed)
    if not other_cell:
        refuse_biased(check, own=trained_on(model.card, dataset))
    ask = replace(ask, dataset=dataset, check=check)
    limits = [*([left_out] if left_out else []), *limits_of_logs(dataset, model)]
    shown = dataset if ESTIMATORS[chosen].needs is not None else None
    effect, visits = order_effect_for(ask), visit_effect_for(ask)

    def rolling(fraction: float, text: str) -> None:
        tell(VALIDATED + (ROLLED - VALIDATED) * fraction, text)

    found: list[Unranked] = []
    for operator in dict.fromkeys(sequence.operator for sequence in sequences):
        some = {sequence: program for sequence, program in programs.items() if sequence.operator == operator}
        mine, rolled, tracks = _answered(ask, some, rolling, refuse)
        if not mine:
            continue
        weights = _weights(ask, rolled[0], tracks)
        level = level_of(ask, tracks)
        beside = BesideRollout(history_of(ask, tracks), effect, visits) if operator is None else None
        for sequence, cycles in zip(mine, rolled, strict=True):
            tasks = programs[sequence].tasks
            pooled = None if any(task.by_work for task in tasks) else beside  # of all works
            mean = means_of(ask, sequence, cycles, weights, level, pooled)
            entry = entry_of(ask, sequence, programs[sequence], cycles, tracks, weights, mean)
            entry, of_other_work, of_work = with_work(entry, tasks)
            known = findings_of(
                model, check, shown, executions=entry.executions if entry.tracks else 0, support=entry.support,
                validated=unknown if chosen == "rollout" and altered is None else None,
            )  # fmt: skip
            findings = (*of_other_work, *coarse_of(cycles, entry), *known)
            mine_alone = (*of_work, *limits_of_cycles(cycles))
            entry = replace(entry, findings=findings, limits=(*mine_alone, *limits))
            found.append(Unranked(entry, mean.resampled_s, last=not cycles.simulated))
            tell(ROLLED + (1.0 - ROLLED) * len(found) / (len(programs) + 1), sequence.name)
    tell(1.0, "done")
    return found


def _chosen(model: SafetyModel, estimator: str | None) -> str:
    if estimator is None:
        estimator = "average" if model.problem == "average" else "rollout"
    if estimator not in ESTIMATORS:
        raise UnknownName("estimate", "estimator", estimator, ESTIMATORS)
    needs = ESTIMATORS[estimator].needs
    if needs is not None and model.problem != needs:
        msg = f"the model predicts problem {model.problem!r}; estimator {estimator!r} needs {needs!r}"
        raise ModelError(msg, cure=f"Train one: cyclekit train DATASET --problem {needs} --out MODEL")
    return estimator


def _raised(_: TaskSequence, error: EstimateError) -> None:
    raise error


def _laid_out(
    sequences: Sequence[TaskSequence], nominal: Mapping[str, NominalTask], dataset: Dataset, refuse: _Refuse
) -> dict[TaskSequence, Program]:
    programs = {}
    for sequence in sequences:
        try:
            programs[sequence] = lay_out(sequence, nominal, dataset)
        except EstimateError as error:
            refuse(sequence, error)
    return programs


def _answered(
    ask: Question, programs: Mapping[TaskSequence, Program], tell: Progress, refuse: _Refuse
) -> tuple[list[TaskSequence], list[Rolled], OperatorTracks | None]:
    """Return the sequences with an answer, the cycles of each, and their tracks (None without any).

    If some are refused, the others are simulated again: the slowest sequence sets the length of the tracks.
    """
    while programs:
        try:
            rolled, tracks, until_s = cycles_of(ask, list(programs), list(programs.values()), tell)
        except EstimateError as error:  # no tracks for any of them
            for sequence in programs:
                refuse(sequence, error)
            break
        problems = [no_answer(ask, *pair, until_s) for pair in zip(programs, rolled, strict=True)]
        if not any(problems):
            return list(programs), rolled, tracks
        for sequence, problem in zip(programs, problems, strict=True):
            if problem is not None:
                refuse(sequence, problem)
        left = zip(programs.items(), problems, strict=True)
        programs = dict(pair for pair, problem in left if problem is None)
    return [], [], None


def _weights(ask: Question, cycles: Rolled, tracks: OperatorTracks | None) -> Floats:
    """Return the weights of the cycles in each resample of the logs, shape (resamples, K)."""
    if tracks is None:  # cycles assembled from tasks: each draw counts on its own
        return resampled([str(k) for k in range(len(cycles.duration_s))], ask.seed)
    return resampled(tracks.executions, ask.seed, together=TOGETHER if tracks.runs_on else 1)
