"""Which sessions share a file of samples: a file costs as much time as many samples, and there may be thousands."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from cyclekit.derive.sample_file import AT_ONCE

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cyclekit.dataset.sessions import Session

Item = TypeVar("Item")

FEW_SESSIONS = 50
"""In datasets of up to so many, each session has a file of its own."""
MOST_SESSIONS = 200
"""Of one file: so many are made at once by a worker, and made again where one is lost."""
SHORT = AT_ONCE // 8
"""A session of more samples has a file of its own."""


def shared_files(sessions: Sequence[Session], rate_hz: float) -> list[list[int]]:
    """Return the numbers of the sessions of each file of samples, which has the name of its first session.

    Files in order of name hold the sessions in order of name.

    Args:
        sessions: All, with their spans.
        rate_hz: Rate of the samples.
    """
    numbers = sorted(range(len(sessions)), key=lambda number: f"{sessions[number].name}.parquet")
    if len(sessions) <= FEW_SESSIONS:
        return [[number] for number in numbers]
    files: list[list[int]] = []
    free = 0.0
    for number in numbers:
        first_s, last_s = sessions[number].span_s
        count = (last_s - first_s) * rate_hz + 1
        if not files or count > min(free, SHORT) or len(files[-1]) >= MOST_SESSIONS:
            files.append([])
            free = float(AT_ONCE) if count <= SHORT else 0.0
        files[-1].append(number)
        free -= count
    return files


def in_order(found: Iterable[tuple[Sequence[int], Sequence[Item]]]) -> list[Item]:
    """Return what was found of the sessions of each file in the order of the sessions."""
    by_number = {number: one for numbers, mine in found for number, one in zip(numbers, mine, strict=True)}
    return [by_number[number] for number in range(len(by_number))]
