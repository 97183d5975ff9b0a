"""`gate_takt`: whether enough cycles are within the takt time: passed, failed, or unknown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.api.estimate import estimate_cycles
from cyclekit.api.given import Sequences, sequences_of
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, EstimateError, UnknownName
from cyclekit.estimate.answers import CycleEstimates
from cyclekit.estimate.finding import Finding, light_of
from cyclekit.estimate.result import CycleEstimate
from cyclekit.estimate.robot.safety import SafetyModel
from cyclekit.learning.task_times.saved import TaskTimesModel
from cyclekit.text.numbers import compact, given, percent, percent_interval
from cyclekit.text.results import Result

SHARE, CONFIDENCE = 0.95, 0.95
"""Defaults: required share of cycles within the takt, and confidence with which it is said to be reached or missed."""
Answer = Literal["passed", "failed", "unknown"]
EXIT_CODES: dict[Answer, int] = {"passed": 0, "failed": 1, "unknown": 2}


@dataclass(frozen=True, repr=False)
class GateVerdict(Result):
    """Whether enough cycles of each sequence are within the takt time; as a frame one row per sequence.

    True if all are known to be (`passed`).

    Attributes:
        takt_s: The takt time, s.
        share: Required share of cycles within the takt time.
        confidence: Confidence with which the share must be known to be reached, or to be missed.
        estimates: Estimates of the sequences that were judged.
    """

    takt_s: float
    share: float
    confidence: float
    estimates: CycleEstimates

    def __bool__(self) -> bool:
        """Return whether it passed."""
        return self.passed

    @property
    def answer(self) -> Answer:
        """The verdict on all sequences: failed if one fails, passed if all pass, else unknown."""
        each = [self.of(one) for one in self.estimates]
        return "failed" if "failed" in each else "unknown" if "unknown" in each else "passed"

    @property
    def passed(self) -> bool:
        """Whether every sequence has enough cycles within the takt time, for certain."""
        return self.answer == "passed"

    @property
    def exit_code(self) -> int:
        """0 if passed, 1 if failed, 2 if unknown."""
        return EXIT_CODES[self.answer]

    @property
    def worst(self) -> CycleEstimate:
        """The sequence that decides: the one with the smallest share among those with this answer."""
        return min((one for one in self.estimates if self.of(one) == self.answer), key=lambda one: self._shares(one)[0])

    def of(self, one: CycleEstimate) -> Answer:
        """Return the verdict on one sequence.

        It is unknown where a finding says that its number, or its interval, cannot be trusted; or where the share that
        is asked for is within the interval at this confidence. A takt shorter than the robot's motion at full speed is
        missed, whatever is unknown.
        """
        if one.estimator != "task times" and self.takt_s < one.nominal_s:
            return "failed"
        _, low, high = self._shares(one)
        if any(finding.blocks for finding in one.findings) or low < self.share <= high:
            return "unknown"
        return "passed" if low >= self.share else "failed"

    def why_unknown(self, one: CycleEstimate) -> tuple[str, ...]:
        """Return why the verdict on a sequence is unknown, and what to do, one sentence each; empty if it is known."""
        if self.of(one) != "unknown":
            return ()
        blocking = tuple(finding.shown for finding in one.findings if finding.blocks)
        _, low, high = self._shares(one)
        close = (
            f"{percent(self.share, 1)} is within the interval of the share, {percent_interval(low, high, 1)}: "
            f"log more executions than these {one.executions}, or ask for another share or confidence"
        )
        return (*blocking, *([close] if low < self.share <= high else []))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is known about the basis of the numbers, the worst first."""
        return self.estimates.findings

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        given = {"takt_s": self.takt_s, "share": self.share, "confidence": self.confidence, "worst": self.worst.name}
        verdict = {"answer": self.answer, "passed": self.passed, "why": list(self.why_unknown(self.worst))}
        return {**verdict, **given, **light_of(self.findings), "sequences": self._frame_rows()}

    def _shares(self, one: CycleEstimate) -> tuple[float, float, float]:
        """Return the share within the takt, and the bounds that it exceeds and stays below at the confidence."""
        if one.distribution is None:
            return 0.0, 0.0, 1.0
        return one.distribution.within(self.takt_s, 2.0 * self.confidence - 1.0)

    def _frame_rows(self) -> list[dict[str, object]]:
        rows = []
        for one in self.estimates:
            share, low, high = self._shares(one)
            found: dict[str, object] = {"sequence": one.name, "answer": self.of(one), "share": share}
            found |= {"at_least": low, "at_most": high, "expected_s": one.expected_s, "executions": one.executions}
            rows.append(found | {"level": one.level, "why": list(self.why_unknown(one)), "doubts": list(one.doubts)})
        return rows

    def _lines(self) -> list[str]:
        share, low, high = self._shares(self.worst)
        least = f", which decides of {len(self.estimates)} sequences" if len(self.estimates) > 1 else ""
        line = (
            f"{self.answer}: {percent(share, 1)} of the cycles of {self.worst.name!r} are within "
            f"{given(self.takt_s)} s{least}; "
            f"with {compact(self.confidence, 4)} confidence at least {percent(low, 1)}, at most "
            f"{percent(high, 1)}; asked for {percent(self.share, 1)}"
        )
        return [line, *self.why_unknown(self.worst)]

    @property
    def line(self) -> str:
        """The verdict in one line."""
        return self._lines()[0]


@checked
def gate_takt(
    model: SafetyModel | TaskTimesModel | Place,
    dataset: Dataset | Place,
    sequences: Sequences,
    takt_s: float,
    *,
    share: float | None = None,
    confidence: float | None = None,
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
        share: Required share of cycles within it, in (0, 1); 0.95 if not given.
        confidence: Confidence with which that share must be known to be reached, or to be missed, in [0.5, 1); 0.95 if
            not given. At 0.5 the best estimate decides. Give it together with `share`.
        sequence: Judge only the sequence of this name.
        seed: Seed of the resampling.
        extrapolate: Answer even if most of the cycle is outside logged positions.
        validate: Validate on logged executions, and correct the bias; without it the verdict is unknown.
        other_cell: Accept a model of another cell.
        progress: Called with the fraction done and a text.

    Raises:
        ConfigError: The share or the confidence is out of range, or the confidence is given without the share.
        UnknownName: There is no such sequence.
        EstimateError: A sequence cannot be answered from these logs.
    """
    if confidence is not None and share is None:
        seen = f"confidence = {given(confidence)} without share: confidence is no longer the share of cycles"
        cure = "Give both: share, the share of cycles within the takt, and confidence, how sure that must be."
        raise ConfigError(seen, cure=cure)
    share, confidence = SHARE if share is None else share, CONFIDENCE if confidence is None else confidence
    if not 0.0 < share < 1.0:
        raise ConfigError(f"share = {given(share)} is not between 0 and 1", cure="Give 0.95, say.")
    if not 0.5 <= confidence < 1.0:
        raise ConfigError(f"confidence = {given(confidence)} is not in 0.5 to 1", cure="Give 0.95, say.")
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
        if one.distribution is None:
            cure = "Log more executions: too few to estimate single cycles."
            raise EstimateError(f"{one.name}: the {one.estimator} estimate has no distribution of cycles", cure=cure)
    return GateVerdict(takt_s, share, confidence, found)
