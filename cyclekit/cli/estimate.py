"""`cyclekit estimate`: the expected cycle time of task sequences, ranked."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cyclekit.cli.options import Json, Quiet
from cyclekit.cli.terminal import Terminal, bullet, percent, table, write_out

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.result import CycleEstimate

EXAMPLE = "cyclekit estimate model sequences.toml --dataset dataset"
CAPTION = "seconds: motion at full speed + slow-down for safety + dwell + wait = expected"
_COLUMNS = ("name", "expected_s", "expected_low_s", "expected_high_s")
_SPLIT = ("nominal_s", "safety_loss_s", "dwell_s", "wait_s")


def estimate(
    model: Annotated[Path, typer.Argument(help="Folder of the model.", metavar="MODEL")],
    sequences: Annotated[
        Path, typer.Argument(help="Sequence file: names and ordered places or tasks.", metavar="SEQUENCES.toml")
    ],
    dataset: Annotated[Path, typer.Option(help="Dataset that holds the robot's motions and the operator's tracks.")],
    out: Annotated[Path | None, typer.Option(help="Also write the result here: JSON, or CSV for x.csv.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the resampling of operator tracks.")] = 0,
    extrapolate: Annotated[
        bool, typer.Option("--extrapolate", help="Answer even where nothing like it was logged.")
    ] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the cycle time of task sequences, ranked.

    Per sequence: the mean, the range of single cycles, where the time goes, and what the number rests on.
    """
    from cyclekit.dataset import Dataset
    from cyclekit.estimate.rollout import estimate as estimate_cycles
    from cyclekit.models.saved import load_model
    from cyclekit.sequences import load_sequences

    terminal = Terminal(json=json, quiet=quiet)
    wanted = load_sequences(sequences)
    with terminal.progress("estimating") as progress:
        found = estimate_cycles(
            load_model(model), Dataset.open(dataset), wanted, seed=seed, extrapolate=extrapolate, progress=progress
        )
    document = {"sequences": [entry.to_json() for entry in found]}
    if out is not None:
        write_out(out, as_csv(found) if out.suffix.lower() == ".csv" else document)
        terminal.remark(f"written: {out}")
    by_task = tasks_table(found[0]) if len(found) == 1 else ""
    terminal.answer(document, f"{estimates_table(found)}\n{CAPTION}", by_task, loses_most(found), rests_on(found))


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


def loses_most(found: Sequence[CycleEstimate]) -> str:
    """Return where each sequence loses most to safety: at which task, and while the operator does what."""
    lines = []
    for entry in found:
        if entry.safety_loss_s <= 0 or not entry.tasks:
            lines.append(f"{entry.name}: nothing is lost to safety")
            continue
        task = max(entry.tasks, key=lambda share: share.safety_loss_s)
        text = f"{entry.name}: most at {task.task} ({task.safety_loss_s:.1f} s)"
        known = {name: lost for name, lost in entry.safety_by_activity_s.items() if name != "unknown"}
        if known:
            activity = max(known, key=lambda name: known[name])
            text += f"; with the operator at or on the way to {activity} ({known[activity]:.1f} s in all)"
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
            f"{entry.name}: {entry.tracks} logged operator tracks; {percent(entry.support)} of the time near logged "
            f"positions; mean between {entry.expected_low_s:.1f} and {entry.expected_high_s:.1f} s (95%)"
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
