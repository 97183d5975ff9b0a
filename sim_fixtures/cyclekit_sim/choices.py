"""Random choices in the cell: next slot, the operator's next station, durations.

Every execution has its own random stream, derived from seed, scene and execution number, so an execution does not
depend on how many are simulated. `plan` uses the streams.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np

from cyclekit_sim.arm import Array
from cyclekit_sim.causes import MixedCauses
from cyclekit_sim.coupled_scenes import COUPLED
from cyclekit_sim.errors import SimulationError
from cyclekit_sim.program import HOME, Execution
from cyclekit_sim.scenes import BUILT_IN, GOAL_SD_M, MIDDLE_SD_M, Scene
from cyclekit_sim.walking import Leg, Press, away, stand, sway, walk

ROBOT, OPERATOR, PAUSE, TRACKER, SEQUENCE, ENCODER, SLOWING, PARTS, COUPLING, SOURCE, HELPER, REPEATS = range(12)
LOGGED, FRESH = range(2)


def stream(seed: int, scene: Scene, purpose: int, number: int, *, domain: int = LOGGED) -> np.random.Generator:
    """Return the random stream of one `purpose` of execution (or session) `number`.

    `domain` FRESH separates executions that check an estimate from executions logged with the same seed.
    """
    kind = list(BUILT_IN).index(scene.name) if scene.name in BUILT_IN else 1000 + list(COUPLED).index(scene.name)
    key = (kind, domain, purpose, number)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def draw_places(scene: Scene, rng: np.random.Generator) -> tuple[str, ...]:
    """Return the places of one execution in visiting order: home, (conveyor, slot) times `picks`, home."""
    slots = np.array(scene.slots)
    chosen = rng.choice(slots, scene.picks) if scene.repeats_slots else rng.permutation(slots)[: scene.picks]
    return (HOME, *(name for slot in chosen for name in ("conveyor", str(slot))), HOME)


def draw_execution(
    scene: Scene, index: int, places: tuple[str, ...], rng: np.random.Generator, causes: MixedCauses | None = None
) -> Execution:
    """Return an execution of `places`, with waits for late boxes by `causes` or the scene, and its idle stay."""
    goals = places[1:]
    late = rng.exponential(scene.wait_s, len(goals)) if scene.wait_s > 0 else np.zeros(len(goals))
    if causes is not None:
        late = np.where(rng.random(len(goals)) < causes.wait_share, rng.uniform(*causes.wait_s, len(goals)), 0.0)
    waits = tuple(float(w) if goal == "conveyor" else 0.0 for w, goal in zip(late, goals, strict=True))
    return Execution(index, places, waits, float(rng.uniform(2.0, 4.0)) if scene.continuous else 0.0)


def places_again(scene: Scene, places: tuple[str, ...], task: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Return `places` with those after the goal of `task` redrawn, consistent with those before."""
    drawn, known = list(places), [place for place in places[: task + 2] if place in scene.slots]
    left = list(scene.slots) if scene.repeats_slots else [slot for slot in scene.slots if slot not in known]
    later = [at for at in range(task + 2, len(places)) if places[at] in scene.slots]
    if later:
        for at, slot in zip(later, rng.choice(left, len(later), replace=scene.repeats_slots), strict=True):
            drawn[at] = str(slot)
    return tuple(drawn)


def legs_again(scene: Scene, legs: Sequence[Leg], into_s: float, rng: np.random.Generator) -> Iterator[Leg]:
    """Yield the last of `legs`, of which `into_s` has passed, and possible legs after it.

    A walk continues unchanged; the remaining dwell and the next station are redrawn.

    Raises:
        SimulationError: The operator visits: the legs do not show how long they have been away.
    """
    if scene.operator in ("visit", "habits"):
        raise SimulationError(f"{scene.name}: futures are drawn for operators who deliver or roam")
    done, last = [leg.press for leg in legs if leg.press is not None], legs[-1]
    name, here = done[-1].goal, np.array(done[-1].goal_m)
    shortest, longest = scene.stations[name].dwell_s
    if len(last.t_s) > 2:
        yield last
        yield stand(here, _dwell_s(scene, name, rng))
    else:
        yield stand(here, float(rng.uniform(max(shortest, min(into_s, longest)), longest)))
    names = [press.goal for press in done]
    follow = _roam(scene, rng, names[-1]) if scene.operator == "roam" else _deliver(scene, rng, names)
    yield from _onwards(scene, here, islice(follow, 1 if scene.operator == "roam" else len(names), None), rng)


def operator_legs(scene: Scene, rng: np.random.Generator) -> Iterator[Leg]:
    """Yield the operator's legs: endless, or of who delivers, up to the rest place when boxes run out."""
    if scene.operator == "visit":
        while True:
            yield away(scene.away_s[0] + rng.exponential(scene.away_s[1] - scene.away_s[0]))
            yield from _legs(scene, _visit(scene, rng), rng)
    if scene.operator == "habits":
        yield from _habitual(scene, rng)
        return
    names = _roam(scene, rng) if scene.operator == "roam" else _deliver(scene, rng)
    yield from _legs(scene, names, rng)


def _legs(scene: Scene, names: Iterator[str], rng: np.random.Generator) -> Iterator[Leg]:
    """Yield the walks and dwells from station to station, including the first dwell."""
    name = next(names)
    here = draw_goal(scene, name, rng)
    yield _begin(stand(here, _dwell_s(scene, name, rng)), name, here)
    yield from _onwards(scene, here, names, rng)


def _onwards(scene: Scene, here: Array, names: Iterator[str], rng: np.random.Generator) -> Iterator[Leg]:
    """Yield the walks and dwells that follow `here`."""
    for name in names:
        there = draw_goal(scene, name, rng)
        yield draw_walk(scene, here, there, name, rng)
        yield stand(there, _dwell_s(scene, name, rng))
        here = there


def _deliver(scene: Scene, rng: np.random.Generator, done: Sequence[str] = ()) -> Iterator[str]:
    """Yield stations that fill the outbound areas in turn, in random order of areas and of spots (`out_left_1`, ...).

    `done` are the stations already visited; only the following ones are drawn.
    """
    areas: dict[str, list[str]] = {}
    for name in scene.stations:
        if name not in ("inbound", "rest"):
            area, _, spot = name.rpartition("_")
            areas.setdefault(area if spot.isdigit() else name, []).append(name)
    order = dict.fromkeys(area for name in done for area, spots in areas.items() if name in spots)
    begun = [*order, *rng.permutation(np.array([area for area in areas if area not in order]))]
    left = [_spots(areas[area], done, rng) for area in begun]
    while any(left):
        for spots in left:
            if spots:
                yield "inbound"
                yield str(spots.pop())
    yield "rest"


def _spots(spots: list[str], done: Sequence[str], rng: np.random.Generator) -> list[str]:
    """Return the spots of an area, the next one last: visited ones first, then the others in random order."""
    first = [spot for spot in reversed(done) if spot in spots]
    return [*map(str, rng.permutation(np.array([spot for spot in spots if spot not in first]))), *first]


def _roam(scene: Scene, rng: np.random.Generator, here: str | None = None) -> Iterator[str]:
    names = list(scene.stations)
    here = here or str(rng.choice(names))
    while True:
        yield here
        here = str(rng.choice([name for name in names if name != here]))


def _visit(scene: Scene, rng: np.random.Generator) -> Iterator[str]:
    """Yield one visit: in by the door, to one to three stations, out by the door."""
    names = [name for name in scene.stations if name not in ("door", "exit")]
    yield "door"
    if scene.passing and rng.random() < scene.passing:
        yield "exit"
        return
    yield from (str(name) for name in rng.permutation(np.array(names))[: rng.integers(1, 4)])
    yield "door"


def _habitual(scene: Scene, rng: np.random.Generator) -> Iterator[Leg]:
    """Yield the legs of one of the scene's people, without end (`Habit`)."""
    mine = scene.habits[rng.integers(len(scene.habits))]
    here, far_stays = draw_goal(scene, "door", rng), 2
    inside = rng.random() >= mine.begins_away
    if inside:
        name = str(rng.choice(mine.far))
        here, far_stays = draw_goal(scene, name, rng), 1
        yield _begin(sway(here, float(rng.uniform(*mine.stay_s)), mine.sway_m, rng), name, here)
    while True:
        if not inside:
            yield away(float(rng.uniform(*mine.away_s)))
            here, inside = draw_goal(scene, "door", rng), True
            yield stand(here, _dwell_s(scene, "door", rng))
        near = far_stays <= 0 and rng.random() < mine.near_share
        name, far_stays = str(rng.choice(mine.near if near else mine.far)), far_stays - 1
        there = draw_goal(scene, name, rng)
        yield draw_walk(scene, here, there, name, rng)
        yield sway(there, float(rng.uniform(*mine.stay_s)), mine.sway_m, rng)
        here = there
        if far_stays <= 0 and rng.random() < mine.leaves:
            yield draw_walk(scene, here, draw_goal(scene, "door", rng), "door", rng)
            inside = False


def draw_walk(scene: Scene, here: Array, there: Array, name: str, rng: np.random.Generator) -> Leg:
    """Return a walk to the station `name`, through a random midpoint, at a random speed."""
    middle = 0.5 * (here + there)
    middle[:2] += rng.normal(0.0, MIDDLE_SD_M, 2)
    return _begin(walk(here, middle, there, rng.uniform(*scene.walk_m_s)), name, there)


def draw_goal(scene: Scene, name: str, rng: np.random.Generator) -> Array:
    """Return the person's position at the station `name` for one dwell, shape (3,), m."""
    goal = np.array(scene.stations[name].xyz_m)
    goal[:2] += rng.normal(0.0, GOAL_SD_M, 2)
    return goal


def _dwell_s(scene: Scene, name: str, rng: np.random.Generator) -> float:
    return float(rng.uniform(*scene.stations[name].dwell_s))


def _begin(leg: Leg, name: str, goal: Array) -> Leg:
    return Leg(leg.t_s, leg.xyz_m, Press(0.0, name, (float(goal[0]), float(goal[1]), float(goal[2]))))
