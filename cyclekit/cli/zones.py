"""`cyclekit zones`: reads the safety function back from logs and network."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cyclekit.cli.options import DatasetPlace, Extrapolate, Json, ModelPlace, OtherCell, Quiet
from cyclekit.cli.terminal import Terminal, bullet, table
from cyclekit.text.numbers import compact, exact_percent, fixed, percent, signed

if TYPE_CHECKING:
    from cyclekit.dataset.cards.rule import RuleCard
    from cyclekit.estimate.whatif.costs import SafetyCosts
    from cyclekit.estimate.whatif.separation import Margins, Separation
    from cyclekit.learning.safety_function import SafetyFunction

EXAMPLE = """cyclekit zones model dataset --out zones.svg

\b
And what each centimetre costs, with the margin to S_p:
  --cost sequences.toml --reaction-time-s 0.1 --stopping-time-s 0.3
  --stopping-distance-m 0.2 --robot-speed-m-s 1 --intrusion-m 0.2
  --operator-uncertainty-m 0.05 --robot-uncertainty-m 0.01"""


def zones(
    model: ModelPlace,
    dataset: DatasetPlace,
    out: Annotated[Path | None, typer.Option(help="Also draw it here: SVG, PNG or PDF.")] = None,
    cost: Annotated[
        Path | None,
        typer.Option(help="Sequence file: also print what each centimetre costs.", metavar="SEQUENCES.toml"),
    ] = None,
    reaction_time_s: Annotated[
        float | None, typer.Option(help="T_r, to compare the thresholds with S_p; needs --cost and the options below.")
    ] = None,
    stopping_time_s: Annotated[
        str | None, typer.Option(help="T_s of the robot; one, or one for each threshold: 0.1,0.3.", metavar="SECONDS")
    ] = None,
    stopping_distance_m: Annotated[
        str | None, typer.Option(help="S_s of the robot; one, or one for each threshold.", metavar="METRES")
    ] = None,
    robot_speed_m_s: Annotated[
        float | None, typer.Option(help="Greatest speed of the robot towards the person at 100 %.")
    ] = None,
    intrusion_m: Annotated[float | None, typer.Option(help="C, intrusion distance.")] = None,
    operator_uncertainty_m: Annotated[
        float | None, typer.Option(help="Z_d, uncertainty of the person's position.")
    ] = None,
    robot_uncertainty_m: Annotated[float | None, typer.Option(help="Z_r, uncertainty of the robot's position.")] = None,
    approach_speed_m_s: Annotated[float | None, typer.Option(help="K, speed of the person; default: 1.6.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the resampling for the intervals.")] = 0,
    extrapolate: Extrapolate = False,
    other_cell: OtherCell = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Read the safety function back: levels, thresholds, zones.

    Prints the rule if a simple one explains the commanded level; else the best thresholds on a distance and a map of
    the floor. --cost: what each number of the rule costs. No safety proof.
    """
    from cyclekit.api.zones import cost_of_safety_function, read_safety_function

    separation = _separation(
        cost,
        reaction_time_s=reaction_time_s,
        stopping_time_s=stopping_time_s,
        stopping_distance_m=stopping_distance_m,
        robot_speed_m_s=robot_speed_m_s,
        intrusion_m=intrusion_m,
        operator_uncertainty_m=operator_uncertainty_m,
        robot_uncertainty_m=robot_uncertainty_m,
        approach_speed_m_s=approach_speed_m_s,
    )
    terminal = Terminal(json=json, quiet=quiet)
    with terminal.progress("reading zones"):
        found = read_safety_function(model, dataset, out=out, seed=seed, other_cell=other_cell)
    if out is not None:
        terminal.remark(f"written: {out}")
    costs = None
    if cost is not None:
        with terminal.progress("rolling out") as progress:
            costs = cost_of_safety_function(
                model,
                dataset,
                cost,
                found=found.commanded,
                separation=separation,
                seed=seed,
                extrapolate=extrapolate,
                other_cell=other_cell,
                progress=progress,
            )
    shown = (_written(found),) if found.rule_sentences else (_rule(found), _thresholds(found), _explained(found))
    document = found.to_dict() | ({"costs": costs.to_dict()} if costs else {})
    priced = (_costs(costs), _margins(costs.margins)) if costs else ()
    terminal.answer(document, bullet(found.doubts, mark=""), *shown, bullet([*_why(found), *found.notes]), *priced)


def _separation(cost: Path | None, **given: Any) -> Separation | None:  # noqa: ANN401
    """Return the parameters of S_p; None if no option for it was given."""
    from cyclekit.estimate.whatif.separation import Separation

    values = {name: value for name, value in given.items() if value is not None}
    if not values:
        return None
    lacking = [_option(name) for name in given if name not in values and name != "approach_speed_m_s"]
    if cost is None:
        lacking.append("--cost")
    if lacking:
        raise typer.BadParameter(f"also give {', '.join(lacking)}", param_hint=_option(next(iter(values))))
    for name in ("stopping_time_s", "stopping_distance_m"):
        values[name] = _numbers(name, values[name])
    return Separation(**values)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _numbers(name: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise typer.BadParameter(f"{text!r}: give numbers such as 0.1,0.3", param_hint=_option(name)) from error


def _written(found: SafetyFunction) -> str:
    """Return the rule with the parameters of a safety controller."""
    from cyclekit.learning.rules.words import verdict

    first = bullet([verdict(found.commanded)], mark="")
    by_law = found.commanded.rule is not None and found.commanded.rule.law is not None
    last = bullet([_from(found)] if by_law else [_levels(found), _from(found)], mark="")
    fields = _fields(found.commanded.rule) if found.rule == "signals" else ""
    return f"{first}\n{fields}{bullet(found.rule_sentences)}\n{last}"


def _fields(rule: RuleCard | None) -> str:
    """Return a table of fields: signal, position of the TCP, and speed."""
    from cyclekit.learning.rules.words import FIELD_COLUMNS, field_rows

    return table(list(FIELD_COLUMNS), [] if rule is None else field_rows(rule)) + "\n"


def _why(found: SafetyFunction) -> list[str]:
    from cyclekit.learning.rules.words import verdict

    return [] if found.rule_sentences else [verdict(found.commanded)]


def _levels(found: SafetyFunction) -> str:
    levels = ", ".join(
        f"{fixed(level, 2)} ({percent(share)})" for level, share in zip(found.levels, found.shares, strict=True)
    )
    return f"levels, share of the samples: {levels}"


def _from(found: SafetyFunction) -> str:
    return f"from {found.rows} samples of {found.executions} executions"


def _rule(found: SafetyFunction) -> str:
    late = "unknown" if found.hysteresis_m is None else f"{fixed(found.hysteresis_m, 3)} m ({found.hysteresis_origin})"
    rule = f"the speed depends on: {found.rule}"
    return bullet([_levels(found), rule, f"hysteresis: {late}", _from(found)], mark="")


def _thresholds(found: SafetyFunction) -> str:
    if not found.thresholds:  # no log holds positions of people
        return ""
    rows = [
        [
            f"{fixed(entry.slower, 2)} -> {fixed(entry.faster, 2)}",
            *(fixed(metres, 3) for metres in (entry.metres, entry.low, entry.high, network)),
        ]
        for entry, network in zip(found.thresholds, found.thresholds_of_network, strict=True)
    ]
    title = "" if found.is_distance else "Best thresholds on a distance, though distance is not enough"
    return table(["level ", "threshold, m", "from", "to (95 %)", "of the network"], rows, title=title)


def _explained(found: SafetyFunction) -> str:
    best = sorted(found.explained.items(), key=lambda entry: -entry[1])
    return table(["explained by ", "of the variance"], [[name, percent(share)] for name, share in best])


def _costs(costs: SafetyCosts) -> str:
    from cyclekit.estimate.whatif.costs import parameter_label, step_label

    tables = []
    for each in costs.sequences:
        rows = [
            [
                parameter_label(one),
                f"{compact(one.value, 3)} {one.unit}",
                step_label(one),
                signed(one.costs_s, 3),
                fixed(one.standard_error_s, 3),
            ]
            for one in each.parameters
        ]
        title = f"What a change costs, {each.sequence!r}: {fixed(each.expected_s, 1)} s by the rule"
        tables.append(table(["number ", "now", "change", "costs, s", "SE"], rows, title=title))
    return "\n\n".join([*tables, bullet([*costs.notes, costs.safety])])


def _margins(found: Margins | None) -> str:
    if found is None:
        return ""
    rows = [
        [
            f"{exact_percent(row.speed)} beyond",
            *(fixed(metres, 3) for metres in (row.threshold_m, row.separation_m)),
            "-" if row.margin_m is None else signed(row.margin_m, 3),
            signed(row.costs_s_per_cm, 3),
        ]
        for row in found.thresholds
    ]
    title = f"Thresholds compared with the protective separation distance S_p. {found.safety}"
    text = table(["speed ", "threshold, m", "S_p, m", "margin, m", "costs, s/cm"], rows)
    costs = signed(found.reaction_costs_s_per_10_ms, 3)
    late = f"where every threshold follows S_p, 10 ms of reaction time cost {costs} s"
    return "\n".join([bullet([title], mark=""), text, bullet([late, *found.notes])])
