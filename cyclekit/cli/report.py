"""`cyclekit report`: the page that an integrator hands to the customer."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cyclekit.cli.options import DatasetPlace, Json, Quiet, seconds
from cyclekit.cli.terminal import Terminal, megabytes

if TYPE_CHECKING:
    from cyclekit.dataset import Dataset
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.evaluate import Evaluation
    from cyclekit.models.saved import TrainedModel
    from cyclekit.report import WhatIf
    from cyclekit.sequences import TaskSequence

EXAMPLE = "cyclekit report dataset --model model --sequences sequences.toml --out report.html"


def report(
    dataset: DatasetPlace,
    out: Annotated[Path, typer.Option(help="Page to write (.html); opens without a network.")],
    model: Annotated[
        str | None, typer.Option(help="Folder of the model; without it the page is about the logs.")
    ] = None,
    sequences: Annotated[Path | None, typer.Option(help="Sequence file whose estimates go into the page.")] = None,
    takt: Annotated[str | None, typer.Option(help="Takt time that the cycles are held against, such as 105s.")] = None,
    what_if: Annotated[
        list[str] | None,
        typer.Option(help="Estimates of a changed cell, again for more.", metavar="LABEL=FILE.json"),
    ] = None,
    kind: Annotated[
        str | None, typer.Option("--format", help="html, json, csv or md; default: by the ending of --out.")
    ] = None,
    pdf: Annotated[
        Path | None, typer.Option(help="Also print the page to this PDF, by the browser that is there.")
    ] = None,
    template: Annotated[
        Path | None, typer.Option(help="Folder with your logo, cover, words or look (docs/report.md).")
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write the page for the customer.

    One self-contained file: the cycle times, where they go, why, what would help, and what all of it rests on.
    """
    from cyclekit.dataset import Dataset
    from cyclekit.models.saved import load_model
    from cyclekit.report import write_pdf, write_report
    from cyclekit.sequences import load_sequences

    terminal = Terminal(json=json, quiet=quiet)
    takt_s = seconds(takt) if takt else None
    chosen, changes = _format(kind, out, pdf), _changes(what_if or [])
    wanted = load_sequences(sequences) if sequences else []
    if wanted and model is None:
        raise typer.BadParameter("estimates need a model; add --model", param_hint="--sequences")
    data, trained = Dataset.open(dataset), load_model(model) if model else None
    found = _found(terminal, data, trained, wanted)
    with terminal.progress("writing the page") as progress:
        facts = write_report(
            data,
            trained,
            out,
            estimates=found.estimates,
            evaluation=found.evaluation,
            what_if=changes,
            takt_s=takt_s,
            missing=found.missing,
            kind=chosen,
            template=template,
            progress=progress,
        )
    if pdf is not None:
        with terminal.progress("printing"):
            write_pdf(out, pdf)
    terminal.warnings(facts.missing)
    document = {"report": str(out), "sequences": len(found.estimates), "bytes": facts.bytes, "missing": facts.missing}
    said = f"{out}: {megabytes(facts.bytes)}" + (", open it in any browser" if chosen == "html" else "")
    printed = {"pdf": str(pdf)} if pdf else {}
    terminal.done({**document, **printed}, said + (f"\n{pdf}: {megabytes(pdf.stat().st_size)}" if pdf else ""))


@dataclass
class _Found:
    """What the page shows beside the logs; what could not be computed is said on the page and ends no command."""

    estimates: list[CycleEstimate] = field(default_factory=list)
    evaluation: Evaluation | None = None
    missing: list[str] = field(default_factory=list)


def _found(terminal: Terminal, data: Dataset, model: TrainedModel | None, wanted: list[TaskSequence]) -> _Found:
    from cyclekit.errors import CyclekitError
    from cyclekit.estimate.rollout import estimate
    from cyclekit.evaluate import evaluate

    found = _Found()
    if model is None:
        return found
    try:
        if wanted:
            with terminal.progress("estimating") as progress:
                found.estimates = estimate(model, data, wanted, progress=progress)
    except CyclekitError as error:
        found.missing.append(f"No estimate: {error}".replace("\n", " "))
    try:
        with terminal.progress("evaluating"):
            found.evaluation = evaluate(model, data)
    except CyclekitError as error:
        found.missing.append(f"The model could not be judged: {error}".replace("\n", " "))
    return found


def _format(kind: str | None, out: Path, pdf: Path | None) -> str:
    from cyclekit.report import FORMATS

    chosen = (
        kind or {".htm": "html", ".markdown": "md"}.get(out.suffix.lower(), out.suffix.lower().lstrip(".")) or "html"
    )
    if chosen not in FORMATS:
        msg = f"{chosen!r} is none of {', '.join(FORMATS)}"
        raise typer.BadParameter(msg, param_hint="--format" if kind else "--out")
    if pdf is not None and chosen != "html":
        raise typer.BadParameter("only the page can be printed; leave --format html", param_hint="--pdf")
    return chosen


def _changes(given: list[str]) -> list[WhatIf]:
    from cyclekit.report import load_what_if

    changes: list[WhatIf] = []
    for entry in given:
        label, equals, file = entry.rpartition("=")
        if not equals or not label.strip():
            msg = f'{entry!r} names no change; write "conveyor 0.3 m back=estimates.json"'
            raise typer.BadParameter(msg, param_hint="--what-if")
        changes += load_what_if(label.strip(), Path(file))
    return changes
