"""How far an ingest is: the share of its time that is over, from the cost of each stage for these logs."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards import LogCard
    from cyclekit.dataset.sessions import LogGroup
    from cyclekit.derive.first_pass import FirstPassResult
    from cyclekit.schema import Progress

MS_PER_MB, MS_PER_LOG = 4.0, 5.0
"""Measured processor time of reading, ms."""
STOP_S = 7.0
"""Assumed time from one standstill to the next, s, before they are counted. Half or twice of it matters only while
logs are read: the remaining time is then too long or too short by the time of the later stages."""
MS_PER_STOP = {"motion": 0.5, "speed": 8.0, "standstills": 1.0, "samples": 0.8, "levels": 0.3, "waits": 0.5}
MS_PER_SESSION = {"motion": 1.5, "speed": 2.0, "standstills": 2.0, "samples": 2.0, "levels": 5.0}
MS_PER_ROW, MS_PER_S = 0.3e-3, 0.2
"""Measured processor time of the stages per standstill, session, row of the robot and second of its log, ms. Half or
twice of one of them makes the remaining time wrong by at most half of that stage's share."""
MS_TRACKER, MS_SIGNALS = {"speed": 1.0, "waits": 1.0}, {"speed": 0.5, "levels": 0.7}
"""The same per standstill: of the tests of the clocks of trackers and signals, of checks, and of the search for signals
that show people."""


class StageProgress:
    """Tells how far an ingest is; the fraction told never goes back."""

    def __init__(self, tell: Progress) -> None:
        self.tell, self.fraction = tell, 0.0
        self.cost_ms = {"read": 0.0}

    def read(self, done: int, size: int, text: str, cards: Sequence[LogCard]) -> None:
        """Tell that `done` of `size` bytes are read, which became these recordings; nothing after the last log.

        What follows a single long log is not known before its standstills are.
        """
        self.cost_ms["read"] = MS_PER_MB * size / 1e6 + MS_PER_LOG * len(cards) * size / max(done, 1)
        if 0 < done < size:
            self._expect(cards, sum(map(_robot_s, cards)) / STOP_S, len(cards), size / done)
            self.at("read", done / size, text)

    def begun(self, groups: Sequence[LogGroup]) -> None:
        """Take over what was read."""
        cards = [log for group in groups for log in group.logs]
        self._expect(cards, sum(map(_robot_s, cards)) / STOP_S, len(groups), 1.0)

    def found(self, groups: Sequence[LogGroup], results: Sequence[FirstPassResult]) -> None:
        """Take over what the first pass found, and tell that it is done: only now the later stages are known."""
        cards = [log for group in groups for log in group.logs]
        silent = any(not run.knows_scaling for result in results for run in result.runs)
        self._expect(cards, sum(len(result.standstills) for result in results), len(groups), 1.0, silent=silent)
        self.at("speed", 0.0, "standstills counted")

    def _expect(
        self, cards: Sequence[LogCard], stops: float, sessions: int, times: float, *, silent: bool = False
    ) -> None:
        """Set the cost of the later stages of `times` as many logs, with scaling to be inferred if it is `silent`."""
        rows, seconds = sum(card.rows.get("robot", 0) for card in cards), sum(map(_robot_s, cards))
        more = {"motion": MS_PER_ROW * rows, "levels": MS_PER_S * seconds}
        people = MS_TRACKER if any("people" in card.tables for card in cards) else MS_SIGNALS
        for stage, ms in MS_PER_STOP.items():
            each = (ms if silent or stage != "speed" else 0.0) + people.get(stage, 0.0)
            cost = each * stops + MS_PER_SESSION.get(stage, 0.0) * sessions + more.get(stage, 0.0)
            self.cost_ms[stage] = cost * times

    def at(self, stage: str, share: float, text: str) -> None:
        """Tell that a share of a stage is done."""
        stages = [*self.cost_ms]
        before = sum(self.cost_ms[name] for name in stages[: stages.index(stage)])
        done = (before + share * self.cost_ms[stage]) / max(sum(self.cost_ms.values()), 1e-9)
        self.fraction = min(max(self.fraction, done), 1.0)
        self.tell(self.fraction, text)


def _robot_s(card: LogCard) -> float:
    return card.duration_s if card.rows.get("robot") else 0.0


__all__ = ["StageProgress"]
