"""`cyclekit train`: the safety function of the cell, learned from a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cyclekit.cli.options import Json, Quiet, seconds
from cyclekit.cli.terminal import Terminal

if TYPE_CHECKING:
    from cyclekit.models.saved import TrainedModel

EXAMPLE = "cyclekit train dataset --out model"
Problem = Literal["now", "ahead", "average"]
Network = Literal["classifier", "regressor", "lstm-1", "lstm-2", "mixed"]


def train(
    dataset: Annotated[Path, typer.Argument(help="Folder of the dataset.", metavar="DATASET")],
    out: Annotated[Path, typer.Option(help="Folder of the model.", metavar="MODEL")],
    problem: Annotated[
        Problem, typer.Option(help="Predict the scaling now, ahead by the horizon, or its average over it.")
    ] = "now",
    network: Annotated[
        Network | None,
        typer.Option(help="Which network; default: classifier, for the average: mixed.", show_default=False),
    ] = None,
    horizon: Annotated[str | None, typer.Option(help="How far ahead, such as 14s (ahead and average).")] = None,
    norm: Annotated[
        Literal["batch", "none"], typer.Option(help="Batch normalisation as in the literature, or none.")
    ] = "batch",
    features: Annotated[
        Literal["positions", "distance"], typer.Option(help="Give the network the distance as well.")
    ] = "positions",
    optimiser: Annotated[Literal["adamw", "muon"], typer.Option(help="How weights are moved.")] = "adamw",
    balance: Annotated[
        Literal["none", "classes"], typer.Option(help="classes: rare levels weigh as much as common ones.")
    ] = "none",
    noise: Annotated[float, typer.Option(min=0.0, help="Train for a tracker that is noisier by this, m.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the split and of the training.")] = 0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Learn from a dataset when the robot slows down.

    The override is inferred where it was not logged; its levels are found; a network is trained and judged on
    executions held out from it.
    """
    horizon_s = None if horizon is None else seconds(horizon)
    if problem == "now" and horizon_s is not None:
        msg = "--horizon goes with --problem ahead or average"
        raise typer.BadParameter(msg)
    from cyclekit.dataset import Dataset
    from cyclekit.models.saved import save_model
    from cyclekit.models.spec import ModelSpec
    from cyclekit.train import train as train_model

    terminal = Terminal(json=json, quiet=quiet)
    settings: dict[str, Any] = {"features": features, "optimiser": optimiser, "balance": balance, "noise_m": noise}
    spec = ModelSpec.of(problem, network, horizon_s, norm=norm, seed=seed, **settings)
    with terminal.progress("training") as progress:
        model = train_model(Dataset.open(dataset), spec, progress=progress)
        save_model(out, model)
    terminal.warnings(model.card["warnings"])
    document = {"model": str(out), "metrics": model.card["metrics"], "card": model.card}
    terminal.done(
        document, f"{out}: {summary(model)}\nnext: cyclekit estimate {out} SEQUENCES.toml --dataset {dataset}"
    )


def summary(model: TrainedModel) -> str:
    """Return what was learned and how well it holds on executions that were held out, in three lines."""
    metrics, split = model.card["metrics"], model.card["split"]
    named = "" if metrics["accuracy"] is None else f", {100 * metrics['accuracy']:.1f}% of levels named rightly"
    levels = ", ".join(f"{level:.2f}" for level in model.levels) or "none found"
    return (
        f"{model.network} for problem {model.problem}, speed-scaling levels {levels}\n"
        f"  learned from {len(split['train'])} executions, judged by {len(split['test'])} others\n"
        f"  there: MSE {metrics['mse_mean']:.2e}, mean absolute error {metrics['mae']:.4f}{named}"
    )
