"""`plan_order`: the order of the same work with the least cycle time."""

from __future__ import annotations

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.given import (
    estimator_model,
    jobs_of,
    path_of,
    place_of,
    refuse_options_of_positions,
    task_jobs_of,
)
from cyclekit.api.workbooks import need_workbook, sheets_of_plan
from cyclekit.config.sequences import TaskSequence
from cyclekit.config.write import sequence_to_toml
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.errors import ConfigError
from cyclekit.estimate.baseline import baseline_of
from cyclekit.estimate.plan.answer import OrderPlan, plan
from cyclekit.estimate.plan.jobs import Jobs
from cyclekit.estimate.plan.task_orders import TaskJobs, TaskOrderPlan, plan_tasks
from cyclekit.estimate.robot.safety import SafetyModel
from cyclekit.estimate.statistics.same_work import work_of
from cyclekit.estimate.validation.check import Check
from cyclekit.learning.task_times.runs import logged_runs
from cyclekit.learning.task_times.saved import TaskTimesModel
from cyclekit.storage.atomic import write_text
from cyclekit.storage.workbook import write_workbook


@checked
def plan_order(
    model: SafetyModel | TaskTimesModel | Place,
    dataset: Dataset | Place,
    jobs: Jobs | TaskJobs | Place,
    *,
    out: Place | None = None,
    seed: int = 0,
    validate: bool = True,
    check: Check | None = None,
    other_cell: bool = False,
    progress: Progress | None = None,
) -> OrderPlan | TaskOrderPlan:
    """Search the order of the jobs with the least expected cycle time.

    Args:
        model: A model of problem `now` or of task times, its folder or its URL.
        dataset: Logs that hold the tasks of at least one allowed order, and the operator's tracks.
        jobs: Places to visit and precedence constraints: jobs, or the jobs file. For a model of task times
            the tasks of both agents.
        out: Also write the order here, as a sequence file (`.toml`), or all of it as a workbook (`.xlsx`; not for a
            model of task times).
        seed: Seed of the search and the resampling.
        validate: As in `estimate_cycles`.
        check: As in `estimate_cycles`.
        other_cell: As in `estimate_cycles`.
        progress: Called with the fraction done and a text.

    Raises:
        ModelError: The model does not predict the present scaling, or is of another cell.
        UnknownName: A place does not exist.
        EstimateError: Every allowed order needs a task that was never logged, or there is no operator track.
    """
    file = path_of(out)
    as_book = file is not None and file.suffix.lower() == ".xlsx"
    inputs = [place_of(model), place_of(jobs), place_of(dataset)]
    check_output(file, "workbook" if as_book else "sequences", inputs, endings=(".toml", ".xlsx"))
    need_workbook(file)
    opened, logs = estimator_model(model), Dataset.of(dataset)
    if isinstance(opened, TaskTimesModel):
        refuse_options_of_positions(validate=not validate, check=check is not None, other_cell=other_cell)
        if as_book:
            seen = f"{file}: the order of both agents' tasks is written as a sequence file, not as a workbook"
            raise ConfigError(seen, cure="Give a file that ends in .toml.")
        runs, _ = logged_runs(logs)
        both = plan_tasks(opened.card, task_jobs_of(jobs), runs, seed=seed, progress=progress)
        work = work_of(TaskSequence.of_plan("", both.tasks).places)
        if (today := baseline_of(logs, work, None, pace=both.estimate.pace)) is not None:
            both = both.against_today(today)
        if file is not None:
            write_text(file, both.to_toml())
        return both
    asked = {"validate": validate, "other_cell": other_cell}
    found = plan(opened, logs, jobs_of(jobs), seed=seed, check=check, progress=progress, **asked)
    if file is not None and as_book:
        write_workbook(file, sheets_of_plan(found, logs, opened))
    elif file is not None:
        write_text(file, _sequence_file(found))
    return found


def _sequence_file(found: OrderPlan) -> str:
    """Return the order found as a sequence file: the robot's places, or a plan for both."""
    return "# Written by cyclekit plan\n" + sequence_to_toml(found.sequence("planned"))
