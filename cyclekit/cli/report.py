"""`cyclekit report`: writes the page that an integrator hands to the customer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cyclekit.cli.options import Baseline, Checked, DatasetPlace, Extrapolate, Json, OtherCell, Quiet, Takt, seconds
from cyclekit.cli.terminal import Terminal
from cyclekit.text.numbers import megabytes

if TYPE_CHECKING:
    from cyclekit.report import ReportFacts

EXAMPLE = "cyclekit report dataset --model model --sequences sequences.toml --out report.html"

Format = Literal["html", "json", "csv", "md", "xlsx"]
FORMATS: tuple[Format, ...] = ("html", "json", "csv", "md", "xlsx")


def report(
    dataset: DatasetPlace,
    out: Annotated[Path, typer.Option(help="Page to write (.html).")],
    model: Annotated[
        str | None,
        typer.Option(metavar="MODEL", help="Model: a folder or its URL; without it the page covers the logs alone."),
    ] = None,
    sequences: Annotated[
        Path | None, typer.Option(metavar="SEQUENCES.toml", help="Sequence file whose estimates go into the page.")
    ] = None,
    takt: Takt = None,
    baseline: Baseline = None,
    what_if: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CHANGES.toml",
            help="Try these changes; or show FILE.json of whatif, or LABEL=FILE.json of estimate. Repeat for more.",
        ),
    ] = None,
    plan: Annotated[
        Path | None, typer.Option(metavar="JOBS.toml", help="Search the order of this work with the least cycle time.")
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="html, json, csv, md or xlsx; default: by the suffix of --out."),
    ] = None,
    pdf: Annotated[
        Path | None, typer.Option(help="Also print the page to this PDF, with an installed browser.")
    ] = None,
    template: Annotated[
        Path | None, typer.Option(help="Folder with your logo, cover, words or look (docs/report.md).")
    ] = None,
    play: Annotated[
        bool, typer.Option("--play/--no-play", help="Let the reader of the page try other orders and thresholds.")
    ] = True,
    check: Checked = True,
    extrapolate: Extrapolate = False,
    other_cell: OtherCell = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write the page for the customer.

    One HTML file that needs no network: cycle times, where the time goes, why, what would help, and how reliable that
    is. A sequence or change that cannot be answered from these logs is named there with the reason, and the others are
    answered; if no sequence can be answered, the command fails.
    """
    from cyclekit.api.report import write_report

    terminal = Terminal(json=json, quiet=quiet)
    takt_s, chosen = seconds(takt) if takt else None, _format(kind, out, pdf)
    _check(sequences, what_if or [], plan, model)
    with terminal.progress("writing the page") as progress:
        facts = write_report(
            dataset,
            out,
            model=model,
            sequences=sequences,
            what_if=what_if or [],
            jobs=plan,
            takt_s=takt_s,
            baseline=baseline,
            kind=chosen,
            pdf=pdf,
            template=template,
            play=play,
            validate=check,
            extrapolate=extrapolate,
            other_cell=other_cell,
            progress=progress,
        )
    terminal.warnings([*facts.missing, *(f"not answered: {each.reason}" for each in facts.refused)])
    terminal.done(facts.to_dict(), _said(facts, chosen))


def _said(facts: ReportFacts, kind: str) -> str:
    page = ", open it in any browser" if kind == "html" else ""
    lines = [facts.headline, f"{facts.path}: {megabytes(facts.bytes)}{page}"]
    return "\n".join([*lines, *([f"{facts.pdf}: {megabytes(facts.pdf.stat().st_size)}"] if facts.pdf else [])])


def _check(sequences: Path | None, what_if: list[str], plan: Path | None, model: str | None) -> None:
    """Raise an error for options that cannot be combined."""
    changes = [each for each in what_if if each.lower().endswith(".toml") and "=" not in each]
    for each in what_if:
        if each not in changes and not each.lower().endswith(".json"):
            msg = f'{each!r} is neither CHANGES.toml nor FILE.json nor "conveyor 0.3 m back=FILE.json"'
            raise typer.BadParameter(msg, param_hint="--what-if")
    if changes and not sequences and not plan:
        raise typer.BadParameter("changes are tried on sequences; add --sequences or --plan", param_hint="--what-if")
    for wanted, option in ((sequences, "--sequences"), (plan, "--plan")):
        if wanted and model is None:
            raise typer.BadParameter("estimates need a model; add --model", param_hint=option)


def _format(kind: str | None, out: Path, pdf: Path | None) -> Format:
    asked = kind or {".htm": "html", ".markdown": "md"}.get(out.suffix.lower(), out.suffix.lower().lstrip("."))
    chosen = next((known for known in FORMATS if known == (asked or "html")), None)
    if chosen is None:
        msg = f"{asked!r} is not one of {', '.join(FORMATS)}"
        raise typer.BadParameter(msg, param_hint="--format" if kind else "--out")
    if pdf is not None and chosen != "html":
        raise typer.BadParameter("only the page can be printed; leave --format html", param_hint="--pdf")
    return chosen
