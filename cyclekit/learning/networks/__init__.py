"""Networks: definition (`spec`, `network`), storage (`saved`) and evaluation (`metrics`).

torch is imported only for training. A saved model predicts with numpy alone, so estimates, replays and reports need no
torch.
"""

from __future__ import annotations

from cyclekit.learning.networks.metrics import measure
from cyclekit.learning.networks.saved import MODEL_VERSION, TrainedModel, load_model, save_model
from cyclekit.learning.networks.spec import ModelSpec

__all__ = ["MODEL_VERSION", "ModelSpec", "TrainedModel", "load_model", "measure", "save_model"]
