"""`read_safety_function`: levels, thresholds and zones, read back; `cost_of_safety_function`: their cost."""

from __future__ import annotations

from dataclasses import replace

from msgspec import structs

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.given import Sequences, path_of, place_of, sequences_of, trained_of
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.errors import ModelError
from cyclekit.estimate.finding import MARKS
from cyclekit.estimate.soundness import findings_of_logs
from cyclekit.estimate.whatif.costs import SafetyCosts, costs_of
from cyclekit.estimate.whatif.separation import Separation
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.rules.ladder import RuleSearch
from cyclekit.learning.rules.of_dataset import rule_of
from cyclekit.learning.rules.safety import RuleSafety, predictor_of
from cyclekit.learning.safety_function.answer import SafetyFunction, read_zones, refuse_without_levels
from cyclekit.plots.canvas import KINDS, write_figure


@checked
def read_safety_function(
    model: TrainedModel | Place,
    dataset: Dataset | Place,
    *,
    out: Place | None = None,
    seed: int = 0,
    other_cell: bool = False,
) -> SafetyFunction:
    """Read the safety function back: the rule or thresholds in metres if they explain it, else a map of the floor.

    Args:
        model: A model of problem `now` with levels, its folder or its URL.
        dataset: Logs with positions and scaling.
        out: Also draw it here, `.svg`, `.png` or `.pdf`.
        seed: Seed of the resampling for the intervals.
        other_cell: Accept a model of another cell.

    Raises:
        ModelError: The model does not predict the present scaling, knows no levels, or is of another cell.
        DatasetError: Too few samples have positions and a scaling.
    """
    file = path_of(out)
    check_output(file, "picture", [place_of(model), place_of(dataset)], endings=KINDS)
    opened, trained = Dataset.of(dataset), trained_of(model)
    found = read_zones(trained, opened, seed=seed, other_cell=other_cell)
    doubted = [one for one in findings_of_logs(opened, predictor_of(trained)) if one.level != "green"]
    found = replace(found, doubts=tuple(f"{MARKS[one.level].strip()} {one.code}: {one.shown}" for one in doubted))
    if file is not None:
        write_figure(file, found.plot())
    return found


@checked
def cost_of_safety_function(
    model: TrainedModel | Place,
    dataset: Dataset | Place,
    sequences: Sequences,
    *,
    found: RuleSearch | None = None,
    separation: Separation | None = None,
    seed: int = 0,
    extrapolate: bool = False,
    other_cell: bool = False,
    progress: Progress | None = None,
) -> SafetyCosts:
    """Return what each centimetre, each 10 ms and each 10 %/s of the safety function costs. No safety proof.

    Args:
        model: A model of problem `now` with levels, its folder or its URL.
        dataset: Logs with positions and scaling.
        sequences: Sequences, or the sequence file.
        found: The rule from `read_safety_function` (`SafetyFunction.commanded`); default: it is read.
        separation: Also compare the thresholds with the protective separation distance computed from this.
        seed: As in `estimate_cycles`; so are `extrapolate` and `other_cell`.
        extrapolate: Answer even if most of the cycle is outside logged positions.
        other_cell: Accept a model of another cell.
        progress: Called with the fraction done and a text.

    Raises:
        ModelError: No rule explains the logs, or its distance is not known in an estimate.
        ConfigError: The separation distance does not fit the rule.
        EstimateError: As in `estimate_cycles`.
    """
    asked, logs = trained_of(model), Dataset.of(dataset)
    refuse_without_levels(asked, logs)
    rule = (found or rule_of(logs, asked.levels, model=asked, seed=seed)).rule
    safety = predictor_of(replace(asked, card=structs.replace(asked.card, rule=rule)))
    if not isinstance(safety, RuleSafety):
        why = "no simple rule explains these logs" if rule is None else f"estimates do not support the {rule.family}"
        cure = "Define the function and its changes (levels with thresholds_m or zones) for cyclekit whatif."
        raise ModelError(f"{why}: there is no threshold to move", cure=cure)
    return costs_of(
        safety,
        logs,
        sequences_of(sequences),
        separation=separation,
        seed=seed,
        extrapolate=extrapolate,
        other_cell=other_cell,
        progress=progress,
    )
