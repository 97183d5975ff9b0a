"""`cyclekit evaluate`: how well a model predicts executions it never saw."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.options import Json, Quiet
from cyclekit.cli.terminal import Terminal, bullet, percent, table

if TYPE_CHECKING:
    from cyclekit.evaluate import Evaluation
    from cyclekit.evaluate.drift import Drift

EXAMPLE = "cyclekit evaluate model dataset"


def evaluate(
    model: Annotated[Path, typer.Argument(help="Folder of the model.", metavar="MODEL")],
    dataset: Annotated[Path, typer.Argument(help="Folder of the dataset.", metavar="DATASET")],
    trained_on: Annotated[
        Path | None, typer.Option(help="Dataset of the training: says whether DATASET shows a changed cell.")
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure a model on held-out executions, beside baselines.

    On newer logs with --trained-on: whether safety function or habits changed.
    """
    from cyclekit.dataset import Dataset
    from cyclekit.evaluate import evaluate as evaluate_model
    from cyclekit.evaluate.drift import drift
    from cyclekit.models.saved import load_model

    terminal = Terminal(json=json, quiet=quiet)
    opened, judged = load_model(model), Dataset.open(dataset)
    with terminal.progress("evaluating") as progress:
        found = evaluate_model(opened, judged, progress=progress)
    changed = None
    if trained_on is not None:
        with terminal.progress("comparing with the training"):
            changed = drift(opened, Dataset.open(trained_on), judged)
    terminal.warnings(found.notes)
    document = found.to_json() | ({} if changed is None else {"drift": changed.to_json()})
    terminal.answer(document, _head(found), _errors(found), _levels(found), _drift(changed))


def _head(found: Evaluation) -> str:
    which = "held out from its training" if found.held_out else "of another dataset"
    lines = [f"{found.network} for problem {found.problem}, judged on {len(found.executions)} executions {which}"]
    metrics = found.metrics
    named = "" if metrics.accuracy is None else f", {percent(metrics.accuracy)} of levels named rightly"
    lines.append(f"{metrics.rows} samples: mean absolute error {metrics.mae:.4f}, bias {metrics.bias:+.4f}{named}")
    lines += [f"left out: {count} samples, {reason}" for reason, count in found.dropped.items()]
    return bullet(lines, mark="")


def _errors(found: Evaluation) -> str:
    rows = [[row.name, f"{row.mse:.2e}", row.note] for row in found.mse]
    return table(["predicted by ", "MSE", "what it is "], rows)


def _levels(found: Evaluation) -> str:
    rows = [
        [f"{row.level:.2f}", str(row.rows), percent(row.recall), percent(row.precision), _signed(row.bias)]
        for row in found.levels
    ]
    return table(["level ", "samples", "found", "named rightly", "bias"], rows) if rows else ""


def _drift(found: Drift | None) -> str:
    """Return whether anything changed since the training, and where."""
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
            f"  {shift.what}: {shift.before:.3f} -> {shift.after:.3f} ({shift.z:+.0f} standard errors)"
            for shift in named[:8]
        ]
    before, after = found.executions
    lines.append(f"judged by {before} executions of the training's logs and {after} of the newer ones")
    return "\n".join(["Since the training", *lines])


def _signed(value: float | None) -> str:
    return "unknown" if value is None else f"{value:+.4f}"
