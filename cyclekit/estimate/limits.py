"""What limits an estimate, in words: few operators, positions never logged, clocks and scaling only inferred."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

from cyclekit.alignment.clocks import ASSUMED
from cyclekit.dataset.unknown_height import said_of_height
from cyclekit.estimate.nominal import slider_losses
from cyclekit.learning.windows import nobody_there

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.check import Check
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.safety import SafetyModel
    from cyclekit.estimate.walk import Rolled

CONTINUED = 0.5
"""Above this part of the time on continued tracks it is said."""
FEW_EXECUTIONS = 20
"""With fewer operators the mean itself is uncertain by more than a percent in the cells seen so far."""


def doubts_of(cycles: Rolled, entry: CycleEstimate, check: Check | None) -> list[str]:
    """Return what makes one sequence's number itself doubtful, one sentence each."""
    found = []
    if entry.tracks and entry.estimator == "rollout" and not cycles.looked_closely:
        found.append(
            "coarse estimate from the table of arrivals, one of many sequences: estimate it alone for an exact one; "
            "support and activities are not known"
        )
    if cycles.support < 0.9:
        marked = "EXTRAPOLATED: " if entry.extrapolated else ""
        found.append(
            f"{marked}{1 - cycles.support:.0%} of the cycle runs through positions that were never logged; the error "
            "there is unknown, and not in the interval of the mean"
        )
    return [*found, *(check.doubts if check is not None else ())]


def limits_of_cycles(cycles: Rolled, entry: CycleEstimate) -> list[str]:
    """Return what else limits one sequence's number, one sentence each."""
    found = []
    if entry.tracks and entry.executions < FEW_EXECUTIONS:
        found.append(f"based on only {entry.executions} operator tracks: the mean itself is uncertain")
    if cycles.spliced > CONTINUED:
        found.append(
            f"{cycles.spliced:.0%} of the time the operator's track is continued with parts of other executions that "
            "begin in the same state"
        )
    return found


def limits_of_logs(dataset: Dataset, model: SafetyModel) -> list[str]:
    """Return what limits every number from these logs, one sentence each."""
    found = []
    samples = dataset.samples(columns=["execution", "human_x_m", "human_z_m", "human_gap", "scaling_origin"])
    found += said_of_height(samples)
    absent = samples.filter(nobody_there()).height / max(samples.height, 1)
    if absent > 0.01 and model.card.scaling_without_operator is None:
        found.append(f"in {absent:.0%} of the samples there is no operator: full speed assumed")
    ran = {one.execution for one in dataset.card.executions if one.complete and not one.reference}
    away = samples.group_by("execution").agg(away=(pl.col("human_gap") == "absent").fill_null(value=False).all())
    alone = ran & set(away.filter("away")["execution"].to_list())
    if alone:
        counted = (
            f"in {len(alone)} of {len(ran)} executions no operator was seen: they count as cycles without an operator"
        )
        found.append(
            f"{counted} (if the operator was absent on purpose, list the log under reference in the cell file)"
        )
    if samples.filter(pl.col("scaling_origin") == "inferred").height:
        found.append("the speed scaling was not logged but inferred from velocity ratios")
    slider = [part for part in slider_losses(dataset).values() if part > 0.0]
    if slider:
        most = (
            f"in {len(slider)} executions the speed slider was below 100 %, which cost up to {max(slider):.1%} of them"
        )
        found.append(f"{most}; the estimate is for full slider")
    if any(record.clock.method == ASSUMED for record in dataset.recordings):
        found.append("the clocks of robot and tracker are assumed to start together, not aligned")
    if any(record.clock.method in ("coarse", "start-text") for record in dataset.recordings):
        found.append("the clocks of robot and tracker are aligned roughly: the reaction delay is hidden or unknown")
    return found
