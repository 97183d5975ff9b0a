"""The networks by name: each is a module of this folder and a line here.

torch is imported only when a network is built.
"""

from __future__ import annotations

from cyclekit.learning.networks.kinds.boosting import BOOSTING
from cyclekit.learning.networks.kinds.classifier import CLASSIFIER
from cyclekit.learning.networks.kinds.kind import Inputs, Network
from cyclekit.learning.networks.kinds.lstm_1 import LSTM_1
from cyclekit.learning.networks.kinds.lstm_2 import LSTM_2
from cyclekit.learning.networks.kinds.mixed import MIXED
from cyclekit.learning.networks.kinds.regressor import REGRESSOR

__all__ = ["NETWORKS", "Inputs", "Network", "is_classifier", "networks_for"]

NETWORKS: dict[str, Network] = {each.name: each for each in (CLASSIFIER, MIXED, REGRESSOR, LSTM_1, LSTM_2, BOOSTING)}
"""All networks; the first one for a problem is its default."""


def networks_for(problem: str) -> tuple[str, ...]:
    """Return the names of the networks for a problem, the default first; none for an unknown problem."""
    return tuple(name for name, each in NETWORKS.items() if problem in each.problems)


def is_classifier(network: str) -> bool:
    """Return whether a network, known or not, predicts the probability of each level."""
    return network in NETWORKS and NETWORKS[network].is_classifier
