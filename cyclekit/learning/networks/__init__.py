"""The networks: what they are made of (`spec`, `network`), how they are kept (`saved`) and judged (`metrics`).

Only `network` imports torch. A saved model predicts with numpy alone, so that whoever estimates, replays or reports
needs no torch.
"""

from __future__ import annotations

from cyclekit.learning.networks.metrics import measure
from cyclekit.learning.networks.saved import MODEL_VERSION, TrainedModel, load_model, save_model
from cyclekit.learning.networks.spec import ModelSpec

__all__ = ["MODEL_VERSION", "ModelSpec", "TrainedModel", "load_model", "measure", "save_model"]
