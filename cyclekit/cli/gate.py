"""`cyclekit gate`: exits with 0 if enough cycles are within takt, else with 1."""

from __future__ import annotations

from typing import Annotated

import typer

from cyclekit.cli.light import light
from cyclekit.cli.options import (
    Checked,
    Extrapolate,
    Json,
    LoggedPlace,
    ModelPlace,
    OtherCell,
    Quiet,
    SequenceFile,
    seconds,
)
from cyclekit.cli.terminal import Terminal

EXAMPLE = "cyclekit gate model sequences.toml --dataset dataset --takt 105s --confidence 0.95"


def gate(
    model: ModelPlace,
    sequences: SequenceFile,
    dataset: LoggedPlace,
    takt: Annotated[str, typer.Option(metavar="TIME", help="Takt time, such as 105s or 1min 45s.")],
    confidence: Annotated[float, typer.Option(help="Share of the cycles that must be within the takt.")] = 0.95,
    sure: Annotated[
        bool, typer.Option("--sure", help="Also ask it of the lower end of the share's 95 % confidence interval.")
    ] = False,
    sequence: Annotated[str | None, typer.Option(help="Judge this sequence alone.", metavar="NAME")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the resampling.")] = 0,
    check: Checked = True,
    extrapolate: Extrapolate = False,
    other_cell: OtherCell = False,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Judge whether enough cycles are within the takt.

    For scripts and CI: exit code 0 if every sequence in the file passes, 1 if one fails, 2 if that is unknown.
    """
    from cyclekit.api.gate import gate_takt

    terminal, takt_s = Terminal(json=json, quiet=quiet), seconds(takt)
    if not 0 < confidence < 1:
        raise typer.BadParameter(f"{confidence:g} is not between 0 and 1", param_hint="--confidence")
    with terminal.progress("estimating") as progress:
        found = gate_takt(
            model,
            dataset,
            sequences,
            takt_s,
            confidence=confidence,
            sure=sure,
            sequence=sequence,
            seed=seed,
            validate=check,
            extrapolate=extrapolate,
            other_cell=other_cell,
            progress=progress,
        )
    terminal.remark(light(found.estimates))
    terminal.answer(found.to_dict(), found.line)
    return 0 if found.passed else 1
