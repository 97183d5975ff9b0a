"""`cyclekit evaluate`: measures a model on held-out executions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.options import DatasetPlace, EngineName, Jobs, Json, OtherCell, Quiet, RayAddress, engine_of
from cyclekit.cli.terminal import Terminal, bullet, table
from cyclekit.text.numbers import fixed, percent, scientific, signed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.learning.evaluation.drift import Drift
    from cyclekit.learning.evaluation.evaluate import Evaluation

EXAMPLE = "cyclekit evaluate model dataset"


def evaluate(
    model: Annotated[str, typer.Argument(help="Model, or a folder of several: a folder or its URL.", metavar="MODEL")],
    dataset: DatasetPlace,
    trained_on: Annotated[
        str | None,
        typer.Option(
            metavar="DATASET",
            help="Dataset of the training, if DATASET is newer: also say whether the cell has changed.",
        ),
    ] = None,
    other_cell: OtherCell = False,
    engine: EngineName = "local",
    jobs: Jobs = None,
    ray_address: RayAddress = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure a model on held-out executions, against baselines.

    On newer logs, --trained-on shows whether the safety function or the operator's habits have changed.
    """
    from cyclekit.api.evaluate import evaluate_models, evaluate_task_times
    from cyclekit.learning.task_times.saved import holds_task_times

    if holds_task_times(model):
        terminal = Terminal(json=json, quiet=quiet)
        with terminal.progress("evaluating") as progress:
            judged_times = evaluate_task_times(model, dataset, trained_on=trained_on, progress=progress)
        terminal.answer(judged_times.to_dict(), judged_times.said())
        return
    terminal, work = Terminal(json=json, quiet=quiet), engine_of(engine, jobs, ray_address)
    with terminal.progress("evaluating") as progress:
        found = evaluate_models(
            model, dataset, trained_on=trained_on, other_cell=other_cell, engine=work, progress=progress
        )
    terminal.warnings(list(dict.fromkeys(note for judged in found.values() for note in judged.notes)))
    if not found.together:
        (judged,) = found.values()
        parts = (_head(judged), _errors(judged), _better(found, dataset), _levels(judged), _drift(judged.drift))
        terminal.answer(found.to_dict(), *parts)
        return
    changes = [f"{Path(place).name}\n{_drift(judged.drift)}" for place, judged in found.items() if judged.drift]
    terminal.answer(found.to_dict(), _beside(found), _better(found, dataset), *changes)


def _beside(found: Mapping[str, Evaluation]) -> str:
    """Return a table with one row per model."""
    rows = [
        [
            Path(place).name,
            one.network,
            str(one.metrics.rows),
            scientific(one.metrics.mse_mean),
            fixed(one.metrics.mae, 4),
        ]
        for place, one in found.items()
    ]
    return table(["model ", "network ", "samples", "MSE", "mean abs. error"], rows)


def _head(found: Evaluation) -> str:
    which = "of another dataset"
    if found.held_out or found.learned:
        which = "that it did not learn from" if found.held_out else "that it learned from"
    lines = [f"{found.network} for problem {found.problem}, judged on {len(found.executions)} executions {which}"]
    metrics = found.metrics
    named = "" if metrics.accuracy is None else f", {percent(metrics.accuracy)} of levels predicted correctly"
    lines.append(
        f"{metrics.rows} samples: mean absolute error {fixed(metrics.mae, 4)}, bias {signed(metrics.bias, 4)}{named}"
    )
    lines += [f"left out: {count} samples, {reason}" for reason, count in found.dropped.items()]
    return bullet(lines, mark="")


def _errors(found: Evaluation) -> str:
    rows = [[row.name, scientific(row.mse), row.note] for row in found.mse]
    return table(["predicted by ", "MSE", "method "], rows)


def _better(found: Mapping[str, Evaluation], dataset: str) -> str:
    """Return one line for each model that is worse than a rival, by the model's path."""
    named = {place: f"{Path(place).name}: " if len(found) > 1 else "" for place in found}
    better = {place: judged.better for place, judged in found.items()}
    return "\n".join(f"{named[place]}{one.said(dataset, place)}" for place, one in better.items() if one)


def _levels(found: Evaluation) -> str:
    rows = [
        [fixed(row.level, 2), str(row.rows), percent(row.recall), percent(row.precision), signed(row.bias, 4)]
        for row in found.levels
    ]
    return table(["level ", "samples", "found", "predicted correctly", "bias"], rows) if rows else ""


def _drift(found: Drift | None) -> str:
    """Return whether the safety function or the operator changed since training, and where."""
    if found is None:
        return ""
    lines = []
    for changed, shifts, name, cure in (
        (found.safety_changed, found.safety, "the safety function", "train again on the newer logs"),
        (found.habits_changed, found.habits, "the operator's habits", "estimate with the newer logs as --dataset"),
    ):
        lines.append(f"{name}: {f'CHANGED ({cure})' if changed else 'no change seen'}")
        named = sorted((shift for shift in shifts if shift.changed), key=lambda shift: -abs(shift.z))
        lines += [
            f"  {shift.what}: {fixed(shift.before, 3)} -> {fixed(shift.after, 3)} "
            f"({signed(shift.z, 0)} standard errors)"
            for shift in named[:8]
        ]
    before, after = found.executions
    lines.append(f"compared: {before} executions of the training's logs with {after} of the newer ones")
    return "\n".join(["Since the training", *lines])
