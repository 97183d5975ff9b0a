"""Log a cell, learn it and answer its orders, through cyclekit's public functions alone."""

from __future__ import annotations

import os
import shutil
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.contract.cells import CELLS, Cycles
from cyclekit import CyclekitError, estimate_cycles, ingest_logs, train_model, train_task_times

if TYPE_CHECKING:
    from pathlib import Path

    from benchmarks.contract.cells import Asked, Kind
    from cyclekit import CycleEstimate

FRESH = 1000
"""Fresh executions of each order."""
LEVELS = (0.05, 0.5, 0.95)
Row = dict[str, Any]


def row_of(work: Path, name: str, kind: Kind, executions: int, seed: int, orders: int) -> Row:
    """Return one row: a cell logged in one way, with its orders beside their truth.

    Args:
        work: Folder for logs and truths; what lies there is used again, but nothing that cyclekit made.
        name: Name of the cell.
        kind: Kind of logs.
        executions: Number of logged executions.
        seed: Of the logs.
        orders: Number of orders of each length.
    """
    cell = CELLS[name]
    row: Row = {"cell": name, "kind": kind, "executions": executions, "seed": seed}
    folder = work / f"{name}-{kind}-{executions}-{seed}".replace(" ", "-")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    asked = cell.orders(kind, orders)
    truths = {each.name: _truth(work, name, kind, each) for each in asked}
    takt_s = float(np.median(np.concatenate([each.durations_s for each in truths.values()])))
    logs = cell.log(kind, folder / "logs", executions, seed)
    seconds: dict[str, float] = {}
    try:
        _timed(seconds, "ingest", lambda: ingest_logs(logs, folder / "dataset"))
        learn = train_task_times if kind == "list" else train_model
        _timed(seconds, "train", lambda: learn(folder / "dataset", out=folder / "model"))
        file = folder / "sequences.toml"
        file.write_text("\n".join(each.toml for each in asked), encoding="utf-8")
        found = _timed(
            seconds,
            "estimate",
            lambda: estimate_cycles(folder / "model", folder / "dataset", file, quantiles=LEVELS, takt_s=takt_s),
        )
    except CyclekitError as error:
        return row | {
            "seconds": seconds,
            "refused": {each.name: _said(str(error), folder) for each in asked},
            "orders": [],
        }
    finally:
        shutil.rmtree(folder / "logs", ignore_errors=True)
    row |= {
        "seconds": seconds,
        "refused": {each.name: _said(each.reason, folder) for each in found.refused},
        "takt_s": takt_s,
    }
    answers = {each.name: each for each in found}
    rows = []
    for each in asked:
        if each.name in answers:
            chance_s = cell.beside(kind, each, executions, seed)
            rows.append(_order(each, answers[each.name], truths[each.name], chance_s, takt_s))
    return row | {"orders": rows}


def _said(text: str, folder: Path) -> str:
    """Return a message without the folder that this machine works in."""
    return text.replace(str(folder / "_")[:-1], "")


def _truth(work: Path, name: str, kind: Kind, asked: Asked) -> Cycles:
    """Return fresh executions of an order, simulated once per folder."""
    file = work / "truth" / f"{name}-{kind}-{asked.name}-{FRESH}.npy".replace(" ", "-")
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        drawn = CELLS[name].truth(kind, asked, FRESH)
        np.save(file, np.array([drawn.durations_s, drawn.robot_waits_s, drawn.operator_waits_s]))
    return Cycles(*np.load(file))


def _order(asked: Asked, found: CycleEstimate, true: Cycles, chance_s: np.ndarray, takt_s: float) -> Row:
    """Return an order's answer beside its truth; times in s, errors as shares of the true mean."""
    mean, durations_s = float(true.durations_s.mean()), true.durations_s
    low, middle, high = (found.quantiles_s[level] for level in LEVELS)
    waits = {"robot": found.wait_s, "operator": None}
    conditions = []
    if found.plan:
        waits = {kind: sum(e.wait_s for e in found.plan if e.kind == kind) for kind in ("robot", "operator")}
        conditions = sorted({f"{e.agent} {e.shown} after {e.ended_by[0]}" for e in found.plan if e.ended_by})
    answer: Row = _rounded(
        {
            "name": asked.name,
            "length": asked.length,
            "true_s": mean,
            "true_error_s": float(durations_s.std(ddof=1)) / len(durations_s) ** 0.5,
            "true_quantiles_s": [float(np.quantile(durations_s, level)) for level in LEVELS],
            "true_waits_s": [_or_none(true.robot_waits_s), _or_none(true.operator_waits_s)],
            "true_within": float((durations_s <= takt_s).mean()),
            "chance": float(chance_s.mean()) / mean - 1.0,
            "expected_s": found.expected_s,
            "interval_s": [found.expected_low_s, found.expected_high_s],
            "quantiles_s": [low, middle, high],
            "waits_s": [waits["robot"], waits["operator"]],
            "within": found.takt_probability[0] if found.takt_probability else None,
            "error": found.expected_s / mean - 1.0,
            "held": bool(found.expected_low_s <= mean <= found.expected_high_s),
            "inside": float(((durations_s >= low) & (durations_s <= high)).mean()),
            "conditions": conditions,
        }
    )
    return answer


def _or_none(waits_s: np.ndarray) -> float | None:
    return None if np.isnan(waits_s).all() else float(waits_s.mean())


def _rounded(value: Any) -> Any:  # noqa: ANN401 - any JSON value
    if isinstance(value, float):
        return round(value, 4)
    if isinstance(value, dict):
        return {key: _rounded(each) for key, each in value.items()}
    return [_rounded(each) for each in value] if isinstance(value, list) else value


def _timed(seconds: dict[str, float], name: str, call: Any) -> Any:  # noqa: ANN401 - whatever the call returns
    """Call and note the processor time, s, that this process and its children took."""
    before = _processor_s()
    try:
        return call()
    finally:
        seconds[name] = round(_processor_s() - before, 2)


def _processor_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system if os.name != "nt" else time.time()
