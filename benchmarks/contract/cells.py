"""The cells of the contract: how each is logged, which orders are asked, and their truth.

A cell knows nothing of cyclekit. It gives a folder of logs, orders that were never logged, fresh executions of an order
(the truth), and as many executions beside the logged operators and gaps as were logged (chance: what a perfect method
beside the same logs would miss).
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from cyclekit_sim import (
    SimulationOptions,
    fresh_cycles,
    orders_beside,
    random_orders,
    random_sequence,
    simulate,
    simulate_sequence,
)
from cyclekit_sim.coupled_list import task_plan
from cyclekit_sim.coupled_scenes import COUPLED
from cyclekit_sim.task_lists import AGENTS, ListOptions, fresh_durations, random_order, simulate_task_lists

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit_sim.coupled_program import Order

Kind = Literal["tracker", "signals", "list", "robot"]
JUDGED = 5_000_000
"""First seed of the asked orders and of their fresh executions; no log has such a seed."""
PLAIN = SimulationOptions()
PLAIN_LIST = ListOptions()
LENGTHS = {"half": 0.5, "same": 1.0, "twice": 2.0, "three times": 3.0}
RESPONSE = SimulationOptions(
    latency_s=0.08, hysteresis_m=0.1, ramp_down_per_s=2.0, ramp_up_per_s=0.8, executions_per_session=1,
    silent_when_empty=True, delta_m=0.005,
)  # fmt: skip
"""One log per execution, a tracker that is silent without people, and a safety function with a response."""

CREW = SimulationOptions(executions_per_session=1, delta_m=0.005)
"""One log per execution, whose end cuts the operator's last stay."""


@dataclass(frozen=True)
class Asked:
    """An order to estimate: its name, its length, and its text in a sequence file."""

    name: str
    length: str
    toml: str
    order: object = field(repr=False)


@dataclass(frozen=True)
class Cycles:
    """Executions of one order: durations and the waits of robot and operator, shape (N,) each, s."""

    durations_s: NDArray[np.float64]
    robot_waits_s: NDArray[np.float64]
    operator_waits_s: NDArray[np.float64]


class Cell(Protocol):
    """What the contract needs of a cell."""

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds of logs that it can write."""

    def log(self, kind: Kind, folder: Path, executions: int, seed: int) -> list[Path]:
        """Write the logs into a new folder; return what to ingest."""

    def orders(self, kind: Kind, count: int) -> list[Asked]:
        """Return orders that were never logged, `count` of each length."""

    def truth(self, kind: Kind, asked: Asked, cycles: int) -> Cycles:
        """Return fresh executions of an order."""

    def beside(self, kind: Kind, asked: Asked, executions: int, seed: int) -> NDArray[np.float64]:
        """Return durations of the order beside the operators and gaps of the logs, shape (executions,), s."""


def _seed(*words: object) -> int:
    """Return a seed for fresh executions that depends on the words alone."""
    return JUDGED + zlib.crc32(repr(words).encode()) % 1_000_000


def _quoted(names: object) -> str:
    return "[" + ", ".join(f'"{name}"' for name in names) + "]"  # type: ignore[attr-defined]


def of_length(places: list[str], part: float) -> list[str]:
    """Return an order of home, pairs of places, and home, with this part of the pairs, repeated as needed."""
    pairs = [places[at : at + 2] for at in range(1, len(places) - 1, 2)]
    count = round(part * len(pairs))
    chosen = [pairs[at % len(pairs)] for at in range(count)]
    return [places[0], *(place for pair in chosen for place in pair), places[-1]]


@dataclass(frozen=True)
class Free:
    """A scene in which nobody waits for anybody: the robot's places are the order."""

    scene: str
    kinds: tuple[Kind, ...] = ("tracker",)
    options: SimulationOptions = PLAIN
    lengths: tuple[str, ...] = ("same",)

    def _logged_as(self, kind: Kind) -> SimulationOptions:
        people = {"tracker": "tracker", "signals": "signals", "robot": "none"}[kind]
        return replace(self.options, people=people)  # type: ignore[arg-type]

    def log(self, kind: Kind, folder: Path, executions: int, seed: int) -> list[Path]:
        """Write the logs of the scene."""
        return [simulate(self.scene, folder, executions=executions, seed=seed, options=self._logged_as(kind))]

    def orders(self, kind: Kind, count: int) -> list[Asked]:
        """Return orders drawn as the scene draws its own, cut or repeated to each length."""
        found = []
        for length in self.lengths:
            for number in range(count):
                places = of_length(random_sequence(self.scene, JUDGED + number), LENGTHS[length])
                name = f"{length} {number}"
                toml = f'[[sequence]]\nname = "{name}"\nplaces = {_quoted(places)}\n'
                found.append(Asked(name, length, toml, tuple(places)))
        return found

    def _cycles(self, kind: Kind, asked: Asked, count: int, seed: int, *, logged: bool) -> Cycles:
        options = self._logged_as("signals" if kind == "signals" else "tracker")
        rows = simulate_sequence(
            self.scene, asked.order, executions=count, seed=seed, options=options, logged=logged  # type: ignore[arg-type]
        )  # fmt: skip
        return Cycles(rows["duration_s"].to_numpy(), rows["wait_s"].to_numpy(), np.zeros(rows.height))

    def truth(self, kind: Kind, asked: Asked, cycles: int) -> Cycles:
        """Return fresh executions."""
        return self._cycles(kind, asked, cycles, _seed(self.scene, asked.order), logged=False)

    def beside(self, kind: Kind, asked: Asked, executions: int, seed: int) -> NDArray[np.float64]:
        """Return executions with the operators of the logs."""
        return self._cycles(kind, asked, executions, seed, logged=True).durations_s


_LOGGED_AS: dict[str, dict[str, object]] = {
    "tracker": {"signals": False}, "signals": {}, "list": {"task_list": True}, "robot": {"people": "none"}
}  # fmt: skip


@dataclass(frozen=True)
class Waiting:
    """A scene in which robot and operator wait for each other: an order names the work of both."""

    scene: str
    kinds: tuple[Kind, ...] = ("tracker", "signals", "list", "robot")
    options: SimulationOptions = PLAIN

    def log(self, kind: Kind, folder: Path, executions: int, seed: int) -> list[Path]:
        """Write the logs of the scene."""
        options = replace(self.options, **_LOGGED_AS[kind])  # type: ignore[arg-type]
        return [simulate(self.scene, folder, executions=executions, seed=seed, options=options)]

    def _of_robot(self, kind: Kind) -> bool:
        """Whether the robot's order alone is asked: nobody waits, or no log shows the operator."""
        return kind == "robot" or (self.options.coupling == 0.0 and kind != "list")

    def orders(self, kind: Kind, count: int) -> list[Asked]:
        """Return orders of both agents, or of the robot alone."""
        found = []
        for number, order in enumerate(random_orders(self.scene, JUDGED, count)):
            head = f'[[sequence]]\nname = "{number}"\n'
            if self._of_robot(kind):
                toml = f"{head}places = {_quoted(order['robot'])}\n"
            elif kind == "list":
                toml = head + "".join(_task(agent, task) for agent, task in task_plan(COUPLED[self.scene], order))
            else:
                tasks = [("robot", place) for place in order["robot"][1:]]
                toml = head + "".join(_task(*each) for each in (*tasks, *(("operator", p) for p in order["operator"])))
            found.append(Asked(str(number), "same", toml, order))
        return found

    def _cycles(self, kind: Kind, order: Order, count: int, seed: int, *, logged: bool) -> Cycles:
        others = orders_beside(self.scene, order["robot"], JUDGED + 7, count) if kind == "robot" else []
        options = self.options
        done = fresh_cycles(
            self.scene, order, cycles=count, seed=seed, options=options, operators=others, logged=logged
        )
        until_s = done.robot_s if self._of_robot(kind) else done.durations_s
        return Cycles(until_s, done.robot_waits_s, done.operator_waits_s)

    def truth(self, kind: Kind, asked: Asked, cycles: int) -> Cycles:
        """Return fresh executions; beside operators in any order of theirs, if only the robot is logged."""
        seed = _seed(self.scene, asked.name)
        return self._cycles(kind, asked.order, cycles, seed, logged=False)  # type: ignore[arg-type]

    def beside(self, kind: Kind, asked: Asked, executions: int, seed: int) -> NDArray[np.float64]:
        """Return executions with the people's times and the gaps between parts of the logs."""
        return self._cycles(kind, asked.order, executions, seed, logged=True).durations_s  # type: ignore[arg-type]


def _task(agent: str, name: str) -> str:
    return f'[[sequence.task]]\nagent = "{agent}"\nname = "{name}"\n'


@dataclass(frozen=True)
class Listed:
    """Task lists of a cell with waits and mutual rates, without positions."""

    options: ListOptions = PLAIN_LIST
    kinds: tuple[Kind, ...] = ("list",)

    def log(self, kind: Kind, folder: Path, executions: int, seed: int) -> list[Path]:
        """Write the task list."""
        simulate_task_lists(folder, executions=executions, seed=seed, options=self.options)
        return [folder / "tasks.csv"]

    def orders(self, kind: Kind, count: int) -> list[Asked]:
        """Return random orders of both agents."""
        found, rng = [], np.random.default_rng(JUDGED)
        for number in range(count):
            order = random_order(rng)
            tasks = [(AGENTS[agent], task) for agent, names in order.items() for task in names]
            toml = f'[[sequence]]\nname = "{number}"\n' + "".join(_task(*each) for each in tasks)
            found.append(Asked(str(number), "same", toml, order))
        return found

    def _cycles(self, asked: Asked, count: int, seed: int) -> NDArray[np.float64]:
        return np.array(fresh_durations(asked.order, cycles=count, seed=seed, options=self.options))  # type: ignore[arg-type]

    def truth(self, kind: Kind, asked: Asked, cycles: int) -> Cycles:
        """Return fresh executions; their waits are not told apart from work."""
        durations_s = self._cycles(asked, cycles, _seed("list", asked.name))
        return Cycles(durations_s, np.full(cycles, np.nan), np.full(cycles, np.nan))

    def beside(self, kind: Kind, asked: Asked, executions: int, seed: int) -> NDArray[np.float64]:
        """Return as many other executions: durations are drawn anew in each, so there is nothing to share."""
        return self._cycles(asked, executions, JUDGED - seed)


CELLS: dict[str, Cell] = {
    "box-picking": Free("box-picking", ("tracker", "robot"), lengths=tuple(LENGTHS)),
    "pick-and-package": Free("pick-and-package"),
    "laser-zones": Free("laser-zones"),
    "scanner-visits": Free("scanner-visits", options=RESPONSE, lengths=tuple(LENGTHS)),
    "scanner-fields": Free("scanner-fields", ("signals", "robot"), lengths=("half", "same", "twice")),
    "guard-door": Free("guard-door", ("signals",)),
    **{
        name: Waiting(name)
        for name in (
            "shared-fixture", "handover", "fed-line", "four-fixtures", "machine-tending", "repeats", "two-operators",
        )
    },
    "waits and rates": Listed(),
    "rates and fatigue": Listed(ListOptions(coupled=False, fatigue=0.2)),
    "nobody waits": Waiting("shared-fixture", ("tracker", "list"), SimulationOptions(coupling=0.0)),
    "shared-zone": Waiting("shared-zone"),
    "mixed-products": Waiting("mixed-products"),
    "two-operators lost": Waiting(
        "two-operators", ("tracker",), SimulationOptions(swap_ids_s=60.0, lost_ids_s=45.0, dropout=0.05)
    ),
    "bench-crew": Free("bench-crew", options=CREW, lengths=tuple(LENGTHS)),
    "e-waste": Listed(ListOptions(coupled=False, drift=0.25, spread=0.25, planned=0.9)),
}  # fmt: skip
"""The cells by name; new ones come last, so that the rows with 200 executions stay the same."""
