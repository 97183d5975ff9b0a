"""`plan_order`: the order of the same work that takes least time."""

from __future__ import annotations

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.given import jobs_of, model_of, path_of, place_of
from cyclekit.api.workbooks import need_workbook, sheets_of_plan
from cyclekit.config.sequences import TaskSequence
from cyclekit.config.write import sequence_to_toml
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.estimate.check import Check
from cyclekit.estimate.plan.answer import OrderPlan, plan
from cyclekit.estimate.plan.jobs import Jobs
from cyclekit.estimate.safety import SafetyModel
from cyclekit.storage.atomic import write_text
from cyclekit.storage.workbook import write_workbook


@checked
def plan_order(
    model: SafetyModel | Place,
    dataset: Dataset | Place,
    jobs: Jobs | Place,
    *,
    out: Place | None = None,
    seed: int = 0,
    validate: bool = True,
    check: Check | None = None,
    other_cell: bool = False,
    progress: Progress | None = None,
) -> OrderPlan:
    """Search the order of the jobs with the least expected cycle time.

    Args:
        model: A model of problem `now`, its folder or its URL.
        dataset: Logs that hold the tasks of at least one allowed order, and the operator's tracks.
        jobs: What is to be visited, and what comes first: jobs, or the jobs file.
        out: Also write the order here, as a sequence file (`.toml`), or all of it as a workbook (`.xlsx`).
        seed: Of the search and the resampling.
        validate: As of `estimate_cycles`.
        check: As of `estimate_cycles`.
        other_cell: As of `estimate_cycles`.
        progress: Told fraction and text.

    Raises:
        ModelError: The model predicts something else than the present scaling, or is of another cell.
        UnknownName: A place does not exist.
        EstimateError: Every allowed order needs a task that was never logged, or there is no operator track.
    """
    file = path_of(out)
    as_book = file is not None and file.suffix.lower() == ".xlsx"
    inputs = [place_of(model), place_of(jobs), place_of(dataset)]
    check_output(file, "workbook" if as_book else "sequences", inputs, endings=(".toml", ".xlsx"))
    need_workbook(file)
    wanted = jobs_of(jobs)
    asked = {"validate": validate, "other_cell": other_cell}
    opened, logs = model_of(model), Dataset.of(dataset)
    found = plan(opened, logs, wanted, seed=seed, check=check, progress=progress, **asked)
    if file is not None and as_book:
        write_workbook(file, sheets_of_plan(found, logs, opened))
    elif file is not None:
        write_text(file, "# Written by cyclekit plan\n" + sequence_to_toml(TaskSequence("planned", found.places)))
    return found
