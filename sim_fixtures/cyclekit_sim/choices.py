"""Chance in the cell: which slot comes next, where the operator goes, how long everybody takes.

Every execution has its own stream of random numbers, drawn from the seed, the scene and the execution's number, so
that an execution is the same however many are simulated. What the streams are used for is the business of `plan`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cyclekit_sim.arm import Array
from cyclekit_sim.causes import MixedCauses
from cyclekit_sim.program import HOME, Execution
from cyclekit_sim.scenes import GOAL_SD_M, MIDDLE_SD_M, SCENES, Scene
from cyclekit_sim.walking import Leg, Press, away, stand, walk

ROBOT, OPERATOR, PAUSE, TRACKER, SEQUENCE, ENCODER, SLOWING = range(7)
LOGGED, FRESH = range(2)


def stream(seed: int, scene: Scene, purpose: int, number: int, *, domain: int = LOGGED) -> np.random.Generator:
    """Return the random stream of one `purpose` of execution (or session) `number`.

    `domain` FRESH keeps executions made to check an estimate apart from those that were logged with the same seed.
    """
    key = (SCENES.index(scene.name), domain, purpose, number)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def draw_places(scene: Scene, rng: np.random.Generator) -> tuple[str, ...]:
    """Return the places of one execution in visiting order: home, (conveyor, slot) times `picks`, home."""
    slots = np.array(scene.slots)
    chosen = rng.choice(slots, scene.picks) if scene.repeats_slots else rng.permutation(slots)[: scene.picks]
    return (HOME, *(name for slot in chosen for name in ("conveyor", str(slot))), HOME)


def draw_execution(
    scene: Scene, index: int, places: tuple[str, ...], rng: np.random.Generator, causes: MixedCauses | None = None
) -> Execution:
    """Add to `places` the waits for boxes that are late, as `causes` or the scene has them, and the idle stay after."""
    goals = places[1:]
    late = rng.exponential(scene.wait_s, len(goals)) if scene.wait_s > 0 else np.zeros(len(goals))
    if causes is not None:
        late = np.where(rng.random(len(goals)) < causes.wait_share, rng.uniform(*causes.wait_s, len(goals)), 0.0)
    waits = tuple(float(w) if goal == "conveyor" else 0.0 for w, goal in zip(late, goals, strict=True))
    return Execution(index, places, waits, float(rng.uniform(2.0, 4.0)) if scene.continuous else 0.0)


def operator_legs(scene: Scene, rng: np.random.Generator) -> Iterator[Leg]:
    """Yield the operator's legs: endless where he roams or visits, up to the rest place where boxes run out."""
    if scene.operator == "visit":
        while True:
            yield away(scene.away_s[0] + rng.exponential(scene.away_s[1] - scene.away_s[0]))
            yield from _legs(scene, _visit(scene, rng), rng)
    names = _roam(scene, rng) if scene.operator == "roam" else _deliver(scene, rng)
    yield from _legs(scene, names, rng)


def _legs(scene: Scene, names: Iterator[str], rng: np.random.Generator) -> Iterator[Leg]:
    """Yield the walks and dwells from station to station, the first dwell included."""
    name = next(names)
    here = _goal(scene, name, rng)
    yield _begin(stand(here, _dwell_s(scene, name, rng)), name, here)
    for name in names:
        there = _goal(scene, name, rng)
        middle = 0.5 * (here + there)
        middle[:2] += rng.normal(0.0, MIDDLE_SD_M, 2)
        yield _begin(walk(here, middle, there, rng.uniform(*scene.walk_m_s)), name, there)
        yield stand(there, _dwell_s(scene, name, rng))
        here = there


def _deliver(scene: Scene, rng: np.random.Generator) -> Iterator[str]:
    """Fill the outbound areas in turn, beginning with any; the spots of one area (`out_left_1`, ...) in any order."""
    areas: dict[str, list[str]] = {}
    for name in scene.stations:
        if name not in ("inbound", "rest"):
            area, _, spot = name.rpartition("_")
            areas.setdefault(area if spot.isdigit() else name, []).append(name)
    left = [list(rng.permutation(np.array(areas[area]))) for area in rng.permutation(np.array(list(areas)))]
    while any(left):
        for spots in left:
            if spots:
                yield "inbound"
                yield str(spots.pop())
    yield "rest"


def _roam(scene: Scene, rng: np.random.Generator) -> Iterator[str]:
    names = list(scene.stations)
    here = str(rng.choice(names))
    while True:
        yield here
        here = str(rng.choice([name for name in names if name != here]))


def _visit(scene: Scene, rng: np.random.Generator) -> Iterator[str]:
    """One visit: in by the door, to one to three stations, out by the door."""
    names = [name for name in scene.stations if name != "door"]
    yield "door"
    yield from (str(name) for name in rng.permutation(np.array(names))[: rng.integers(1, 4)])
    yield "door"


def _goal(scene: Scene, name: str, rng: np.random.Generator) -> Array:
    goal = np.array(scene.stations[name].xyz_m)
    goal[:2] += rng.normal(0.0, GOAL_SD_M, 2)
    return goal


def _dwell_s(scene: Scene, name: str, rng: np.random.Generator) -> float:
    return float(rng.uniform(*scene.stations[name].dwell_s))


def _begin(leg: Leg, name: str, goal: Array) -> Leg:
    return Leg(leg.t_s, leg.xyz_m, Press(0.0, name, (float(goal[0]), float(goal[1]), float(goal[2]))))
