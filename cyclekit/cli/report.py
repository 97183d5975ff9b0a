"""`cyclekit report`: the page that an integrator hands to the customer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cyclekit.cli.options import Json, Quiet
from cyclekit.cli.terminal import Terminal, by_stage

EXAMPLE = "cyclekit report dataset --model model --sequences sequences.toml --out report.html"


def report(
    dataset: Annotated[Path, typer.Argument(help="Folder of the dataset.", metavar="DATASET")],
    model: Annotated[Path, typer.Option(help="Folder of the model.")],
    out: Annotated[Path, typer.Option(help="Page to write (.html); opens without a network.")],
    sequences: Annotated[Path | None, typer.Option(help="Sequence file whose estimates go into the page.")] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write the page for the customer.

    One self-contained file: the cell, the safety function, the estimates, and what they rest on.
    """
    from cyclekit.dataset import Dataset
    from cyclekit.estimate.rollout import estimate
    from cyclekit.evaluate import evaluate
    from cyclekit.models.saved import load_model
    from cyclekit.report import write_report
    from cyclekit.sequences import load_sequences

    terminal = Terminal(json=json, quiet=quiet)
    wanted = load_sequences(sequences) if sequences else []
    data, trained = Dataset.open(dataset), load_model(model)
    with terminal.progress("estimating") as progress:
        estimates = estimate(trained, data, wanted, progress=progress) if wanted else []
    with terminal.progress("evaluating"):
        evaluation = evaluate(trained, data)
    with terminal.progress("writing the page") as progress:
        write_report(data, trained, out, estimates=estimates, evaluation=evaluation, progress=by_stage(progress))
    terminal.done({"report": str(out), "sequences": len(estimates)}, f"{out}: open it in any browser")
