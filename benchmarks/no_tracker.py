"""Cells without a tracker: which signals are found to detect people, and whether the rule on them is the true one.

Each cell logs the bits of its fields and other bits: the gripper's feedback, passing parts, a lamp of slow speed, a bit
of the program. Prints a Markdown table: fields found, signals chosen wrongly, error of the delay, share of the lost
time explained, share of held-out samples that the rule explains, and error of an edge on the robot's path.

    python -m benchmarks.no_tracker --executions 20 --seeds 11 12 --out FOLDER
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.rules.of_dataset import rule_of
from cyclekit_sim import SimulationOptions, simulate

if TYPE_CHECKING:
    from cyclekit.dataset.cards import OperatorSignalCard

CELLS: dict[str, tuple[str, SimulationOptions]] = {
    "scanner-fields": ("scanner-fields", SimulationOptions()),
    "light-curtain": ("light-curtain", SimulationOptions()),
    "guard-door": ("guard-door", SimulationOptions()),
    "box-picking by signals": (
        "box-picking",
        SimulationOptions(people="signals", latency_s=0.1, ramp_down_per_s=1.5, ramp_up_per_s=1.5),
    ),
    "pick-and-package by signals": (
        "pick-and-package",
        SimulationOptions(people="signals", latency_s=0.1, ramp_down_per_s=1.5, ramp_up_per_s=1.5),
    ),
    "scanner-fields, slow recovery": (
        "scanner-fields",
        SimulationOptions(latency_s=0.3, ramp_down_per_s=1.0, ramp_up_per_s=0.1),
    ),
    "scanner-fields, outputs not logged": ("scanner-fields", SimulationOptions(log_outputs=False)),
    "scanner-fields, held for 1 s": ("scanner-fields", SimulationOptions(hold_s=1.0)),
}
"""Scene and options by name of the cell."""


def judged(logs: Path, dataset: Dataset) -> list[str]:
    """Return the cells of one row, which compares the result with the truth."""
    facts = json.loads((logs / "truth" / "truth.json").read_text(encoding="utf-8"))
    by_events = dataset.card.operator_signals and not dataset.card.operator_signals[0].signal.startswith("digital")
    true = {one["name"] if by_events else f"digital-input {one['bit']}": one for one in facts["fields"]}
    found = {one.signal: one for one in dataset.card.operator_signals}
    right = [name for name in true if name in found and is_right(found[name], true[name])]
    late = max((abs(found[name].delay_s - facts["options"]["latency_s"]) for name in right), default=float("nan"))
    search = rule_of(dataset, dataset.levels)
    explained = max(search.explained.values(), default=0.0)
    return [
        f"{len(right)} of {len(true)}",
        str(len(found) - len(right)),
        f"{late:.3f}",
        f"{dataset.card.operator_signals[-1].explained:.1%}" if found else "-",
        f"{explained:.2%}" if search.rule else f"no rule ({explained:.1%})",
        f"{edge_error(true, search.rule):.3f}" if search.rule else "-",
    ]


def is_right(found: OperatorSignalCard, field: dict[str, int | None]) -> bool:
    """Return whether a signal is occupied at the true value, and has the true reset button, if any."""
    bit = field["reset_bit"]
    return found.occupied == str(field["occupied"]) and found.reset == (None if bit is None else f"digital-input {bit}")


def edge_error(true: dict[str, dict[str, list[list[float]]]], rule: object) -> float:
    """Return the maximum distance of true edges from the nearest edges of the rule, m; infinite if one is missing."""
    worst = 0.0
    signals = [one for limit in rule.limits for one in limit.within.signals]  # type: ignore[attr-defined]
    for name, field in true.items():
        polygon = field["robot_polygon_m"]
        mine = next((one for one in signals if one.signal.partition(" (reset")[0] == name), None)
        if mine is None or bool(polygon) != (mine.robot is not None):
            return float("inf")
        if mine.robot is not None:
            ys = [corner[1] for corner in polygon]
            edges = [edge.value for edge in mine.robot.across if edge is not None]
            worst = max([worst, *(min(abs(edge - y) for y in ys) for edge in edges)])
    return worst


def main() -> int:
    """Print one row for each cell and seed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--executions", type=int, default=20)
    parser.add_argument("--seeds", type=int, nargs="+", default=[11, 12])
    parser.add_argument("--cells", nargs="+", default=list(CELLS), choices=list(CELLS))
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    print(
        "| cell | seed | fields found | wrong signals | delay error, s | explained | by the rule | edge error, m | s |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name in asked.cells:
        scene, options = CELLS[name]
        for seed in asked.seeds:
            logs, out = asked.out / "logs", asked.out / "dataset"
            simulate(scene, logs, executions=asked.executions, seed=seed, options=options)
            begin = time.perf_counter()
            ingest(logs, out)
            dataset = Dataset.open(out)
            row = [name, str(seed), *judged(logs, dataset), f"{time.perf_counter() - begin:.1f}"]
            print(f"| {' | '.join(row)} |", flush=True)
            for folder in (logs, out):
                shutil.rmtree(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
