"""The numbers of the answer as tiles, at most three for each kind of work: today, asked for or found, the best."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from cyclekit.report.verdict import against_today, of_sequence
from cyclekit.text.numbers import count, fixed, interval, percent, percent_interval

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.report.texts import ReportTexts
    from cyclekit.report.verdict import TaktVerdict


class Tile(NamedTuple):
    """One number.

    Attributes:
        what: What takes this time.
        number: Mean cycle time, without its unit.
        interval: Interval of the mean; empty where it is not known.
        change: Difference from today, or what today's number rests on.
        share: Share of the cycles within the takt; empty without a takt.
    """

    what: str
    number: str
    interval: str
    change: str
    share: str


class TileRow(NamedTuple):
    """The tiles of one kind of work, named if there are several."""

    work: str
    tiles: tuple[Tile, ...]


def tile_rows(texts: ReportTexts, verdicts: Sequence[TaktVerdict]) -> list[TileRow]:
    """Return one row of tiles for each kind of work."""
    rows = [TileRow(str(each.work) if len(verdicts) > 1 else "", _tiles(texts, each)) for each in verdicts]
    return [row for row in rows if row.tiles]


def _tiles(texts: ReportTexts, found: TaktVerdict) -> tuple[Tile, ...]:
    """Return today, the sequence asked for, and the best of the order found and the changes."""
    today, best = found.today, found.best
    tiles = []
    if today is not None:
        rests = texts("tiles.estimated")
        if today.executions:
            rests = texts("tiles.executions", executions=count(today.executions))
        if today.executions == 1:
            rests = texts("tiles.one_execution")
        if found.apart:
            key = "tiles.at_pace" if found.apart == "at_pace" else "tiles.rolled"
            rests += texts(key, logged=fixed(today.as_logged_s, found.decimals))
        if today.others:
            rests += texts("tiles.others", others=count(today.others))
        around = _interval(texts, found, today.low_s, today.high_s) if today.executions != 1 or found.apart else ""
        what = texts("tiles.today") if today.sequence is None else today.sequence
        tiles.append(Tile(what, fixed(today.mean_s, found.decimals), around, rests, _share(texts, today.within)))
    order = found.order
    saves = order is not None and order.saves_s[1] > 0 and found.expected_s is not None
    asked = found.asked or (None if order else best)
    if saves and found.change is not None and today is not None:
        asked = None  # its number stands in the chart and the table; a search was asked for, too
    if asked is not None and (today is None or today.sequence != asked.name):
        change = of_sequence(texts, found, asked).removeprefix(", ")
        share = _share(texts, found.share_within(asked))
        around = _interval(texts, found, asked.expected_low_s, asked.expected_high_s)
        tiles.append(Tile(asked.name, fixed(asked.expected_s, found.decimals), around, change, share))
    if saves and order is not None and found.expected_s is not None:
        of = found.best or order
        bounds = of.expected_low_s, of.expected_high_s
        tiles.append(_tile(texts, found, texts("tiles.order"), found.expected_s, bounds, found.within))
    if found.change is not None:
        what = texts("tiles.change", label=found.change.label, name=found.change.sequence)
        bounds = found.change.low_s, found.change.high_s
        tiles.append(_tile(texts, found, what, found.change.expected_s, bounds, found.change.within))
    return tuple(tiles)


def _tile(
    texts: ReportTexts,
    found: TaktVerdict,
    what: str,
    mean_s: float,
    bounds_s: tuple[float, float],
    within: tuple[float, float, float] | None,
) -> Tile:
    change, around = against_today(texts, found, mean_s).removeprefix(", "), _interval(texts, found, *bounds_s)
    return Tile(what, fixed(mean_s, found.decimals), around, change, _share(texts, within))


def _interval(texts: ReportTexts, found: TaktVerdict, low_s: float, high_s: float) -> str:
    known = math.isfinite(low_s) and math.isfinite(high_s)
    return texts("tiles.interval", interval=interval(low_s, high_s, found.decimals)) if known else ""


def _share(texts: ReportTexts, within: tuple[float, float, float] | None) -> str:
    if within is None:
        return ""
    share, low, high = within
    return texts("tiles.within", share=percent(share), interval=percent_interval(low, high))
