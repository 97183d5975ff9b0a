"""`cyclekit whatif`: cycle times of the same logs in a changed cell."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.options import Extrapolate, Json, LoggedPlace, ModelPlace, Quiet
from cyclekit.cli.terminal import Terminal, bullet, table, write_out

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.whatif import WhatIf

EXAMPLE = "cyclekit whatif model sequences.toml changes.toml --dataset dataset"


def whatif(
    model: ModelPlace,
    sequences: Annotated[
        Path, typer.Argument(help="Sequence file: names and ordered places or tasks.", metavar="SEQUENCES.toml")
    ],
    changes: Annotated[Path, typer.Argument(help="What is changed: [[change]] tables.", metavar="CHANGES.toml")],
    dataset: LoggedPlace,
    out: Annotated[Path | None, typer.Option(help="Also write the result here, as JSON.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the resampling.")] = 0,
    extrapolate: Extrapolate = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Estimate cycle times in a changed cell. No safety proof.

    Another staircase or zones, a moved base or place, an operator who comes more or less often.
    """
    from cyclekit.dataset import Dataset
    from cyclekit.guard import check_output
    from cyclekit.models.saved import load_model
    from cyclekit.sequences import load_sequences
    from cyclekit.whatif import NO_PROOF, load_changes, what_if

    terminal = Terminal(json=json, quiet=quiet)
    check_output(out, "what-if", [model, sequences, changes, dataset])
    wanted, changed = load_sequences(sequences), load_changes(changes)
    with terminal.progress("estimating") as progress:
        found = what_if(
            load_model(model),
            Dataset.open(dataset),
            wanted,
            changed,
            seed=seed,
            extrapolate=extrapolate,
            progress=progress,
        )
    document = {"safety": NO_PROOF, "answers": [entry.to_json() for entry in found]}
    if out is not None:
        write_out(out, document)
        terminal.remark(f"written: {out}")
    terminal.answer(document, _table(found), _limits(found), NO_PROOF)


def _table(found: Sequence[WhatIf]) -> str:
    rows = []
    for entry in found:
        saved, low, high = entry.saves_s
        after = entry.after
        rows.append(
            [
                entry.change,
                after.name,
                f"{entry.before.expected_s:.1f}",
                f"{after.expected_s:.1f}",
                f"{after.expected_low_s:.1f}-{after.expected_high_s:.1f}",
                f"{saved:.1f} ({low:.1f} to {high:.1f})",
            ]
        )
    return table(["change ", "sequence ", "before, s", "after, s", "mean (95%)", "saves, s"], rows)


def _limits(found: Sequence[WhatIf]) -> str:
    texts = [f"{entry.change}: {text}" for entry in found for text in entry.after.warnings if text != entry.safety]
    return bullet(list(dict.fromkeys(texts)))
