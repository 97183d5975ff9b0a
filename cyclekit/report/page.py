"""Build the page: numbers become sentences, tables and pictures; the template arranges them.

The sections are: the answer, where the time goes, why, what would help, and how reliable the numbers are. Each section
is built by its own module, each figure by its own in `figures`; the words are in `texts.toml`.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version as installed
from typing import TYPE_CHECKING, Any

from cyclekit.estimate.statistics.same_work import by_work
from cyclekit.learning.unseen.model import UnseenOperator
from cyclekit.parallel.one_thread import one_thread
from cyclekit.report import answer, helps, trust, where, why
from cyclekit.report.document import MARK, as_csv, as_json, as_markdown
from cyclekit.report.inputs import PageInputs
from cyclekit.report.light import put_away, resting
from cyclekit.report.play import play_part
from cyclekit.report.template import Template
from cyclekit.storage.atomic import write_text
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.answers import Refusal
    from cyclekit.estimate.finding import Finding
    from cyclekit.estimate.plan import OrderPlan
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.validation.check import Check
    from cyclekit.report.findings import Judged, Predicts
    from cyclekit.report.tried import Tried

FORMATS = ("html", "json", "csv", "md")
SECTIONS: dict[str, Callable[[PageInputs], dict[str, Any]]] = {
    "answer": answer.section,
    "where": where.section,
    "why": why.section,
    "helps": helps.section,
    "trust": trust.section,
}
"""What makes each section, in the order of the page."""


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
        refused: Sequences, changes and an order search that the logs cannot answer, each with the reason.
        findings: What is known about the basis of its numbers, the worst first: its traffic light.
    """

    path: Path
    bytes: int
    headline: str
    pictures: int
    missing: tuple[str, ...]
    sequences: int = 0
    pdf: Path | None = None
    refused: tuple[Refusal, ...] = ()
    findings: tuple[Finding, ...] = ()

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        document: dict[str, object] = {"report": str(self.path), "answer": self.headline}
        document |= {"sequences": self.sequences, "bytes": self.bytes}
        refused = [each.to_dict() for each in self.refused]
        document |= {"missing": list(self.missing), "refused": refused}
        return {**document, **({"pdf": str(self.pdf)} if self.pdf else {})}

    def _lines(self) -> list[str]:
        missing = [f"missing: {text}" for text in self.missing]
        return [self.headline, f"{self.path}", *missing, *(f"not answered: {each.reason}" for each in self.refused)]


@one_thread()
def compose_report(
    dataset: Dataset,
    model: Predicts | UnseenOperator | None,
    out: Path,
    *,
    estimates: Sequence[CycleEstimate] = (),
    evaluation: Judged | None = None,
    check: Check | None = None,
    what_if: Sequence[Tried] = (),
    planned: OrderPlan | None = None,
    takt_s: float | None = None,
    baseline: str | None = None,
    missing: Sequence[str] = (),
    refused: Sequence[Refusal] = (),
    cell_name: str | None = None,
    kind: str = "html",
    template: Path | None = None,
    play: bool = True,
    progress: Callable[[float, str], None] | None = None,
) -> ReportFacts:
    """Write the report of a dataset, as one self-contained HTML page, or as data.

    Args:
        dataset: The logs.
        model: Trained model whose safety function and metrics are shown; that of an unseen operator has none to show;
            None for logs alone.
        out: File to write; an existing one is replaced when the new one is complete.
        estimates: Sequences to rank; without any the page describes the logged executions.
        evaluation: Held-out metrics with baselines; without it the model's own card is shown.
        check: Backtest on logged executions; without it the page states no coverage.
        what_if: The same sequences under other conditions.
        planned: The order found for the same work.
        takt_s: Takt time to compare the cycles with, s.
        baseline: Name of the sequence that the others are compared with; by default the logged executions.
        missing: Optional parts that could not be computed, and why, one sentence each; shown in the last section.
        refused: Sequences, changes and an order search that the logs cannot answer; each is named at its place.
        cell_name: Title of the page; the dataset's name where not given.
        kind: `html`; `json` for everything, `csv` for the seconds per task, `md` for words and tables.
        template: Folder whose files replace the page's own (docs/report.md).
        play: Let the reader of the HTML page try other orders and thresholds.
        progress: Called with the part done and a short text.

    Raises:
        CyclekitError: The file cannot be written, or something in the template folder is wrong.
    """
    say = progress or (lambda _part, _text: None)
    dataset.require_positions()
    look = Template(template)
    say(0.0, "reading the dataset")
    quickest = sorted(estimates, key=lambda each: each.expected_s)
    ranked = [each for work in by_work(quickest).values() for each in work]
    name = cell_name or dataset.card.name or dataset.path.name
    texts = replace(look.texts, place=dataset.label)
    unseen = isinstance(model, UnseenOperator)
    shown = None if isinstance(model, UnseenOperator) else model
    page = PageInputs(
        texts, dataset, shown, ranked, what_if, planned, evaluation, check, takt_s, baseline, unseen, refused
    )
    left_out = tuple(refused)
    if kind == "csv":
        write_text(out, as_csv(page))
        return ReportFacts(out, out.stat().st_size, name, 0, tuple(missing), len(ranked), refused=left_out)
    sections: dict[str, Any] = {}
    for number, (key, section) in enumerate(SECTIONS.items()):
        say(0.05 * number, f"section {number + 1} of {len(SECTIONS)}: {texts(f'{key}.title').lower()}")
        sections[key] = section(page)
    if ranked:  # a logged mean rests on no clock or pose
        sections["answer"]["headline"] = put_away(texts, page.light, sections["answer"]["headline"])
        if page.light is not None and page.light.level == "red":
            sections["answer"] |= {"tiles": [], "sentences": sections["answer"]["beside"]}
        if mark := resting(texts, page.findings):
            for key in ("where", "helps"):
                sections[key]["sentences"] = [mark, *sections[key]["sentences"]]
    say(0.25, "tables of the part to play with")
    played = play_part(page) if play and kind == "html" else None
    missing = [*missing, *(played.missing if played else ())]
    sections["trust"]["sentences"] = [*sections["trust"]["sentences"], *missing]
    made = texts("page.made", date=_today(), version=installed("cyclekit"), executions=page.seen.executions)
    if kind == "json":
        content = as_json(name, made, page, sections)
    elif kind == "md":
        content = as_markdown(texts, name, made, sections, page.light)
    else:
        _draw(sections, lambda part, text: say(0.3 + 0.65 * part, text))
        say(0.95, "writing the page")
        content = look.render(
            cell=name, made=made, version=installed("cyclekit"), play=played, light=page.light, **sections
        )
        content += f"\n{MARK}\n"
    write_text(out, content)
    said = tuple(missing) + tuple(text for section in sections.values() for text in section.get("missing", ()))
    headline, size = sections["answer"]["headline"], out.stat().st_size
    return ReportFacts(out, size, headline, content.count("<figure"), said, len(ranked), None, left_out, page.findings)


def _draw(sections: dict[str, Any], say: Callable[[float, str], None]) -> None:
    """Draw every picture for wide screens and for phones, which takes most of the time; report progress."""
    pictures = [chart.picture for section in sections.values() for chart in section.get("charts", ())]
    for number, picture in enumerate(pictures):
        say(number / len(pictures), f"picture {number + 1} of {len(pictures)}")
        _ = picture.wide, picture.narrow


def _today() -> str:
    return dt.datetime.now(tz=dt.UTC).date().isoformat()
