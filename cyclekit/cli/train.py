"""`cyclekit train`: the safety function of the cell, learned from a dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cyclekit.cli.options import (
    DatasetPlace,
    EngineName,
    Jobs,
    Json,
    Quiet,
    RayAddress,
    engine_of,
    seconds,
    whole_numbers,
)
from cyclekit.cli.terminal import Terminal

if TYPE_CHECKING:
    from collections.abc import Mapping

EXAMPLE = "cyclekit train dataset --out model"
Problem = Literal["now", "ahead", "average"]
Network = Literal["classifier", "regressor", "lstm-1", "lstm-2", "mixed"]


def train(
    dataset: DatasetPlace,
    out: Annotated[str, typer.Option(help="Model to make: a folder or a URL.", metavar="MODEL")],
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
        Literal["auto", "positions", "distance"],
        typer.Option(help="distance: the network sees it as well; auto: for problem now."),
    ] = "auto",
    optimiser: Annotated[
        Literal["auto", "muon", "adamw"],
        typer.Option(help="How weights are moved; auto: muon where it was measured better."),
    ] = "auto",
    balance: Annotated[
        Literal["none", "classes"], typer.Option(help="classes: rare levels weigh as much as common ones.")
    ] = "none",
    noise: Annotated[float, typer.Option(min=0.0, help="Train for a tracker that is noisier by this, m.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the split and of the training.")] = 0,
    seeds: Annotated[
        str | None, typer.Option(help="Several seeds, with commas between: one model for each, OUT/seed-N.")
    ] = None,
    engine: EngineName = "local",
    jobs: Jobs = None,
    ray_address: RayAddress = None,
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
    chosen = None if seeds is None else whole_numbers(seeds)
    from functools import partial

    from cyclekit.dataset.guard import check_output
    from cyclekit.errors import command_line
    from cyclekit.learning.networks.saved import check_model_output
    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.learning.training import Training, need_torch, train_at
    from cyclekit.storage.remote.folders import join

    terminal, work = Terminal(json=json, quiet=quiet), engine_of(engine, jobs, ray_address)
    settings: dict[str, Any] = {"features": features, "optimiser": optimiser, "balance": balance, "noise_m": noise}
    spec = partial(ModelSpec.of, problem, network, horizon_s, norm=norm, **settings)
    todo = [Training(dataset, spec(seed=seed), out)]
    if chosen is not None:
        todo = [Training(dataset, spec(seed=one), join(out, f"seed-{one}")) for one in chosen]
    need_torch()
    for each in todo:
        check_output(each.out, "model", [dataset])
        check_model_output(each.out)
    with terminal.progress("training") as progress:
        here = work.stays_here(len(todo)) and len(todo) == 1
        cards: dict[str, dict[str, Any]] = {}
        for done in work.map(partial(train_at, progress=progress) if here else train_at, todo):
            cards[done.item.out] = done.get()
            progress(len(cards) / len(todo), done.item.out)
    terminal.warnings(list(dict.fromkeys(text for card in cards.values() for text in card["warnings"])))
    documents = [{"model": each.out, "metrics": cards[each.out]["metrics"], "card": cards[each.out]} for each in todo]
    told = "\n".join(f"{each.out}: {summary(cards[each.out])}" for each in todo)
    following = command_line("evaluate", out, dataset)
    if chosen is None and problem != "ahead":  # no estimator works with a forecast
        following = command_line("estimate", out, "SEQUENCES.toml", "--dataset", dataset)
    terminal.done(documents[0] if chosen is None else {"models": documents}, f"{told}\nnext: {following}")


def summary(card: Mapping[str, Any]) -> str:
    """Return what was learned and how well it holds on executions that were held out, in three lines.

    Args:
        card: Of the model.
    """
    metrics, split = card["metrics"], card["split"]
    named = "" if metrics["accuracy"] is None else f", {100 * metrics['accuracy']:.1f}% of levels named rightly"
    levels = ", ".join(f"{level['value']:.2f}" for level in card["levels"]) or "none found"
    count = {part: len(names) for part, names in split.items()}
    return (
        f"{card['network']} for problem {card['problem']}, speed-scaling levels {levels}\n"
        f"  {sum(count.values())} executions: {count['train']} to learn from, {count['validation']} to choose the "
        f"epoch by, {count['test']} held out\n"
        f"  held out: MSE {metrics['mse_mean']:.2e}, mean absolute error {metrics['mae']:.4f}{named}"
    )
