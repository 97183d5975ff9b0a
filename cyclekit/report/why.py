"""Section 3: why the robot slows down: scaling against distance, and operator positions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.report.findings import safety_function
from cyclekit.report.floor import floor_plan, has_robot
from cyclekit.report.numbers import UNKNOWN, count, fixed, percent
from cyclekit.report.pictures import Picture
from cyclekit.report.tables import ReportTable

if TYPE_CHECKING:
    from collections.abc import Sequence

    import polars as pl

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.report.findings import LoggedResponse, Overview, Predicts
    from cyclekit.report.floor import FloorPlan
    from cyclekit.report.texts import ReportTexts

DATA_M = 0.25
"""Distance per row of the table behind the staircase."""

EXPLAINS = 0.8
"""From this share of explained variance on, the page says that the safety function acts on distance."""


def section(
    texts: ReportTexts, dataset: Dataset, samples: pl.DataFrame, model: Predicts | None, seen: Overview
) -> dict[str, Any]:
    """Return what the template needs for section 3."""
    found = safety_function(samples, dataset.levels, model)
    plan = floor_plan(dataset, samples, model)
    missing = _missing(texts, samples, found)
    sentences: list[str] = []
    if seen.slowed == 0.0:
        sentences.append(texts("why.never"))
    elif seen.slowed is not None and seen.halted is not None:
        sentences.append(texts("why.slowed", slowed=percent(seen.slowed), halted=percent(seen.halted)))
    if found:
        sentences.append(texts("why.lead", samples=count(found.samples)))
        key = "why.distance_good" if found.explained >= EXPLAINS else "why.distance_bad"
        sentences.append(texts(key, percent=percent(found.explained)))
    return {
        "sentences": sentences + missing,
        "staircase": _staircase(texts, found, dataset.levels) if found else None,
        "data": _data(texts, found) if found else None,
        "bands": _bands(texts, found) if found and found.bands else None,
        "zones": _zones(texts, plan) if plan and len(plan.zones) else None,
        "map": _map(texts, plan) if plan else None,
        "map_title": texts("why.map_title" if plan and len(plan.lost) else "why.map_title_seen"),
        "map_caption": texts("why.map_caption" if plan and len(plan.lost) else "why.map_caption_seen"),
        "missing": missing,
    }


def _missing(texts: ReportTexts, samples: pl.DataFrame, found: LoggedResponse | None) -> list[str]:
    missing = []
    if not samples["human_x_m"].count():
        missing.append(texts("why.no_operator"))
    if not has_robot(samples):
        missing.append(texts("why.no_robot"))
    elif not samples["scaling"].count():
        missing.append(texts("why.no_scaling"))
    if found is None and not missing:
        missing.append(texts("why.too_few"))
    return missing


def _speed(scaling: float) -> str:
    return f"{100 * scaling:.0f} %"


def _staircase(texts: ReportTexts, found: LoggedResponse, levels: Sequence[float]) -> Picture:
    from cyclekit.report import maps

    labels = {key: texts(f"why.{key}") for key in ("logged", "predicted", "distance", "speed")}
    labels["tip"] = texts.section("why")["tip_samples"]
    bands = " ".join(
        texts("why.band", speed=_speed(b.scaling), low=fixed(b.low_m, 2), high=fixed(b.high_m, 2)) for b in found.bands
    )
    alt = texts("why.picture", bands=bands)
    return Picture("staircase", alt, lambda width_in: maps.staircase(width_in, found, levels, labels))


def _bands(texts: ReportTexts, found: LoggedResponse) -> ReportTable:
    heads = [texts("why.level"), texts("why.range"), texts("why.count")]
    rows = [[_speed(b.scaling), f"{fixed(b.low_m, 2)} to {fixed(b.high_m, 2)}", count(b.samples)] for b in found.bands]
    return ReportTable(texts("why.bands"), heads, rows, frozenset({0, 1, 2}))


def _data(texts: ReportTexts, found: LoggedResponse) -> ReportTable:
    """The numbers behind the staircase: one row per 0.25 m of distance."""
    heads = [texts(f"why.{key}") for key in ("range_head", "logged", "predicted", "count")]
    edges = np.floor(found.bin_m / DATA_M + 1e-9)
    counts = {round(d, 4): 0.0 for d in found.bin_m.tolist()}
    for distance, _, number in found.cells.tolist():
        counts[round(distance, 4)] = counts.get(round(distance, 4), 0.0) + number
    weight = np.array([counts[round(d, 4)] for d in found.bin_m.tolist()])
    rows = []
    for edge in np.unique(edges).tolist():
        mine = edges == edge
        logged = _speed(float(np.average(found.logged[mine], weights=weight[mine])))
        expected = UNKNOWN
        if found.predicted is not None and np.isfinite(found.predicted[mine]).all():
            expected = _speed(float(np.average(found.predicted[mine], weights=weight[mine])))
        name = f"{fixed(edge * DATA_M, 2)} to {fixed((edge + 1) * DATA_M, 2)}"
        rows.append([name, logged, expected, count(int(weight[mine].sum()))])
    return ReportTable(texts("why.data"), heads, rows, frozenset({0, 1, 2, 3}), silent=True)


def _labels(texts: ReportTexts) -> dict[str, str]:
    words = texts.section("why")
    return {key: words[key] for key in ("base", "x", "y", "tip_seen", "tip_lost", "tip_zone")}


def _zones(texts: ReportTexts, plan: FloorPlan) -> dict[str, Any]:
    from cyclekit.report import maps

    labels = _labels(texts) | {"speed": texts("why.zone_speed")}
    x, y, slowest = plan.zones[int(plan.zones[:, 2].argmin())].tolist()
    alt = texts("why.zone_picture", x=fixed(x, 1), y=fixed(y, 1), speed=_speed(slowest))
    drawn = Picture("zones", alt, lambda width_in: maps.zone_map(width_in, plan, labels))
    return {"picture": drawn, "caption": texts("why.zone_model" if plan.zones_of_model else "why.zone_log")}


def _map(texts: ReportTexts, plan: FloorPlan) -> Picture:
    from cyclekit.report import maps

    labels = _labels(texts) | ({"speed": texts("why.map_speed")} if len(plan.lost) else {})
    alt = texts("why.map_picture_none")
    if len(plan.lost):
        x, y = plan.lost[int(plan.lost[:, 2].argmax()), :2].tolist()
        alt = texts("why.map_picture", x=fixed(x, 1), y=fixed(y, 1))
    return Picture("floor", alt, lambda width_in: maps.lost_map(width_in, plan, labels))
