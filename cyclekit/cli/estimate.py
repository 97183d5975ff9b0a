"""`cyclekit estimate`: the expected cycle time of task sequences, ranked."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cyclekit.cli.options import (
    Checked,
    EngineName,
    Extrapolate,
    Jobs,
    Json,
    LoggedPlace,
    ModelPlace,
    Quiet,
    RayAddress,
    engine_of,
    levels,
    seconds,
)
from cyclekit.cli.terminal import Terminal, bullet, percent, table, write_out

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.check import Check
    from cyclekit.estimate.result import CycleEstimate

EXAMPLE = "cyclekit estimate model sequences.toml --dataset dataset"
CAPTION = "seconds: motion at full speed + slow-down for safety + dwell + wait = expected"
_COLUMNS = ("name", "expected_s", "expected_low_s", "expected_high_s")
_SPLIT = ("nominal_s", "safety_loss_s", "dwell_s", "wait_s")


def estimate(
    model: ModelPlace,
    sequences: Annotated[
        Path, typer.Argument(help="Sequence file: names and ordered places or tasks.", metavar="SEQUENCES.toml")
    ],
    dataset: LoggedPlace,
    out: Annotated[Path | None, typer.Option(help="Also write the result here: JSON, or CSV for x.csv.")] = None,
    estimator: Annotated[
        str | None, typer.Option(help="rollout, average, history or nominal; by default what suits the model.")
    ] = None,
    takt: Annotated[
        str | None, typer.Option(metavar="TIME", help="Also tell how many cycles meet it, such as 105s.")
    ] = None,
    quantiles: Annotated[str, typer.Option(metavar="LEVELS", help="Of single cycles, percent.")] = "5,50,95",
    check: Checked = True,
    seed: Annotated[int, typer.Option(min=0, help="Of the resampling of operator tracks.")] = 0,
    extrapolate: Extrapolate = False,
    engine: EngineName = "local",
    jobs: Jobs = None,
    ray_address: RayAddress = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the cycle time of task sequences, ranked.

    Per sequence: the mean, the range of single cycles, where the time goes, and what the number rests on.
    """
    from cyclekit.dataset import Dataset
    from cyclekit.estimate.check import check_rollout
    from cyclekit.estimate.rollout import estimate as estimate_cycles
    from cyclekit.guard import check_output
    from cyclekit.models.saved import load_model
    from cyclekit.sequences import load_sequences

    terminal, work = Terminal(json=json, quiet=quiet), engine_of(engine, jobs, ray_address)
    as_table = out is not None and out.suffix.lower() == ".csv"
    check_output(out, "estimates-csv" if as_table else "estimates-json", [model, sequences, dataset])
    wanted = load_sequences(sequences)
    asked, takt_s = levels(quantiles), None if takt is None else seconds(takt)
    opened, logs = load_model(model), Dataset.open(dataset)
    checks: list[Check] = []

    def checked() -> Check:
        checks.append(check_rollout(opened, logs, levels=asked, seed=seed))
        return checks[0]

    with terminal.progress("estimating") as progress:
        found = estimate_cycles(
            opened,
            logs,
            wanted,
            estimator=estimator,
            quantiles=asked,
            takt_s=takt_s,
            seed=seed,
            extrapolate=extrapolate,
            check=checked if check else None,
            engine=work,
            progress=progress,
        )
    document: dict[str, Any] = {"sequences": [entry.to_json() for entry in found]}
    document["check"] = checks[0].to_json() if checks else None
    if out is not None:
        write_out(out, as_csv(found) if as_table else document)
        terminal.remark(f"written: {out}")
    by_task = tasks_table(found[0]) if len(found) == 1 else ""
    parts = [f"{estimates_table(found)}\n{CAPTION}", ranking(found), takt_table(found), by_task, loses_most(found)]
    terminal.answer(document, *parts, rests_on(found), *(judged(entry) for entry in checks))


def estimates_table(found: Sequence[CycleEstimate]) -> str:
    """Return one row per sequence, the quickest first: expected time, 90 % range, and where the time goes."""
    low, high = _range(found)
    rows = [
        [
            f"{place}. {entry.name}",
            f"{entry.expected_s:.1f} s",
            f"{entry.quantiles_s[low]:.0f}-{entry.quantiles_s[high]:.0f} s",
            *(f"{getattr(entry, part):.1f}" for part in _SPLIT),
        ]
        for place, entry in enumerate(found, start=1)
    ]
    cycles = f"{100 * (high - low):.0f}% of cycles"
    return table(["sequence ", "expected", cycles, "motion", "safety", "dwell", "wait"], rows)


def ranking(found: Sequence[CycleEstimate]) -> str:
    """Return how sure it is that the first sequence is quicker than each other one."""
    best = found[0]
    rows = [[f"{best.name} before {name}", percent(chance)] for name, chance in list(best.beats.items())[:20]]
    return table(["mean cycle time ", "probability"], rows) if rows else ""


def takt_table(found: Sequence[CycleEstimate]) -> str:
    """Return the part of the cycles that meet the takt time, with its 95 % interval."""
    rows = []
    for entry in found:
        if entry.takt_probability is not None:
            share, low, high = entry.takt_probability
            rows.append([entry.name, percent(share), f"{percent(low)} to {percent(high)}"])
    return table(["sequence ", f"within {found[0].takt_s:g} s", "95%"], rows) if rows else ""


def judged(check: Check) -> str:
    """Return how the rollout compares with the logged executions."""
    lines = [
        f"{check.executions} logged executions rolled out beside their own operators: {check.own_bias:+.2%} "
        f"(+-{1.96 * check.own_error:.2%}) on average, {check.held_out} of them unseen by the network",
    ]
    if abs(check.factor - 1) >= 5e-5:
        lines.append(f"so every duration above is corrected by {check.factor - 1:+.2%}")
    if check.coverage is not None:
        low, high = check.levels
        lines.append(
            f"beside all other operators: {percent(check.coverage)} lie between the {100 * low:g}% and "
            f"{100 * high:g}% quantiles, which should hold {percent(high - low)}"
        )
    return "How the rollout does on what was logged\n" + bullet([*lines, *check.doubts])


def loses_most(found: Sequence[CycleEstimate]) -> str:
    """Return where each sequence loses most to safety: at which task, and while the operator does what."""
    lines = []
    for entry in found:
        if entry.safety_loss_s <= 0 or not entry.tasks:
            lines.append(f"{entry.name}: nothing is lost to safety")
            continue
        task = max(entry.tasks, key=lambda share: share.safety_loss_s)
        text = f"{entry.name}: most at {task.task} ({task.safety_loss_s:.1f} s)"
        if entry.costliest_activity is not None:
            activity, lost = entry.costliest_activity
            text += f"; with the operator at or on the way to {activity} ({lost:.1f} s in all)"
        lines.append(text)
    return "Where safety slows the robot\n" + bullet(lines)


def _range(found: Sequence[CycleEstimate]) -> tuple[float, float]:
    levels = sorted(found[0].quantiles_s) if found else [0.05, 0.95]
    return levels[0], levels[-1]


def tasks_table(entry: CycleEstimate) -> str:
    """Return one row per task of a sequence, in order, mean seconds."""
    rows = [
        [task.task, f"{task.expected_s:.1f}", *(f"{getattr(task, part):.1f}" for part in _SPLIT)]
        for task in entry.tasks
    ]
    return table(["task ", "expected, s", "motion", "safety", "dwell", "wait"], rows)


def rests_on(found: Sequence[CycleEstimate]) -> str:
    """Return what the numbers rest on and what limits them, one line each."""
    lines: list[str] = []
    for entry in found:
        lines.append(
            f"{entry.name}: {entry.estimator}, as {entry.why}; {entry.executions} logged executions, {entry.tracks} "
            f"operator tracks; {percent(entry.support)} of the time near logged positions; mean between "
            f"{entry.expected_low_s:.1f} and {entry.expected_high_s:.1f} s (95%)"
        )
        lines.extend(f"{entry.name}: {text}" for text in entry.warnings)
    return "What the numbers rest on\n" + bullet(lines)


def as_csv(found: Sequence[CycleEstimate]) -> str:
    """Return one CSV row per sequence, quantiles as columns `q0.05_s` and so on."""
    import csv
    import io

    page = io.StringIO()
    levels = sorted(found[0].quantiles_s) if found else []
    writer = csv.writer(page, lineterminator="\n")
    writer.writerow([*_COLUMNS, *(f"q{level:g}_s" for level in levels), *_SPLIT, "support", "tracks", "warnings"])
    for entry in found:
        row: list[Any] = [getattr(entry, name) for name in _COLUMNS]
        row += [entry.quantiles_s[level] for level in levels]
        row += [getattr(entry, name) for name in _SPLIT]
        writer.writerow([*row, entry.support, entry.tracks, " | ".join(entry.warnings)])
    return page.getvalue()
