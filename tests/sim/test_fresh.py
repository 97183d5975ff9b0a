"""Fresh executions, the truth of the benchmarks, come from the cell that was logged."""

from __future__ import annotations

from typing import TYPE_CHECKING

from benchmarks.cells import durations_of, fresh
from cyclekit_sim import SimulationOptions, random_sequence
from cyclekit_sim.scenes import BUILT_IN

if TYPE_CHECKING:
    from pathlib import Path


def test_fresh_executions_have_the_response_of_their_scene(tmp_path: Path) -> None:
    scene = BUILT_IN["light-curtain"]
    told = SimulationOptions(
        latency_s=scene.latency_s, ramp_down_per_s=scene.ramp_down_per_s, ramp_up_per_s=scene.ramp_up_per_s
    )
    places = random_sequence(scene.name, 1)[:4]
    left_open = durations_of(fresh(tmp_path / "left open", scene.name, places, 3))
    assert (left_open == durations_of(fresh(tmp_path / "told", scene.name, places, 3, options=told))).all()
