"""The simulator's truth of mixed causes: every lost part of a cycle has one cause."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit_sim import MixedCauses, SimulationError, SimulationOptions
from cyclekit_sim.causes import CAUSES, Caps, lost_parts, scaling_of
from cyclekit_sim.program import DWELL, MOVE, WAIT

CAP = st.floats(0.05, 1.0)


@given(st.floats(0, 1), CAP, CAP, CAP, st.booleans(), st.booleans(), st.sampled_from([MOVE, DWELL, WAIT]))
def test_the_parts_of_a_cycle_add_up(
    person: float, reduced: float, limit: float, slider: float, stopped: bool, paused: bool, kind: int
):
    values = [np.array([value]) for value in (person, reduced, limit, slider)]
    caps = Caps(*values, np.array([stopped]), np.array([paused]))
    parts = lost_parts(caps, np.array([kind]))
    assert tuple(parts) == CAUSES
    assert min(part.item() for part in parts.values()) >= -1e-12
    pace = (scaling_of(caps) * caps.slider).item()
    lost = 1.0 if paused else {MOVE: 1.0 - pace, DWELL: 0.0, WAIT: 1.0}[kind]
    assert sum(part.item() for part in parts.values()) == pytest.approx(lost)
    assert parts["person"].item() == pytest.approx(0.0) or not stopped or person == 0.0


def test_bags_have_no_mixed_causes():
    with pytest.raises(SimulationError, match="CSV"):
        SimulationOptions(logs="mcap", causes=MixedCauses())
