"""Floor plans: the robot's speed by operator position, and where the operator was and time was lost."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.report.figures.figure import Chart, Figure
from cyclekit.report.light import resting
from cyclekit.report.pictures import Picture
from cyclekit.text.numbers import fixed, whole_percent

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclekit.report.inputs import PageInputs


def _zones(page: PageInputs) -> Iterator[Chart]:
    texts, plan = page.texts, page.plan
    if plan is None or not len(plan.zones):
        return
    from cyclekit.report import maps

    labels = maps.floor_labels(texts) | {"speed": texts("why.zone_speed")}
    x, y, slowest = plan.zones[int(plan.zones[:, 2].argmin())].tolist()
    alt = texts("why.zone_picture", x=fixed(x, 1), y=fixed(y, 1), speed=whole_percent(slowest))
    picture = Picture("zones", alt, lambda width_in: maps.zone_map(width_in, plan, labels))
    caption = texts("why.zone_model" if plan.zones_of_model else "why.zone_log")
    if plan.shapes:
        caption += " " + texts("why.zone_rule")
    caption = f"{resting(texts, page.basis)} {caption}".lstrip()
    yield Chart(picture, caption, title=texts("why.zone_title"), half=True)


ZONES = Figure("zones", "why", _zones)


def _lost_time(page: PageInputs) -> Iterator[Chart]:
    texts, plan = page.texts, page.plan
    if plan is None:
        return
    from cyclekit.report import maps

    labels, alt = maps.floor_labels(texts), texts("why.map_picture_none")
    caption, title = texts("why.map_caption_seen"), texts("why.map_title_seen")
    if len(plan.lost):
        labels = labels | {"speed": texts("why.map_speed")}
        caption, title = texts("why.map_caption"), texts("why.map_title")
        x, y = plan.lost[int(plan.lost[:, 2].argmax()), :2].tolist()
        alt = texts("why.map_picture", x=fixed(x, 1), y=fixed(y, 1))
    picture = Picture("floor", alt, lambda width_in: maps.lost_map(width_in, plan, labels))
    caption = f"{resting(texts, page.basis)} {caption}".lstrip()
    yield Chart(picture, caption, title=title, half=True)


LOST_TIME = Figure("lost_time", "why", _lost_time)
