"""Whether the number of an answer can be trusted: the findings that every answer has, made once.

Clock and pose of the tracker, the executions that show people, bias and coverage of the backtest, and support. Every
command, the page and the workbook show these, in `CycleEstimate.findings`; none of them judges again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from cyclekit.alignment.clocks import ASSUMED
from cyclekit.dataset.cards.notes import ADVICE, UNPROVEN
from cyclekit.estimate.finding import Finding
from cyclekit.estimate.robot.safety import OnStates
from cyclekit.estimate.validation.several import several_found
from cyclekit.text.numbers import percent

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclekit.dataset.cards import Note
    from cyclekit.dataset.cards.recording import ClockMethod
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.estimate.robot.safety import SafetyModel

FEW_EXECUTIONS = 20
"""Number of operator tracks below which the mean is reported as uncertain (by more than 1 % in the cells so far)."""
ROUGHLY: tuple[ClockMethod, ...] = ("logs", "start-text")
"""Methods of clock alignment that leave an error of the order of a reaction time."""
BY_THE_LOGS: tuple[ClockMethod, ...] = ("own", "same-log", "event-pairs", "motion", "lower-envelope", "logs")
"""Methods that the logs themselves decide: one device, or a fit with its residual."""
WRONG = ("clock-contradicted", "clock-by-logs-unsure", "clock-apart", "clock-future", "clock-unit")
"""Codes of notes on a clock that is wrong, or not certain."""
GIVE_CLOCK = "give clock_offset_s, sync or sees in the cell file, or ingest with --align-clocks logs"
GIVE_POSE = "give frame in the cell file (`cyclekit calibrate points.csv` computes it)"


class Backtest(Protocol):
    """The comparison of rollouts with logged executions."""

    @property
    def findings(self) -> Sequence[Finding]:
        """What it says of the model."""
        ...


def findings_of(
    model: SafetyModel,
    check: Backtest | None,
    dataset: Dataset | None,
    *,
    executions: int,
    support: float,
    validated: str | None = "",
) -> list[Finding]:
    """Return what is known about the basis of the number of one sequence.

    Args:
        model: The safety function.
        check: The comparison with the logged executions; None without one.
        dataset: The logs; None if people have no part in the number.
        executions: Number of logged executions behind the number; 0 if none shows people.
        support: Share of the cycle in logged positions; NaN if unknown.
        validated: Why there is no `check`; None if nobody expects one.
    """
    found = [] if dataset is None else [*findings_of_logs(dataset, model), *_people(model, executions)]
    if dataset is not None and not isinstance(model, OnStates):
        found += [*several_found(dataset), *unproven_found(model.card.warnings)]
    if check is not None:
        found += check.findings
    elif validated is not None:
        found.append(not_validated(validated))
    return [*found, *_support(support)]


def findings_of_logs(dataset: Dataset, model: object = None) -> list[Finding]:
    """Return what is known about clock and pose of the tracker, on which every distance rests."""
    return [*_clock(dataset, model), *_pose(dataset, model)]


def confirmed(dataset: Dataset) -> bool:
    """Return whether the slow-downs confirm clock and pose: a reaction time was found at which their places agree.

    With a clock that is off by more than a second, or in a wrong frame, they agree at none.
    """
    return dataset.card.dynamics.latency_s is not None


def _clock(dataset: Dataset, model: object) -> Iterator[Finding]:
    wrong = [(one, said) for one in dataset.recordings for said in one.clock.warnings if said.code in WRONG]
    if wrong:  # whatever the model: it learned without this log, or with it at wrong times
        yield Finding("clock", "red", f"{wrong[0][0].shown}: {wrong[0][1].text}")
        return
    if isinstance(model, OnStates) and not model.card.operator_signals:
        return  # only the robot's own log
    others = [one for one in dataset.recordings if "people" in one.tables or isinstance(model, OnStates)]
    methods = {one.clock.method for one in others}
    shown = confirmed(dataset) or _signals_found(dataset, model)
    untested = {
        one.clock.method
        for one in others
        if one.clock.method not in BY_THE_LOGS
        and not (shown or (one.clock.test is not None and one.clock.test.certain))
    }
    if ASSUMED in untested:
        text = "the clocks of robot and tracker are assumed to start together, and nothing in the logs confirms it"
        yield Finding("clock", "red", text, GIVE_CLOCK)
    elif methods.intersection(ROUGHLY):
        text = "the clocks of robot and tracker are aligned roughly: the reaction delay is hidden or unknown"
        yield Finding("clock", "amber", text, "give sync or clock_offset_s in the cell file")
    elif untested:
        text = "the clocks of robot and tracker are as stated, and nothing in the logs shows whether that is right"
        yield Finding("clock", "amber", text, "log more executions that show people")
    elif others:
        how = "the clocks are assumed to start together" if ASSUMED in methods else "the clocks are aligned"
        yield Finding("clock", "green", f"{how}, and the logs confirm it")


def _signals_found(dataset: Dataset, model: object) -> bool:
    """Return whether the signals of people were found in the logs: the speed follows them after a fixed delay."""
    return isinstance(model, OnStates) and not any(one.told for one in dataset.card.operator_signals)


def _pose(dataset: Dataset, model: object) -> Iterator[Finding]:
    logs = [one for one in dataset.recordings if "people" in one.tables]
    if isinstance(model, OnStates) or not logs:
        return
    notes = {one.code: one for one in dataset.card.warnings}
    given = all(one.frame.method != "assumed base frame" or "base_frame" in one.facts for one in logs)
    if doubtful := notes.get("frame-doubtful"):
        yield Finding("pose", "red", doubtful.text)
    elif "frame-assumed" in notes or not (given or confirmed(dataset)):
        text = "the tracker's pose is not given, and the slow-downs do not confirm that its axes are the robot's"
        yield Finding("pose", "red", text, GIVE_POSE)
    else:
        yield Finding("pose", "green", "the tracker's pose is given" if given else "the slow-downs confirm the pose")


def unproven_found(warnings: Sequence[Note]) -> Iterator[Finding]:
    """Yield a finding if what was learned on who waits for whom is not used: it failed on logged executions."""
    for one in warnings:
        if one.code == UNPROVEN:
            yield Finding("waits", "amber", one.finding, ADVICE[one.code])


def _people(model: SafetyModel, executions: int) -> Iterator[Finding]:
    if isinstance(model, OnStates) and model.doubts:
        yield from (Finding("people", "amber", text) for text in model.doubts)
    elif 0 < executions < FEW_EXECUTIONS:
        text = f"based on only {executions} executions that show the operator: the mean itself is uncertain"
        yield Finding("people", "amber", text, "log more executions")
    elif executions:
        yield Finding("people", "green", f"{executions} executions show the operator")


def not_validated(why: str) -> Finding:
    """Return the finding that a number was not compared with logged executions, for this reason (empty: not asked)."""
    text = "not validated on logged executions, so no bias is known or corrected" + (f": {why}" if why else "")
    return Finding("backtest", "amber", text, covered=False)


def _support(support: float) -> Iterator[Finding]:
    """Yield a finding on extrapolation: red if most, amber if more than a tenth of the cycle was never logged."""
    if support < MIN_SUPPORT:
        yield Finding("support", "red", f"EXTRAPOLATED: {_unlogged(support)}", LOG_THERE)
    elif support < ENOUGH_SUPPORT:
        yield Finding("support", "amber", _unlogged(support), LOG_THERE)  # most of the cycle was logged
    elif support == support:
        yield Finding("support", "green", f"{percent(support)} of the cycle runs through logged positions")


def _unlogged(support: float) -> str:
    return (
        f"{percent(1 - support)} of the cycle runs through positions that were never logged; the error "
        "there is unknown, and not in the interval of the mean"
    )


MIN_SUPPORT = 0.5
"""Minimum share of the cycle in logged positions; below it the estimate is refused."""
ENOUGH_SUPPORT = 0.9
"""Minimum share of the cycle in logged positions without a finding."""
LOG_THERE = "log this part of the cell"
