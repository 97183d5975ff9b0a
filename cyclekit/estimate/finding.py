"""A finding: one thing that is known about the basis of a number, as a light with its reason and its cure.

Whoever finds a limit makes a `Finding`; `soundness` makes those that every answer has. The estimate carries them, and
everything that shows an estimate reads them there. Nothing searches their texts: a program asks for code and level.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

Level = Literal["green", "amber", "red"]
LEVELS: tuple[Level, ...] = ("green", "amber", "red")
"""From sound to not to be trusted."""
MARKS: dict[Level, str] = {"green": "", "amber": "*", "red": " RED"}
"""Mark behind a number, by the level of its basis."""


@dataclass(frozen=True)
class Finding:
    """One thing that is known about the basis of a number.

    Attributes:
        code: What it is about, such as `clock`; programs ask for it.
        level: `green`: sound; `amber`: a limit to know; `red`: the number and its intervals cannot be trusted.
        text: What was seen, one sentence without a full stop.
        cure: What to do; empty where nothing is to be done, or where `text` says it.
        covered: Whether a verdict may be based on the printed intervals in spite of an amber finding: they cover what
            it leaves open, or it is about the smaller part of the cycle.
    """

    code: str
    level: Level
    text: str
    cure: str = ""
    covered: bool = True

    @property
    def shown(self) -> str:
        """The text with its cure."""
        return f"{self.text}: {self.cure}" if self.cure else self.text

    @property
    def blocks(self) -> bool:
        """Whether no verdict can be based on the number."""
        return self.level == "red" or (self.level == "amber" and not self.covered)

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        return dict(vars(self))


def worst(findings: Iterable[Finding]) -> Level:
    """Return the level of the worst finding; green without any."""
    return max((one.level for one in findings), key=LEVELS.index, default="green")


def doubts_of(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the amber and red findings with their cures, one sentence each."""
    return tuple(one.shown for one in findings if one.level != "green")


def merged(several: Iterable[Sequence[Finding]]) -> tuple[Finding, ...]:
    """Return the findings of several answers, each once, the worst first; a green one only if all agree on its code."""
    every = list(dict.fromkeys(one for findings in several for one in findings))
    doubted = {one.code for one in every if one.level != "green"}
    sound = {one.code: one for one in every if one.level == "green" and one.code not in doubted}
    kept = [*(one for one in every if one.level != "green"), *sound.values()]
    return tuple(sorted(kept, key=lambda one: -LEVELS.index(one.level)))


def holders(several: Iterable[tuple[str, Sequence[Finding]]]) -> dict[Finding, str]:
    """Return what stands before each finding of several named answers: the names of those that have it, unless all."""
    answers = list(several)
    names = {one: dict.fromkeys(name for name, found in answers if one in found) for _, all_ in answers for one in all_}
    every = len({name for name, _ in answers})
    return {one: "" if len(some) == every else f"{', '.join(some)}: " for one, some in names.items()}


def light_of(findings: Sequence[Finding]) -> dict[str, object]:
    """Return findings as the traffic light of an answer, plain JSON values: level, warnings and the findings."""
    return {
        "level": worst(findings),
        "warnings": list(doubts_of(findings)),
        "findings": [one.to_dict() for one in findings],
    }
