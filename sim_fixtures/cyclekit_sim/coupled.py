"""Cells with waits of robot and operator: sessions from a seed, and fresh executions of one order of both agents."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cyclekit_sim.arm import Array
from cyclekit_sim.choices import FRESH, LOGGED, ROBOT, SEQUENCE, stream
from cyclekit_sim.coupled_program import Order, check_order, order_beside, people_of, plan_all, random_order
from cyclekit_sim.coupled_run import CoupledTrace, make_cell, run_cells
from cyclekit_sim.coupled_scenes import COUPLED, Coupled, wired
from cyclekit_sim.errors import SimulationError
from cyclekit_sim.motion import MotionTable
from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.plan import begins_of
from cyclekit_sim.scenes import Scene
from cyclekit_sim.session import Session

_BATCH, _FRESH_BATCH = 128, 1000  # executions simulated in parallel
_DEFAULT = SimulationOptions()


@dataclass(frozen=True)
class CoupledWork:
    """Content of a simulation: the cell, its motion table, and the order of each execution."""

    cell: Coupled
    seed: int
    options: SimulationOptions
    table: MotionTable
    executions: tuple[Order, ...]

    @property
    def scene(self) -> Scene:
        """Places, stations and safety function of the cell."""
        return self.cell.scene

    @property
    def signal_logs(self) -> tuple[bool, bool]:
        """Whether there are event logs, and digital inputs in the robot's log."""
        told = self.options.signals
        return told and len(self.cell.bits) < len(self.cell.signals), told and bool(self.cell.bits)

    def sessions(self, progress: Callable[[float], None] | None = None) -> Iterator[Session]:
        """Yield the sessions in order."""
        size = self.options.executions_per_session
        per_batch = max(1, _BATCH // size) * size
        for first in range(0, len(self.executions), per_batch):
            last = min(first + per_batch, len(self.executions))

            def report(done: float, first: int = first, count: int = last - first) -> None:
                if progress is not None:
                    progress((first + done * count) / len(self.executions))

            traces = self.run(range(first, last), report)
            for at in range(first, last, size):
                mine = tuple(traces[at - first : min(at + size, last) - first])
                begins = begins_of(self.scene, self.seed, self.options, mine)
                yield Session(at // size, mine, begins, self.table, self._signals(mine, begins))

    def run(self, numbers: Sequence[int], progress: Callable[[float], None] | None = None) -> list[CoupledTrace]:
        """Run executions given by number."""
        options, size = self.options, self.options.executions_per_session
        cells = [
            make_cell(
                self.cell,
                self.executions[i],
                self.table,
                self.seed,
                i,
                options.coupling,
                LOGGED,
                options.pace(i, i // size),
            )
            for i in numbers
        ]
        return run_cells(self.cell, cells, self.table, self.options, logged=True, progress=progress)[1]

    def _signals(self, traces: Sequence[CoupledTrace], begins_s: Sequence[float]) -> tuple[tuple[float, str, str], ...]:
        """Return time, name and value of each change of a signal, in session time."""
        found: list[tuple[float, str, str]] = []
        for trace, begin_s in zip(traces, begins_s, strict=True):
            for on_s, off_s, name in trace.done.signals(self.cell):
                if name not in self.cell.bits:
                    found += [(begin_s + on_s, name, "1"), (begin_s + off_s, name, "0")]
        return tuple(sorted(found))


def coupled_work(name: str, seed: int, options: SimulationOptions, executions: int) -> CoupledWork:
    """Draw the orders of all executions and plan their moves.

    Raises:
        SimulationError: Such a cell does not support these options.
    """
    cell = _cell(name) if options.people != "none" else wired(_cell(name))
    if executions < 1:
        raise SimulationError(f"executions is {executions}: simulate at least one")
    if options.logs != "csv" or options.causes or options.operator_log or not options.with_operator:
        msg = f"{name}: a scene with waits supports only CSV logs, without operator log and other causes"
        raise SimulationError(msg)
    orders = [random_order(cell, stream(seed, cell.scene, ROBOT, index)) for index in range(executions)]
    return CoupledWork(cell, seed, options, plan_all(cell, orders), tuple(orders))


def random_orders(scene: str, seed: int, count: int) -> list[Order]:
    """Return orders of both agents as drawn by the scene, independent of the logged ones.

    Raises:
        SimulationError: The scene has no waits.
    """
    cell = _cell(scene)
    return [random_order(cell, stream(seed, cell.scene, SEQUENCE, number)) for number in range(count)]


def orders_beside(scene: str, robot: Sequence[str], seed: int, count: int) -> list[tuple[str, ...]]:
    """Return orders of the operator as drawn by the scene beside this order of the robot, with the same joint tasks.

    Raises:
        SimulationError: The scene has no waits.
    """
    cell = _cell(scene)
    return [order_beside(cell, robot, stream(seed, cell.scene, SEQUENCE, number)) for number in range(count)]


@dataclass(frozen=True)
class FreshCycles:
    """Fresh executions of one order: duration, end of the robot alone, and waits of each agent, (N,), s."""

    durations_s: Array
    robot_s: Array
    robot_waits_s: Array
    operator_waits_s: Array


def fresh_cycles(
    scene: str,
    order: Order,
    *,
    cycles: int,
    seed: int,
    options: SimulationOptions = _DEFAULT,
    operators: Sequence[tuple[str, ...]] = (),
    after: int = 0,
    logged: bool = False,
) -> FreshCycles:
    """Run one order of both agents repeatedly, without writing logs.

    The random streams are independent of those of `simulate` for all seeds, unless `logged`.

    Args:
        scene: Which cell.
        order: Of both agents.
        cycles: How often.
        seed: Of what is drawn.
        options: How strongly they are coupled, and the dynamics of the safety function.
        operators: Orders of the operator that take turns, in place of his in `order`.
        after: Number of executions before them: they all have the operator's pace then. Several people take turns.
        logged: Execution *i* has the random streams of logged execution *i* of that seed: the same luck of people and
            parts, in this order of work.

    Raises:
        SimulationError: The scene has no waits, or the order does not belong to it.
    """
    cell = _cell(scene)
    orders: list[Order] = [{**order, "operator": each} for each in operators] or [order]
    for each in orders:
        check_order(cell, each)
    table = plan_all(cell, [order])
    done = []
    for first in range(0, cycles, _FRESH_BATCH):
        numbers = range(first, min(first + _FRESH_BATCH, cycles))
        cells = [
            make_cell(
                cell,
                orders[number % len(orders)],
                table,
                seed,
                number,
                options.coupling,
                LOGGED if logged else FRESH,
                options.pace(after, number),
            )
            for number in numbers
        ]
        done += run_cells(cell, cells, table, options)[0]
    waits = ([each.waited_s(agent) for each in done] for agent in ("robot", "operator"))
    idle = len(people_of(cell))  # the last segments are its idle stays at home until each person is done
    robot_s = np.array([each.ends_s["robot"][-1 - idle] for each in done])
    return FreshCycles(np.array([each.duration_s for each in done]), robot_s, *(np.array(each) for each in waits))


def _cell(name: str) -> Coupled:
    if name not in COUPLED:
        raise SimulationError(f"no scene {name!r} where robot and operator wait: choose one of {', '.join(COUPLED)}")
    return COUPLED[name]
