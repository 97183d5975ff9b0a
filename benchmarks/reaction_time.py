"""Compares two estimates of the reaction time with the true one: by the positions of level changes, and by the rule.

    python benchmarks/reaction_time.py [--scenes box-picking,laser-zones,scanner-visits] [--executions 15] [--seed 77]

Each cell is simulated with a reaction time of 0, 0.1 or 0.3 s and three responses, and ingested twice: unchanged, and
with the estimate by positions withheld, so that `derive.reaction_time` must find it. One response is also read from
logs without the override.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from cyclekit.dataset.dataset import Dataset
from cyclekit.derive import passes
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import SimulationOptions, simulate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.scaling.response import Changes, SafetyResponse

SCENES = ("box-picking", "laser-zones", "scanner-visits")
LATENCIES_S = (0.0, 0.1, 0.3)
RESPONSES = ((None, None, True), (1.0, 0.1, True), (5.0, 0.5, True), (1.0, 0.1, False))
"""Ramps down and up, 1/s (None = none), and whether the override is logged."""


def read(
    scene: str, latency_s: float, response: tuple[float | None, float | None, bool], executions: int, seed: int
) -> tuple[float | None, float | None]:
    """Return the reaction time by the positions of changes, and that which explains the level best, s."""
    down, up, logged = response
    ramps = {} if down is None else {"ramp_down_per_s": down, "ramp_up_per_s": up}
    options = SimulationOptions(latency_s=latency_s, log_override=logged, **ramps)
    known, told = passes.read_response, []

    def kept_back(seen: Sequence[Changes]) -> SafetyResponse:
        found = known(seen)
        told.append(found.latency_s)
        return replace(found, latency_s=None, hysteresis_m=None)

    with tempfile.TemporaryDirectory() as folder:
        logs = simulate(scene, Path(folder) / "logs", executions=executions, seed=seed, options=options)
        passes.read_response = kept_back
        try:
            ingest([logs], Path(folder) / "dataset")
        finally:
            passes.read_response = known
        explained = Dataset.open(Path(folder) / "dataset").card.dynamics.latency_s
    return told[0], explained


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=list(SCENES))
    parser.add_argument("--executions", type=int, default=15)
    parser.add_argument("--seed", type=int, default=77)
    asked = parser.parse_args()
    table = Table("scene", "down, up per s", "override", "true, s", "by positions, s", "by rule, s")
    for scene, latency_s, response in product(asked.scenes, LATENCIES_S, RESPONSES):
        found = read(scene, latency_s, response, asked.executions, asked.seed)
        ramps = "at once" if response[0] is None else f"{response[0]:g}, {response[1]:g}"
        shown = ["-" if one is None else f"{one:.2f}" for one in found]
        table.add_row(scene, ramps, "logged" if response[2] else "inferred", f"{latency_s:g}", *shown)
    Console().print(table)


if __name__ == "__main__":
    main()
