"""`gate_takt`: whether enough cycles are within the takt time, as one verdict."""

from __future__ import annotations

from dataclasses import dataclass

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.estimate import estimate_cycles
from cyclekit.api.given import Sequences, sequences_of
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, EstimateError, UnknownName
from cyclekit.estimate.answers import CycleEstimates
from cyclekit.estimate.result import CycleEstimate
from cyclekit.estimate.robot.safety import SafetyModel
from cyclekit.learning.task_times.saved import TaskTimesModel
from cyclekit.text.results import Result


@dataclass(frozen=True, repr=False)
class GateVerdict(Result):
    """Whether enough cycles of each sequence are within the takt time; as a frame one row per sequence.

    Attributes:
        takt_s: The takt time, s.
        confidence: Required share of cycles within the takt time.
        sure: Whether the lower end of the 95 % interval must reach that share, too.
        estimates: Estimates of the sequences that were judged.
    """

    takt_s: float
    confidence: float
    sure: bool
    estimates: CycleEstimates

    @property
    def worst(self) -> CycleEstimate:
        """The sequence with the smallest share of cycles within the takt time."""
        return min(self.estimates, key=self._reached)

    @property
    def passed(self) -> bool:
        """Whether every sequence has enough cycles within the takt time."""
        return self._reached(self.worst) >= self.confidence

    def _reached(self, one: CycleEstimate) -> float:
        share, low, _ = _share(one)
        return low if self.sure else share

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        given = {"takt_s": self.takt_s, "confidence": self.confidence, "sure": self.sure}
        return {"passed": self.passed, **given, "worst": self.worst.name, "sequences": self._frame_rows()}

    def _frame_rows(self) -> list[dict[str, object]]:
        rows = []
        for one in self.estimates:
            share, low, high = _share(one)
            found: dict[str, object] = {"sequence": one.name, "probability": share, "low": low, "high": high}
            reached = {"passed": self._reached(one) >= self.confidence, "expected_s": one.expected_s}
            rows.append(found | reached | {"executions": one.executions, "doubts": list(one.doubts)})
        return rows

    def _lines(self) -> list[str]:
        share, low, high = _share(self.worst)
        least = f", the least of {len(self.estimates)} sequences" if len(self.estimates) > 1 else ""
        asked = f"asked for {self.confidence:.1%}" + (" by the lower end" if self.sure else "")
        return [
            f"{'passed' if self.passed else 'failed'}: {share:.1%} (95% CI {low:.1%} to {high:.1%}) of the cycles of "
            f"{self.worst.name!r} are within {self.takt_s:g} s{least}; {asked}"
        ]

    @property
    def line(self) -> str:
        """The verdict in one line."""
        return self._lines()[0]


def _share(one: CycleEstimate) -> tuple[float, float, float]:
    """Return the share of cycles within the takt time, with a 95 % interval."""
    return one.takt_probability or (0.0, 0.0, 1.0)


@checked
def gate_takt(
    model: SafetyModel | TaskTimesModel | Place,
    dataset: Dataset | Place,
    sequences: Sequences,
    takt_s: float,
    *,
    confidence: float = 0.95,
    sure: bool = False,
    sequence: str | None = None,
    seed: int = 0,
    extrapolate: bool = False,
    validate: bool = True,
    other_cell: bool = False,
    progress: Progress | None = None,
) -> GateVerdict:
    """Judge whether enough cycles of every sequence, or of one, are within the takt time.

    Args:
        model: As in `estimate_cycles`; so are `dataset`, `sequences`, `seed`, `extrapolate`, `validate`, `other_cell`.
        dataset: The logs.
        sequences: Sequences, or the sequence file.
        takt_s: Takt time, s.
        confidence: Required share of cycles within it, in (0, 1).
        sure: The lower end of the 95 % interval of that share must reach it, too.
        sequence: Judge only the sequence of this name.
        seed: Seed of the resampling.
        extrapolate: Answer even if most of the cycle is outside logged positions.
        validate: Validate on logged executions, and correct the bias.
        other_cell: Accept a model of another cell.
        progress: Called with the fraction done and a text.

    Raises:
        ConfigError: The confidence is not between 0 and 1.
        UnknownName: There is no such sequence.
        EstimateError: A sequence cannot be answered from these logs.
    """
    if not 0.0 < confidence < 1.0:
        raise ConfigError(f"confidence = {confidence:g} is not between 0 and 1", cure="Give 0.95, say.")
    wanted = sequences_of(sequences)
    if sequence is not None:
        names = [one.name for one in wanted]
        if sequence not in names:
            raise UnknownName("the sequences", "sequence", sequence, names)
        wanted = [one for one in wanted if one.name == sequence]
    found = estimate_cycles(
        model, dataset, wanted, takt_s=takt_s, seed=seed, extrapolate=extrapolate, validate=validate,
        other_cell=other_cell, progress=progress,
    ).require_all()  # fmt: skip
    for one in found:
        if one.takt_probability is None:
            cure = "Log more executions: too few to estimate single cycles."
            raise EstimateError(f"{one.name}: the {one.estimator} estimate has no distribution of cycles", cure=cure)
    return GateVerdict(takt_s, confidence, sure, found)
