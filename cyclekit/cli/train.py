"""`cyclekit train`: learns the safety function of a cell from a dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

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
from cyclekit.text.numbers import compact, duration, fixed, percent, signed_percent

if TYPE_CHECKING:
    from cyclekit.dataset.cards import TrainingCard
    from cyclekit.dataset.cards.rule import RuleCard
    from cyclekit.learning.networks.saved import TrainedModel
    from cyclekit.learning.task_times.saved import TaskTimesModel
    from cyclekit.learning.unseen.model import UnseenOperator

EXAMPLE = "cyclekit train dataset --out model"
Problem = Literal["now", "ahead", "average"]


def train(
    dataset: DatasetPlace,
    out: Annotated[str, typer.Option(help="Model to make: a folder or a URL.", metavar="MODEL")],
    problem: Annotated[
        Problem, typer.Option(help="Predict the scaling now, ahead by the horizon, or its average over it.")
    ] = "now",
    network: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="classifier, regressor, mixed; for ahead also lstm-1, lstm-2, boosting. Default: by the problem.",
            show_default=False,
        ),
    ] = None,
    model: Annotated[
        Literal["auto", "network"],
        typer.Option(
            help="What answers. auto: a rule, if a simple one explains the commanded level, else the network."
        ),
    ] = "auto",
    people: Annotated[
        Literal["auto", "positions", "signals"],
        typer.Option(help="What the logs show of people; auto: the kind that more executions have."),
    ] = "auto",
    horizon: Annotated[
        str | None, typer.Option(metavar="TIME", help="How far ahead, such as 14s (ahead and average).")
    ] = None,
    norm: Annotated[
        Literal["batch", "none"], typer.Option(help="Batch normalisation in the network, or none.")
    ] = "batch",
    features: Annotated[
        Literal["auto", "positions", "distance", "past"],
        typer.Option(
            help="Inputs. distance: positions and their distance; past: also goals and the past scaling (LSTM); "
            "auto: by the problem."
        ),
    ] = "auto",
    target: Annotated[
        Literal["auto", "commanded", "logged"],
        typer.Option(
            help="For --problem now, what is learned: the commanded level, or the scaling as logged; auto: the level."
        ),
    ] = "auto",
    optimiser: Annotated[
        Literal["auto", "muon", "adamw"],
        typer.Option(help="Optimiser of the network; auto: the better one for this amount of data."),
    ] = "auto",
    balance: Annotated[
        Literal["none", "classes"], typer.Option(help="classes: rare levels weigh as much as common ones.")
    ] = "none",
    noise: Annotated[
        float, typer.Option(min=0.0, help="Noise added to the positions in training, m, standard deviation.")
    ] = 0.0,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the training and of the choice of held-out executions.")
    ] = 0,
    seeds: Annotated[
        str | None,
        typer.Option(
            metavar="LIST", help="Several seeds, such as 1,2,3: one model each, in the folders seed-N of --out."
        ),
    ] = None,
    engine: EngineName = "local",
    jobs: Jobs = None,
    ray_address: RayAddress = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Learn the safety function from a dataset.

    Finds the levels of the speed scaling, searches a rule, trains a network, and measures both on held-out
    executions.
    """
    horizon_s = None if horizon is None else seconds(horizon)
    if problem == "now" and horizon_s is not None:
        msg = "--horizon goes with --problem ahead or average"
        raise typer.BadParameter(msg)
    chosen = None if seeds is None else whole_numbers(seeds)
    terminal, work = Terminal(json=json, quiet=quiet), engine_of(engine, jobs, ray_address)
    if _task_lists_alone(dataset):
        if chosen is not None:
            msg = "--seeds is for networks, and the dataset holds task lists alone: give --seed"
            raise typer.BadParameter(msg)
        _train_task_times(terminal, dataset, out, seed)
        return
    from cyclekit.api.train import train_model, train_seeds
    from cyclekit.dataset.cards import texts
    from cyclekit.errors import command_line
    from cyclekit.learning.networks.spec import ModelSpec

    spec = ModelSpec.of(
        problem, network, horizon_s, norm=norm, seed=seed, features=features, optimiser=optimiser, balance=balance,
        noise_m=noise, target=target,
    )  # fmt: skip
    with terminal.progress("training") as progress:
        rules = model == "auto"
        if chosen is None:
            one = train_model(dataset, spec, out=out, rules=rules, people=people, engine=work, progress=progress)
            models = {out: one}
        else:
            models = train_seeds(dataset, chosen, out, spec, rules=rules, people=people, engine=work, progress=progress)
    cards = {place: model.card for place, model in models.items()}
    terminal.warnings(list(dict.fromkeys(text for card in cards.values() for text in texts(card.warnings))))
    shown = {place: card.to_dict() for place, card in cards.items()}
    documents = [{"model": place, "metrics": card["metrics"], "card": card} for place, card in shown.items()]
    text = "\n".join(f"{place}: {summary_of(model)}" for place, model in models.items())
    following = command_line("evaluate", out, dataset)
    if chosen is None and problem != "ahead":  # no estimator uses a forecast
        following = command_line("estimate", out, "SEQUENCES.toml", "--dataset", dataset)
    terminal.done(documents[0] if chosen is None else {"models": documents}, f"{text}\nnext: {following}")


def _task_lists_alone(dataset: str) -> bool:
    """Return whether a dataset was made from task lists; False for an invalid dataset, which training refuses."""
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.errors import CyclekitError

    try:
        return Dataset.open(dataset).holds_task_lists_alone
    except CyclekitError:
        return False


def _train_task_times(terminal: Terminal, dataset: str, out: str, seed: int) -> None:
    """Learn task times from task lists, without a network."""
    from cyclekit.api.train import train_task_times
    from cyclekit.errors import command_line

    with terminal.progress("learning from task lists") as progress:
        found = train_task_times(dataset, out=out, seed=seed, progress=progress)
    following = command_line("estimate", out, "SEQUENCES.toml", "--dataset", dataset)
    document = {"model": out, "card": found.to_dict()}
    terminal.done(document, f"{out}: {task_times_summary(found)}\nnext: {following}")


def task_times_summary(found: TaskTimesModel) -> str:
    """Return what was learned from task lists: one row per task, and the error on held-out orders."""
    from cyclekit.cli.terminal import table

    rows = [
        [task.agent, task.task, str(len(task.work_s)), fixed(task.usual_s, 1), ", ".join(task.waits_for[1:]) or "-"]
        for task in found.card.tasks
    ]
    heads = ["agent ", "task ", "times", "mean, s", "waits for"]
    held_out = found.card.held_out
    held = "held out: too few executions to judge by"
    if held_out is not None:
        held = (
            f"held out: {held_out.orders} order{'s' * (held_out.orders != 1)}, "
            f"mean cycle time {signed_percent(held_out.bias, 1)} off (± {percent(held_out.within)}), "
            f"spread over orders {percent(held_out.order_error)}"
        )
    lines = [held, *found.card.notices]
    text = "\n".join(f"  {line}" for line in lines)
    return f"task times from {found.card.executions} executions\n{table(heads, rows)}\n{text}"


def summary_of(model: TrainedModel | UnseenOperator) -> str:
    """Return what was learned; without a visible operator, that no network was trained."""
    from cyclekit.learning.networks.saved import TrainedModel
    from cyclekit.learning.unseen.model import said

    return summary(model.card) if isinstance(model, TrainedModel) else "\n  ".join(said(model))


def summary(card: TrainingCard) -> str:
    """Return what was learned and its error on held-out executions, in three lines.

    Args:
        card: Card of the model.
    """
    from cyclekit.dataset.cards import SplitCard

    metrics, split = card.metrics, card.split or SplitCard()
    levels = ", ".join(compact(100.0 * level.value, 4) for level in card.levels or ())
    levels = f"levels {levels} %" if levels else "no levels found"
    levels = "continuous" if card.rule is not None and card.rule.law is not None else levels
    held_out = "nothing was held out to judge it"
    if metrics is not None:
        named = "" if metrics.accuracy is None else f"the level is right in {percent(metrics.accuracy, 1)} of samples, "
        held_out = f"there {named}the speed off by {percent(metrics.mae, 2)} on average"
    rule = "" if card.rule is None else "".join(f"\n  {line}" for line in rule_lines(card.rule))
    what = {
        "ahead": f"speed {duration(card.horizon_s or 0.0)} ahead",
        "average": f"mean speed over {duration(card.horizon_s or 0.0)}",
    }
    return (
        f"{what.get(str(card.problem), 'speed near people')}: {levels} ({card.network})\n"
        f"  {len(split.train) + len(split.validation) + len(split.test)} executions: {len(split.train)} for training, "
        f"{len(split.validation)} for validation, {len(split.test)} held out\n"
        f"  {held_out}{rule}"
    )


def rule_lines(rule: RuleCard) -> list[str]:
    """Return the rule that replaces the network, and the share of levels that it explains."""
    from cyclekit.learning.rules.words import kind_of, sentences

    network = "" if rule.network is None else f" (the network {percent(rule.network, 2)})"
    right = "scaling right within 2 %" if rule.law is not None else "commanded level right"
    first = f"answers: the rule {kind_of(rule)}; {right} in {percent(rule.explained, 2)} of held-out samples"
    return [f"{first}{network}", *(f"- {sentence}" for sentence in sentences(rule))]
