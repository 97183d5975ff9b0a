"""Compares `whatif` estimates for twelve changes of single numbers of a rule with simulations of the changed cell.

    python benchmarks/rule_changes.py --executions 60 --fresh 40 --seeds 1 2 --work FOLDER

Two cells with latency, ramps, hysteresis and tracker noise of 5 mm; `scanner-visits` is logged without a scaling. The
rule is read from the logs (`rule_of`), and `whatif` changes one threshold, edge or parameter of the response. Ground
truth is the simulator with the true function changed in the same way, with the same tracks of logged operators as the
estimate, and with fresh operators. The first difference is the error of the method; the second adds the sampling error
of the logged operators.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from any_length import HARD, TRUE
from cells import JUDGED_SEED, unseen_sequences
from changes import OUT, Operators, beside, simulated
from rich.table import Table

from cyclekit.dataset.cards import TrainingCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.whatif import Change, LimitChange, what_if
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.rules.of_dataset import rule_of
from cyclekit.learning.rules.safety import RuleSafety
from cyclekit_sim import simulate
from cyclekit_sim.safety import DistanceStaircase, FloorZone, FloorZones, SafetyFunction, SlowestOf
from cyclekit_sim.scenes import BUILT_IN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.config.sequences import TaskSequence

VISITS, BOXES = "scanner-visits", "box-picking"
OPTIONS = {VISITS: HARD, BOXES: dataclasses.replace(HARD, silent_when_empty=False)}
LEVELS = {VISITS: (0.0, 0.3, 0.6, 1.0), BOXES: (0.0, 0.25, 0.5, 0.75, 1.0)}
NOW = {VISITS: (0.8, 1.2, 1.7), BOXES: (1.2, 1.5, 1.9, 2.4)}
X_M, Y_M = (0.9, 2.3), (-0.6, 1.1)


@dataclasses.dataclass(frozen=True)
class Case:
    """One change, as specified for `whatif` and for the simulator."""

    scene: str
    change: Change
    thresholds_m: tuple[float, ...] = ()
    x_m: tuple[float, float] = X_M
    response: dict[str, float] = dataclasses.field(default_factory=dict)

    @property
    def safety(self) -> SafetyFunction:
        """Changed safety function of the simulator."""
        levels = LEVELS[self.scene]
        stairs = DistanceStaircase(levels, self.thresholds_m or NOW[self.scene])
        if self.scene == BOXES:
            return stairs
        return SlowestOf(levels, (stairs, FloorZones(levels, (FloorZone("scanner", self.x_m, Y_M, 1),))))


def _thresholds(scene: str, name: str, *metres: float) -> Case:
    changed = zip(LEVELS[scene], NOW[scene], metres, strict=False)
    limits = tuple(LimitChange(level, threshold_m=then) for level, now, then in changed if then != now)
    return Case(scene, Change(name, limits=limits), metres)


def _response(scene: str, name: str, **response: float) -> Case:
    return Case(scene, Change(name, dynamics=response), response=response)


CASES = (
    _thresholds(VISITS, "threshold of 60 % 1.70 -> 1.45 m", 0.8, 1.2, 1.45),
    _thresholds(VISITS, "threshold of stop 0.80 -> 0.95 m", 0.95, 1.2, 1.7),
    Case(VISITS, Change("edge x 2.3 -> 1.9 m", limits=(LimitChange(0.3, x_m=(0.9, 1.9)),)), x_m=(0.9, 1.9)),
    _response(VISITS, "hysteresis 0.10 -> 0 m", hysteresis_m=0.0),
    _response(VISITS, "recovery 80 -> 200 %/s", ramp_up_per_s=2.0),
    _response(VISITS, "reaction time 0.08 -> 0.30 s", latency_s=0.3),
    _thresholds(BOXES, "threshold of 75 % 2.40 -> 2.20 m", 1.2, 1.5, 1.9, 2.2),
    _thresholds(BOXES, "threshold of 50 % 1.90 -> 2.10 m", 1.2, 1.5, 2.1, 2.4),
    _thresholds(BOXES, "all thresholds 0.15 m less", 1.05, 1.35, 1.75, 2.25),
    _response(BOXES, "hysteresis 0.10 -> 0.25 m", hysteresis_m=0.25),
    _response(BOXES, "recovery 80 -> 40 %/s", ramp_up_per_s=0.4),
    _response(BOXES, "braking 200 -> 50 %/s", ramp_down_per_s=0.5),
)


def cell_of(work: Path, scene: str, executions: int, seed: int) -> tuple[Dataset, RuleSafety]:
    """Return a logged cell and the rule read from its logs; simulated once per folder."""
    folder = work / f"{scene}-{executions}-{seed}"
    if not (folder / "dataset").is_dir():
        simulate(scene, folder / "logs", executions=executions, seed=seed, options=OPTIONS[scene])
        ingest([folder / "logs"], folder / "dataset")
    dataset = Dataset.open(folder / "dataset")
    rule = rule_of(dataset, dataset.levels).rule
    if rule is None:
        msg = f"{folder}: no rule found"
        raise SystemExit(msg)
    return dataset, RuleSafety(rule, TrainingCard(rule=rule))


def of_cell(work: Path, asked: argparse.Namespace, scene: str, seed: int) -> dict[str, np.ndarray]:
    """Return by change the saved share of the cycle, shape (3, sequences).

    Rows: estimated, simulated with logged operators, simulated with fresh operators. Simulations are stored in the
    folder.
    """
    dataset, rule = cell_of(work, scene, asked.executions, seed)
    wanted = unseen_sequences(dataset, scene, asked.sequences, first=JUDGED_SEED)
    cases = [case for case in CASES if case.scene == scene]
    found = what_if(rule, dataset, wanted, [case.change for case in cases])
    sides = beside(dataset, seed, asked.fresh, rule)
    true = dataclasses.replace(TRUE, silent_when_empty=False)
    key = f"truth-{scene}-{seed}-{asked.executions}-{asked.sequences}-{asked.fresh}.json"
    kept = json.loads((work / key).read_text("utf-8")) if (work / key).is_file() else {}
    now, rows = None, {}
    for case in cases:
        mine = {entry.before.name: entry for entry in found if entry.change == case.change.name}
        told = [mine[each.name].saves_s[0] / mine[each.name].before.expected_s for each in wanted]
        if case.change.name not in kept:
            now = now or _simulated(wanted, Case(scene, Change("now", frequency=1.0)), true, sides)
            then = _simulated(wanted, case, dataclasses.replace(true, **case.response), sides)  # type: ignore[arg-type]
            saved = [1 - after_s / before_s for after_s, before_s in zip(then, now, strict=True)]
            kept[case.change.name] = np.round(saved, 5).tolist()
            (work / key).write_text(json.dumps(kept), "utf-8")
        rows[case.change.name] = np.array([told, *kept[case.change.name]])
        OUT.print(scene, seed, case.change.name, rows[case.change.name].round(5).tolist(), soft_wrap=True)
    return rows


def _simulated(wanted: list[TaskSequence], case: Case, options: Any, sides: Sequence[Operators]) -> list[np.ndarray]:  # noqa: ANN401
    scene = dataclasses.replace(BUILT_IN[case.scene], safety=case.safety)
    return [durations_s.mean(axis=1) for durations_s in simulated(wanted, scene, options, sides)]


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--executions", type=int, default=60)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--scenes", nargs="+", default=[VISITS, BOXES])
    parser.add_argument("--sequences", type=int, default=3)
    parser.add_argument("--fresh", type=int, default=40)
    parser.add_argument("--work", type=Path)
    asked = parser.parse_args()
    table = Table("scene", "change", "saved %", "logged %", "error: mean, worst", "fresh %", "difference")
    with tempfile.TemporaryDirectory() as folder:
        for scene in asked.scenes:
            sets = [of_cell(asked.work or Path(folder), asked, scene, seed) for seed in asked.seeds]
            for name in sets[0]:
                told, beside, fresh = 100 * np.concatenate([rows[name] for rows in sets], axis=1)
                off = told - beside
                worst = off[np.abs(off).argmax()]
                numbers = [told.mean(), beside.mean(), fresh.mean(), np.mean(beside - fresh)]
                cells = [f"{number:+.2f}" for number in numbers]
                table.add_row(scene, name, *cells[:2], f"{off.mean():+.2f}, {worst:+.2f}", *cells[2:])
    OUT.print(table)


if __name__ == "__main__":
    main()
