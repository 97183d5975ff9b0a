"""The cells: places, stations, safety function, and the behaviour of robot and operator.

All coordinates are in the robot base frame, m; the robot is on a pedestal, the floor is at z = -0.8 and a walking
person's pelvis at z = 0.2. Geometry and dwell times are ours, tuned so that cycle time and loss are plausible; levels
and thresholds of the first two cells are those of the paper (arXiv 2512.17579).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from cyclekit_sim.fields import Field, rule_of
from cyclekit_sim.motion import Place
from cyclekit_sim.rules import Points
from cyclekit_sim.safety import DistanceStaircase, FloorZone, FloorZones, SafetyFunction, SlowestOf

LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
PELVIS_Z_M = 0.2
FLOOR_Z_M = -0.75
GOAL_SD_M, MIDDLE_SD_M = 0.05, 0.25


@dataclass(frozen=True)
class Station:
    """A place where the operator works: position, minimum and maximum dwell."""

    xyz_m: Place
    dwell_s: tuple[float, float]
    radius_m: float = 0.25


@dataclass(frozen=True)
class Habit:
    """What one person usually does: he begins away or at a far station, comes near, and stays there more and more.

    Attributes:
        begins_away: Share of his executions that begin without him; he comes within `away_s`.
        far, near: Stations, by name; the first two stays are at far ones.
        near_share: Share of the later stays that are at near ones.
        leaves: Share of the later stays after which he goes away for a while.
        away_s, stay_s: Minimum and maximum absence and stay, s.
        sway_m: Standard deviation of his position at work, m, on each axis of the floor.
    """

    begins_away: float
    far: tuple[str, ...]
    near: tuple[str, ...]
    near_share: float
    leaves: float
    away_s: tuple[float, float]
    stay_s: tuple[float, float]
    sway_m: float


@dataclass(frozen=True)
class Scene:
    """One cell.

    Attributes:
        name: Its name on the command line.
        places: Robot places by name, including `home` and `conveyor`.
        stations: Operator places by name.
        furniture: Tables and belts by name, for display only: centre of the top and size of each.
        safety: The safety function, which is not in the logs.
        picks: Conveyor-to-slot placements per execution.
        repeats_slots: True: each placement draws any slot; False: the slots are a permutation.
        pick_s, place_s: Process times of the gripper.
        wait_s: Mean wait for a box at the conveyor; 0: boxes are always there.
        walk_m_s: Minimum and maximum walking speed.
        operator: "deliver": boxes from `inbound` to each outbound station once, then rest. "roam": from station to
            station without end. "visit": away for a while, in by `door` to one to three stations, and out again,
            without end and independent of the robot. "habits": one of the people in `habits`, who begins anew with
            each execution and goes on without end.
        away_s: Minimum and mean absence of an operator who visits.
        passing: Share of visits in which a person only walks by, in at `door` and out at `exit`.
        fields: Fields, for logs with signals of people; they then define the safety function.
        plc: A PLC's event log holds the signals; otherwise the robot's digital inputs do.
        tracked: A tracker logs the operator; otherwise the signals do.
        latency_s, ramp_down_per_s, ramp_up_per_s: Response of the safety function, unless set in the options.
        continuous: One recording without pauses; the operator continues from execution to execution.
    """

    name: str
    places: Mapping[str, Place]
    stations: Mapping[str, Station]
    furniture: Mapping[str, tuple[Place, Place]]
    safety: SafetyFunction
    picks: int
    pick_s: float
    place_s: float
    walk_m_s: tuple[float, float]
    operator: str
    habits: tuple[Habit, ...] = ()
    repeats_slots: bool = False
    wait_s: float = 0.0
    continuous: bool = False
    away_s: tuple[float, float] = (0.0, 0.0)
    passing: float = 0.0
    fields: tuple[Field, ...] = ()
    plc: bool = False
    tracked: bool = True
    latency_s: float = 0.0
    ramp_down_per_s: float | None = None
    ramp_up_per_s: float | None = None

    @property
    def slots(self) -> tuple[str, ...]:
        """Places where the robot puts boxes."""
        return tuple(name for name in self.places if name not in ("home", "conveyor"))


_LEFT: Points = ((-1.0, 0.05), (1.0, 0.05), (1.0, 1.0), (-1.0, 1.0))
_RIGHT: Points = ((-1.0, -1.0), (1.0, -1.0), (1.0, -0.05), (-1.0, -0.05))
_BELT: Points = ((-1.0, -1.0), (1.0, -1.0), (1.0, -0.2), (-1.0, -0.2))
_BOXES: Points = ((-1.0, 0.1), (1.0, 0.1), (1.0, 1.0), (-1.0, 1.0))


def _thing(x: float, y: float, top_z: float, length: float, width: float) -> tuple[Place, Place]:
    """Return a table or belt on the floor: centre of its top, and its size."""
    return (x, y, top_z), (length, width, round(top_z - FLOOR_Z_M, 3))


def _station(x: float, y: float, dwell_s: tuple[float, float]) -> Station:
    return Station((x, y, PELVIS_Z_M), dwell_s)


def _two_tables() -> dict[str, tuple[Place, Place]]:
    tables = {side: _thing(0.0, y, -0.05, 0.9, 0.35) for side, y in (("left_table", 0.65), ("right_table", -0.65))}
    return {"belt": _thing(0.95, 0.0, 0.05, 0.9, 0.3), **tables}


def _slots(xs: tuple[float, ...], y: float) -> dict[str, Place]:
    """Return home, the conveyor, and slots at these x on a table on either side."""
    places: dict[str, Place] = {"home": (0.40, 0.0, 0.40), "conveyor": (0.60, 0.0, 0.10)}
    for number, x in enumerate(xs, start=1):
        places |= {f"left_{number}": (x, y, 0.0), f"right_{number}": (x, -y, 0.0)}
    return places


def _box_picking() -> Scene:
    stations = {"inbound": _station(3.1, 0.0, (2.0, 3.0)), "rest": _station(3.6, 1.8, (1.0, 1.0))}
    for number, x in enumerate((-0.20, 0.25, 0.70), start=1):
        stations[f"out_left_{number}"] = _station(x, 1.50, (3.0, 5.0))
        stations[f"out_right_{number}"] = _station(x, -1.50, (3.0, 5.0))
    return Scene(
        name="box-picking",
        places=dict(sorted(_slots((-0.32, -0.16, 0.0, 0.16, 0.32), 0.62).items())),
        stations=stations,
        furniture=_two_tables(),
        safety=DistanceStaircase(LEVELS, (1.2, 1.5, 1.9, 2.4)),
        fields=_three_fields(),
        picks=10,
        pick_s=0.6,
        place_s=0.5,
        walk_m_s=(1.0, 1.2),
        operator="deliver",
    )


def _pick_and_package() -> Scene:
    places: dict[str, Place] = {
        "home": (0.40, 0.0, 0.40),
        "conveyor": (0.45, -0.40, 0.10),
        "box_1": (0.60, 0.20, 0.0),
        "box_2": (0.42, 0.40, 0.0),
        "box_3": (0.18, 0.56, 0.0),
        "box_4": (-0.08, 0.60, 0.0),
    }
    stations = {
        "inspect": _station(1.35, -0.75, (4.0, 9.0)),
        "pack": _station(0.70, 1.05, (5.0, 11.0)),
        "refill": _station(2.30, 1.30, (6.0, 14.0)),
    }
    return Scene(
        name="pick-and-package",
        places=places,
        stations=stations,
        furniture={
            "belt": _thing(0.75, -0.40, 0.05, 0.8, 0.3),
            "packing_table": _thing(0.30, 0.55, -0.05, 1.0, 0.35),
        },
        safety=DistanceStaircase(LEVELS, (0.6, 0.8, 1.2, 1.6)),
        fields=(
            Field("warning", 4, (-0.5, 1.9), (-1.5, 1.6), 0.5),
            Field("protective_belt", 5, (0.9, 1.8), (-1.2, -0.3), 0.0, _BELT, occupied=0),
            Field("protective_pack", 8, (0.1, 1.3), (0.6, 1.5), 0.25, _BOXES, occupied=0),
        ),
        picks=12,
        repeats_slots=True,
        pick_s=0.6,
        place_s=0.5,
        wait_s=0.6,
        walk_m_s=(0.9, 1.1),
        operator="roam",
        continuous=True,
    )


def _laser_zones() -> Scene:
    stations = {
        "inbound": _station(3.3, 0.0, (2.0, 3.5)),
        "rest": _station(3.9, -1.5, (1.0, 1.0)),
        "shelf": _station(2.0, -1.9, (3.0, 6.0)),
        "pallet_left": _station(0.4, 2.0, (2.0, 5.0)),
        "pallet_right": _station(0.9, -1.35, (2.0, 5.0)),
        "refill": _station(-0.3, 1.25, (1.5, 3.0)),
    }
    zones = (
        FloorZone("presence", (-1.6, 2.6), (-2.4, 2.4), 2),
        FloorZone("warning", (-1.2, 1.7), (-1.9, 1.7), 1),
        FloorZone("protective", (-0.9, 1.1), (-1.1, 1.4), 0),
    )
    return Scene(
        name="laser-zones",
        places=_slots((-0.20, 0.05, 0.30), 0.62),
        stations=stations,
        furniture=_two_tables(),
        safety=FloorZones((0.0, 0.5, 0.75, 1.0), zones),
        picks=6,
        pick_s=0.6,
        place_s=0.5,
        walk_m_s=(1.0, 1.2),
        operator="deliver",
    )


def _scanner_visits() -> Scene:
    stations = {
        "door": _station(3.4, 1.6, (0.5, 1.0)),
        "shelf": _station(2.2, -1.7, (3.0, 8.0)),
        "bench": _station(0.5, 1.55, (4.0, 9.0)),
        "rework": _station(0.3, -1.45, (3.0, 7.0)),
        "panel": _station(1.75, 0.35, (2.0, 5.0)),
    }
    levels = (0.0, 0.3, 0.6, 1.0)
    scanner = FloorZones(levels, (FloorZone("scanner", (0.9, 2.3), (-0.6, 1.1), 1),))
    return Scene(
        name="scanner-visits",
        places=_slots((-0.20, 0.05, 0.30), 0.60),
        stations=stations,
        furniture=_two_tables(),
        safety=SlowestOf(levels, (DistanceStaircase(levels, (0.8, 1.2, 1.7)), scanner)),
        picks=6,
        pick_s=0.9,
        place_s=0.7,
        walk_m_s=(0.9, 1.2),
        operator="visit",
        away_s=(3.0, 10.0),
    )


def _bench_crew() -> Scene:
    """Return a scene with four people of different habits, each recorded again and again, and no log of buttons."""
    stations = {
        "door": _station(3.4, 1.6, (0.2, 0.6)),
        "stock": _station(3.2, -1.6, (4.0, 9.0)),
        "desk": _station(2.7, 1.9, (4.0, 9.0)),
        "rack": _station(-1.6, 2.2, (4.0, 9.0)),
        "bench": _station(0.5, 1.35, (4.0, 9.0)),
        "rework": _station(0.3, -1.35, (4.0, 9.0)),
        "panel": _station(1.55, 0.35, (4.0, 9.0)),
    }
    levels = (0.0, 0.3, 0.6, 1.0)
    return replace(
        _scanner_visits(),
        name="bench-crew",
        places=_slots((-0.32, -0.16, 0.0, 0.16, 0.32), 0.60),
        picks=10,
        stations=stations,
        safety=DistanceStaircase(levels, (0.8, 1.2, 1.7)),
        operator="habits",
        habits=(
            Habit(0.8, ("stock", "desk"), ("bench",), 0.7, 0.10, (3.0, 12.0), (4.0, 10.0), 0.04),
            Habit(0.1, ("desk", "rack"), ("panel", "bench"), 0.5, 0.05, (5.0, 20.0), (3.0, 7.0), 0.07),
            Habit(0.3, ("stock", "rack"), ("rework",), 0.5, 0.15, (4.0, 15.0), (6.0, 15.0), 0.05),
            Habit(0.2, ("desk", "stock", "rack"), ("panel", "rework"), 0.4, 0.10, (5.0, 15.0), (2.0, 6.0), 0.09),
        ),
    )


def _three_fields() -> tuple[Field, ...]:
    """Return fields of a scanner for box-picking: a warning field, and a protective field on either side."""
    return (
        Field("warning", 4, (-1.3, 2.6), (-2.3, 2.3), 0.5),
        Field("protective_left", 5, (-0.8, 1.4), (1.0, 2.1), 0.0, _LEFT, occupied=0),
        Field("protective_right", 8, (-0.8, 1.4), (-2.1, -1.0), 0.0, _RIGHT, occupied=0),
    )


def _scanner_fields() -> Scene:
    """Return a scene with visits and passers-by; the protective field counts while the robot is at its left table."""
    stations = {
        "door": _station(3.4, 1.6, (0.2, 0.6)),
        "exit": _station(3.3, -1.9, (0.2, 0.6)),
        "feeder": _station(0.7, 1.35, (3.0, 6.0)),
        "shelf": _station(1.9, -0.9, (3.0, 8.0)),
        "panel": _station(2.1, 0.6, (2.0, 5.0)),
    }
    fields = (
        Field("warning", 4, (-1.2, 2.5), (-1.5, 2.0), 0.5),
        Field("protective", 5, (-0.8, 1.3), (0.9, 1.8), 0.0, _LEFT, occupied=0),
    )
    base = _scanner_visits()
    return replace(
        base,
        name="scanner-fields",
        stations=stations,
        safety=rule_of(fields),
        away_s=(4.0, 12.0),
        passing=0.35,
        fields=fields,
        tracked=False,
        latency_s=0.12,
        ramp_down_per_s=2.0,
        ramp_up_per_s=1.0,
    )


def _light_curtain() -> Scene:
    """Return a scene with a light curtain at each table and a mat in front, logged by a PLC, without passers-by."""
    stations = {
        "door": _station(3.4, 1.6, (0.2, 0.6)),
        "left": _station(0.1, 1.15, (2.0, 5.0)),
        "right": _station(0.1, -1.15, (2.0, 5.0)),
        "front": _station(1.7, 0.0, (3.0, 7.0)),
    }
    fields = (
        Field("mat_front", 4, (1.3, 2.1), (-0.7, 0.7), 0.4),
        Field("curtain_left", 5, (-0.7, 0.9), (0.8, 1.4), 0.0, _LEFT, occupied=0),
        Field("curtain_right", 8, (-0.7, 0.9), (-1.4, -0.8), 0.0, _RIGHT, occupied=0),
    )
    base = _scanner_visits()
    return replace(
        base,
        name="light-curtain",
        stations=stations,
        safety=rule_of(fields),
        away_s=(3.0, 9.0),
        fields=fields,
        plc=True,
        tracked=False,
        latency_s=0.06,
        ramp_down_per_s=4.0,
        ramp_up_per_s=0.8,
    )


def _guard_door() -> Scene:
    """Return a scene with a guard door: it stops the robot until its reset button is pressed."""
    fields = (
        Field("warning", 4, (-1.2, 2.5), (-1.5, 2.0), 0.5),
        Field("guard_door", 5, (-0.8, 1.3), (0.9, 1.8), 0.0, occupied=0, reset_bit=8),
    )
    return replace(_scanner_fields(), name="guard-door", safety=rule_of(fields), fields=fields)


TRACKED = (_box_picking(), _pick_and_package(), _laser_zones(), _scanner_visits())
BUILT_IN: dict[str, Scene] = {
    scene.name: scene for scene in (*TRACKED, _scanner_fields(), _light_curtain(), _guard_door(), _bench_crew())
}
SCENES: tuple[str, ...] = tuple(scene.name for scene in TRACKED)
"""Scenes with a tracker and a log of the operator's buttons."""
HABIT_SCENES: tuple[str, ...] = tuple(name for name, scene in BUILT_IN.items() if scene.habits)
"""Scenes with a tracker alone, where people have habits of their own."""
FIELD_SCENES: tuple[str, ...] = tuple(name for name, scene in BUILT_IN.items() if not scene.tracked)
"""Scenes without a tracker, where only signals show people."""
