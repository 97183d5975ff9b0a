"""`cyclekit evaluate`: how well a model predicts executions it never saw."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cyclekit.cli.options import Json, Quiet
from cyclekit.cli.terminal import Terminal

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
    terminal.answer(found.to_json(), "")
