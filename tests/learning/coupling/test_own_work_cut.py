"""Own work of an operator who also waits at the place, in stays some of which the end of an execution cuts."""

from __future__ import annotations

import numpy as np
import pytest

from cyclekit.learning.coupling.conditions.departures import Condition, Departures, Gate
from cyclekit.learning.coupling.conditions.observed import own_work


@pytest.mark.parametrize("waits_until_s", [0.0, 12.0, 25.0])
def test_own_work_is_as_long_as_it_is_where_he_waits_too(waits_until_s: float) -> None:
    rng = np.random.default_rng(0)
    work_s, event_s = rng.uniform(4.0, 30.0, 2000), rng.uniform(0.0, waits_until_s, 2000)
    stays_s, ends_s = np.maximum(work_s, event_s), rng.uniform(0.0, 50.0, 2000)
    seen, none = stays_s < ends_s, np.zeros(0)
    gate = Gate("operator", "leave", "bench")
    found = Departures(gate, none, none, none, none, none, none, stayed_s=ends_s[~seen])
    found.since_s[gate, Condition(("robot", "bench", "leaves"), 0)] = stays_s[seen] - event_s[seen]
    own_s = own_work(found, stays_s[seen], work_s[seen] >= event_s[seen])
    assert np.mean(own_s) == pytest.approx(17.0, rel=0.04)
