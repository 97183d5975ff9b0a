"""`cyclekit whatif`: cycle times of the same logs in a changed cell."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.estimate import alarmed, alarms_of, doubted, not_answered, starred
from cyclekit.cli.options import Checked, Extrapolate, Json, LoggedPlace, ModelPlace, OtherCell, Quiet
from cyclekit.cli.terminal import Terminal, bullet, table, write_out

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.errors import EstimateError
    from cyclekit.estimate.whatif import WhatIf

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
    check: Checked = True,
    extrapolate: Extrapolate = False,
    other_cell: OtherCell = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Estimate cycle times in a changed cell. No safety proof.

    Another staircase or zones, a moved base or place, an operator who comes more or less often. A change that cannot be
    answered from these logs is named with the reason, and the others are answered; if none can be, that is an error.
    """
    from cyclekit.config.sequences import load_sequences
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.dataset.guard import check_output
    from cyclekit.errors import EstimateError
    from cyclekit.estimate.whatif import NO_PROOF, load_changes, what_if
    from cyclekit.learning.networks.saved import load_model

    terminal = Terminal(json=json, quiet=quiet)
    check_output(out, "what-if", [model, sequences, changes, dataset], endings=(".json",))
    wanted, changed = load_sequences(sequences), load_changes(changes)
    refused: dict[str, EstimateError] = {}
    with terminal.progress("estimating") as progress:
        found = what_if(
            load_model(model),
            Dataset.open(dataset),
            wanted,
            changed,
            seed=seed,
            extrapolate=extrapolate,
            validate=check,
            other_cell=other_cell,
            refused=lambda change, error: refused.__setitem__(change.name, error),
            progress=progress,
        )
    if not found:
        raise EstimateError("\n".join(map(str, refused.values())))
    alarms = alarms_of([entry.before for entry in found])
    document = {
        "safety": NO_PROOF,
        "warnings": alarms,
        "answers": [entry.to_json() for entry in found],
        "refused": [{"change": name, "reason": str(error)} for name, error in refused.items()],
    }
    if out is not None:
        write_out(out, document)
        terminal.remark(f"written: {out}")
    numbers = f"{_table(found)}\n{doubted([side for entry in found for side in (entry.before, entry.after)])}".rstrip()
    terminal.answer(document, alarmed(alarms), numbers, not_answered(refused), _limits(found), NO_PROOF)


def _table(found: Sequence[WhatIf]) -> str:
    rows = []
    for entry in found:
        saved, low, high = entry.saves_s
        after = entry.after
        rows.append(
            [
                entry.change,
                after.name,
                starred(entry.before, f"{entry.before.expected_s:.1f}"),
                starred(after, f"{after.expected_s:.1f}"),
                f"{after.expected_low_s:.1f}-{after.expected_high_s:.1f}",
                f"{saved:.1f} ({low:.1f} to {high:.1f})",
            ]
        )
    return table(["change ", "sequence ", "before, s", "after, s", "mean (95%)", "saves, s"], rows)


def _limits(found: Sequence[WhatIf]) -> str:
    """Return every warning with its change and the sequences that it is about; doubts stand under the table."""
    about: dict[tuple[str, str], list[str]] = {}
    for entry in found:
        for text in entry.after.warnings:
            if text not in (entry.safety, *entry.after.doubts):
                about.setdefault((entry.change, text), []).append(entry.after.name)
    every = len({entry.after.name for entry in found})
    shown = {key: "all sequences" if len(names) == every > 1 else ", ".join(names) for key, names in about.items()}
    return bullet([f"{change}, {shown[change, text]}: {text}" for change, text in about])
