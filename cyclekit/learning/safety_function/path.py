"""Speed along the robot's path while a signal that detects people is on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cyclekit.learning.signal_inputs import as_inputs

if TYPE_CHECKING:
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.learning.networks.saved import TrainedModel
    from cyclekit.learning.rules.safety import RuleSafety
    from cyclekit.schema import Floats

PATH_M = 0.05
"""Width of a cell of the path, seen from above, m."""


def speeds_on_path(model: TrainedModel | RuleSafety, dataset: Dataset) -> tuple[Floats, dict[str, Floats]]:
    """Return the cells that the TCP was in, and the speed there while one signal alone is on.

    Args:
        model: Safety function on the dataset's signals.
        dataset: Dataset with the robot's path.

    Returns:
        Corners x, y, base frame, m, shape (C, 2), PATH_M wide; speed by name of the signal, 0 to 1, shape (C,).
    """
    places = dataset.samples(columns=["robot_x_m", "robot_y_m", "robot_z_m"]).drop_nulls().to_numpy()
    cells, code = np.unique(np.floor(places[:, :2] / PATH_M), axis=0, return_inverse=True)
    count = np.bincount(code.ravel())
    middle = np.stack([np.bincount(code.ravel(), places[:, axis]) / count for axis in range(3)], axis=1)
    signals = dataset.card.operator_signals
    on = {one.name: as_inputs(np.full(len(middle), 1 << k), len(signals)) for k, one in enumerate(signals)}
    speeds = {name: model.predict(np.hstack([middle, asked]).astype(np.float32)) for name, asked in on.items()}
    return cells * PATH_M, {name: np.clip(speed, 0.0, 1.0) for name, speed in speeds.items()}
