"""The kinds of rules, simplest first. A new kind is a module of this folder and a line here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit.learning.rules.families.distance import DISTANCE
from cyclekit.learning.rules.families.mixture import MIXTURE
from cyclekit.learning.rules.families.polygon import POLYGON
from cyclekit.learning.rules.families.presence import PRESENCE
from cyclekit.learning.rules.families.rectangle import RECTANGLE, TURNED
from cyclekit.learning.rules.families.robot import ROBOT
from cyclekit.learning.rules.families.signal import SIGNAL

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cyclekit.learning.rules.families.family import Family

FAMILIES: Mapping[str, Family] = {
    **PRESENCE,
    **SIGNAL,
    **DISTANCE,
    **RECTANGLE,
    **TURNED,
    **POLYGON,
    **ROBOT,
    **MIXTURE,
}
"""Kinds of rules by name, in order of preference."""

__all__ = ["FAMILIES"]
