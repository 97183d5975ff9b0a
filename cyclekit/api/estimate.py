"""`estimate_cycles`: the expected cycle time of task sequences, ranked."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.given import (
    Sequences,
    estimator_model,
    path_of,
    place_of,
    refuse_options_of_positions,
    sequences_of,
)
from cyclekit.api.workbooks import need_workbook, sheets_of_estimates
from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.guard import Kind, check_output
from cyclekit.errors import CyclekitError, EstimateError
from cyclekit.estimate.answers import CycleEstimates, Refusal, refusing, together
from cyclekit.estimate.gantt import write_gantt
from cyclekit.estimate.robot.safety import SafetyModel
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.estimate.validation.check import Check
from cyclekit.estimate.what_to_log import what_to_log
from cyclekit.learning.task_times.saved import TaskTimesModel
from cyclekit.parallel.engine import LOCAL, Engine
from cyclekit.plots.canvas import KINDS
from cyclekit.storage.atomic import write_text
from cyclekit.storage.workbook import write_workbook
from cyclekit.text.plain_json import json_text

_KINDS: dict[str, Kind] = {".csv": "estimates-csv", ".xlsx": "workbook"}
QUANTILES = (0.05, 0.5, 0.95)
"""Default quantile levels of single cycles."""


@checked
def estimate_cycles(
    model: SafetyModel | TaskTimesModel | Place,
    dataset: Dataset | Place,
    sequences: Sequences,
    *,
    out: Place | None = None,
    gantt: Place | None = None,
    estimator: str | None = None,
    quantiles: Sequence[float] = QUANTILES,
    takt_s: float | None = None,
    seed: int = 0,
    extrapolate: bool = False,
    validate: bool = True,
    check: Check | None = None,
    other_cell: bool = False,
    engine: Engine = LOCAL,
    progress: Progress | None = None,
) -> CycleEstimates:
    """Estimate the expected cycle time of each sequence, grouped by work, shortest first.

    Args:
        model: A model, its folder or its URL; one of task times answers plans for robot and operator.
        dataset: Logs that hold the tasks and the operator's tracks; a dataset, its folder or its URL.
        sequences: Sequences, or the sequence file.
        out: Also write the result here, `.json`, `.csv` or `.xlsx`.
        gantt: Also draw a time chart here, `.svg`, `.png` or `.pdf`.
        estimator: `rollout`, `average`, `history` or `nominal`; None: the default for the model.
        quantiles: Quantiles of single cycles, each in (0, 1).
        takt_s: Takt time, s; adds the share of cycles within it.
        seed: Seed of the resampling for the intervals.
        extrapolate: Answer even if most of the cycle is outside logged positions; the number is marked.
        validate: Validate on logged executions, and correct the bias.
        check: An earlier validation (`CycleEstimates.check`).
        other_cell: Accept a model of another cell, or one with a large bias on these logs.
        engine: Where sequences are simulated; each gives the same numbers.
        progress: Called with the fraction done and a text.

    Returns:
        The estimates. A sequence that cannot be answered from these logs is in `refused`, with the reason.

    Raises:
        EstimateError: None of the sequences can be answered.
        ModelError: The model does not predict what the estimator needs, or is of another cell.
        UnknownName: A place or the estimator does not exist.
        CyclekitError: An input cannot be read, or the result cannot be written.
    """
    file = path_of(out)
    ending = "" if file is None else file.suffix.lower()
    inputs = [place_of(model), place_of(sequences), place_of(dataset)]
    check_output(file, _KINDS.get(ending, "estimates-json"), inputs, endings=(".json", ".csv", ".xlsx"))
    need_workbook(file)
    chart = path_of(gantt)
    check_output(chart, "picture", inputs, option="--gantt", endings=KINDS)
    wanted = sequences_of(sequences)
    refused: list[Refusal] = []
    refuse = partial(refusing, refused)
    opened = estimator_model(model)

    logs = Dataset.of(dataset)
    if isinstance(opened, TaskTimesModel):
        refuse_options_of_positions(
            estimator=estimator is not None,
            extrapolate=extrapolate,
            validate=not validate,
            check=check is not None,
            other_cell=other_cell,
            engine=not engine.stays_here(len(wanted)),
        )
        found = estimate_plans(
            opened.card, wanted, quantiles=quantiles, takt_s=takt_s, seed=seed, refused=refuse, progress=progress
        )
    else:
        found = estimate(
            opened,
            logs,
            wanted,
            estimator=estimator,
            quantiles=quantiles,
            takt_s=takt_s,
            seed=seed,
            extrapolate=extrapolate,
            validate=validate,
            check=check,
            other_cell=other_cell,
            engine=engine,
            refused=refuse,
            progress=progress,
        )
    if not found and wanted:
        raise with_plan(together(refused), opened, logs, wanted)
    answer = CycleEstimates(tuple(found), tuple(refused))
    if file is not None and ending == ".xlsx":
        write_workbook(file, sheets_of_estimates(answer, logs, opened))
    elif file is not None:
        write_text(file, answer.to_csv() if ending == ".csv" else json_text(answer.to_dict(), ascii_only=True) + "\n")
    if chart is not None:
        write_gantt(chart, answer)
    return answer


def with_plan(
    error: EstimateError, model: SafetyModel | TaskTimesModel, logs: Dataset, wanted: Sequence[TaskSequence]
) -> EstimateError:
    """Return an error whose cure says what to log to answer these sequences."""
    if isinstance(model, TaskTimesModel) or any(one.plan for one in wanted):
        return error
    try:
        lines = what_to_log(logs, wanted).lines
    except CyclekitError:
        return error
    told = [f"To log next: {line}" for line in lines]
    return EstimateError(error.seen, cure="\n  ".join(text for text in (error.cure or "", *told) if text))
