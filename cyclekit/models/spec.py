"""What to train: the problem, the network, and the settings of the training run.

    now      classifier, regressor
    ahead    classifier, regressor
    average  mixed, regressor

The paper's recurrent networks (`lstm-1`, `lstm-2`) are known by name and refused: they are not there yet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

from cyclekit.errors import ConfigError, UnknownName
from cyclekit.samples import PROBLEMS

if TYPE_CHECKING:
    from collections.abc import Mapping

Norm = Literal["batch", "none"]

NETWORKS: Mapping[str, tuple[str, ...]] = {
    "now": ("classifier", "regressor"),
    "ahead": ("classifier", "regressor"),
    "average": ("mixed", "regressor"),
}
"""Networks that can be trained for each problem, the default first."""
HIDDEN: Mapping[str, tuple[int, ...]] = {
    "classifier": (64,) * 4,
    "regressor": (64,) * 5,
    "mixed": (64,) * 5,
}
"""Widths of the hidden layers in the paper; `mixed` has a sixth, as wide as there are levels."""
HORIZON_S: Mapping[str, float] = {"now": 0.0, "ahead": 2.0, "average": 14.0}
"""Horizon where none is given: that of the paper's figures."""
_ABSENT = ("lstm-1", "lstm-2")


@dataclass(frozen=True, kw_only=True)
class ModelSpec:
    """One training run, resolved. Use `ModelSpec.of` to have the defaults filled in.

    Attributes:
        problem: `now`, `ahead` or `average`.
        network: One of `NETWORKS[problem]`.
        horizon_s: How far the target lies ahead or reaches; 0 for `now`.
        hidden: Widths of the hidden layers.
        norm: `batch` normalises inside the network as the paper does; `none` leaves that out.
        seed: Of the split, the first weights and the order of the rows. Same data and seed, same model (on a CPU).
        epochs: Passes over the training rows, None for as many as the rows need (about 6000 steps); the learning rate
            rises and falls once over all of them.
        batch: Rows per step.
        learning_rate: The highest learning rate of the run.
        test_fraction: Part of the executions held out to judge by.
        validation_fraction: Part of the remaining executions that decides which epoch's weights are kept.
        weight_decay: How strongly weights are drawn to zero (as AdamW), None for what suits the number of rows.
        freeze_norm_after: Part of the run after which batch normalisation keeps its statistics; 1 = never, as usual.
            Statistics that change with every batch shake the boundaries between levels, which is what limits the
            network in the end; with the default the error is less than half as large after the same time.
    """

    problem: str
    network: str
    horizon_s: float
    hidden: tuple[int, ...]
    norm: Norm = "batch"
    seed: int = 0
    epochs: int | None = None
    batch: int = 1024
    learning_rate: float = 6e-3
    test_fraction: float = 0.2
    validation_fraction: float = 0.1
    freeze_norm_after: float = 0.25
    weight_decay: float | None = None

    def __post_init__(self) -> None:
        """Check what was asked for, before any data is read.

        Raises:
            UnknownName: There is no such problem, network or norm.
            ConfigError: Network or horizon do not suit the problem, or a number is out of its range.
        """
        check_network(self.problem, self.network)
        if self.norm not in get_args(Norm):
            raise UnknownName("the model", "norm", self.norm, get_args(Norm))
        if not math.isfinite(self.horizon_s) or self.horizon_s < 0 or (self.horizon_s == 0) != (self.problem == "now"):
            msg = f"problem {self.problem!r} with a horizon of {self.horizon_s} s"
            cure = "`now` has no horizon." if self.problem == "now" else "Give one in seconds, for example 2s or 14s."
            raise ConfigError(msg, cure=cure)
        if not self.hidden or min(*self.hidden, self.epochs or 1) < 1 or self.batch < 2 or not self.learning_rate > 0:
            msg = f"hidden {self.hidden}, epochs {self.epochs}, batch {self.batch}, rate {self.learning_rate}"
            raise ConfigError(msg, cure="All must be positive, and a batch needs at least two rows.")
        parts = (self.test_fraction, self.validation_fraction, self.freeze_norm_after)
        if (
            not all(0 < part < 1 for part in parts[:2])
            or not 0 <= parts[2] <= 1
            or self.seed < 0
            or not (self.weight_decay or 0) >= 0
        ):
            msg = f"test, validation and freezing part {parts}, seed {self.seed}, weight decay {self.weight_decay}"
            raise ConfigError(msg, cure="Parts lie between 0 and 1; seed and weight decay are not negative.")

    @classmethod
    def of(
        cls,
        problem: str = "now",
        network: str | None = None,
        horizon_s: float | None = None,
        *,
        hidden: tuple[int, ...] | None = None,
        norm: Norm = "batch",
        **settings: float | None,
    ) -> ModelSpec:
        """Return a spec with the paper's network, widths and horizon where none are given.

        `settings` are the numbers of the training run (seed, epochs, batch, ...), as the attributes of this class.
        """
        if problem not in NETWORKS:
            raise UnknownName("the model", "problem", problem, PROBLEMS)
        network = network or NETWORKS[problem][0]
        check_network(problem, network)
        horizon_s = HORIZON_S[problem] if horizon_s is None else horizon_s
        fields = {"hidden": hidden or HIDDEN[network], "norm": norm, **settings}
        return cls(problem=problem, network=network, horizon_s=horizon_s, **fields)  # type: ignore[arg-type]


def check_network(problem: str, network: str) -> None:
    """Refuse a network that does not exist or does not suit the problem.

    Raises:
        UnknownName: There is no such problem or network.
        ConfigError: The network exists but not for this problem, or not in this version.
    """
    if problem not in NETWORKS:
        raise UnknownName("the model", "problem", problem, PROBLEMS)
    suits = ", ".join(NETWORKS[problem])
    if network in _ABSENT:
        msg = f"network {network!r} is not part of this version of cyclekit"
        raise ConfigError(msg, cure=f"For problem {problem!r} there are: {suits}.")
    if network not in HIDDEN:
        raise UnknownName("the model", "network", network, HIDDEN, cure=f"For problem {problem!r} there are: {suits}.")
    if network not in NETWORKS[problem]:
        msg = f"network {network!r} does not solve problem {problem!r}"
        raise ConfigError(msg, cure=f"For problem {problem!r} there are: {suits}.")
