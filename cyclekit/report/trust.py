"""Section 5: validation of the model and the estimates, the data, and what this page is not."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cyclekit.dataset.cards import plain
from cyclekit.learning.rules.safety import RuleSafety
from cyclekit.learning.rules.words import kind_of
from cyclekit.report import basis
from cyclekit.report.figures import charts_of
from cyclekit.report.provenance import provenance
from cyclekit.report.tables import ReportTable
from cyclekit.text.numbers import count, error_text, fixed, percent, signed_percent, significant, whole_percent

if TYPE_CHECKING:
    from collections.abc import Mapping

    import polars as pl

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.report.findings import Overview
    from cyclekit.report.inputs import PageInputs
    from cyclekit.report.provenance import Provenance
    from cyclekit.report.texts import ReportTexts

_CARD_METRICS = ("rows", "mse_mean", "mse_argmax", "mae", "bias", "accuracy")

RULE, MODEL, CONSTANT, STAIRCASE = "rule", "model", "constant mean", "distance staircase"
"""Rows of an evaluation; rows of a network that answers begin with `model`."""

_GAPS = {"absent": "gap_absent", "occluded": "gap_occluded", "outside": "gap_outside"}


def section(page: PageInputs) -> dict[str, Any]:
    """Return what the template needs for section 5."""
    texts, dataset, model, check = page.texts, page.dataset, page.model, page.check
    versions = {texts("trust.made_dataset"): f"cyclekit {dataset.card.cyclekit_version}"}
    versions[texts("trust.layout")] = str(dataset.card.schema_version)
    if model is not None:
        versions[texts("trust.made_model")] = f"cyclekit {model.card.cyclekit or 'unknown'}"
    origin = provenance(dataset, versions, advise=page.may_regress)
    unmeasured = bool(page.ranked) and (check is None or check.coverage is None)
    said = [*_network_and_baselines(page), *([texts("trust.no_coverage")] if unmeasured else [])]
    tables = [*basis.tables(texts, page.ranked, check), *basis.to_log(page), *_unseen(texts, page.samples)]
    tables += _data_tables(texts, origin)
    return {
        "facts": _facts(texts, dataset, page.seen, origin),
        "model": _unseen_model(texts) if page.unseen else _model(page),
        "charts": charts_of("trust", page),
        "sentences": said,
        "tables": tables,
        "missing": [],
    }


def _facts(texts: ReportTexts, dataset: Dataset, seen: Overview, origin: Provenance) -> list[tuple[str, str]]:
    runs = dataset.executions
    hours = float(runs["duration_s"].sum()) / 3600 if runs.height else 0.0
    length = f"{fixed(hours, 1)} h" if hours >= 1 else f"{fixed(60 * hours, 1)} min"
    executions = texts("trust.executions_value", all=count(seen.executions), complete=count(seen.complete))
    facts = [
        (texts("trust.executions"), executions),
        (texts("trust.duration"), length),
        (texts("trust.seen"), percent(seen.operator_seen)),
        (texts("trust.inferred"), percent(seen.inferred)),
        (texts("trust.levels"), ", ".join(whole_percent(level) for level in dataset.levels) or "–"),
    ]
    return facts + [(name, value) for name, value in origin.versions]


def _unseen_model(texts: ReportTexts) -> ReportTable:
    return ReportTable(title=texts("trust.model"), text=texts("trust.model_unseen"))


def _model(page: PageInputs) -> ReportTable:
    """What answers, a rule or a network, with its errors and those of its rivals."""
    texts, model, judged, answers = page.texts, page.model, page.judged, page.answers
    if model is None or answers is None:
        return ReportTable(title=texts("trust.model"), text=texts("trust.model_none"))
    rows = [
        [texts("trust.problem"), str(model.problem), ""],
        *([[texts("trust.rule"), kind_of(answers.rule), ""]] if isinstance(answers, RuleSafety) else ()),
        [texts("trust.network_beside" if isinstance(answers, RuleSafety) else "trust.network"), str(model.network), ""],
        *_judged_rows(texts, judged),
    ]
    if not judged:
        metrics = {} if model.card.metrics is None else plain(model.card.metrics)
        names = {"rows": "rows_held_out"}
        rows.extend(
            [texts(f"trust.{names.get(key, key)}"), _metric(key, float(metrics[key])), ""]
            for key in _CARD_METRICS
            if metrics.get(key) is not None
        )
    heads = [texts("trust.metric"), texts("trust.value"), texts("trust.note")]
    if not any(row[2] for row in rows):
        heads, rows = heads[:2], [row[:2] for row in rows]
    held_out = texts("trust.held_out" if judged.get("held_out", True) else "trust.not_held_out")
    notes = [str(note) for note in judged.get("notes") or ()]
    title = texts("trust.model")
    return ReportTable(title, heads, rows, frozenset({1}), silent=True, title=title, text=held_out, items=notes)


def _judged_rows(texts: ReportTexts, judged: Mapping[str, Any]) -> list[list[str]]:
    rows = []
    for entry in judged.get("mse") or ():
        label = f"{texts('trust.mse_mean')}: {entry.get('name', '')}"
        rows.append([label, _metric("mse_mean", float(entry["mse"])), str(entry.get("note") or "")])
    if judged.get("accuracy") is not None:
        rows.append([texts("trust.accuracy"), percent(float(judged["accuracy"])), ""])
    if judged.get("rows") is not None:
        rows.append([texts("trust.rows_held_out"), count(int(judged["rows"])), ""])
    return rows


def _network_and_baselines(page: PageInputs) -> list[str]:
    """Say which row the cycle times come from, and what a smaller error of a baseline means."""
    texts, check = page.texts, page.check
    errors = {str(entry.get("name")): float(entry["mse"]) for entry in page.judged.get("mse") or ()}
    if RULE in errors:
        return [texts("trust.made_with_rule")]
    model = errors.get(MODEL)
    rivals = {name: mse for name, mse in errors.items() if not name.startswith(MODEL)}
    if model is None or not rivals:
        return []
    found = [texts("trust.made_with")]
    best = min(rivals, key=lambda name: rivals[name])
    if rivals[best] >= model:
        return found
    key = "trust.better_staircase" if best == STAIRCASE else "trust.better_other"
    found.append(texts(key, name=best, rival=_metric("mse", rivals[best]), model=_metric("mse", model)))
    if errors.get(CONSTANT):
        left = {"model": 1 - model / errors[CONSTANT], "rival": 1 - rivals[best] / errors[CONSTANT]}
        found.append(texts("trust.explained", name=best, **{name: percent(part) for name, part in left.items()}))
    if check is not None:
        bias, within = signed_percent(check.own_bias, 2), percent(check.own_within, 2)
        found.append(texts("trust.backtest_bias", bias=bias, error=within))
    return [" ".join(found)]


def _metric(key: str, value: float) -> str:
    if key == "rows":
        return count(int(value))
    return percent(value) if key == "accuracy" else error_text(value)


def _unseen(texts: ReportTexts, samples: pl.DataFrame) -> list[ReportTable]:
    """Reasons for missing operator positions, as shares of all samples."""
    gaps = samples["human_gap"].drop_nulls()
    if not len(gaps):
        return []
    title = texts("trust.unseen")
    counts = gaps.value_counts(sort=True).iter_rows()
    rows = [[texts(f"trust.{_GAPS[reason]}"), percent(number / samples.height)] for reason, number in counts]
    return [
        ReportTable(title, [texts("trust.reason"), texts("trust.part")], rows, frozenset({1}), silent=True, title=title)
    ]


def _data_tables(texts: ReportTexts, origin: Provenance) -> list[ReportTable]:
    none = texts("trust.none")
    warnings = [text if n == 1 else texts("trust.times", text=text, count=n) for text, n in origin.warnings]
    after = texts("trust.more_warnings", count=origin.more_warnings) if origin.more_warnings else ""
    tables = [
        ReportTable(title=texts("trust.warnings"), text="" if warnings else none, items=warnings, after=after),
        _sources(texts, origin),
        ReportTable(
            texts("trust.aside_title"),
            [texts("trust.reason"), texts("trust.rows")],
            [[reason, count(rows)] for reason, rows in origin.set_aside],
            frozenset({1}),
            silent=True,
            title=texts("trust.aside_title"),
            text="" if origin.set_aside else none,
        ),
    ]
    if origin.not_read:
        title, heads = texts("trust.not_read"), [texts("trust.path"), texts("trust.reason")]
        tables.append(
            ReportTable(title, heads, [list(pair) for pair in origin.not_read[:50]], silent=True, title=title)
        )
    if origin.files:
        title, heads = texts("trust.files"), [texts("trust.path"), texts("trust.checksum")]
        more = texts("trust.more_files", count=origin.more_files) if origin.more_files else ""
        files = [[path, f"{digest[:23]}…" if digest else "–"] for path, digest in origin.files]
        tables.append(ReportTable(title, heads, files, silent=True, title=title, after=more))
    return tables


def _sources(texts: ReportTexts, origin: Provenance) -> ReportTable:
    names = ("reader", "tables", "recordings", "rows", "aside", "rate", "length", "clock", "frame")
    heads = [texts(f"trust.{name}") for name in names]
    rows = [
        [
            s.adapter,
            s.tables,
            count(s.recordings),
            count(s.rows),
            count(s.set_aside),
            significant(s.rate_hz),
            significant(s.hours, 2),
            s.clock,
            s.frame,
        ]
        for s in origin.sources
    ]
    title = texts("trust.sources")
    return ReportTable(title, heads, rows, frozenset(range(2, 7)), silent=True, title=title)
