"""Selection of each topic's time stamps, and their conversion to one clock.

Every message has a receive time of the recorder; most also have a header time. If the header uses the recorder's clock,
it is the better time, because it is the time of the measurement. A header of another clock (a camera that counts from
its start, a second computer) must not be mixed with it. Such a clock is ahead of the receive times, further behind them
than transport takes, or drifts. The topic is then mapped to the recorder's clock by the line below its delays. If all
topics in use share one other clock, the log keeps that clock, and both stamps are stored.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from cyclekit.adapter.clock_line import MAX_DRIFT, least_delays
from cyclekit.errors import ConfigError
from cyclekit.text.numbers import fixed, signed
from cyclekit_adapters.rosbag.envelope import PARTS, Array, ClockLine, line_under, middle

How = Literal["header", "receive", "own-clock"]
HOWS: tuple[How, ...] = ("header", "receive", "own-clock")

EPOCH_S = 1e8
"""Minimum time since 1970, s (1973). A smaller time counts from another start, as a recorder's does in a simulation."""
AHEAD_S = 0.02
"""Minimum lead of stamps over receive times, s, that indicates another clock; simulated time goes in larger steps."""
BEHIND_S = 0.5
"""Minimum delay, s, of all messages that indicates another clock."""
SLOW_S = 0.2
"""Minimum delay, s, of all messages that is reported."""
BACK_S = 1.0
"""Maximum backward step of a header clock, s; beyond it the clock is not used."""
DRIFT_S = 0.01
"""Maximum drift against the recorder's clock over the recording, s, that is ignored."""
STEP_S = 0.25
"""Minimum step, s, of a clock set during recording; a smaller one is taken for delays."""
BACKLOG = 0.05
"""Maximum growth of delays, s/s, that a recorder can cause by falling behind; beyond it the header clock is slow."""
NO_LINE = "header and recorder's clock drift apart faster than clocks do, and no line fits them"
AGREE_S = 0.1
"""Maximum difference, s, at which the clocks of topics count as one."""
_MIN_S, _MIN_MESSAGES = 20.0, 100  # a rate from fewer is noise
_PARTS = 16


@dataclass(frozen=True)
class StampSource:
    """Times of a topic or of a transform link: receive times and header stamps (NaN: none), shape (N,), s."""

    receive_s: Array
    stamp_s: Array


@dataclass(frozen=True)
class Chosen:
    """The time used for a source, and why.

    Attributes:
        line: Conversion from the header's clock to the recorder's, if they differ.
        least_s: Minimum time between stamp and receipt, s; None without stamps.
    """

    how: How
    why: str
    line: ClockLine | None = None
    least_s: float | None = None

    def times(self, source: StampSource) -> Array:
        """Return the times of a source in the log's clock, shape (N,), s."""
        if self.how == "receive":
            return source.receive_s
        return source.stamp_s if self.line is None else self.line.of(source.stamp_s)

    def fact(self) -> str:
        """Return a description of the choice."""
        if self.line is None:
            delay = f", received at least {fixed(self.least_s, 3)} s later" if self.least_s is not None else ""
            return f"{'header stamp' if self.how == 'header' else 'receive time'} ({self.why}{delay})"
        line = self.line
        return (
            f"lower-envelope: header stamp * {fixed(line.rate, 9)} {signed(line.offset_s, 4)} s, "
            f"typically {fixed(line.delay_s, 4)} s above it, {line.steps} messages ({self.why})"
        )


@dataclass
class BagTimes:
    """Clock of a log.

    Attributes:
        chosen: Chosen time, by name of the source.
        own: The log keeps the clock of its headers, which is not the recorder's.
        warnings: What the user must know about it, one sentence each.
    """

    chosen: dict[str, Chosen] = field(default_factory=dict)
    own: bool = False
    warnings: list[str] = field(default_factory=list)


def choose_times(sources: Mapping[str, StampSource], asked: Mapping[str, How]) -> BagTimes:
    """Choose the time to use for every source.

    Args:
        sources: Times by name; none is empty.
        asked: Choices given in the cell file.
    """
    times = BagTimes({name: _choice(source, asked.get(name)) for name, source in sources.items()})
    fitted = {name: chosen.line for name, chosen in times.chosen.items() if chosen.line is not None}
    if fitted and len(fitted) == len(times.chosen) and _one_clock(sources, fitted):
        times.own = True
        kept = {name: Chosen("header", "one clock for all topics in use") for name in sources}
        times.warnings.append(_other_clock(sources, fitted))
        times.chosen = kept
        return times
    for name, chosen in times.chosen.items():
        if chosen.line is not None:
            times.warnings.append(f"{name} is stamped by another clock ({chosen.why}): {_put(chosen.line)}")
        elif chosen.how == "header" and chosen.least_s is not None and chosen.least_s > SLOW_S:
            times.warnings.append(
                f"{name} is received at least {fixed(chosen.least_s, 2)} s after its stamps, which are used: a slow "
                "tracker, or another clock (then set time in [sources.map])"
            )
        elif chosen.how == "receive" and chosen.least_s is not None:
            times.warnings.append(f"{name}: {chosen.why}; the receive times are used instead")
    return times


def _choice(source: StampSource, asked: How | None) -> Chosen:
    stamped = np.isfinite(source.stamp_s)
    if not stamped.all():
        without = np.count_nonzero(~stamped)
        return Chosen("receive", "no header time" + (f" on {without} messages" if stamped.any() else ""))
    delay = source.receive_s - source.stamp_s
    least = float(delay.min())
    ahead_s = AHEAD_S if float(source.receive_s.min()) > EPOCH_S else BEHIND_S
    if asked == "receive":
        return Chosen("receive", "as the cell file says")
    if asked == "header":
        return Chosen("header", "as the cell file says", least_s=least)
    if (np.diff(source.stamp_s) < -BACK_S).any():
        return Chosen("receive", "the header times jump back", least_s=least)
    line = line_under(source.stamp_s, source.receive_s, drifts=_long_enough(source))
    if asked == "own-clock":
        if not line.fits:
            raise ConfigError(f"time: {NO_LINE}", cure="Give header or receive in place of own-clock.")
        return Chosen("own-clock", "as the cell file says", line, least)
    if unsteady := _unsteady(source, delay):
        return Chosen("receive", unsteady, least_s=least)
    if not line.fits and not -ahead_s <= least <= BEHIND_S:
        return Chosen("receive", NO_LINE, least_s=least)
    if least < -ahead_s:
        return Chosen("own-clock", f"{fixed(-least, 3)} s ahead of the receive times", line, least)
    if least > BEHIND_S:
        return Chosen("own-clock", f"{fixed(least, 3)} s behind the receive times", line, least)
    if _drifts(source, delay, line):
        return Chosen("own-clock", f"it drifts by {signed((1 / line.rate - 1) * 1e6, 1)} ppm", line, least)
    return Chosen("header", "of the recorder's clock", least_s=least)


def _long_enough(source: StampSource) -> bool:
    """Return whether the recording is long enough to determine a clock rate."""
    return _span_s(source) >= _MIN_S and source.stamp_s.size >= _MIN_MESSAGES


def _span_s(source: StampSource) -> float:
    return float(source.receive_s.max() - source.receive_s.min())


def _floors(delay: Array) -> Array:
    """Return the minimum delay in each of up to 16 consecutive parts."""
    lowest = delay[least_delays(delay, PARTS)]
    return np.array([part.min() for part in np.array_split(lowest, min(_PARTS, lowest.size))])


def _unsteady(source: StampSource, delay: Array) -> str:
    """Return why no line fits the header clock (it was set, or runs at another speed); empty if a line may fit."""
    if not _long_enough(source):
        return ""
    floors = _floors(delay)
    steps = np.abs(np.diff(floors))
    jump = int(steps.argmax())
    moved = float(floors[-1] - floors[0])
    inside = 0 < jump < steps.size - 1  # in the first or last part, growing delays look the same
    if inside and abs(moved) > STEP_S and steps[jump] > 0.6 * steps.sum():
        return f"the header clock was set by about {signed(-moved, 2)} s while recording"
    speed = moved / (_span_s(source) * (1.0 - 1.0 / floors.size))
    if speed < -2 * MAX_DRIFT or speed > BACKLOG:
        return f"the header clock runs at {fixed(1 - speed, 3)} times the speed of the recorder's"
    return ""


def _drifts(source: StampSource, delay: Array, line: ClockLine) -> bool:
    """Return whether header and receive times drift apart steadily, at a rate plausible for clocks."""
    if not _long_enough(source) or not line.drifts:
        return False
    moved = abs(line.rate - 1.0) * _span_s(source)
    above = _floors(delay - (line.rate - 1.0) * (source.stamp_s - source.stamp_s[0]))
    return moved > max(DRIFT_S, 4.0 * middle(above - above.min()))


def _one_clock(sources: Mapping[str, StampSource], lines: Mapping[str, ClockLine]) -> bool:
    """Return whether the header clocks of all sources are one: their lines agree over the time of all messages."""
    ends = [float(end) for name in lines for end in (sources[name].stamp_s.min(), sources[name].stamp_s.max())]
    at = np.array([[line.of(np.array([end]))[0] for end in ends] for line in lines.values()])
    return bool(float(np.ptp(at, axis=0).max()) < AGREE_S)


def _other_clock(sources: Mapping[str, StampSource], lines: Mapping[str, ClockLine]) -> str:
    name, line = max(lines.items(), key=lambda item: sources[item[0]].stamp_s.size)
    return (
        f"the header stamps come from another clock than the recorder's ({_off(line, sources[name])}); "
        f"they are used, and both stamps are kept{_speed(line)}"
    )


def _off(line: ClockLine, source: StampSource) -> str:
    first = float(source.stamp_s.min())
    return f"{signed(float(line.of(np.array([first]))[0]) - first, 3)} s, {signed((line.rate - 1) * 1e6, 1)} ppm"


def _put(line: ClockLine) -> str:
    return (
        f"mapped to the recorder's by the line below its delays (rate {fixed(line.rate, 6)}, typically "
        f"{fixed(line.delay_s * 1e3, 1)} ms above it); the smallest delay is unknown and remains{_speed(line)}"
    )


def _speed(line: ClockLine) -> str:
    """Return a remark on a clock rate that no real clock has; else empty."""
    if line.drifts:
        return ""
    return (
        f"; it runs at {fixed(1.0 / line.rate, 4)} times the recorder's speed, which no real clock does: if its time "
        "is simulated, durations are simulated ones"
    )


def simulated(source_s: Array, clock_receive_s: Array, clock_s: Array) -> Array:
    """Return receive times in simulated time, interpolated from `/clock`; shape (N,), s.

    Args:
        source_s: Receive times, shape (N,), s.
        clock_receive_s: Receive times of `/clock`, shape (M,), M >= 1, s.
        clock_s: Values of `/clock`, shape (M,), s.
    """
    order: npt.NDArray[np.int64] = np.argsort(clock_receive_s, kind="stable")
    at, shown = clock_receive_s[order], clock_s[order]
    inside: Array = np.interp(source_s, at, shown)
    inside += np.minimum(source_s - at[0], 0.0) + np.maximum(source_s - at[-1], 0.0)
    return inside
