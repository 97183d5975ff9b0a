"""Build the page: numbers become sentences, tables and pictures; the template arranges them.

The sections are: the answer, where the time goes, why, what would help, and how reliable the numbers are. Each section
is built by its own module; the words are in `texts.toml`.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from importlib.metadata import version as installed
from typing import TYPE_CHECKING, Any

from cyclekit.estimate.same_work import by_work
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.rules.safety import answering
from cyclekit.parallel.one_thread import one_thread
from cyclekit.report import answer, helps, trust, where, why
from cyclekit.report.document import MARK, ReportInputs, as_csv, as_json, as_markdown
from cyclekit.report.findings import overview
from cyclekit.report.template import Template
from cyclekit.report.verdict import verdict
from cyclekit.storage.atomic import write_text
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import polars as pl

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.check import Check
    from cyclekit.estimate.plan import OrderPlan
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.report.findings import Predicts
    from cyclekit.report.tried import Tried
    from cyclekit.report.trust import Judged

FORMATS = ("html", "json", "csv", "md")


@dataclass(frozen=True, repr=False)
class ReportFacts(Result):
    """What was written.

    Attributes:
        path: The page.
        bytes: Its size.
        headline: Its first sentence.
        pictures: How many pictures it shows.
        missing: What the page says it could not show, one sentence each.
        sequences: How many sequences were estimated for it.
        pdf: Where it was printed; None where it was not.
    """

    path: Path
    bytes: int
    headline: str
    pictures: int
    missing: tuple[str, ...]
    sequences: int = 0
    pdf: Path | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON values."""
        document = {"report": str(self.path), "answer": self.headline, "sequences": self.sequences, "bytes": self.bytes}
        return {**document, "missing": list(self.missing), **({"pdf": str(self.pdf)} if self.pdf else {})}

    def to_frame(self) -> pl.DataFrame:
        """One row: what was written, and how large it is."""
        import polars as pl

        return pl.DataFrame([{name: value for name, value in self.to_dict().items() if name != "missing"}])

    def _said(self) -> list[str]:
        return [f"{self.headline}", f"{self.path}", *(f"missing: {text}" for text in self.missing)]


@one_thread()
def compose_report(
    dataset: Dataset,
    model: Predicts | None,
    out: Path,
    *,
    estimates: Sequence[CycleEstimate] = (),
    evaluation: Judged | None = None,
    check: Check | None = None,
    what_if: Sequence[Tried] = (),
    planned: OrderPlan | None = None,
    takt_s: float | None = None,
    missing: Sequence[str] = (),
    cell_name: str | None = None,
    kind: str = "html",
    template: Path | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> ReportFacts:
    """Write the report of a dataset, as one self-contained HTML page, or as data.

    Args:
        dataset: The logs.
        model: Trained model whose safety function and metrics are shown; None for logs alone.
        out: File to write; an existing one is replaced when the new one is complete.
        estimates: Sequences to rank; without any the page describes the logged executions.
        evaluation: Held-out metrics with baselines; without it the model's own card is shown.
        check: Backtest on logged executions; without it the page states no coverage.
        what_if: The same sequences under other conditions.
        planned: The order found for the same work.
        takt_s: Takt time to compare the cycles with, s.
        missing: Optional parts that could not be computed, and why, one sentence each; shown in the last section.
        cell_name: Title of the page; the dataset's name where not given.
        kind: `html`; `json` for everything, `csv` for the seconds per task, `md` for words and tables.
        template: Folder whose files replace the page's own (docs/report.md).
        progress: Called with the part done and a short text.

    Raises:
        CyclekitError: The file cannot be written, or something in the template folder is wrong.
    """
    say = progress or (lambda _part, _text: None)
    dataset.require_positions()
    look = Template(template)
    say(0.02, "reading the dataset")
    samples, tasks = dataset.samples(), dataset.tasks()
    seen = overview(dataset, samples, tasks)
    quickest = sorted(estimates, key=lambda each: each.expected_s)
    ranked = [each for work in by_work(quickest).values() for each in work]
    name = cell_name or dataset.card.name or dataset.path.name
    if kind == "csv":
        write_text(out, as_csv(ranked, tasks, what_if, planned))
        return ReportFacts(out, out.stat().st_size, name, 0, tuple(missing), len(ranked))
    texts = look.texts
    sections: dict[str, Any] = {}
    answers = answering(model) if isinstance(model, TrainedModel) else model
    judged = verdict(dataset, ranked, what_if, planned, takt_s)
    about: dict[str, Any] = {
        "has_model": model is not None,
        "takt_s": takt_s,
        "checked": check is not None,
        "found": judged,
    }
    steps: list[tuple[str, Callable[[], dict[str, Any]]]] = [
        ("answer", lambda: answer.section(texts, ranked, seen, **about)),
        ("where", lambda: where.section(texts, ranked, tasks)),
        ("why", lambda: why.section(texts, dataset, samples, answers, seen)),
        ("helps", lambda: helps.section(texts, ranked, samples, seen, what_if, planned)),
        ("trust", lambda: trust.section(texts, dataset, samples, model, evaluation, seen, ranked, check)),
    ]
    for number, (key, make) in enumerate(steps):
        say(0.1 + 0.17 * number, f"section {number + 1} of {len(steps)}: {texts(f'{key}.title').lower()}")
        sections[key] = make()
    sections["trust"]["sentences"] = [*sections["trust"]["sentences"], *missing]
    say(0.95, "writing the page")
    made = texts("page.made", date=_today(), version=installed("cyclekit"), executions=seen.executions)
    if kind == "json":
        found = ReportInputs(ranked, what_if, planned, evaluation, check, judged)
        content = as_json(name, made, found, dataset, samples, sections)
    elif kind == "md":
        content = as_markdown(texts, name, made, sections)
    else:
        content = look.render(cell=name, made=made, version=installed("cyclekit"), **sections) + f"\n{MARK}\n"
    write_text(out, content)
    said = tuple(missing) + tuple(text for section in sections.values() for text in section.get("missing", ()))
    headline, size = sections["answer"]["headline"], out.stat().st_size
    return ReportFacts(out, size, headline, content.count("<figure>"), said, len(ranked))


def _today() -> str:
    return dt.datetime.now(tz=dt.UTC).date().isoformat()
