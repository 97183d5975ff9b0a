"""`cyclekit gate`: exits with 0 if enough cycles are within takt, with 1 if not, with 2 if that is unknown."""

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
from cyclekit.cli.terminal import Terminal, bullet
from cyclekit.text.numbers import given

EXAMPLE = "cyclekit gate model sequences.toml --dataset dataset --takt 105s --share 0.95"


def gate(
    model: ModelPlace,
    sequences: SequenceFile,
    dataset: LoggedPlace,
    takt: Annotated[str, typer.Option(metavar="TIME", help="Takt time, such as 105s or 1min 45s.")],
    share: Annotated[
        float | None, typer.Option(help="Share of the cycles that must be within the takt; default 0.95.")
    ] = None,
    confidence: Annotated[
        float | None, typer.Option(help="How sure that must be, with --share; 0.5: best estimate; default 0.95.")
    ] = None,
    sequence: Annotated[str | None, typer.Option(help="Judge this sequence alone.", metavar="NAME")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the resampling.")] = 0,
    check: Checked = True,
    extrapolate: Extrapolate = False,
    other_cell: OtherCell = False,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Judge whether enough cycles are within the takt.

    For scripts and CI: exit code 0 if every sequence in the file passes, 1 if one fails, 2 if that is unknown: if the
    basis of the number cannot be trusted, or the logs are too few to tell. It says why and what to do.
    """
    from cyclekit.api.gate import gate_takt

    terminal, takt_s = Terminal(json=json, quiet=quiet), seconds(takt)
    if confidence is not None and share is None:
        msg = "--confidence is no longer the share of cycles: give --share too, and --confidence is how sure it must be"
        raise typer.BadParameter(msg, param_hint="--confidence")
    if share is not None and not 0 < share < 1:
        raise typer.BadParameter(f"{given(share)} is not between 0 and 1", param_hint="--share")
    if confidence is not None and not 0.5 <= confidence < 1:
        raise typer.BadParameter(f"{given(confidence)} is not in 0.5 to 1", param_hint="--confidence")
    with terminal.progress("estimating") as progress:
        found = gate_takt(
            model,
            dataset,
            sequences,
            takt_s,
            share=share,
            confidence=confidence,
            sequence=sequence,
            seed=seed,
            validate=check,
            extrapolate=extrapolate,
            other_cell=other_cell,
            progress=progress,
        )
    terminal.remark(light(found.estimates))
    why = bullet(found.why_unknown(found.worst))
    terminal.answer(found.to_dict(), f"{bullet([found.line], mark='')}\n{why}".rstrip())
    return found.exit_code
