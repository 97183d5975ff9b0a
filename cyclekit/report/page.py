"""Put the page together: numbers become sentences, tables and pictures; the template sets them.

The sections are in the order in which an integrator asks: what comes out, where the time goes, why, and can it be
believed. Each section is built by its own module; the words are in `texts.toml`.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from importlib.metadata import version as installed
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import jinja2

from cyclekit.atomic import write_text
from cyclekit.report import answer, trust, where, why
from cyclekit.report.findings import overview
from cyclekit.report.texts import load_texts

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from cyclekit.dataset import Dataset
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.findings import Predicts
    from cyclekit.report.trust import Judged


@dataclass(frozen=True)
class ReportFacts:
    """What was written.

    Attributes:
        path: The page.
        bytes: Its size.
        headline: Its first sentence.
        pictures: How many pictures it shows.
        missing: What the page says it could not show, one sentence each.
    """

    path: Path
    bytes: int
    headline: str
    pictures: int
    missing: tuple[str, ...]


def write_report(
    dataset: Dataset,
    model: Predicts | None,
    out: Path,
    *,
    estimates: Sequence[CycleEstimate] = (),
    evaluation: Judged | None = None,
    cell_name: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> ReportFacts:
    """Write the report of a dataset as one HTML page that needs nothing else.

    Args:
        dataset: The logs.
        model: Trained model whose safety function and metrics are shown; None for logs alone.
        out: The page; an existing one is replaced when the new one is complete.
        estimates: Sequences to rank; without any the page describes the logged executions.
        evaluation: Held-out metrics with baselines; without it the model's own card is shown.
        cell_name: Title of the page; the dataset's name where not given.
        progress: Called with a short text at each stage.

    Raises:
        CyclekitError: The page cannot be written.
    """
    say_progress = progress or (lambda _text: None)
    texts = load_texts()
    say_progress("reading the dataset")
    samples, tasks = dataset.samples(), dataset.tasks()
    seen = overview(dataset, samples, tasks)
    say_progress("drawing the pictures")
    ranked = sorted(estimates, key=lambda each: each.expected_s)
    sections: dict[str, Any] = {
        "answer": answer.section(texts, ranked, seen, has_model=model is not None),
        "where": where.section(texts, ranked, tasks),
        "why": why.section(texts, dataset, samples, model, seen),
        "trust": trust.section(texts, dataset, model, evaluation, seen),
    }
    say_progress("writing the page")
    name = cell_name or str(dataset.card.get("name") or dataset.path.name)
    version = installed("cyclekit")
    today = dt.datetime.now(tz=dt.UTC).date().isoformat()
    made = texts("page.made", date=today, version=version, executions=seen.executions)
    html = _template().render(
        say=texts, language=texts.language, cell=name, made=made, version=version, css=_asset("page.css"), **sections
    )
    write_text(out, html)
    drawn = html.count("<figure>")
    return ReportFacts(out, out.stat().st_size, sections["answer"]["headline"], drawn, _missing(sections))


def _missing(sections: dict[str, Any]) -> tuple[str, ...]:
    return tuple(text for section in sections.values() for text in section.get("missing", ()))


def _template() -> jinja2.Template:
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    return environment.from_string(_asset("page.html.jinja"))


def _asset(name: str) -> str:
    return files("cyclekit.report").joinpath(name).read_text("utf-8")
