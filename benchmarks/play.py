"""The part of the report to play with, compared with the library, value by value in a browser.

    python benchmarks/play.py --scene box-picking --seed 1 --kind classifier

Simulates, ingests and trains a model (minutes; stored in --work and reused), writes the page of the first logged order,
and asks the page for logged orders and halves of two of them, as logged and with a recovery rate of 20 %/s. Prints the
maximum errors in percent of the library's values, the size of the page and the time of an answer. `--kind rule` keeps
the model's rule, the others leave it out; with `--hysteresis` the dataset is taken to have one, m.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from cells import dataset_of
from msgspec import structs
from rich.console import Console

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import CyclekitError
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.whatif import what_if
from cyclekit.estimate.whatif.change import Change
from cyclekit.learning.networks.saved import TrainedModel, load_model, save_model
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.rules.safety import predictor_of
from cyclekit.learning.training import train
from cyclekit.report import compose_report

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from browser import open_browser

if TYPE_CHECKING:
    from cyclekit.estimate.result import CycleEstimate

OUT = Console(width=120)
SLOW = Change("recovery of 20 %/s", dynamics={"ramp_up_per_s": 0.2})


def model_of(work: Path, dataset: Dataset, kind: str) -> TrainedModel:
    """Return the model of a dataset: a network of this kind, or with `rule` the rule; trained once."""
    folder = work / f"{dataset.path.parent.name}-{kind}"
    if not (folder / "model.json").is_file():
        spec = ModelSpec.of(network="classifier" if kind == "rule" else kind, seed=0)
        save_model(folder, train(dataset, spec, rules=kind == "rule"))
    return load_model(folder)


def orders(dataset: Dataset, most: int) -> list[TaskSequence]:
    """Return logged orders and their first halves."""
    logged = list(dict.fromkeys(each.places for each in dataset.card.executions if each.complete))[:most]
    halves = [places[: len(places) // 2 + 1] for places in logged[:2]]
    return [TaskSequence(f"order {n}", places) for n, places in enumerate((*logged, *halves))]


def off(found: float, wanted: float) -> float:
    """Return the error in percent."""
    return 100.0 * abs(found / wanted - 1.0)


def main() -> None:
    """Measure one cell."""
    parser = argparse.ArgumentParser(description="Compare the page to play with with the library.")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "cyclekit-play")
    parser.add_argument("--scene", default="box-picking")
    parser.add_argument("--executions", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=("classifier", "regressor", "rule"), default="classifier")
    parser.add_argument("--hysteresis", type=float)
    parser.add_argument("--orders", type=int, default=4)
    asked = parser.parse_args()
    data = dataset_of(asked.work, asked.scene, asked.executions, seed=asked.seed)
    model = predictor_of(model_of(asked.work, data, asked.kind))
    if asked.hysteresis is not None:
        dynamics = structs.replace(data.card.dynamics, hysteresis_m=asked.hysteresis)
        data.card = structs.replace(data.card, dynamics=dynamics)
    wanted = orders(data, asked.orders)
    given = estimate(model, data, wanted, other_cell=True)
    check = given[0].check
    after = {}
    for each in wanted:
        (changed,) = what_if(model, data, [each], [SLOW], check=check, other_cell=True)
        after[each.name] = changed.after
    page = asked.work / f"{asked.scene}-{asked.seed}-{asked.kind}.html"
    began_s = time.perf_counter()
    facts = compose_report(data, model, page, estimates=given, check=check)
    made_s = time.perf_counter() - began_s
    errors = compared(page, wanted, {each.name: each for each in given}, after)
    OUT.print(f"{asked.scene} seed {asked.seed} {asked.kind} hysteresis {data.card.dynamics.hysteresis_m}:", end=" ")
    OUT.print(f"page {page.stat().st_size / 1e6:.2f} MB in {made_s:.1f} s, missing {facts.missing}")
    for when, rows in errors.items():
        most = ", ".join(f"{name} {max(row[name] for row in rows):.3f}" for name in rows[0])
        OUT.print(f"  {when}: {most}")


def compared(
    page: Path, wanted: list[TaskSequence], given: dict[str, CycleEstimate], after: dict[str, CycleEstimate]
) -> dict[str, list[dict[str, float]]]:
    """Return the errors of the page per order, percent, as logged and with slow recovery."""
    errors: dict[str, list[dict[str, float]]] = {"as logged": [], "slow recovery": []}
    with open_browser() as tab:
        tab.show(page)
        tab.ask("cyclekitPlay.ready.then(() => 1)")
        for each in wanted:
            for when, change, one in (
                ("as logged", {}, given[each.name]),
                ("slow recovery", {"ramp": 0.2}, after[each.name]),
            ):
                asked = f"cyclekitPlay.answer({json.dumps(list(each.places))}, {json.dumps(change)}, null)"
                found = tab.ask(f"(t => [{asked}, performance.now() - t])(performance.now())")
                errors[when].append(row(*found, one))
    return errors


def row(found: dict[str, Any], spent_ms: float, one: CycleEstimate) -> dict[str, float]:
    """Return the errors of one answer, percent, and its time, ms."""
    if "unknown" in found:
        raise CyclekitError(found["unknown"], cure="")
    cycles = [off(a, b) for a, b in zip(found["durations_s"], one.durations_s, strict=True)]
    quantiles = zip(found["quantiles_s"], one.quantiles_s.values(), strict=True)
    ends = [("low_s", one.expected_low_s), ("high_s", one.expected_high_s)]
    return {
        "single cycles": max(cycles),
        "root mean square": float(np.sqrt(np.mean(np.square(cycles)))),
        "quantiles": max(off(a, b) for a, b in quantiles),
        "mean": off(found["expected_s"], one.expected_s),
        "interval": max(off(found[name], value) for name, value in ends),
        "ms": spent_ms,
    }


if __name__ == "__main__":
    main()
