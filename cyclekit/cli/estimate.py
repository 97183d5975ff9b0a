"""`cyclekit estimate`: estimates and ranks the cycle times of task sequences."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.light import light, marked
from cyclekit.cli.options import (
    Baseline,
    Checked,
    EngineName,
    Extrapolate,
    Jobs,
    Json,
    LoggedPlace,
    ModelPlace,
    OtherCell,
    Quiet,
    RayAddress,
    SequenceFile,
    Takt,
    engine_of,
    levels,
    seconds,
)
from cyclekit.cli.terminal import Terminal, bullet, table
from cyclekit.text.numbers import (
    counted,
    decimals_of,
    exact_percent,
    fixed,
    given,
    percent,
    percent_interval,
    signed_percent,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.answers import Refusal
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.validation.check import Check

EXAMPLE = "cyclekit estimate model sequences.toml --dataset dataset"
CAPTION = "seconds: motion at full speed + slow-down for safety + dwell + wait = expected"
OF_LISTS = "seconds of the robot: usual task times + effect of simultaneous tasks + wait"
IDLE = "seconds: motion at full speed + slow-down for safety + dwell + wait"
UNTIL_DONE = " + idle until the operator is done = expected"
SPLIT_HEADS = ["motion", "safety", "dwell", "wait"]
PLAN_RESTS = "continued: the robot waited on its way to the place"
PLAN_SHARES = "in brackets: in which share of the cycles it came last"
MIN_WAIT_S = 0.05
"""Minimum wait between two tasks, s, whose cause is printed."""


def estimate(
    model: ModelPlace,
    sequences: SequenceFile,
    dataset: LoggedPlace,
    out: Annotated[Path | None, typer.Option(help="Also write it here: JSON; CSV for x.csv, Excel for x.xlsx.")] = None,
    gantt: Annotated[Path | None, typer.Option(help="Also draw a time chart here: SVG, PNG or PDF.")] = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="rollout (simulation), average, history (sums of logged tasks) or nominal (no people); "
            "default: by the model.",
        ),
    ] = None,
    takt: Takt = None,
    baseline: Baseline = None,
    quantiles: Annotated[str, typer.Option(metavar="LEVELS", help="Quantiles of single cycles, percent.")] = "5,50,95",
    check: Checked = True,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the resampling of logged executions.")] = 0,
    extrapolate: Extrapolate = False,
    other_cell: OtherCell = False,
    engine: EngineName = "local",
    jobs: Jobs = None,
    ray_address: RayAddress = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the cycle time of task sequences.

    Per sequence: the mean, the range of single cycles, where the time goes, and the basis of the number; ranked among
    those that do the same work. A sequence that cannot be answered from these logs is listed with the reason, and the
    others are answered; if none can be answered, the command fails.
    """
    from cyclekit.api.estimate import estimate_cycles
    from cyclekit.api.given import refuse_baseline, sequences_of
    from cyclekit.api.inspect import plan_recordings
    from cyclekit.cli.facts import to_log
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.report.texts import load_texts
    from cyclekit.report.verdict import basis, in_words, others, verdict

    terminal, work = Terminal(json=json, quiet=quiet), engine_of(engine, jobs, ray_address)
    if baseline is not None:
        refuse_baseline(baseline, [each.name for each in sequences_of(sequences)])
    asked, takt_s = levels(quantiles), None if takt is None else seconds(takt)
    with terminal.progress("estimating") as progress:
        found = estimate_cycles(
            model,
            dataset,
            sequences,
            out=out,
            gantt=gantt,
            estimator=estimator,
            quantiles=asked,
            takt_s=takt_s,
            seed=seed,
            extrapolate=extrapolate,
            validate=check,
            other_cell=other_cell,
            engine=work,
            progress=progress,
        )
    found.require(baseline)
    for file in (out, gantt):
        if file is not None:
            terminal.remark(f"written: {file}")
    by_task = "" if len(found) != 1 else plan_table(found[0]) if found[0].plan else tasks_table(found[0])
    caption = _caption(found)
    numbers = f"{estimates_table(found)}\n{bullet([caption], mark='')}"
    parts = [
        light(found),
        numbers,
        not_answered(found.refused),
        to_log(plan_recordings(dataset, sequences)) if found.refused and not found[0].plan else "",
        ranking(found),
        takt_table(found),
        by_task,
        "" if any(entry.plan for entry in found) else largest_losses(found),
    ]
    parts += [basis_and_limits(found), validation(found.check) if found.check else ""]
    logs, texts = Dataset.of(dataset), load_texts()
    if (held := verdict(logs, found, (), None, takt_s, baseline)) is not None:
        said = [in_words(texts, each) for each in (held, *others(logs, found, (), held))]
        parts.append(bullet([*filter(None, said), basis(texts, held)], mark=""))
    terminal.answer(found.to_dict(), *parts)


def not_answered(refused: Sequence[Refusal]) -> str:
    """Return the sequences and changes without an answer, one per line with the reason."""
    return f"Not answered\n{bullet([one.reason for one in refused])}" if refused else ""


def estimates_table(found: Sequence[CycleEstimate]) -> str:
    """Return one table per kind of work, fastest first: expected time, range of cycles, and its parts."""
    from cyclekit.estimate.result import SPLIT
    from cyclekit.estimate.statistics.same_work import by_work

    (low, high), places = _range(found), decimals_of(*(entry.expected_s for entry in found))
    parts = ["usual", "beside", "dwell", "wait"] if _of_lists(found) else SPLIT_HEADS
    idle = ["idle_s"] if any(one.plan for one in found) else []
    heads = ["sequence ", "expected", f"{percent(high - low)} of cycles", *parts, *(["idle"] if idle else [])]
    works = by_work(found)
    tables = []
    for work, entries in works.items():
        rows = [
            [
                f"{place}. {entry.name}" if len(entries) > 1 else entry.name,
                marked(entry, f"{fixed(entry.expected_s, places)} s"),
                f"{fixed(entry.quantiles_s[low], places)}-{fixed(entry.quantiles_s[high], places)} s",
                *(fixed(getattr(entry, part), places) for part in (*SPLIT, *idle)),
            ]
            for place, entry in enumerate(entries, start=1)
        ]
        tables.append(table(heads, rows, title=bullet([str(work)], mark="") if len(works) > 1 else ""))
    return "\n\n".join(tables)


def _of_lists(found: Sequence[CycleEstimate]) -> bool:
    """Return whether the estimates are from task lists, which have no motion."""
    return any(entry.estimator == "task times" for entry in found)


def _caption(found: Sequence[CycleEstimate]) -> str:
    """Return the caption that explains the columns of the table."""
    if not any(entry.plan for entry in found):
        return CAPTION
    return (OF_LISTS if _of_lists(found) else IDLE) + UNTIL_DONE


def ranking(found: Sequence[CycleEstimate]) -> str:
    """Return the probabilities that the first sequence of each kind of work is faster than each of the others."""
    from cyclekit.estimate.statistics.same_work import by_work

    works = by_work(found)
    rows = [
        [f"“{first.name}” shorter than “{name}”", percent(chance)]
        for first, *_ in works.values()
        for name, chance in list(first.beats.items())[:20]
    ]
    chances = table(["mean cycle time ", "probability"], rows) if rows else ""
    return "\n\n".join(part for part in (chances, _per_visit(found) if len(works) > 1 else "") if part)


def _per_visit(found: Sequence[CycleEstimate]) -> str:
    """Return the time per visit, the only number by which sequences of different work can be compared."""
    rows = [[entry.name, str(len(entry.places) - 1), f"{fixed(entry.per_visit_s, 2)} s"] for entry in found]
    different = "The work differs: sequences are compared only with those of the same visits."
    return table(["sequence ", "visits", "per visit"], rows, title=different)


def takt_table(found: Sequence[CycleEstimate]) -> str:
    """Return the share of cycles within takt, with its 95 % interval."""
    rows = []
    for entry in found:
        if entry.takt_probability is not None:
            share, low, high = entry.takt_probability
            rows.append([entry.name, percent(share), percent_interval(low, high)])
    return table(["sequence ", f"within {given(found[0].takt_s or 0.0)} s", "95 % CI"], rows) if rows else ""


def validation(check: Check) -> str:
    """Return the result of the validation on logged executions."""
    lines = [
        f"{counted(check.executions, 'logged execution')} rolled out with {check.with_own}: "
        f"bias {signed_percent(check.own_bias, 2)} (95 % CI ± {percent(check.own_within, 2)}), "
        f"{check.held_out} of them unseen by the network",
    ]
    if abs(check.factor - 1) >= 5e-5:
        lines.append(f"every duration above is corrected by {signed_percent(check.factor - 1, 2)}")
    if check.coverage is not None:
        low, high = check.levels
        lines.append(
            f"with {check.with_others}: {percent(check.coverage)} lie between the {exact_percent(low)} and "
            f"{exact_percent(high)} quantiles, which should hold {percent(high - low)}"
        )
    return "Backtest on logged executions\n" + bullet(lines)


def largest_losses(found: Sequence[CycleEstimate]) -> str:
    """Return the task and the operator's activity with the largest safety loss of each sequence."""
    from cyclekit.estimate.result import OF_STATES

    lines = []
    for entry in found:
        if entry.costliest_task is None:
            lines.append(f"{entry.name}: nothing is lost to safety")
            continue
        task, part = entry.costliest_task
        lost_s = fixed(task.safety_loss_s, 1), fixed(entry.safety_loss_s, 1)
        text = f"{entry.name}: {' of '.join(lost_s)} s at {task.task}, {_largest(part)}"
        if entry.costliest_activity is not None:
            activity, lost = entry.costliest_activity
            where = "" if activity.startswith(OF_STATES) else "the operator at or on the way to "
            text += f"; {fixed(lost, 1)} s with {where}{activity}"
            text += f", {_largest(lost / entry.safety_loss_s)}"
        lines.append(text)
    return "Where safety slows the robot\n" + bullet(lines)


def _largest(part: float) -> str:
    """Return the wording for the largest share: `most` only above one half."""
    from cyclekit.estimate.result import MAJORITY

    return f"most of it ({percent(part)})" if part > MAJORITY else f"the largest share ({percent(part)})"


def _range(found: Sequence[CycleEstimate]) -> tuple[float, float]:
    levels = sorted(found[0].quantiles_s) if found else [0.05, 0.95]
    return levels[0], levels[-1]


def tasks_table(entry: CycleEstimate) -> str:
    """Return a table of mean seconds with one row per task of a sequence, in order."""
    from cyclekit.estimate.result import SPLIT

    places = decimals_of(entry.expected_s)
    rows = [
        [task.task, *(fixed(getattr(task, part), places) for part in ("expected_s", *SPLIT))] for task in entry.tasks
    ]
    return table(["task ", "expected, s", "motion", "safety", "dwell", "wait"], rows)


def plan_table(entry: CycleEstimate) -> str:
    """Return a table with one row per task of a plan for both agents: start, end, and cause of its wait."""
    from cyclekit.estimate.gantt import ALWAYS

    rows, places = [], decimals_of(entry.expected_s)
    for task in sorted(entry.plan, key=lambda one: one.start_s):
        cause, share = (task.ended_by if task.wait_s > MIN_WAIT_S else None) or ("-", ALWAYS)
        waited = cause if share >= ALWAYS else f"{cause} ({percent(share)})"
        times = [fixed(value_s, places) for value_s in (task.start_s, task.end_s, task.wait_s)]
        rows.append([task.agent, task.shown, *times, waited])
    rests = [PLAN_RESTS] if any(task.rest for task in entry.plan) else []
    shares = [PLAN_SHARES] if any(row[-1].endswith("%)") for row in rows) else []
    notes = bullet([*rests, *shares], mark="")
    return "\n".join(
        [
            table(["agent ", "task ", "start, s", "end, s", "wait, s", "wait ended by "], rows),
            *([notes] if notes else []),
        ]
    )


def basis_and_limits(found: Sequence[CycleEstimate]) -> str:
    """Return the basis and the limits of each estimate, one line each."""
    lines: list[str] = []
    every = [set(entry.limits) for entry in found]
    of_all = set.intersection(*every) if len(found) > 1 else set[str]()
    for entry in found:
        tracks = f", {counted(entry.tracks, 'cycle')} simulated" if entry.tracks else ""
        lines.append(
            f"{entry.name}: {entry.estimator}: {entry.why}; "
            f"{counted(entry.executions, 'logged execution')}{tracks}; {_support(entry)}; mean {entry.mean_in_words}"
        )
        lines.extend(f"{entry.name}: {text}" for text in entry.limits if text not in of_all)
    lines.extend(text for text in (found[0].limits if of_all else ()) if text in of_all)
    return "Basis and limits\n" + bullet(lines)


def _support(entry: CycleEstimate) -> str:
    """Return the share of the cycle that is supported by the logs, or that it is unknown."""
    from math import isnan

    if entry.estimator == "task times":
        return "no positions"
    return (
        "support not counted" if isnan(entry.support) else f"{percent(entry.support)} of the time near logged positions"
    )
