"""Cells with waits of robot and operator: conditions of both, and their tasks in one execution.

In every execution each agent does three joint tasks and four separate ones, in any order; the k-th joint task of one
belongs to the k-th of the other, in a cell of several fixtures the k-th at each fixture. Geometry and times are ours,
tuned for cycles of 45 to 60 s. In one cell a second person, the helper, works too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from cyclekit_sim.motion import Place
from cyclekit_sim.safety import DistanceStaircase
from cyclekit_sim.scenes import LEVELS, PELVIS_Z_M, Scene, Station

Moment = Literal["arrives", "done", "leaves"]
OPERATOR_LAG_S, ROBOT_LAG_S = (0.3, 0.8), (0.1, 0.2)
INPUT = "digital-input "
LINGER_S = (0.1, 0.4)
"""Range of the time, s, from the end of an operator's work at a place to the first step away from it."""


@dataclass(frozen=True)
class Need:
    """Condition of a gate: for its k-th passage the (k - back)-th such event; none if that is negative.

    Attributes:
        agent: Agent of the event, which may be the waiting one; `helper` = the second person, `source` = the conveyor.
        place: Place of the event.
        moment: The agent arrives there, has done the work there, or leaves.
        back: See above. None: the place is in a zone for one at a time. An agent takes the zone when its gate before
            the place opens and gives it back when it leaves the place; who asks first goes first.
        lag_s: Range of the time from the event until the waiting agent continues, s.
    """

    agent: Literal["robot", "operator", "helper", "source"]
    place: str
    moment: Moment
    back: int | None
    lag_s: tuple[float, float]


@dataclass(frozen=True)
class Gate:
    """A point where an agent waits: before going to `place` (`approach`) or before its work there (`work`)."""

    agent: Literal["robot", "operator", "helper"]
    at: Literal["approach", "work"]
    place: str
    need: Need


@dataclass(frozen=True)
class Feed:
    """Supply of parts to a place of the robot.

    Attributes:
        place: Place of the parts.
        gap_s: Minimum and mean time between parts while there is room, s.
        buffer: Maximum number of waiting parts; when full, the next one arrives as soon as one is taken.
    """

    place: str
    gap_s: tuple[float, float]
    buffer: int


@dataclass(frozen=True)
class Coupled:
    """One cell of agents that wait.

    Attributes:
        scene: Places, stations, furniture and safety function.
        short_of: Place -> where the robot stops on its way to it.
        robot_s: Process times by robot place, s.
        robot_jobs, operator_jobs: Task -> places; joint tasks come first.
        gates: Wait conditions.
        signals: (agent, place, moment) -> name of the signal that shows it; of a zone, it is on while taken.
        feed: Supply of parts, if any.
        joint: Number of joint tasks of each agent; three are done, each any of these.
        helper_jobs: As `operator_jobs`, of a second person; none: there is none.
        repeats: Robot place -> probability that its process fails there: the robot backs off and does it again.
        products: Number of the robot's joint tasks, one per product, for one of the people.
        late_s: Robot place -> range of the delay before each process there, s: the camera looks for the part.
        jam: Probability that a process of the robot jams, and how long it then stands, s.
        tool: Place where the robot changes tools before every so many parts, counted over all executions; if any.
        keeps: Robot places where the gripper stays as it is.
    """

    scene: Scene
    short_of: Mapping[str, Place]
    robot_s: Mapping[str, float]
    robot_jobs: Mapping[str, tuple[str, ...]]
    operator_jobs: Mapping[str, tuple[str, ...]]
    gates: tuple[Gate, ...]
    signals: Mapping[tuple[str, str, Moment], str]
    feed: Feed | None = None
    joint: int = 1
    helper_jobs: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    repeats: Mapping[str, float] = field(default_factory=dict)
    products: int = 1
    late_s: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    jam: tuple[float, tuple[float, float]] = (0.0, (0.0, 0.0))
    tool: tuple[str, int] | None = None
    keeps: frozenset[str] = frozenset()

    @property
    def bits(self) -> dict[str, int]:
        """Bits of the signals that are digital inputs in the robot's log; the others are events."""
        names = [name.removeprefix(INPUT) for name in self.signals.values() if name.startswith(INPUT)]
        return {INPUT + number: int(number) for number in names}


REST, HELPER_REST = "rest", "gate"
JOINT_TIMES = 3
_RACKS: dict[str, Place] = {
    "tray": (0.30, -0.60, 0.05),
    "rack_1": (0.02, -0.62, 0.0),
    "rack_2": (-0.12, -0.60, 0.0),
    "rack_3": (0.05, -0.48, 0.0),
    "rack_4": (0.46, -0.45, 0.0),
}
_RACKS_S = {**dict.fromkeys(_RACKS, 0.5), "tray": 0.6}
_SORTING = {f"sort_{number}": ("tray", f"rack_{number}") for number in (1, 2, 3, 4)}
_OWN_STATIONS = {"shelf": (2.2, 0.1), "pack": (1.1, 1.55), "label": (1.6, -0.3), "scan": (2.25, 0.75)}
_OWN_S = {"shelf": (1.0, 2.0), "pack": (1.5, 2.5), "label": (1.2, 2.4), "scan": (0.8, 1.8)}


def _scene(
    name: str,
    places: Mapping[str, Place],
    stations: Mapping[str, tuple[tuple[float, float], tuple[float, float]]],
    thresholds_m: tuple[float, ...],
) -> Scene:
    own = {station: (xy, _OWN_S[station]) for station, xy in _OWN_STATIONS.items()}
    all_stations = {REST: ((2.4, 1.5), (0.2, 0.8)), **stations, **own}
    return Scene(
        name=name,
        places={"home": (0.40, 0.0, 0.40), **places, **_RACKS},
        stations={key: Station((*xy, PELVIS_Z_M), dwell_s) for key, (xy, dwell_s) in all_stations.items()},
        furniture={},
        safety=DistanceStaircase(LEVELS, thresholds_m),
        picks=0,
        pick_s=0.6,
        place_s=0.5,
        walk_m_s=(1.0, 1.2),
        operator="plan",
    )


def _shared_fixture() -> Coupled:
    places: dict[str, Place] = {"feeder": (0.60, -0.10, 0.10), "fixture": (0.55, 0.30, 0.10)}
    stations = {"bench": ((1.70, 1.05), (0.4, 0.9)), "fixture": ((1.15, 0.7), (4.5, 6.5))}
    brought = Need("robot", "fixture", "leaves", 0, OPERATOR_LAG_S)
    released = Need("operator", "fixture", "done", 1, ROBOT_LAG_S)
    return Coupled(
        scene=_scene("shared-fixture", places, stations, (0.45, 0.75, 1.1, 1.6)),
        short_of={"fixture": (0.50, 0.14, 0.25)},
        robot_s={**_RACKS_S, "feeder": 0.6, "fixture": 1.2},
        robot_jobs={"bring": ("feeder", "fixture"), **_SORTING},
        operator_jobs={"mount": ("bench", "fixture"), **{name: (name,) for name in _OWN_STATIONS}},
        gates=(Gate("operator", "approach", "fixture", brought), Gate("robot", "approach", "fixture", released)),
        signals={("operator", "fixture", "done"): "release"},
    )


_FIXTURES: dict[str, tuple[Place, Place, tuple[float, float]]] = {
    "fixture_1": ((0.60, 0.10, 0.10), (0.50, 0.02, 0.25), (1.15, 0.20)),
    "fixture_2": ((0.58, 0.28, 0.10), (0.48, 0.17, 0.25), (1.15, 0.75)),
    "fixture_3": ((0.45, 0.42, 0.10), (0.38, 0.30, 0.25), (0.75, 1.15)),
    "fixture_4": ((0.25, 0.52, 0.10), (0.20, 0.40, 0.25), (0.20, 1.25)),
}
"""Fixture -> the robot's place, where it stops short of it, and the operator's station."""


def _four_fixtures() -> Coupled:
    gates = []
    for name in _FIXTURES:
        brought = Need("robot", name, "leaves", 0, OPERATOR_LAG_S)
        released = Need("operator", name, "done", 1, ROBOT_LAG_S)
        gates += [Gate("operator", "approach", name, brought), Gate("robot", "approach", name, released)]
    stations = {name: (xy, (4.5, 6.5)) for name, (_, _, xy) in _FIXTURES.items()}
    return Coupled(
        scene=_scene(
            "four-fixtures",
            {"feeder": (0.60, -0.10, 0.10)} | {name: place for name, (place, _, _) in _FIXTURES.items()},
            {"bench": ((1.70, 1.05), (0.4, 0.9))} | stations,
            (0.45, 0.75, 1.1, 1.6),
        ),
        short_of={name: short for name, (_, short, _) in _FIXTURES.items()},
        robot_s={**_RACKS_S, "feeder": 0.6, **dict.fromkeys(_FIXTURES, 1.2)},
        robot_jobs={**{f"bring {name}": ("feeder", name) for name in _FIXTURES}, **_SORTING},
        operator_jobs={
            **{f"mount {name}": ("bench", name) for name in _FIXTURES},
            **{name: (name,) for name in _OWN_STATIONS},
        },
        gates=tuple(gates),
        signals={("operator", name, "done"): f"release {name[-1]}" for name in _FIXTURES},
        joint=len(_FIXTURES),
    )


def _machine_tending() -> Coupled:
    places: dict[str, Place] = {
        "feeder": (0.60, -0.10, 0.10),
        "machine": (0.60, 0.20, 0.10),
        "outfeed": (0.45, 0.45, 0.10),
    }
    finished = Need("robot", "machine", "leaves", 1, (12.6, 13.4))
    return Coupled(
        scene=_scene("machine-tending", places, {"bench": ((1.30, 0.95), (2.0, 4.0))}, (0.45, 0.75, 1.1, 1.6)),
        short_of={},
        robot_s={**_RACKS_S, "feeder": 0.6, "machine": 2.0, "outfeed": 0.5},
        robot_jobs={"tend": ("feeder", "machine", "outfeed"), **_SORTING},
        operator_jobs={"check": ("bench",), **{name: (name,) for name in _OWN_STATIONS}},
        gates=(Gate("robot", "work", "machine", finished),),
        signals={},
    )


def _handover() -> Coupled:
    places: dict[str, Place] = {"bin": (0.55, -0.30, 0.10), "handover": (0.62, 0.18, 0.30)}
    stations = {"handover": ((1.15, 0.55), (1.0, 2.0)), "bench": ((1.70, 1.05), (2.5, 4.5))}
    held = Need("robot", "handover", "arrives", 0, OPERATOR_LAG_S)
    taken = Need("operator", "handover", "done", 0, ROBOT_LAG_S)
    return Coupled(
        scene=_scene("handover", places, stations, (0.3, 0.7, 1.1, 1.6)),
        short_of={},
        robot_s={**_RACKS_S, "bin": 0.6, "handover": 0.4},
        robot_jobs={"give": ("bin", "handover"), **_SORTING},
        operator_jobs={"take": ("handover", "bench"), **{name: (name,) for name in _OWN_STATIONS}},
        gates=(Gate("operator", "work", "handover", held), Gate("robot", "work", "handover", taken)),
        signals={("operator", "handover", "done"): "digital-input 2"},
    )


def _fed_line() -> Coupled:
    places: dict[str, Place] = {"conveyor": (0.60, 0.10, 0.10), "outfeed": (0.45, 0.45, 0.10)}
    stations = {"bench": ((1.30, 0.95), (2.0, 4.0))}
    come = Need("source", "conveyor", "arrives", 0, ROBOT_LAG_S)
    return Coupled(
        scene=_scene("fed-line", places, stations, (0.45, 0.75, 1.1, 1.6)),
        short_of={},
        robot_s={**_RACKS_S, "conveyor": 0.6, "outfeed": 0.5},
        robot_jobs={"load": ("conveyor", "outfeed"), **_SORTING},
        operator_jobs={"check": ("bench",), **{name: (name,) for name in _OWN_STATIONS}},
        gates=(Gate("robot", "work", "conveyor", come),),
        signals={("source", "conveyor", "arrives"): "digital-input 3"},
        feed=Feed("conveyor", (6.0, 10.0), 2),
    )


def _repeats() -> Coupled:
    cell = _shared_fixture()
    return replace(
        cell,
        scene=replace(cell.scene, name="repeats"),
        short_of={**cell.short_of, "feeder": (0.58, -0.10, 0.22)},
        repeats={"feeder": 0.12},
    )


def _mixed_products() -> Coupled:
    """Three products, repeated picks, a camera that keeps the robot waiting, tool changes and jams."""
    cell = _shared_fixture()
    feeders: dict[str, Place] = {
        "feeder_a": (0.60, -0.10, 0.10), "feeder_b": (0.60, -0.22, 0.10), "feeder_c": (0.56, -0.34, 0.10)
    }  # fmt: skip
    programs = {"a": ("fixture",), "b": ("scale", "fixture"), "c": ("scale", "turner", "fixture")}
    more: dict[str, Place] = {"scale": (0.45, -0.25, 0.15), "turner": (0.40, 0.10, 0.20), "tools": (0.25, -0.40, 0.35)}
    fixture = cell.scene.places["fixture"]
    racks = {name: place for name, place in cell.scene.places.items() if name in _RACKS}
    return replace(
        cell,
        scene=replace(
            cell.scene,
            name="mixed-products",
            places={"home": cell.scene.places["home"], **feeders, **more, "fixture": fixture, **racks},
            stations={**cell.scene.stations, "fixture": replace(cell.scene.stations["fixture"], dwell_s=(8.0, 11.0))},
        ),
        short_of={**cell.short_of, **{name: (x - 0.02, y, z + 0.12) for name, (x, y, z) in feeders.items()}},
        robot_s={**_RACKS_S, **dict.fromkeys(feeders, 0.6), "scale": 1.0, "turner": 1.5, "tools": 6.0, "fixture": 1.2},
        robot_jobs={
            **{f"bring {name}": (f"feeder_{name}", *places) for name, places in programs.items()},
            **_SORTING,
        },
        joint=3,
        products=3,
        repeats=dict.fromkeys(feeders, 0.12),
        late_s=dict.fromkeys(feeders, (0.3, 2.0)),
        jam=(0.004, (20.0, 60.0)),
        tool=("tools", 5),
        keeps=frozenset(more),
    )


def _two_operators() -> Coupled:
    """A loader fills a fixture with two slots, the robot moves parts to an outfeed for two, an unloader takes them."""
    places: dict[str, Place] = {"fixture": (0.60, 0.10, 0.10), "outfeed": (0.45, 0.45, 0.10)}
    stations = {
        "fixture": ((1.20, 0.20), (4.0, 6.0)),
        "outfeed": ((0.75, 1.15), (3.0, 5.0)),
        HELPER_REST: ((0.2, 2.4), (0.2, 0.8)),
        "pallet": ((-0.4, 1.9), (1.0, 2.0)),
        "inspect": ((0.6, 2.2), (1.5, 3.0)),
    }
    loaded = Need("operator", "fixture", "done", 0, ROBOT_LAG_S)
    free = Need("robot", "fixture", "leaves", 2, OPERATOR_LAG_S)
    brought = Need("robot", "outfeed", "leaves", 0, OPERATOR_LAG_S)
    room = Need("helper", "outfeed", "leaves", 2, ROBOT_LAG_S)
    return Coupled(
        scene=_scene("two-operators", places, stations, (0.45, 0.75, 1.1, 1.6)),
        short_of={"fixture": (0.50, 0.02, 0.25), "outfeed": (0.38, 0.30, 0.25)},
        robot_s={**_RACKS_S, "fixture": 1.2, "outfeed": 0.5},
        robot_jobs={"turn": ("fixture", "outfeed"), **_SORTING},
        operator_jobs={"load": ("shelf", "fixture"), "label": ("label",), "scan": ("scan",)},
        helper_jobs={"unload": ("outfeed", "pallet"), "inspect": ("inspect",), "pack": ("pack",)},
        gates=(
            Gate("operator", "approach", "fixture", free),
            Gate("robot", "approach", "fixture", loaded),
            Gate("robot", "approach", "outfeed", room),
            Gate("helper", "approach", "outfeed", brought),
        ),
        signals={},
    )


def _shared_zone() -> Coupled:
    """The robot fits parts on a table that the operator refills; in the zone of the table is one of them at a time."""
    places: dict[str, Place] = {"feeder": (0.60, -0.10, 0.10), "table": (0.55, 0.30, 0.10)}
    stations = {"bench": ((1.70, 1.05), (0.4, 0.9)), "table": ((1.15, 0.7), (3.0, 5.0))}
    return Coupled(
        scene=_scene("shared-zone", places, stations, (0.45, 0.75, 1.1, 1.6)),
        short_of={"table": (0.50, 0.14, 0.25)},
        robot_s={**_RACKS_S, "feeder": 0.6, "table": 3.0},
        robot_jobs={"fit": ("feeder", "table"), **_SORTING},
        operator_jobs={"refill": ("bench", "table"), **{name: (name,) for name in _OWN_STATIONS}},
        gates=(
            Gate("operator", "approach", "table", Need("robot", "table", "leaves", None, OPERATOR_LAG_S)),
            Gate("robot", "approach", "table", Need("operator", "table", "leaves", None, ROBOT_LAG_S)),
        ),
        signals={(agent, "table", "leaves"): "digital-input 4" for agent in ("robot", "operator")},
    )


COUPLED: dict[str, Coupled] = {
    cell.scene.name: cell
    for cell in (
        _shared_fixture(),
        _handover(),
        _fed_line(),
        _four_fixtures(),
        _machine_tending(),
        _repeats(),
        _two_operators(),
        _shared_zone(),
        _mixed_products(),
    )
}


def wired(cell: Coupled) -> Coupled:
    """Return a cell whose buttons and sensors are all digital inputs of the robot, as where no tracker logs events."""
    taken = set(cell.bits.values())
    free = (number for number in range(1, 8) if number not in taken)
    names = ((key, name if name.startswith(INPUT) else f"{INPUT}{next(free)}") for key, name in cell.signals.items())
    return replace(cell, signals=dict(names))
