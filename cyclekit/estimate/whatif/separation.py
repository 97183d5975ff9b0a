"""Thresholds of a rule compared with the protective separation distance, which is computed from the user's numbers.

S_p = S_h + S_r + S_s + C + Z_d + Z_r (ISO 10218-2:2025, before ISO/TS 15066; approach speed and C: ISO 13855:2024).
This is no safety validation: it compares numbers, without knowledge of the risk assessment or the system.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclekit.errors import ConfigError
from cyclekit.learning.rules.samples.distances import TO_BASE
from cyclekit.text.numbers import compact, fixed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards.rule import LimitCard, RuleCard

APPROACH_M_S = 1.6
"""Speed of a walking person, ISO 13855:2024."""
NO_VALIDATION = "No safety validation: S_p is computed from the numbers given, thresholds were read from logs."
_MOST = {"m": 10.0, "s": 10.0, "m/s": 20.0}


@dataclass(frozen=True)
class Separation:
    """Numbers from which S_p is computed.

    Attributes:
        reaction_time_s: T_r, from the person's position to the start of braking, including sensor and controller.
        stopping_time_s: T_s of the robot; one for all speeds, or one for each threshold, the slowest speed first.
        stopping_distance_m: S_s, in the same form as the stopping time.
        robot_speed_m_s: Maximum speed of the robot towards the person at 100 %.
        intrusion_m: C, distance that a part of the body can reach before it is detected.
        operator_uncertainty_m: Z_d, uncertainty of the person's position.
        robot_uncertainty_m: Z_r, uncertainty of the robot's position.
        approach_speed_m_s: K, v_h: approach speed of the person.
    """

    reaction_time_s: float
    stopping_time_s: tuple[float, ...]
    stopping_distance_m: tuple[float, ...]
    robot_speed_m_s: float
    intrusion_m: float
    operator_uncertainty_m: float
    robot_uncertainty_m: float
    approach_speed_m_s: float = APPROACH_M_S

    def __post_init__(self) -> None:
        """Refuse numbers that are no length, time or speed in these units.

        Raises:
            ConfigError: A number is negative, not finite, or so large that it must be in another unit.
        """
        for name, value in vars(self).items():
            unit = "m/s" if name.endswith("_m_s") else name.rpartition("_")[2]
            values = value if isinstance(value, tuple) else (value,)
            if not values:
                raise ConfigError(f"{name}: no number", cure="Give one, or one for each threshold.")
            for one in values:
                if not math.isfinite(one) or not 0 <= one <= _MOST[unit] or (unit == "m/s" and one == 0):
                    cure = f"Give it in {unit}: more than 0" if unit == "m/s" else f"Give it in {unit}: 0 or more"
                    raise ConfigError(f"{name} {compact(one, 6)}", cure=f"{cure}, at most {compact(_MOST[unit], 6)}.")

    def distance_m(self, speed: float, number: int) -> float:
        """Return S_p, m, for a robot at share `speed` of its speed, with the stopping times of threshold `number`."""
        stopping = self.stopping_time_s, self.stopping_distance_m
        stopping_s, stopping_m = (each[min(number, len(each) - 1)] for each in stopping)
        person_m = self.approach_speed_m_s * (self.reaction_time_s + stopping_s)
        robot_m = speed * self.robot_speed_m_s * self.reaction_time_s + stopping_m
        return person_m + robot_m + self.intrusion_m + self.operator_uncertainty_m + self.robot_uncertainty_m


@dataclass(frozen=True)
class Margin:
    """One threshold compared with S_p.

    Attributes:
        level: Maximum speed nearer than the threshold.
        speed: Maximum speed just beyond the threshold, 0 to 1.
        distance: Distance that the threshold applies to.
        threshold_m: Distance at which the robot slows down.
        separation_m: S_p at that speed.
        margin_m: Threshold minus S_p; None if the distance is to the base, which does not include the robot's reach.
        costs_s_per_cm: Cost of one centimetre, mean of the sequences.
    """

    level: float
    speed: float
    distance: str
    threshold_m: float
    separation_m: float
    margin_m: float | None
    costs_s_per_cm: float


@dataclass(frozen=True)
class Margins:
    """All thresholds compared with S_p.

    Attributes:
        given: The numbers behind S_p.
        thresholds: The thresholds, the slowest level first.
        reaction_costs_s_per_10_ms: Cost of 10 ms of reaction time if every threshold follows S_p.
        notes: What is not compared.
        safety: Note that this is no validation.
    """

    given: Separation
    thresholds: tuple[Margin, ...]
    reaction_costs_s_per_10_ms: float
    notes: tuple[str, ...]
    safety: str = NO_VALIDATION


def margins_of(
    rule: RuleCard,
    given: Separation,
    costs_s_per_cm: Mapping[tuple[float | None, str], float],
    latency_s: float | None,
) -> Margins:
    """Compare every threshold of a rule with S_p at the speed that holds just beyond it.

    Args:
        rule: A rule with thresholds on distances.
        given: Numbers for S_p.
        costs_s_per_cm: Costs by level and distance.
        latency_s: Reaction time in the logs; None = unknown.
    """
    near, rows = _thresholds(rule), list[Margin]()
    for number, (limit, distance, metres) in enumerate(near):
        speed = _beyond(rule, limit, distance, metres)
        separation_m = given.distance_m(speed, number)
        margin_m = None if distance == TO_BASE else metres - separation_m
        costs_s = costs_s_per_cm[limit.scaling, distance]
        rows.append(Margin(limit.scaling, speed, distance, metres, separation_m, margin_m, costs_s))
    cm_per_10_ms = [given.approach_speed_m_s + row.speed * given.robot_speed_m_s for row in rows]
    follows = sum(row.costs_s_per_cm * cm for row, cm in zip(rows, cm_per_10_ms, strict=True))
    return Margins(given, tuple(rows), follows, tuple(_notes(rule, given, rows, latency_s)))


def refuse_other_thresholds(rule: RuleCard, given: Separation) -> None:
    """Refuse numbers that do not fit the rule.

    Raises:
        ConfigError: No threshold is on a distance, or the number of stopping times differs from that of thresholds.
    """
    count = len(_thresholds(rule))
    if not count:
        seen = f"the rule ({rule.family}) has no threshold on a distance to compare with S_p"
        raise ConfigError(seen, cure="Leave out the options of the separation distance.")
    for name in ("stopping_time_s", "stopping_distance_m"):
        if len(getattr(given, name)) not in (1, count):
            seen = f"{name}: {len(getattr(given, name))} numbers, {count} thresholds"
            raise ConfigError(seen, cure=f"Give one number, or {count}, that of the slowest speed first.")


def _thresholds(rule: RuleCard) -> list[tuple[LimitCard, str, float]]:
    return [(limit, one.distance, one.metres.value) for limit in rule.limits for one in limit.within.nearer]


def _beyond(rule: RuleCard, limit: LimitCard, distance: str, metres: float) -> float:
    """Return the speed that holds just beyond a threshold: that of the next larger one, else full speed."""
    farther = [
        other.scaling
        for other in rule.limits
        for one in other.within.nearer
        if other.scaling > limit.scaling and one.distance == distance and one.metres.value > metres
    ]
    return min(farther, default=rule.levels[-1])


def _notes(rule: RuleCard, given: Separation, rows: Sequence[Margin], latency_s: float | None) -> list[str]:
    told = ["thresholds are between logged points, TCP or link to tracked point; other parts of both may be nearer"]
    if any(limit.within.rectangles for limit in rule.limits):
        told.append("rectangles are not compared: their distance to the robot depends on where it is")
    if any(row.margin_m is None for row in rows):
        told.append("distances to the robot's base are not compared: they do not include the robot's reach")
    if latency_s is not None and latency_s > given.reaction_time_s + 0.02:
        told.append(
            f"the logs show a reaction time of {fixed(latency_s, 2)} s, the one given is "
            f"{compact(given.reaction_time_s, 6)} s"
        )
    if any(len(each) == 1 < len(rows) for each in (given.stopping_time_s, given.stopping_distance_m)):
        told.append(
            "one stopping time or distance is used for every speed; give one for each threshold if lower ones apply"
        )
    return told
