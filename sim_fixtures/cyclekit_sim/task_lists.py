"""Task lists of a cell with waits of robot and operator: starts and ends without positions, and the truth.

The robot brings a part, the operator mounts it, the robot welds it; between these, each agent has other tasks. The k-th
mount waits for the k-th bring, the k-th weld for the k-th mount. Some tasks are slower or faster in parallel with
others.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

Order = dict[str, list[str]]
"""Tasks of each agent, in order."""
AGENTS = {"robot": "arm", "operator": "worker"}
MEAN_S = {"bring": 6.0, "weld": 5.0, "polish": 4.0, "mount": 5.0, "inspect": 7.0, "pack": 4.0}
WAITS = {"mount": "bring", "weld": "mount"}
PARALLEL_RATE = {("weld", "inspect"): 0.6, ("inspect", "weld"): 0.8, ("pack", "polish"): 1.3}
"""Rate of the first task while the second runs in parallel; 1 for all other pairs."""
LAG_S = 0.2
EPOCH_S = 1_700_000_000.0
REPEATS = 3
"""Number of repetitions of each task in one execution."""


@dataclass(frozen=True)
class ListOptions:
    """Options of the simulation.

    Attributes:
        coupled: Operator and robot wait for each other.
        needed: Share of the turns in which they do.
        parallel_rates: Tasks are slower or faster in parallel with others.
        spread: Standard deviation of the logarithm of a duration.
        drift: Share by which the operator becomes faster from the first to the last execution; fresh executions have
            the rate of the last one.
        fatigue: Share by which a task takes longer with each repetition in one execution.
        planned: A planner lets no task start before this share of the mean durations of the agent's tasks before it;
            0: there is none.
    """

    coupled: bool = True
    needed: float = 1.0
    parallel_rates: bool = True
    spread: float = 0.1
    drift: float = 0.0
    fatigue: float = 0.0
    planned: float = 0.0


@dataclass
class _Agent:
    order: list[str]
    at: int = 0
    left_s: float = 0.0
    began_s: float = float("nan")
    ready_s: float = 0.0
    ended_s: dict[tuple[str, int], float] = field(default_factory=dict)
    free: frozenset[int] = frozenset()


def random_order(rng: np.random.Generator) -> Order:
    """Return an order of all tasks; the n-th bring comes before the n-th weld."""
    robot = list(rng.permutation(["bring"] * REPEATS + ["weld"] * REPEATS + ["polish"] * REPEATS))
    ahead = 0
    for at, name in enumerate(robot):
        if name == "bring":
            ahead += 1
        elif name == "weld" and ahead == 0:
            later = next(i for i in range(at, len(robot)) if robot[i] == "bring")
            robot[at], robot[later] = "bring", "weld"
            ahead += 1
        elif name == "weld":
            ahead -= 1
    operator = rng.permutation(["mount"] * REPEATS + ["inspect"] * REPEATS + ["pack"] * REPEATS)
    return {"robot": [str(name) for name in robot], "operator": [str(name) for name in operator]}


def one_cycle(
    order: Order, rng: np.random.Generator, options: ListOptions, passed: float = 1.0
) -> list[tuple[str, str, float, float]]:
    """Return agent, task, start and end, s, of every task of one execution; `passed` is the share of the drift."""
    free = frozenset(turn for turn in range(REPEATS) if options.needed < 1.0 and rng.random() >= options.needed)
    agents = {name: _Agent(tasks, free=free) for name, tasks in order.items()}
    done: list[tuple[str, str, float, float]] = []
    t = 0.0
    while any(agent.at < len(agent.order) for agent in agents.values()):
        steps = []
        for name, agent in agents.items():
            if agent.at < len(agent.order):
                steps.append(_until_next(agents, name, t, options))
        step = min(steps)
        if not np.isfinite(step):
            msg = "the order cannot be done: each waits for the other"
            raise ValueError(msg)
        for name, agent in agents.items():
            if np.isfinite(agent.began_s):
                agent.left_s -= _rate(agents, name, options) * step
        t += step
        for name, agent in agents.items():
            if agent.at >= len(agent.order):
                continue
            task = agent.order[agent.at]
            if np.isfinite(agent.began_s) and agent.left_s <= 1e-9:
                done.append((name, task, agent.began_s, t))
                agent.ended_s[task, agent.order[: agent.at].count(task)] = t
                agent.at, agent.began_s, agent.ready_s = agent.at + 1, float("nan"), t
            elif not np.isfinite(agent.began_s) and _starts(agents, name, options) <= t + 1e-9:
                agent.began_s = t
                agent.left_s = MEAN_S[task] * float(np.exp(options.spread * rng.standard_normal()))
                agent.left_s *= 1.0 + options.fatigue * agent.order[: agent.at].count(task)
                agent.left_s *= 1.0 - options.drift * passed if name == "operator" else 1.0
    return done


def _until_next(agents: dict[str, _Agent], name: str, t: float, options: ListOptions) -> float:
    agent = agents[name]
    if np.isfinite(agent.began_s):
        return agent.left_s / _rate(agents, name, options)
    return max(_starts(agents, name, options) - t, 0.0)


def _starts(agents: dict[str, _Agent], name: str, options: ListOptions) -> float:
    """Return the start of an agent's next task, s; infinite until its condition has ended."""
    agent = agents[name]
    task = agent.order[agent.at]
    ready = max(agent.ready_s, options.planned * sum(MEAN_S[done] for done in agent.order[: agent.at]))
    if options.coupled and (needed := WAITS.get(task)):
        nth = agent.order[: agent.at].count(task)
        if nth in agent.free:
            return ready + LAG_S
        ended = [other.ended_s for other in agents.values() if needed in other.order]
        ready = max([ready, *(ends.get((needed, nth), float("inf")) for ends in ended)])
    return ready + LAG_S


def _rate(agents: dict[str, _Agent], name: str, options: ListOptions) -> float:
    agent = agents[name]
    running = [other.order[other.at] for other in agents.values() if other is not agent and np.isfinite(other.began_s)]
    task = agent.order[agent.at]
    rates = [PARALLEL_RATE.get((task, other), 1.0) for other in running] if options.parallel_rates else []
    return float(np.prod(rates))


def simulate_task_lists(
    folder: Path, *, executions: int = 60, seed: int = 0, options: ListOptions | None = None, first: float = 0.0
) -> list[Order]:
    """Write `tasks.csv` and `truth/truth.json` into a folder; return the order of each execution.

    `first` is the share of the drift before the first execution.
    """
    wanted = options or ListOptions()
    rng = np.random.default_rng(seed)
    orders = [random_order(rng) for _ in range(executions)]
    lines, at_s = ["run,agent,task,t_start,t_end"], EPOCH_S
    for number, order in enumerate(orders):
        cycle = one_cycle(order, rng, wanted, first + (1.0 - first) * number / max(executions - 1, 1))
        for agent, task, start_s, end_s in sorted(cycle, key=lambda each: each[2]):
            lines.append(f"{number:04d},{AGENTS[agent]},{task},{at_s + start_s:.3f},{at_s + end_s:.3f}")
        at_s += max(end_s for *_, end_s in cycle) + 30.0
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    (folder / "tasks.csv").write_text("\n".join([*lines, ""]), encoding="utf-8", newline="\n")
    truth = {
        "agents": {AGENTS[kind]: kind for kind in AGENTS},
        "waits": WAITS if wanted.coupled else {},
        "rates": [[*pair, rate] for pair, rate in PARALLEL_RATE.items()] if wanted.parallel_rates else [],
        "lag_s": LAG_S,
    }
    (folder / "truth" / "truth.json").write_text(json.dumps(truth, indent=2) + "\n", encoding="utf-8", newline="\n")
    return orders


def fresh_durations(order: Order, *, cycles: int, seed: int, options: ListOptions | None = None) -> list[float]:
    """Return durations of fresh executions of one order, s, from the first start to the last end."""
    rng = np.random.default_rng([seed, cycles])
    found = []
    for _ in range(cycles):
        cycle = one_cycle(order, rng, options or ListOptions())
        found.append(max(end for *_, end in cycle) - min(start for _, _, start, _ in cycle))
    return found
