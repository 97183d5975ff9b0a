"""Makes labels for places: one for `left_1` to `left_5`, instead of five that overlap.

Places share a label if their names differ only in a final number and they are close together.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.config import Furniture

CLOSE_M = 0.6
"""Maximum distance between neighbours that share a label, m."""

_NUMBERED = re.compile(r"^(?P<stem>.*?)[ _-]?(?P<number>\d+)$")


@dataclass(frozen=True)
class PlaceLabel:
    """A text, its position, and its places, the middle one first, m, base frame."""

    text: str
    xyz_m: tuple[float, float, float]
    places_m: tuple[tuple[float, float, float], ...] = ()


class ShownPlace(Protocol):
    """Interface of a place."""

    @property
    def shown(self) -> str:
        """Displayed name."""

    @property
    def xyz_m(self) -> tuple[float, float, float]:
        """Centre, m, base frame."""


@dataclass(frozen=True)
class CellOnFloor:
    """Contents of a cell: places of robot and operator, and boxes of the cell file; by name, base frame."""

    places: Mapping[str, ShownPlace] = field(default_factory=dict)
    human_places: Mapping[str, ShownPlace] = field(default_factory=dict)
    furniture: Mapping[str, Furniture] = field(default_factory=dict)


def place_labels(places: Mapping[str, ShownPlace]) -> list[PlaceLabel]:
    """Return the labels of places; numbered places close together share one."""
    families: dict[str, list[ShownPlace]] = {}
    for place in places.values():
        found = _NUMBERED.match(place.shown)
        families.setdefault(f"{found['stem']}#" if found else place.shown, []).append(place)
    return [label for family in families.values() for label in _labels(family)]


def _labels(family: list[ShownPlace]) -> list[PlaceLabel]:
    family = sorted(family, key=lambda place: (len(place.shown), place.shown))
    points = np.array([place.xyz_m for place in family])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if len(family) < 2 or steps.max() > CLOSE_M:
        return [PlaceLabel(place.shown, place.xyz_m, (place.xyz_m,)) for place in family]
    x_m, y_m, z_m = points.mean(axis=0).tolist()
    far = np.linalg.norm(points - points.mean(axis=0), axis=1)
    places_m = tuple(family[number].xyz_m for number in np.argsort(far, kind="stable").tolist())
    last = _NUMBERED.match(family[-1].shown)
    return [PlaceLabel(f"{family[0].shown} … {last['number'] if last else ''}", (x_m, y_m, z_m), places_m)]
