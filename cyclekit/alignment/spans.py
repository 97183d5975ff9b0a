"""Spans of logs with dates: what may explain the time between them, and which robots' logs are of the same time.

The clock of another computer may be off by hours (a time zone) or years (another epoch), and nothing else would show
it. Robots of one cell are beside each other if their logs have one time, as stated or with such a cause taken away.
"""

from __future__ import annotations

from itertools import pairwise, product
from typing import TYPE_CHECKING, NamedTuple

from cyclekit.alignment.recording_clocks import of_one_kind
from cyclekit.dataset.sessions import OVERLAP_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cyclekit.config import Source
    from cyclekit.dataset.cards import LogCard

    Span = tuple[float, float]

HALF = 0.5
"""Share of the shorter span below which logs hardly overlap: the larger part of it has no counterpart. At half of it
logs of a minute are named from 50 s late, not from 40 s; at twice from 5 s, and no time zone fits."""
HOUR_S, MOST_HOURS = 3600.0, 14.0
"""Time zones differ by whole or half hours, at most 14 from UTC."""
EPOCHS = {"counts since 1904 (LabVIEW)": 2082844800.0, "counts since 1900": 2208988800.0, "GPS time": -315964782.0}
"""Time at 1970 on clocks that count from another date, s; the others fall outside of 2000 to 2099, and are refused."""
DECADE_S = 3e8
"""Minimum time between logs of two epochs, s, from their numbers: GPS time is 3.2e8 s away, which twice would miss;
half would compare the clocks of logs of one robot five years apart."""
DATED_S = 9.4e8
"""Times above it, s, are dates: since 1970 those from 1999 on. No controller runs for 30 years."""


class Cause(NamedTuple):
    """What may explain the time between two spans: how far the log is late, s, and in words."""

    late_s: float
    words: str


class Beside(NamedTuple):
    """A robot's log and another robot's of the same time, as stated or but for a cause."""

    log: LogCard
    robot: LogCard
    cause: Cause | None


def overlap(one: Span, other: Span) -> float:
    """Return the time that is common to two spans, s."""
    return max(min(one[1], other[1]) - max(one[0], other[0]), 0.0)


def share(one: Span, other: Span) -> float:
    """Return the share of the shorter of two spans that is common to both."""
    return overlap(one, other) / max(min(one[1] - one[0], other[1] - other[0]), 1e-9)


def cause_of(mine: Span, spans: Sequence[Span]) -> Cause | None:
    """Return the time zone or epoch with which a log lies best within others, the nearest zone first; None: none."""
    hours = sorted((n / 2.0 for n in range(-round(2 * MOST_HOURS), round(2 * MOST_HOURS) + 1)), key=abs)
    found, best = None, HALF
    for (epoch, late_s), zone in product([("", 0.0), *EPOCHS.items()], hours):
        late = late_s + zone * HOUR_S
        most = max(share((mine[0] - late, mine[1] - late), span) for span in spans)
        if late and most > best:
            words = " and ".join(filter(None, (epoch, "another time zone" if zone else "")))
            found, best = Cause(late, words), most
    return found


def robots_beside(logs: Iterable[LogCard], sources: Mapping[str, Source | None]) -> list[Beside]:
    """Return logs of robots, each with a log of another robot of the same time.

    Logs that overlap are of two robots. Those that do not may be of one, shift by shift: only logs of another section
    of the cell file, or another format, or decades away, are compared by what may explain the time between them.
    Dates without a time zone count, as those of all robots are probably of the same zone.
    """
    robots = [log for log in logs if "robot" in log.tables and log.first_s > DATED_S and log.duration_s > 0.0]
    found = _at_once(robots)
    first, *others = _by_clock(robots, sources) or [[]]
    for mine in others:
        ids = {log.id for log in mine}
        if any((one.log.id in ids) != (one.robot.id in ids) for one in _at_once([*first, *mine])):
            continue  # they overlap as stated
        for late, right in ((mine, first), (first, mine)):
            if cause := cause_of((late[0].first_s, late[0].last_s), [(log.first_s, log.last_s) for log in right]):
                found += [Beside(log, max(right, key=lambda one: _common(log, one, cause)), cause) for log in late]
                break
    return found


def _at_once(robots: Sequence[LogCard]) -> list[Beside]:
    """Return the logs that overlap as stated, each with that of those before it which ends last."""
    found: list[Beside] = []
    last: dict[str, LogCard] = {}
    for log in sorted(robots, key=lambda log: log.first_s):
        before = last.get(log.clock.kind, log)
        if log.first_s < before.last_s - OVERLAP_S and log.shown != before.shown:
            found.append(Beside(log, before, None))
        last[log.clock.kind] = max(before, log, key=lambda log: log.last_s)
    return found


def _by_clock(robots: Sequence[LogCard], sources: Mapping[str, Source | None]) -> list[list[LogCard]]:
    """Return the logs of each clock: those of one section or format that are not decades apart."""
    found: list[list[LogCard]] = []
    for kind in dict.fromkeys(of_one_kind(log, sources) for log in robots):
        mine = sorted((log for log in robots if of_one_kind(log, sources) == kind), key=lambda log: log.first_s)
        far = [number for number, pair in enumerate(pairwise(mine), 1) if pair[1].first_s - pair[0].last_s > DECADE_S]
        found += [mine[begin:end] for begin, end in pairwise([0, *far, len(mine)])]
    return found


def _common(log: LogCard, robot: LogCard, cause: Cause) -> float:
    return overlap((log.first_s - cause.late_s, log.last_s - cause.late_s), (robot.first_s, robot.last_s))
