"""The traffic light of the page: what its numbers rest on, above all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit.estimate.finding import holders, merged, worst

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cyclekit.estimate.finding import Finding, Level
    from cyclekit.report.texts import ReportTexts

LAMPS = ("clock", "pose", "people", "backtest", "bias", "support")
"""Codes of the findings that every answer has."""


@dataclass(frozen=True)
class TrafficLight:
    """What the page shows above its numbers.

    Attributes:
        level: Level of the worst finding.
        title: What that means for the numbers.
        doubted: Level, name and text of each amber and red finding.
        sound: The names of the green ones; empty without any.
    """

    level: Level
    title: str
    doubted: Sequence[tuple[Level, str, str]]
    sound: str

    @property
    def lines(self) -> list[str]:
        """The light in words."""
        doubted = [f"{level}: {name}: {text}" for level, name, text in self.doubted]
        return [self.title, *doubted, *([self.sound] if self.sound else [])]


def traffic_light(
    texts: ReportTexts, findings: Sequence[Finding], several: Iterable[tuple[str, Sequence[Finding]]] = ()
) -> TrafficLight | None:
    """Return the light of findings; None without any.

    Args:
        texts: Texts of the page.
        findings: All of them.
        several: Names and findings of the answers: a finding that does not concern all names those that it concerns.
    """
    every, of = merged([findings]), holders(several)
    if not every:
        return None
    names = {code: texts(f"light.{code}") for code in LAMPS}
    names |= {one.code: one.code.replace("-", " ").capitalize() for one in every if one.code not in names}
    doubted = [(one.level, names[one.code], of.get(one, "") + one.shown) for one in every if one.level != "green"]
    sound = ", ".join(names[one.code] for one in every if one.level == "green")
    level = worst(every)
    titles = {"green": texts("light.green"), "amber": texts("light.amber"), "red": texts("light.red")}
    return TrafficLight(level, titles[level], doubted, texts("light.sound", names=sound) if sound else "")


def resting(texts: ReportTexts, findings: Sequence[Finding]) -> str:
    """Return the mark of what rests on these findings, a sentence; empty if all are green."""
    marks = {"green": "", "amber": texts("light.rests_amber"), "red": texts("light.rests_red")}
    return marks[worst(findings)]


def put_away(texts: ReportTexts, light: TrafficLight | None, headline: str) -> str:
    """Return the headline, behind a plain mark if the light is red."""
    return texts("light.put_away", headline=headline) if light is not None and light.level == "red" else headline
