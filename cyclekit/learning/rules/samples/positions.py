"""Positions and signals by which regions are tested."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from cyclekit.schema import Vector


@dataclass(frozen=True)
class Positions:
    """Positions of robot and operator at N instants.

    Attributes:
        apart_m: Distances by name, (N,), m; infinite without an operator.
        floor_m: The operator on the floor, (N, 2), m; NaN without an operator.
        tcp_m: The TCP on the floor, (N, 2), m.
        signals: Values as text by name and delay of the signal, (N,), delayed by that.
    """

    apart_m: Mapping[str, Vector]
    floor_m: NDArray[np.float64]
    tcp_m: NDArray[np.float64]
    signals: Mapping[tuple[str, float], NDArray[np.str_]] = field(default_factory=dict)

    def where(self, keep: NDArray[np.bool_] | NDArray[np.int64]) -> Positions:
        """Return a subset of the instants."""
        apart = {name: values[keep] for name, values in self.apart_m.items()}
        signals = {name: values[keep] for name, values in self.signals.items()}
        return Positions(apart, self.floor_m[keep], self.tcp_m[keep], signals)
