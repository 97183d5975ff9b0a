"""What the page is made of: given once, found out of the logs when a section or a figure first asks for it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from cyclekit.config.sequences import PLAN, TaskSequence
from cyclekit.errors import DatasetError
from cyclekit.estimate.finding import merged
from cyclekit.estimate.soundness import findings_of_logs
from cyclekit.estimate.what_to_log import what_to_log
from cyclekit.learning.coupling.words import wait_rows, waited_s
from cyclekit.learning.networks.kinds import is_classifier
from cyclekit.learning.networks.saved import TrainedModel
from cyclekit.learning.rules.safety import predictor_of
from cyclekit.report import findings
from cyclekit.report.floor import floor_plan
from cyclekit.report.light import traffic_light
from cyclekit.report.verdict import others, verdict
from cyclekit.text.numbers import decimals_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    import polars as pl

    from cyclekit.dataset.cards import CouplingCard
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.answers import Refusal
    from cyclekit.estimate.finding import Finding
    from cyclekit.estimate.plan import OrderPlan
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.validation.check import Check
    from cyclekit.estimate.what_to_log import RecordingPlan
    from cyclekit.learning.coupling.words import WaitRow
    from cyclekit.report.findings import Judged, LoggedResponse, Overview, Predicts
    from cyclekit.report.floor import FloorPlan
    from cyclekit.report.light import TrafficLight
    from cyclekit.report.texts import ReportTexts
    from cyclekit.report.tried import Tried
    from cyclekit.report.verdict import TaktVerdict


@dataclass(frozen=True)
class PageInputs:
    """What the page is made of.

    Attributes:
        texts: The words.
        dataset: The logs.
        model: The trained model; None for logs alone.
        ranked: Estimates, those of the same work together, the fastest first.
        what_if: Changes that were tried.
        planned: The order found.
        evaluation: Of the model.
        check: The backtest on logged executions.
        takt_s: The takt time, s.
        baseline: Name of the sequence that the others are compared with.
        unseen: Whether the estimates are of a model of an operator whom no log shows; `model` is None then.
        refused: Sequences, changes and an order search that the logs cannot answer, each with the reason.
    """

    texts: ReportTexts
    dataset: Dataset
    model: Predicts | None = None
    ranked: Sequence[CycleEstimate] = ()
    what_if: Sequence[Tried] = ()
    planned: OrderPlan | None = None
    evaluation: Judged | None = None
    check: Check | None = None
    takt_s: float | None = None
    baseline: str | None = None
    unseen: bool = False
    refused: Sequence[Refusal] = ()

    @cached_property
    def light(self) -> TrafficLight | None:
        """The traffic light above the numbers; None if nothing is known of their basis."""
        return traffic_light(self.texts, self.findings, [(one.name, one.findings) for one in self.ranked])

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """What is known about the basis of the numbers, the worst first."""
        return merged([self.basis, *(one.findings for one in self.ranked)])

    @cached_property
    def basis(self) -> list[Finding]:
        """Findings on clock and pose of the tracker, on which every distance rests."""
        return findings_of_logs(self.dataset)

    @cached_property
    def samples(self) -> pl.DataFrame:
        """Table SAMPLES of all executions."""
        return self.dataset.samples()

    @cached_property
    def tasks(self) -> pl.DataFrame:
        """Table TASKS of the robot."""
        return self.dataset.tasks()

    @cached_property
    def seen(self) -> Overview:
        """What the logs hold."""
        return findings.overview(self.dataset, self.samples, self.tasks)

    @cached_property
    def answers(self) -> Predicts | None:
        """The rule of the model if it has one, else its network."""
        return predictor_of(self.model) if isinstance(self.model, TrainedModel) else self.model

    @property
    def may_regress(self) -> bool:
        """Whether the answers are of no model yet, or of a network that knows levels only."""
        return self.answers is None or (isinstance(self.answers, TrainedModel) and is_classifier(self.answers.network))

    @cached_property
    def response(self) -> LoggedResponse | None:
        """Scaling against distance; None where scaling or positions are unknown."""
        return findings.safety_function(self.samples, self.dataset.levels, self.answers)

    @cached_property
    def plan(self) -> FloorPlan | None:
        """The floor plan; None where no operator position is known."""
        return floor_plan(self.dataset, self.samples, self.answers)

    @property
    def coupling(self) -> CouplingCard | None:
        """Who waits for whom: as the model has it, which may not use what was found in the logs."""
        return (self.model.card.coupling if self.model else None) or self.dataset.card.coupling

    @property
    def coupled(self) -> bool:
        """Whether robot or operator are known to wait for anything."""
        return self.coupling is not None and self.coupling.coupled

    @cached_property
    def waits(self) -> list[tuple[WaitRow, float]]:
        """The wait conditions in words, each with the time waited for it per logged execution, s."""
        rows = wait_rows(self.coupling, self.texts.place)
        each_s = waited_s(self.dataset.every_task(), rows) if rows else []
        return [(row, seconds / self.seen.executions) for row, seconds in zip(rows, each_s, strict=True)]

    @cached_property
    def verdict(self) -> TaktVerdict | None:
        """The verdict; None without sequences, an order search or changes."""
        return verdict(self.dataset, self.ranked, self.what_if, self.planned, self.takt_s, self.baseline)

    @cached_property
    def verdicts(self) -> list[TaktVerdict]:
        """The verdict on each kind of work that was asked for; the main one comes first."""
        main = self.verdict
        return [] if main is None else [main, *others(self.dataset, self.ranked, self.what_if, main)]

    @cached_property
    def best(self) -> CycleEstimate | None:
        """The sequence that the answer names; None without estimates."""
        return self.verdict.best if self.verdict and self.verdict.best else next(iter(self.ranked), None)

    @property
    def decimals(self) -> int:
        """Number of decimals that the cycle times of this page show."""
        logged_s = self.seen.duration_s
        times_s = [*(each.expected_s for each in self.ranked), *(each.expected_s for each in self.what_if)]
        return decimals_of(*times_s, *([float(logged_s.mean())] if len(logged_s) else []))

    @cached_property
    def to_log(self) -> RecordingPlan | None:
        """What to log next for these sequences; None where the robot's tasks are not known."""
        asked = [TaskSequence(each.name, _robot_places(each)) for each in self.ranked]
        asked += [each.sequence for each in self.refused if each.sequence is not None and not each.sequence.plan]
        try:
            return what_to_log(self.dataset, asked)
        except DatasetError:
            return None

    @cached_property
    def judged(self) -> dict[str, Any]:
        """The evaluation of the model as JSON values; empty without one."""
        return {} if self.evaluation is None else self.evaluation.to_dict()


def _robot_places(each: CycleEstimate) -> tuple[str, ...]:
    """Return the robot's ordered places, also of a plan for both."""
    if each.places[:1] != (PLAN,):
        return each.places
    tasks = [task.task.split("->") for task in each.tasks]
    return (*tasks[0][:1], *(task[-1] for task in tasks)) if tasks else ()
