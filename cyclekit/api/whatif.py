"""`what_if`: cycle times of the same logs in a changed cell."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.given import (
    Changes,
    Sequences,
    changes_of,
    estimator_model,
    path_of,
    place_of,
    refuse_options_of_positions,
    sequences_of,
)
from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.estimate.answers import Refusal, refusing, together
from cyclekit.estimate.robot.safety import SafetyModel
from cyclekit.estimate.validation.check import Check
from cyclekit.estimate.whatif.answer import what_if as compare
from cyclekit.estimate.whatif.answers import WhatIfAnswers
from cyclekit.estimate.whatif.both import what_if_tasks
from cyclekit.estimate.whatif.change import Change
from cyclekit.learning.task_times.saved import TaskTimesModel
from cyclekit.storage.atomic import write_text
from cyclekit.text.plain_json import json_text


@checked
def what_if(
    model: SafetyModel | TaskTimesModel | Place,
    dataset: Dataset | Place,
    sequences: Sequences,
    changes: Changes,
    *,
    out: Place | None = None,
    seed: int = 0,
    extrapolate: bool = False,
    validate: bool = True,
    check: Check | None = None,
    other_cell: bool = False,
    progress: Progress | None = None,
) -> WhatIfAnswers:
    """Estimate every sequence in the unchanged cell and under every change. No safety proof.

    Args:
        model: A model of problem `now` or of task times, its folder or its URL.
        dataset: The logs.
        sequences: Sequences, or the sequence file.
        changes: Changes, each applied separately, or the file of changes.
        out: Also write the result here, `.json`.
        seed: As in `estimate_cycles`; so are `extrapolate`, `validate`, `check` and `other_cell`.
        extrapolate: Answer even if most of the cycle is outside logged positions.
        validate: Validate on logged executions; the bias corrects results of the learned safety function.
        check: An earlier validation.
        other_cell: Accept a model of another cell.
        progress: Called with the fraction done and a text.

    Returns:
        The answers. A sequence or change that cannot be answered from these logs is in `refused`, with the reason.

    Raises:
        EstimateError: No sequence can be answered, or no change.
        ModelError: As in `estimate_cycles`.
        UnknownName: A place does not exist.
    """
    file = path_of(out)
    inputs = [place_of(given) for given in (model, sequences, changes, dataset)]
    check_output(file, "what-if", inputs, endings=(".json",))
    wanted, changed = sequences_of(sequences), changes_of(changes)
    answer = changed_cycles(
        estimator_model(model),
        Dataset.of(dataset),
        wanted,
        changed,
        seed=seed,
        extrapolate=extrapolate,
        validate=validate,
        check=check,
        other_cell=other_cell,
        progress=progress,
    )
    if not answer.answers and changed:
        raise together(answer.refused)
    if file is not None:
        write_text(file, json_text(answer.to_dict(), ascii_only=True) + "\n")
    return answer


def changed_cycles(
    model: SafetyModel | TaskTimesModel,
    logs: Dataset,
    wanted: Sequence[TaskSequence],
    changed: Sequence[Change],
    *,
    seed: int = 0,
    extrapolate: bool = False,
    validate: bool = True,
    check: Check | None = None,
    other_cell: bool = False,
    progress: Progress | None = None,
) -> WhatIfAnswers:
    """Return the answers of `what_if`, also if there are none."""
    refused: list[Refusal] = []
    refuse = partial(refusing, refused)
    if isinstance(model, TaskTimesModel):
        refuse_options_of_positions(
            extrapolate=extrapolate, validate=not validate, check=check is not None, other_cell=other_cell
        )
        found = what_if_tasks(model.card, wanted, changed, seed=seed, refused=refuse, progress=progress)
    else:
        found = compare(
            model,
            logs,
            wanted,
            changed,
            seed=seed,
            extrapolate=extrapolate,
            validate=validate,
            check=check,
            other_cell=other_cell,
            refused=refuse,
            progress=progress,
        )
    return WhatIfAnswers(tuple(found), tuple(refused))
