"""Writes the results as Markdown tables and figures: means and spread over seeds, with the paper's numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.paper.figures import draw_heatmap, draw_reliability, draw_staircase
from benchmarks.paper.plan import AHEAD_S, AVERAGES_S, DELTAS_M, PAPER, Entry, entries
from cyclekit.errors import ConfigError
from cyclekit.storage.atomic import write_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    Results = Sequence[dict[str, Any]]

BEGIN, END = "<!-- made by python -m benchmarks.paper: begin -->", "<!-- made by python -m benchmarks.paper: end -->"
_MISSING = ""


def markdown(results: Results) -> str:
    """Return the tables of all scenes in `results`."""
    parts = []
    for scene in dict.fromkeys(result["scene"] for result in results):
        mine = [result for result in results if result["scene"] == scene]
        seeds = sorted({result["seed"] for result in mine})
        rows = max(result["rows"] for result in mine)
        which = f"{mine[0]['executions']} executions, {'seeds' if len(seeds) > 1 else 'seed'} "
        parts.append(f"### {scene}\n\n{which}{', '.join(map(str, seeds))}; judged by up to {rows} held-out samples.")
        parts += [part for part in (_table_one(mine), _table_two(mine), _averages(mine)) if part]
    return "\n\n".join(parts) + "\n"


def _table_one(results: Results) -> str:
    columns = [("now", 0.0, delta_m) for delta_m in DELTAS_M]
    heads = [f"noise {delta_m:g} m" for delta_m in DELTAS_M]
    return _table("Table I: the scaling now, MSE x 1e4", results, columns, heads, 1e4)


def _table_two(results: Results) -> str:
    return _table("Table II: the scaling 2 s ahead, MSE x 1e3", results, [("ahead", AHEAD_S, 0.0)], ["2 s ahead"], 1e3)


def _averages(results: Results) -> str:
    columns = [("average", horizon_s, 0.0) for horizon_s in AVERAGES_S]
    heads = [f"mean over {horizon_s:g} s" for horizon_s in AVERAGES_S]
    return _table("Average scaling, MSE x 1e3 (the paper gives pictures only)", results, columns, heads, 1e3)


def _table(
    title: str, results: Results, columns: Sequence[tuple[str, float, float]], heads: Sequence[str], scale: float
) -> str:
    """Return one table with a row per network, rival or floor with results."""
    named: dict[str, Entry] = {}
    for entry in entries():
        if (entry.problem, entry.horizon_s, entry.delta_m) in columns:
            named.setdefault(entry.shown, entry)
    lines = []
    for shown, entry in named.items():
        cells, any_result = [], False
        for problem, horizon_s, delta_m in columns:
            mine = [r for r in results if _is(r, problem, horizon_s, delta_m, entry)]
            any_result |= bool(mine)
            paper = PAPER.get((problem, delta_m, entry.name)) if not entry.settings else None
            cells += [_spread([r["mse"] * scale for r in mine]), _MISSING if paper is None else f"{paper * scale:.4g}"]
            cells.append(_spread([r["bias"] for r in mine], digits=4))
        if any_result:
            lines.append(f"| {shown} | {' | '.join(cells)} |")
    if not lines:
        return ""
    head = " | ".join(f"{head} | paper | bias" for head in heads)
    rule = "|---" * (1 + 3 * len(columns)) + "|"
    return f"**{title}**\n\n| | {head} |\n{rule}\n" + "\n".join(lines)


def _is(result: dict[str, Any], problem: str, horizon_s: float, delta_m: float, entry: Entry) -> bool:
    same = (result["problem"], result["horizon_s"], result["delta_m"]) == (problem, horizon_s, delta_m)
    settings = tuple(tuple(pair) for pair in result["settings"])
    return same and result["name"] == entry.name and settings == entry.settings


def _spread(values: Sequence[float], digits: int = 2) -> str:
    """Return mean ± standard deviation over seeds; the value alone for one seed."""
    if not values:
        return _MISSING
    mean = f"{np.mean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {np.std(values, ddof=1):.{digits}f}"


def put_into(page: Path, text: str) -> None:
    """Write the tables between the two marks of a Markdown file.

    Raises:
        ConfigError: The file does not contain the marks.
    """
    whole = page.read_text(encoding="utf-8") if page.is_file() else ""
    if BEGIN not in whole or END not in whole:
        msg = f"{page}: no place for the tables"
        raise ConfigError(msg, cure=f"Write two lines at their position: {BEGIN} and {END}")
    before, _, rest = whole.partition(BEGIN)
    write_text(page, f"{before}{BEGIN}\n\n{text}\n{END}{rest.partition(END)[2]}")


def write_figures(results: Results, folder: Path) -> None:
    """Draw the paper's figures for every scene: staircase, heatmaps, and reliability of probabilities."""
    folder.mkdir(parents=True, exist_ok=True)
    for result in results:
        if result["seed"] != results[0]["seed"]:
            continue
        settings = "".join(f"-{value}" for _, value in result["settings"])
        words = (result["scene"], result["problem"], f"{result['horizon_s']:g}s", result["name"] + settings)
        name = "-".join(words).replace(" ", "-")
        if result["problem"] == "now" and result["delta_m"] == 0 and "by_distance_true" in result:
            draw_staircase(folder / f"{name}-staircase.svg", result)
            if "reliability" in result:
                draw_reliability(folder / f"{name}-reliability.svg", result["reliability"])
        if result["name"].startswith("lstm") or result["name"] == "mixed":
            draw_heatmap(folder / f"{name}-heatmap.svg", np.array(result["heat"]))
