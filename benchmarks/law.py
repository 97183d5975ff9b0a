"""The ISO law: whether it is found with its parameters if the scaling is continuous, and never if it has levels.

Some simulated cells have the continuous law of speed and separation monitoring, with and without reaction time and
ramps; others have staircases with slow ramps. The logs contain neither. The limits of the method were chosen on
box-picking and scanner-visits with seed 3.

    python benchmarks/law.py --work DIR --executions 60 --seed 11
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console
from rich.table import Table

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.rules.of_dataset import law_of, rule_of
from cyclekit.learning.rules.samples.distances import TO_BASE, TO_LINK, TO_TCP, TO_TCP_FLAT
from cyclekit_sim import SimulationOptions, simulate
from cyclekit_sim.rules import IsoLaw, Rule

STEEP, FLAT = IsoLaw(), IsoLaw("tcp", 1.2, 0.3, 6.0, 0.35, 1.2, 0.1)
BASE, LINK = IsoLaw("base", 1.6, 0.15, 3.0, 0.4), IsoLaw("link", 1.0, 0.2, 2.0, 0.3, 0.8)
NAMES = {"tcp": TO_TCP, "tcp-floor": TO_TCP_FLAT, "base": TO_BASE, "link": TO_LINK}
REAL = {"ramp_up_per_s": 0.1, "ramp_down_per_s": 1.0, "latency_s": 0.3}


@dataclass(frozen=True)
class Case:
    """One cell: a law, or the scene's staircase."""

    scene: str
    law: IsoLaw | None
    options: dict[str, float] = field(default_factory=dict)


CASES = (
    *(Case(scene, law) for scene in ("box-picking", "scanner-visits") for law in (STEEP, FLAT)),
    *(Case(scene, law, REAL) for scene in ("box-picking", "scanner-visits") for law in (STEEP, FLAT)),
    Case("scanner-visits", BASE, {"latency_s": 0.1}),
    Case("box-picking", LINK),
    Case("laser-zones", STEEP, {"latency_s": 0.1, "ramp_up_per_s": 0.25, "ramp_down_per_s": 1.0}),
    Case("pick-and-package", FLAT, {"latency_s": 0.05}),
    *(
        Case(scene, None, {"ramp_up_per_s": up, "ramp_down_per_s": down})
        for scene in ("box-picking", "laser-zones", "scanner-visits")
        for up, down in ((0.05, 1.0), (0.1, 1.0), (0.05, 0.05), (0.1, 0.1))
    ),
)


def main() -> None:
    """Simulate, find the rule, print one row per cell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--executions", type=int, default=60)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--cases", type=int, nargs="*", default=range(1, len(CASES) + 1))
    asked = parser.parse_args()
    shown = Table(
        "scene", "true", "response", "found", "within 2 %", "length errors, m", "coverage", "latency error, s", "s"
    )
    for number in asked.cases:
        case = CASES[number - 1]
        dataset = logged(case, asked.work / f"{number}-{asked.seed}-{asked.executions}-{asked.noise:g}", asked)
        shown.add_row(*_row(case, dataset))
    Console(width=200).print(shown)


def _row(case: Case, dataset: Dataset) -> list[str]:
    begin = time.perf_counter()
    found = rule_of(dataset, dataset.levels) if case.law else law_of(dataset)
    took = f"{time.perf_counter() - begin:.1f}"
    response = ", ".join(f"{name} {value:g}" for name, value in case.options.items())
    true = "levels" if case.law is None else f"law, {case.law.distance}, lowest {case.law.lowest:g}"
    card = None if found is None or found.rule is None else found.rule.law
    if card is None or found is None or found.rule is None:
        return [case.scene, true, response, "no law", "", "", "", "", took]
    explained = f"{found.rule.explained:.2%}"
    if case.law is None:
        return [case.scene, true, response, card.distance, explained, "", "", "", took]
    named = "yes" if card.distance == NAMES[case.law.distance] else card.distance
    law, a = case.law, case.law.deceleration_m_s2
    linear_m = law.programmed_m_s * (law.reaction_s + law.person_m_s / a)
    truth = (law.distance_m(0.0), linear_m, law.programmed_m_s**2 / (2 * a))
    lengths = list(zip((card.stop, card.linear, card.square), truth, strict=True))
    off = ", ".join(f"{metres.value - at:+.4f}" for metres, at in lengths)
    hold = sum((metres.low or 0.0) <= at <= (metres.high or 0.0) for metres, at in lengths)
    late = card.latency_s - case.options.get("latency_s", 0.0)
    return [case.scene, true, response, named, explained, off, f"{hold} of 3", f"{late:+.4f}", took]


def logged(case: Case, folder: Path, asked: argparse.Namespace) -> Dataset:
    """Return the logs of a case; made once per folder."""
    if not (folder / "dataset").is_dir():
        rule = None if case.law is None else Rule(law=case.law)
        options = SimulationOptions(delta_m=asked.noise, rule=rule, **case.options)  # type: ignore[arg-type]
        simulate(case.scene, folder / "logs", executions=asked.executions, seed=asked.seed, options=options)
        ingest([folder / "logs"], folder / "dataset")
    return Dataset.open(folder / "dataset")


if __name__ == "__main__":
    main()
