"""The result of `cyclekit zones`: the safety function as far as the logs show it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from cyclekit.dataset.cards import plain
from cyclekit.dataset.unknown_height import HUMAN_Z_IN_PLANE, height_notes
from cyclekit.errors import DatasetError, ModelError, command_line
from cyclekit.learning.networks.cell import refuse_other_cell
from cyclekit.learning.rules.ladder import RuleSearch
from cyclekit.learning.rules.of_dataset import rule_of
from cyclekit.learning.rules.safety import RuleSafety
from cyclekit.learning.rules.samples.distances import DISTANCES
from cyclekit.learning.rules.shapes import RuleShape, shapes_of
from cyclekit.learning.rules.words import sentences, verdict
from cyclekit.learning.safety_function.fit import (
    FLOOR_M,
    ScalingSamples,
    Threshold,
    by_distance,
    by_place,
    explained,
    floor_cells,
    hysteresis,
    thresholds,
)
from cyclekit.learning.safety_function.path import PATH_M, speeds_on_path
from cyclekit.learning.signal_inputs import as_learned_by, by_signals
from cyclekit.parallel.one_thread import one_thread
from cyclekit.plots.labels import CellOnFloor
from cyclekit.text.numbers import fixed, percent
from cyclekit.text.results import Result

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.dataset.cards.rule import RuleCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.learning.networks.saved import TrainedModel
    from cyclekit.plots.drawing import Drawing
    from cyclekit.schema import Floats

MIN_ROWS = 500
"""Minimum number of samples with positions and a scaling."""
BY_DISTANCE = 0.02
"""Maximum deficit in explained variance, against the best other rule, at which a distance is chosen as the rule."""
SAME = 0.003
"""Tolerance in explained variance within which distances count as equal; then the first of DISTANCES is chosen."""
_NO_PROOF = "read from logs, the safety system was not measured: no safety proof"
MIN_SEEN = 5
"""Minimum number of samples in a cell of the floor; cells with fewer are left blank."""


@dataclass(frozen=True, repr=False)
class SafetyFunction(Result):
    """The safety function read from the logs.

    Attributes:
        levels: Levels of the speed scaling, ascending.
        shares: Share of the samples on each level.
        rule: The gamma that explains the scaling best: name of a distance, or `place on the floor`.
        is_distance: Whether `rule` is a distance.
        explained: Share of the scaling's variance that each rule explains; `network` is the model.
        thresholds: Thresholds on the best distance; of little meaning if `is_distance` is false.
        thresholds_of_network: Thresholds fitted to the network's predictions, m.
        hysteresis_m: How much farther out s rises than it falls, m; None if the logs do not show it.
        hysteresis_origin: `dynamics` of the dataset, or `approaching against leaving`.
        floor_m: Corners x, y (base frame, m) of cells of the floor with samples, shape (C, 2), FLOOR_M wide.
        floor_scaling: Median scaling while the operator is in each cell, shape (C,).
        rows: Number of samples.
        executions: Number of executions.
        notes: Limits of the result.
        commanded: The rule that explains the commanded level, if there is one. It then replaces `thresholds`: its own
            are separate for entering and leaving, and `thresholds` lie between them.
        shapes: Outlines of that rule on the floor; empty without one.
        cell: Places and furniture, for the picture.
        path_m: If signals detect people, corners x, y (base frame, m) of cells of the robot's path, shape (C, 2),
            PATH_M wide.
        path_speed: Speed in these cells while a signal alone is on, by name of the signal, shape (C,), 0 to 1.
        doubts: What is amber or red of clock and pose, on which every distance rests.
    """

    levels: tuple[float, ...]
    shares: tuple[float, ...]
    rule: str
    is_distance: bool
    explained: Mapping[str, float]
    thresholds: tuple[Threshold, ...]
    thresholds_of_network: tuple[float, ...]
    hysteresis_m: float | None
    hysteresis_origin: str
    floor_m: Floats
    floor_scaling: Floats
    rows: int
    executions: int
    notes: tuple[str, ...]
    commanded: RuleSearch
    shapes: tuple[RuleShape, ...] = ()
    cell: CellOnFloor = field(default_factory=CellOnFloor)
    path_m: Floats = field(default_factory=lambda: np.empty((0, 2)))
    path_speed: Mapping[str, Floats] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()

    def plot(self) -> Drawing:
        """Return the speed over the distance and the floor seen from above, as a matplotlib figure."""
        from cyclekit.learning.safety_function.picture import zones_figure

        return zones_figure(self)

    @property
    def rule_sentences(self) -> tuple[str, ...]:
        """The rule in sentences, as for a safety controller; empty if none explains the logs."""
        return () if self.commanded.rule is None else tuple(sentences(self.commanded.rule))

    def to_dict(self) -> dict[str, object]:
        """Return everything as plain JSON values."""
        out = {name: value for name, value in vars(self).items() if name != "cell"}
        out["explained"] = dict(self.explained)
        out["thresholds"] = [dict(vars(entry)) for entry in self.thresholds]
        out["floor_m"], out["floor_scaling"] = self.floor_m.tolist(), self.floor_scaling.tolist()
        out["floor_cell_m"], out["path_cell_m"] = FLOOR_M, PATH_M
        out["path_m"] = self.path_m.tolist()
        out["path_speed"] = {name: speed.tolist() for name, speed in self.path_speed.items()}
        out["shapes"] = [dict(vars(entry)) for entry in self.shapes]
        found = self.commanded
        out["commanded"] = {
            "rule": None if found.rule is None else plain(found.rule, nulls=True),
            "sentences": list(self.rule_sentences),
            "verdict": verdict(found),
            "explained": dict(found.explained),
            "network": found.network,
        }
        return out

    def to_frame(self) -> pl.DataFrame:
        """Return one row per threshold between two levels; metres."""
        rows = [
            {
                "slower": entry.slower,
                "faster": entry.faster,
                "threshold_m": entry.metres,
                "low_m": entry.low,
                "high_m": entry.high,
                "network_m": network,
            }
            for entry, network in zip(self.thresholds, self.thresholds_of_network, strict=True)
        ]
        return pl.DataFrame(rows)

    def _lines(self) -> list[str]:
        if self.commanded.rule is not None:
            return [*self.doubts, *self.rule_sentences]
        best = self.explained.get(self.rule, float("nan"))
        return [
            *self.doubts,
            f"levels {', '.join(f'{fixed(level, 2)}' for level in self.levels)}; by {self.rule} (explains "
            f"{percent(best, 1)})",
        ]


@one_thread()
def read_zones(model: TrainedModel, dataset: Dataset, *, seed: int = 0, other_cell: bool = False) -> SafetyFunction:
    """Read the safety function from logged samples and a network trained on them.

    Args:
        model: A model of problem `now` with levels.
        dataset: Logs with positions and scaling.
        seed: Seed of the resampling for confidence intervals.
        other_cell: Accept a model of another cell.

    Raises:
        ModelError: The model does not predict the present scaling, has no levels, or is of another cell.
        DatasetError: Too few samples have positions and a scaling.
    """
    refuse_without_levels(model, dataset)
    refuse_other_cell(model.card, dataset, other_cell=other_cell)
    dataset = as_learned_by(model.card, dataset)
    if by_signals(dataset):
        return _by_signals(model, dataset, seed)
    rows, notes = _rows(dataset)
    if len(rows.scaling) < MIN_ROWS:
        msg = f"{dataset.path}: {len(rows.scaling)} samples have both positions and a scaling; {MIN_ROWS} are needed"
        raise DatasetError(msg, cure=f"See what the logs lack: {command_line('inspect', dataset.place)}")
    levels = model.levels
    predicted = _predicted(model, rows)
    in_space = bool((rows.human_m[:, 2] != rows.robot_m[:, 2]).any())  # otherwise both distances to the TCP are equal
    fits = {name: by_distance(rows, levels, name)[1] for name in list(DISTANCES)[not in_space :]}
    nearest = next(name for name in fits if fits[name] >= max(fits.values()) - SAME)
    parts = {**fits, "place on the floor": by_place(rows), "network": explained(rows.scaling, predicted)}
    is_distance = fits[nearest] >= max(parts["network"], parts["place on the floor"]) - BY_DISTANCE
    rule = nearest if is_distance or fits[nearest] >= parts["place on the floor"] else "place on the floor"
    asked = ScalingSamples(rows.robot_m, rows.human_m, predicted, rows.execution, rows.t_s)
    network = by_distance(asked, levels, nearest)[0]
    found = rule_of(dataset, levels, model=model, seed=seed)
    said = dataset.card.dynamics.hysteresis_m
    corner, scaling = _floor(rows)
    return SafetyFunction(
        levels=levels,
        shares=_shares(rows.scaling, levels),
        rule=rule,
        is_distance=is_distance,
        explained=parts,
        thresholds=tuple(thresholds(rows, levels, nearest, seed=seed)),
        thresholds_of_network=tuple(network.tolist()),
        hysteresis_m=hysteresis(rows, levels, nearest) if said is None else float(said),
        hysteresis_origin="approaching against leaving" if said is None else "dynamics",
        floor_m=corner,
        floor_scaling=scaling,
        rows=len(rows.scaling),
        executions=len(np.unique(rows.execution)),
        notes=(*notes, *_notes(rule, is_distance=is_distance or found.rule is not None, parts=parts)),
        commanded=found,
        shapes=() if found.rule is None else tuple(_shapes(found.rule, rows)),
        cell=CellOnFloor(dataset.places, dataset.human_places, dataset.furniture),
    )


def _shares(scaling: Floats, levels: tuple[float, ...]) -> tuple[float, ...]:
    """Return the share of the samples nearest to each level."""
    count = np.bincount(np.abs(scaling[:, None] - np.array(levels)).argmin(axis=1), minlength=len(levels))
    return tuple((count / count.sum()).tolist())


def _by_signals(model: TrainedModel, dataset: Dataset, seed: int) -> SafetyFunction:
    """Return the safety function of a cell whose signals detect people, without floor and distance."""
    frame = dataset.samples(columns=["execution", "scaling", "human_signals"]).drop_nulls()
    levels, found = model.levels, rule_of(dataset, model.levels, model=model, seed=seed)
    path_m, speed = speeds_on_path(model if found.rule is None else RuleSafety(found.rule, model.card), dataset)
    return SafetyFunction(
        levels=levels,
        shares=_shares(frame["scaling"].to_numpy(), levels),
        rule="signals",
        is_distance=False,
        explained=dict(found.explained),
        thresholds=(),
        thresholds_of_network=(),
        hysteresis_m=None,
        hysteresis_origin="signals",
        floor_m=np.empty((0, 2)),
        floor_scaling=np.empty(0),
        rows=found.rows,
        executions=found.executions,
        notes=(_NO_PROOF,),
        commanded=found,
        cell=CellOnFloor(dataset.places, dataset.human_places, dataset.furniture),
        path_m=path_m,
        path_speed=speed,
    )


def _shapes(rule: RuleCard, rows: ScalingSamples) -> list[RuleShape]:
    return shapes_of(rule, rows.robot_m[:, :2], within_m=float(np.abs(rows.human_m[:, :2]).max()))


def refuse_without_levels(model: TrainedModel, dataset: Dataset) -> None:
    """Refuse a model of another problem, or one without levels.

    Raises:
        ModelError: The model is of another problem or has no levels.
    """
    if model.problem != "now" or len(model.levels) < 2:
        msg = f"the model (problem {model.problem!r}, {len(model.levels)} levels) shows no staircase"
        cure = f"Train one: {command_line('train', dataset.place, '--problem', 'now', '--out', 'MODEL')}"
        raise ModelError(msg, cure=cure)


def _rows(dataset: Dataset) -> tuple[ScalingSamples, list[str]]:
    """Return the samples, and notes on unknown heights."""
    robots, humans = ([f"{who}_{axis}_m" for axis in "xyz"] for who in ("robot", "human"))
    rows = dataset.samples(columns=["execution", "t_s", "scaling", *robots, *humans])
    notes = height_notes(rows)
    rows = rows.with_columns(human_z_m=HUMAN_Z_IN_PLANE)
    known = rows.drop_nulls(["robot_x_m", *humans, "scaling"])
    robot, human = (known.select(names).to_numpy() for names in (robots, humans))
    code = known["execution"].rle_id().cast(pl.Int64).to_numpy()
    return ScalingSamples(robot, human, known["scaling"].to_numpy(), code, known["t_s"].to_numpy()), notes


def _predicted(model: TrainedModel, rows: ScalingSamples) -> Floats:
    inputs = np.concatenate([rows.robot_m, rows.human_m], axis=1).astype(np.float32)
    parts = [model.predict(inputs[first : first + 2048]) for first in range(0, len(inputs), 2048)]
    return np.concatenate(parts)


def _floor(rows: ScalingSamples) -> tuple[Floats, Floats]:
    cell, code = np.unique(floor_cells(rows.human_m), axis=0, return_inverse=True)
    code = code.ravel()
    order = np.argsort(code, kind="stable")
    parts = np.split(rows.scaling[order], np.cumsum(np.bincount(code))[:-1])
    seen = np.array([len(part) >= MIN_SEEN for part in parts])
    medians = np.array([np.median(part) for part in parts])
    return np.asarray(cell[seen] * FLOOR_M), medians[seen]


def _notes(rule: str, *, is_distance: bool, parts: Mapping[str, float]) -> tuple[str, ...]:
    found = []
    if not is_distance:
        best = max((name for name in DISTANCES if name in parts), key=lambda name: parts[name])
        found.append(
            f"distance is not enough: the best one ({best}) explains {percent(parts[best], 1)} of the "
            f"scaling's variance, {rule if rule not in DISTANCES else 'the network'} "
            f"{percent(parts[rule] if rule not in DISTANCES else parts['network'], 1)}; thresholds in "
            "metres mean little here"
        )
    found.append(_NO_PROOF)
    return tuple(found)
