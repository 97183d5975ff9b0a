"""The traffic light above the numbers: each finding with its level and its cure, and the mark beside a number."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.cli.terminal import bullet

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.estimate.finding import Finding
    from cyclekit.estimate.result import CycleEstimate


def light(found: Sequence[CycleEstimate], *, width: int = 80) -> str:
    """Return the traffic light of several estimates: a finding that does not concern all names its sequences."""
    from cyclekit.estimate.finding import holders, merged

    of = holders((each.name, each.findings) for each in found)
    return light_of_findings(merged(each.findings for each in found), of, width=width)


def light_of_findings(findings: Sequence[Finding], of: dict[Finding, str] | None = None, *, width: int = 80) -> str:
    """Return findings, the worst first, one per line with level and cure; green ones by their codes alone.

    Args:
        findings: The findings.
        of: What stands before the text of each.
        width: Maximum width, characters.
    """
    lines = {"red": "RED ", "amber": "* "}
    doubted = [
        bullet([f"{one.code}: {(of or {}).get(one, '')}{one.shown}"], mark=lines[one.level], width=width)
        for one in findings
        if one.level in lines
    ]
    sound = ", ".join(one.code for one in findings if one.level == "green")
    return "\n".join([*doubted, *([bullet([sound], mark="green: ", width=width)] if sound else [])])


def marked(entry: CycleEstimate, number: str) -> str:
    """Return a number with the mark of its estimate's level."""
    from cyclekit.estimate.finding import MARKS

    return f"{number}{MARKS[entry.level]}"
