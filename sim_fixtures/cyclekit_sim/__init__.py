"""cyclekit_sim: seeded human-robot cells that write plant logs in vendor formats, together with their ground truth.

It imports nothing of cyclekit, because a test may not share code with what it tests.
"""

from cyclekit_sim.causes import MixedCauses
from cyclekit_sim.coupled import FreshCycles, fresh_cycles, orders_beside, random_orders
from cyclekit_sim.coupled_scenes import COUPLED
from cyclekit_sim.errors import SimulationError
from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.rule_file import read_rule
from cyclekit_sim.scenes import FIELD_SCENES, HABIT_SCENES, SCENES
from cyclekit_sim.short_cycles import write_short_cycles
from cyclekit_sim.simulate import random_sequence, scene_places, simulate, simulate_sequence

__all__ = [
    "COUPLED",
    "FIELD_SCENES",
    "HABIT_SCENES",
    "SCENES",
    "FreshCycles",
    "MixedCauses",
    "SimulationError",
    "SimulationOptions",
    "fresh_cycles",
    "orders_beside",
    "random_orders",
    "random_sequence",
    "read_rule",
    "scene_places",
    "simulate",
    "simulate_sequence",
    "write_short_cycles",
]
