"""`cyclekit report`: the page that an integrator hands to the customer."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cyclekit.cli.options import Checked, DatasetPlace, Extrapolate, Json, OtherCell, Quiet, seconds
from cyclekit.cli.terminal import Terminal, megabytes

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclekit.config.sequences import TaskSequence
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.dataset.guard import Kind
    from cyclekit.estimate.check import Check
    from cyclekit.estimate.plan import Jobs, Plan
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.whatif import Change
    from cyclekit.learning.evaluation.evaluate import Evaluation
    from cyclekit.learning.networks.saved import TrainedModel
    from cyclekit.report import Tried

EXAMPLE = "cyclekit report dataset --model model --sequences sequences.toml --out report.html"

ORDER = "order found"
"""How the order that --plan found is named among the sequences."""
WRITTEN_AS: dict[str, Kind] = {"html": "page", "md": "words", "json": "report-json", "csv": "report-csv"}


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
        typer.Option(
            metavar="CHANGES.toml",
            help="Try these changes; or FILE.json of whatif, or LABEL=FILE.json of estimate. Again for more.",
        ),
    ] = None,
    plan: Annotated[
        Path | None, typer.Option(metavar="JOBS.toml", help="Search the order of this work that takes least time.")
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
    check: Checked = True,
    extrapolate: Extrapolate = False,
    other_cell: OtherCell = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write the page for the customer.

    One self-contained file: the cycle times, where they go, why, what would help, and how sure that is.
    """
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.dataset.guard import check_output
    from cyclekit.learning.networks.cell import refuse_other_cell
    from cyclekit.learning.networks.saved import load_model
    from cyclekit.report import Template, need_browser, write_pdf, write_report

    terminal = Terminal(json=json, quiet=quiet)
    takt_s = seconds(takt) if takt else None
    chosen = _format(kind, out, pdf)
    read = [dataset, model, sequences, plan, template, *(entry.rpartition("=")[2] for entry in what_if or [])]
    check_output(out, WRITTEN_AS[chosen], read)
    check_output(pdf, "pdf", [*read, out], option="--pdf", endings=(".pdf",))
    asked = replace(_asked(sequences, what_if or [], plan, check, extrapolate), other_cell=other_cell)
    _refuse_without_model(asked, model)
    if pdf is not None:
        need_browser()
    Template(template)
    data, trained = Dataset.open(dataset), load_model(model) if model else None
    if trained is not None:
        refuse_other_cell(trained.card, data, other_cell=other_cell)
    found = _found(terminal, data, trained, asked) if trained else _Found(tried=asked.tried)
    with terminal.progress("writing the page") as progress:
        facts = write_report(
            data,
            trained,
            out,
            estimates=found.estimates,
            evaluation=found.evaluation,
            check=found.check,
            what_if=found.tried,
            planned=found.planned,
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
    document = {"report": str(out), "answer": facts.headline, "sequences": len(found.estimates), "bytes": facts.bytes}
    document["missing"] = facts.missing
    said = f"{facts.headline}\n{out}: {megabytes(facts.bytes)}" + (
        ", open it in any browser" if chosen == "html" else ""
    )
    printed = {"pdf": str(pdf)} if pdf else {}
    terminal.done({**document, **printed}, said + (f"\n{pdf}: {megabytes(pdf.stat().st_size)}" if pdf else ""))


@dataclass(frozen=True)
class _Asked:
    """What is to be computed for the page, all files read; `tried` was computed before."""

    sequences: list[TaskSequence]
    changes: list[Change]
    tried: list[Tried]
    jobs: Jobs | None
    check: bool
    extrapolate: bool
    other_cell: bool = False


def _asked(sequences: Path | None, what_if: list[str], plan: Path | None, check: bool, extrapolate: bool) -> _Asked:
    from cyclekit.config.sequences import load_sequences
    from cyclekit.estimate.plan import load_jobs
    from cyclekit.estimate.whatif import load_changes
    from cyclekit.report import load_tried

    changes: list[Change] = []
    tried: list[Tried] = []
    for entry in what_if:
        label, _, file = entry.rpartition("=")
        if file.lower().endswith(".toml") and not label:
            changes += load_changes(Path(file))
        elif file.lower().endswith(".json"):
            tried += load_tried(Path(file), label.strip() or None)
        else:
            msg = f'{entry!r} is neither CHANGES.toml nor FILE.json nor "conveyor 0.3 m back=FILE.json"'
            raise typer.BadParameter(msg, param_hint="--what-if")
    wanted = load_sequences(sequences) if sequences else []
    return _Asked(wanted, changes, tried, load_jobs(plan) if plan else None, check, extrapolate)


def _refuse_without_model(asked: _Asked, model: str | None) -> None:
    if asked.changes and not asked.sequences and not asked.jobs:
        raise typer.BadParameter("changes are tried on sequences; add --sequences or --plan", param_hint="--what-if")
    for wanted, option in ((asked.sequences, "--sequences"), (asked.jobs, "--plan")):
        if wanted and model is None:
            raise typer.BadParameter("estimates need a model; add --model", param_hint=option)


@dataclass
class _Found:
    """What the page shows beside the logs. What was asked for is in it; what was not, only if it could be computed."""

    estimates: list[CycleEstimate] = field(default_factory=list)
    check: Check | None = None
    tried: list[Tried] = field(default_factory=list)
    planned: Plan | None = None
    evaluation: Evaluation | None = None
    missing: list[str] = field(default_factory=list)

    @contextmanager
    def or_say(self, what: str) -> Iterator[None]:
        """Note an error of the block, which computes what nobody asked for, as a sentence of the page."""
        from cyclekit.errors import CyclekitError

        try:
            yield
        except CyclekitError as error:
            self.missing.append(f"{what}: {error.seen}.")


def _found(terminal: Terminal, data: Dataset, model: TrainedModel, asked: _Asked) -> _Found:
    """Compute what was asked for.

    Raises:
        CyclekitError: Something that was asked for cannot be computed.
    """
    from cyclekit.estimate.plan import plan as search
    from cyclekit.estimate.rollout import estimate
    from cyclekit.estimate.whatif import what_if
    from cyclekit.learning.evaluation.evaluate import evaluate
    from cyclekit.report import Tried

    found = _Found(tried=list(asked.tried))
    given: dict[str, Any] = {"validate": asked.check, "other_cell": asked.other_cell}
    if asked.jobs:
        with terminal.progress("planning") as progress:
            found.planned = search(model, data, asked.jobs, progress=progress, **given)
    sequences = _with_order(asked.sequences, found.planned)
    if sequences:
        with terminal.progress("estimating") as progress:
            found.estimates = estimate(
                model, data, sequences, extrapolate=asked.extrapolate, progress=progress, **given
            )
            given["check"] = found.check = found.estimates[0].check
    if asked.changes:
        with terminal.progress("trying changes") as progress:
            more: dict[str, Any] = {"extrapolate": asked.extrapolate, "progress": progress, **given}
            tried = what_if(model, data, sequences, asked.changes, **more)
            found.tried += [Tried.of(entry) for entry in tried]
    with found.or_say("The model could not be judged"), terminal.progress("evaluating") as progress:
        found.evaluation = evaluate(model, data, boosting=False, other_cell=asked.other_cell, progress=progress)
    return found


def _with_order(sequences: list[TaskSequence], planned: Plan | None) -> list[TaskSequence]:
    """Return the sequences and the order found, unless it is one of them: it is estimated, and changed, as they are."""
    from cyclekit.config.sequences import TaskSequence

    if planned is None or any(each.places == planned.places and each.operator is None for each in sequences):
        return sequences
    names = {each.name for each in sequences}
    name = next(name for n in count(1) if (name := ORDER if n == 1 else f"{ORDER} {n}") not in names)
    return [*sequences, TaskSequence(name, planned.places)]


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
