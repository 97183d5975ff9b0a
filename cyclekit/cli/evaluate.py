"""`cyclekit evaluate`: how well a model predicts executions it never saw."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.options import Json, Quiet
from cyclekit.cli.terminal import Terminal, percent, table

if TYPE_CHECKING:
    from cyclekit.evaluate import Evaluation

EXAMPLE = "cyclekit evaluate model dataset"


def evaluate(
    model: Annotated[Path, typer.Argument(help="Folder of the model.", metavar="MODEL")],
    dataset: Annotated[Path, typer.Argument(help="Folder of the dataset.", metavar="DATASET")],
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure a model on held-out executions, beside baselines."""
    from cyclekit.dataset import Dataset
    from cyclekit.evaluate import evaluate as evaluate_model
    from cyclekit.models.saved import load_model

    terminal = Terminal(json=json, quiet=quiet)
    with terminal.progress("evaluating"):
        found = evaluate_model(load_model(model), Dataset.open(dataset))
    terminal.warnings(found.notes)
    terminal.answer(found.to_json(), _head(found), _errors(found), _levels(found))


def _head(found: Evaluation) -> str:
    which = "held out from its training" if found.held_out else "of another dataset"
    lines = [f"{found.network} for problem {found.problem}, judged on {len(found.executions)} executions {which}"]
    metrics = found.metrics
    named = "" if metrics.accuracy is None else f", {percent(metrics.accuracy)} of levels named rightly"
    lines.append(f"{metrics.rows} samples: mean absolute error {metrics.mae:.4f}, bias {metrics.bias:+.4f}{named}")
    lines += [f"left out: {count} samples, {reason}" for reason, count in found.dropped.items()]
    return "\n".join(lines)


def _errors(found: Evaluation) -> str:
    rows = [[row.name, f"{row.mse:.2e}", row.note] for row in found.mse]
    return table(["predicted by ", "MSE", "what it is "], rows)


def _levels(found: Evaluation) -> str:
    rows = [
        [f"{row.level:.2f}", str(row.rows), percent(row.recall), percent(row.precision), _signed(row.bias)]
        for row in found.levels
    ]
    return table(["level ", "samples", "found", "named rightly", "bias"], rows) if rows else ""


def _signed(value: float | None) -> str:
    return "unknown" if value is None else f"{value:+.4f}"
