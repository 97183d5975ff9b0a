"""`cyclekit whatif`: estimates cycle times in a changed cell from the same logs."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.estimate import not_answered
from cyclekit.cli.light import light, marked
from cyclekit.cli.options import Checked, Extrapolate, Json, LoggedPlace, ModelPlace, OtherCell, Quiet, SequenceFile
from cyclekit.cli.terminal import Terminal, bullet, table
from cyclekit.text.numbers import difference, fixed, interval

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.whatif import WhatIf

EXAMPLE = """cyclekit whatif model sequences.toml changes.toml --dataset dataset

\b
changes.toml, more in docs/commands.md:
  [[change]]
  name = "other thresholds"     # of the rule in the model
  limits = [{ level = 0.5, threshold_m = 1.3 }, { level = 0, threshold_m = 0.7 }]
  [[change]]
  name = "quicker recovery"     # also ramp_down_per_s, latency_s, hysteresis_m
  ramp_up_per_s = 2.0"""


def whatif(
    model: ModelPlace,
    sequences: SequenceFile,
    changes: Annotated[Path, typer.Argument(help="What is changed: [[change]] tables.", metavar="CHANGES.toml")],
    dataset: LoggedPlace,
    out: Annotated[Path | None, typer.Option(help="Also write the result here, as JSON.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the resampling.")] = 0,
    check: Checked = True,
    extrapolate: Extrapolate = False,
    other_cell: OtherCell = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Estimate cycle times in a changed cell. No safety proof.

    Changes: thresholds and edges of the model's rule, another staircase or zones, reaction time, ramps and hysteresis,
    a moved base or place, more or fewer visits of the operator; a faster operator, a second fixture, a buffer, a
    removed wait. A sequence or change that cannot be answered from these logs is listed with the reason, and the others
    are answered; if none can be answered, the command fails.
    """
    from cyclekit.api.whatif import what_if

    terminal = Terminal(json=json, quiet=quiet)
    with terminal.progress("estimating") as progress:
        found = what_if(
            model,
            dataset,
            sequences,
            changes,
            out=out,
            seed=seed,
            extrapolate=extrapolate,
            validate=check,
            other_cell=other_cell,
            progress=progress,
        )
    if out is not None:
        terminal.remark(f"written: {out}")
    lamp = light([side for entry in found for side in (entry.before, entry.after)])
    terminal.answer(found.to_dict(), lamp, _table(found), not_answered(found.refused), _limits(found), found.safety)


def _table(found: Sequence[WhatIf]) -> str:
    rows = []
    for entry in found:
        after, places = entry.after, entry.decimals
        saved = fixed(difference(entry.before.expected_s, after.expected_s, places), places)
        rows.append(
            [
                entry.change,
                after.name,
                marked(entry.before, fixed(entry.before.expected_s, places)),
                marked(after, fixed(after.expected_s, places)),
                interval(after.expected_low_s, after.expected_high_s, places),
                f"{saved} ({interval(*entry.saves_s[1:], places)})",
            ]
        )
    return table(["change ", "sequence ", "before, s", "after, s", "95 % CI, s", "saves, s (95 % CI)"], rows)


def _limits(found: Sequence[WhatIf]) -> str:
    """Return every limit with its change and sequences."""
    about: dict[tuple[str, str], list[str]] = {}
    for entry in found:
        for text in entry.after.limits:
            if text != entry.safety:
                about.setdefault((entry.change, text), []).append(entry.after.name)
    every = len({entry.after.name for entry in found})
    shown = {key: "all sequences" if len(names) == every > 1 else ", ".join(names) for key, names in about.items()}
    times = Counter(text for _, text in about for _ in about[_, text])
    of_all = [text for text, n in times.items() if n == len(found) > 1]
    lines = [f"{change}, {shown[change, text]}: {text}" for change, text in about if text not in of_all]
    return bullet([*lines, *of_all])
