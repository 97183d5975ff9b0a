"""How the weights are moved: AdamW, or Muon for the square matrices, with a learning rate that rises and falls once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from cyclekit.errors import ConfigError

if TYPE_CHECKING:
    from torch import nn

    from cyclekit.models.spec import ModelSpec

_MUON_RATE = 0.02
"""Highest rate of Muon; its steps are orthogonal matrices, so their size does not depend on the gradient's."""


class Steps:
    """The optimisers of one training run with their schedules."""

    def __init__(self, network: nn.Module, spec: ModelSpec, decay: float, total: int) -> None:
        """Prepare `total` steps.

        Raises:
            ConfigError: Muon was asked for and this torch has none.
        """
        square: list[nn.Parameter] = []
        if spec.optimiser == "muon":
            if not hasattr(torch.optim, "Muon"):
                msg = f"torch {torch.__version__} has no Muon optimiser"
                raise ConfigError(msg, cure="Install torch 2.9 or newer, or train with the optimiser adamw.")
            width = spec.hidden[-1]
            square = [p for p in network.parameters() if p.shape == (width, width)]
        mine = {id(p) for p in square}
        rest = [p for p in network.parameters() if id(p) not in mine]
        rate = spec.learning_rate
        parts: list[tuple[torch.optim.Optimizer, float]] = [
            (torch.optim.AdamW(rest, lr=rate, weight_decay=decay, fused=True), rate)
        ]
        if square:
            muon = torch.optim.Muon(square, lr=_MUON_RATE, weight_decay=decay * rate / _MUON_RATE)
            parts.append((muon, _MUON_RATE))
        self._optimisers = [optimiser for optimiser, _ in parts]
        self._schedules = [
            torch.optim.lr_scheduler.OneCycleLR(optimiser, most, total, pct_start=0.2, cycle_momentum=most == rate)
            for optimiser, most in parts
        ]

    def take(self, loss: torch.Tensor) -> None:
        """Take one step down the gradient of `loss`."""
        for optimiser in self._optimisers:
            optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        for optimiser, schedule in zip(self._optimisers, self._schedules, strict=True):
            optimiser.step()
            schedule.step()
