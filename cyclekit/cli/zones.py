"""`cyclekit zones`: the safety function read back from logs and network."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.options import DatasetPlace, Json, ModelPlace, OtherCell, Quiet
from cyclekit.cli.terminal import Terminal, bullet, percent, table

if TYPE_CHECKING:
    from cyclekit.learning.safety_function import SafetyFunction

EXAMPLE = "cyclekit zones model dataset --out zones.svg"


def zones(
    model: ModelPlace,
    dataset: DatasetPlace,
    out: Annotated[Path | None, typer.Option(help="Also draw it here, as SVG.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the resampling for the intervals.")] = 0,
    other_cell: OtherCell = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Read the safety function back: levels, thresholds, zones.

    The rule in words where a simple one explains the commanded level; else the best thresholds on a distance and a map
    of the floor. No safety proof.
    """
    from cyclekit.api.zones import read_safety_function

    terminal = Terminal(json=json, quiet=quiet)
    with terminal.progress("reading zones"):
        found = read_safety_function(model, dataset, out=out, seed=seed, other_cell=other_cell)
    if out is not None:
        terminal.remark(f"written: {out}")
    shown = (_written(found),) if found.rule_sentences else (_rule(found), _thresholds(found), _explained(found))
    terminal.answer(found.to_dict(), *shown, bullet([*_why(found), *found.notes]))


def _written(found: SafetyFunction) -> str:
    """Return the rule as it would be written into a safety controller."""
    from cyclekit.learning.rules.words import verdict

    first = bullet([verdict(found.commanded)], mark="")
    levels = "" if found.commanded.rule is not None and found.commanded.rule.law is not None else f"{_levels(found)}\n"
    return f"{first}\n{bullet(found.rule_sentences)}\n{levels}{_from(found)}"


def _why(found: SafetyFunction) -> list[str]:
    from cyclekit.learning.rules.words import verdict

    return [] if found.rule_sentences else [verdict(found.commanded)]


def _levels(found: SafetyFunction) -> str:
    levels = ", ".join(
        f"{level:.2f} ({percent(share)})" for level, share in zip(found.levels, found.shares, strict=True)
    )
    return f"levels, share of the samples: {levels}"


def _from(found: SafetyFunction) -> str:
    return f"from {found.rows} samples of {found.executions} executions"


def _rule(found: SafetyFunction) -> str:
    late = "unknown" if found.hysteresis_m is None else f"{found.hysteresis_m:.3f} m ({found.hysteresis_origin})"
    rule = f"the speed depends on: {found.rule}"
    return bullet([_levels(found), rule, f"hysteresis: {late}", _from(found)], mark="")


def _thresholds(found: SafetyFunction) -> str:
    rows = [
        [
            f"{entry.slower:.2f} -> {entry.faster:.2f}",
            *(f"{metres:.3f}" for metres in (entry.metres, entry.low, entry.high, network)),
        ]
        for entry, network in zip(found.thresholds, found.thresholds_of_network, strict=True)
    ]
    title = "" if found.is_distance else "Best thresholds on a distance, though distance is not enough"
    return table(["level ", "threshold, m", "from", "to (95%)", "of the network"], rows, title=title)


def _explained(found: SafetyFunction) -> str:
    best = sorted(found.explained.items(), key=lambda entry: -entry[1])
    return table(["explained by ", "of the variance"], [[name, f"{share:.1%}"] for name, share in best])
