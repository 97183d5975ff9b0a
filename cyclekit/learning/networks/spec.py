"""What to train: the problem, the network, and the settings of the training run.

`kinds` lists the networks. Each difference from the paper is a named option; its default is the setting that was
measured better.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Literal, TypedDict, Unpack, get_args

from cyclekit.dataset.cards import SpecCard
from cyclekit.dataset.time_grid import samples_in
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.learning.networks.kinds import NETWORKS, Network, networks_for
from cyclekit.learning.windows import PROBLEMS

if TYPE_CHECKING:
    from collections.abc import Mapping

Norm = Literal["batch", "none"]
Balance = Literal["none", "classes"]
Optimiser = Literal["auto", "adamw", "muon"]
Features = Literal["auto", "positions", "distance", "past"]
Target = Literal["auto", "commanded", "logged"]

HISTORY, HISTORY_S = 6, 1.0
"""Default history of a recurrent network: number of samples and duration, s; fewer samples at rates below 5 Hz."""
HORIZON_S: Mapping[str, float] = {"now": 0.0, "ahead": 2.0, "average": 14.0}
"""Default horizon, s: that of the paper's figures."""
MUON_ROWS = 100_000
"""Number of training rows from which Muon is the default for `now` and `ahead`. Measured for `now`, MSE x 1e4: 3.4 with
AdamW and 2.2 with Muon on 700 000 rows, 3.3 and 2.1 on 140 000, but 5.5 and 7.4 on 28 000. For averages, which depend
mostly on chance events of the operator, Muon is 1 % worse."""
FREEZE_NORM_AFTER: Mapping[str, float] = {"muon": 0.1, "adamw": 0.25}
"""Default of `freeze_norm_after` by optimiser."""


class RunSettings(TypedDict, total=False):
    """Settings of a training run that `ModelSpec.of` accepts; see the attributes of `ModelSpec`."""

    seed: int
    epochs: int | None
    batch: int
    learning_rate: float
    test_fraction: float
    validation_fraction: float
    freeze_norm_after: float | None
    weight_decay: float | None
    patience: int | None
    noise_m: float
    optimiser: Optimiser
    features: Features
    target: Target
    balance: Balance
    history: tuple[int, int] | None
    forecast_weight: float
    centre: bool


@dataclass(frozen=True, kw_only=True)
class ModelSpec:
    """One training run with all settings. `ModelSpec.of` fills in the defaults.

    Attributes:
        problem: `now`, `ahead` or `average`.
        network: One of `kinds.networks_for(problem)`.
        horizon_s: Horizon of the target, or length of its average, s; 0 for `now`.
        hidden: Widths of the hidden layers.
        norm: `batch` for batch normalisation inside the network, as in the paper; `none` for none.
        seed: Seed of the split, the initial weights and the order of the rows. Same data and seed give the same model
            (on a CPU).
        epochs: Passes over the training rows; None to choose by the number of rows (see `fitting`). The learning rate
            rises and falls once over all of them.
        patience: Number of epochs without a better validation error after which training stops; None = never, because
            the learning rate falls to the end and the last epochs gain most. The best epoch's weights are kept in
            either case.
        batch: Rows per step.
        learning_rate: Maximum learning rate of the run.
        test_fraction: Share of the executions held out for evaluation.
        validation_fraction: Share of the remaining executions that selects the best epoch.
        noise_m: Standard deviation per axis, m, of noise that is added to the operator's position, drawn anew for every
            row and epoch; for logs with less noise than later inputs.
        optimiser: `muon` for the square matrices and AdamW for the rest (Jordan et al. 2024), `adamw` for all, or
            `auto` for the one measured better for the problem and the number of rows (`MUON_ROWS`).
        features: `positions` as in the paper; `distance` adds ||x_r - x_h||; `past` adds `last_second.PAST` for a
            network with a history. `auto` is the distance for `now` and the past for trees, see `with_features`.
        target: Target of `now`. `commanded` is the level commanded by the safety system: its response (reaction time,
            ramps) is removed, and applied again in simulated cycles. `logged` is the scaling at that instant, as in the
            paper. `auto` is `commanded` for a network that predicts levels.
        balance: `classes` gives every level the same total weight in a classifier's loss; its probabilities then ignore
            how frequent a level is, so the default is `none`.
        history: Number of samples that a recurrent network sees, and rows between them; (1, 1) for the others. None for
            the default at the rate of the dataset, see `at_rate`.
        forecast_weight: Weight, in the loss of `lstm-2`, of the squared error of the forecast position in standard
            deviations, relative to that of the scaling.
        weight_decay: Weight decay, as in AdamW; None to choose by the number of rows.
        freeze_norm_after: Share of the run after which batch normalisation keeps its statistics; 1 = never, as usual;
            None for the default of the optimiser. Statistics that change with every batch move the boundaries between
            levels, which limits the accuracy in the end; with the default the error is less than half as large after
            the same time.
        centre: Shift the output of a network that predicts a value so that its mean error over the training rows is
            zero; the best epoch may be from the middle of the run, where every step changes the mean.
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
    freeze_norm_after: float | None = None
    weight_decay: float | None = None
    patience: int | None = None
    noise_m: float = 0.0
    optimiser: Optimiser = "auto"
    features: Features = "auto"
    target: Target = "auto"
    balance: Balance = "none"
    history: tuple[int, int] | None = None
    forecast_weight: float = 0.02
    centre: bool = True

    def __post_init__(self) -> None:
        """Check the settings before any data is read.

        Raises:
            UnknownName: There is no such problem, network or norm.
            ConfigError: Network or horizon do not suit the problem, or a number is out of range.
        """
        check_network(self.problem, self.network)
        if self.norm not in get_args(Norm):
            raise UnknownName("the model", "norm", self.norm, get_args(Norm))
        if not math.isfinite(self.horizon_s) or self.horizon_s < 0 or (self.horizon_s == 0) != (self.problem == "now"):
            msg = f"problem {self.problem!r} with a horizon of {self.horizon_s} s"
            cure = "`now` has no horizon." if self.problem == "now" else "Give one in seconds, for example 2s or 14s."
            raise ConfigError(msg, cure=cure)
        if min((*self.hidden, self.epochs or 1)) < 1 or self.batch < 2 or not self.learning_rate > 0:
            msg = f"hidden {self.hidden}, epochs {self.epochs}, batch {self.batch}, rate {self.learning_rate}"
            raise ConfigError(msg, cure="All must be positive, and a batch needs at least two rows.")
        self._check_extras()
        parts = (self.test_fraction, self.validation_fraction, self.freeze_norm_after or 0.0)
        if (
            not all(0 < part < 1 for part in parts[:2])
            or not 0 <= parts[2] <= 1
            or self.seed < 0
            or not (self.weight_decay or 0) >= 0
        ):
            msg = f"test, validation and freezing part {parts}, seed {self.seed}, weight decay {self.weight_decay}"
            raise ConfigError(msg, cure="Shares must be between 0 and 1; seed and weight decay must not be negative.")

    def _check_extras(self) -> None:
        for name, kinds in (("balance", Balance), ("optimiser", Optimiser), ("features", Features), ("target", Target)):
            if getattr(self, name) not in get_args(kinds):
                raise UnknownName("the model", name, getattr(self, name), get_args(kinds))
        back = self.kind.sees_history
        count, every = self.history or ((2, 1) if back else (1, 1))
        suits = ["past"] if self.kind.trees else ["positions", "past" if back else "distance"]
        if self.features not in ("auto", *suits):
            msg = f"a {self.network} with features {self.features!r}"
            raise ConfigError(msg, cure=f"Its inputs are: {', '.join(suits)}.")
        if self.kind.trees and (self.noise_m or self.optimiser != "auto" or self.balance != "none"):
            msg = f"{self.network} with noise {self.noise_m} m, optimiser {self.optimiser}, balance {self.balance}"
            raise ConfigError(msg, cure="Leave these out: they are of networks.")
        if not (count > 1 if back else count == 1) or not 1 <= every <= 1000 or count > 1000:
            msg = f"a {self.network} with a history of {count} samples, {every} rows apart"
            cure = "Recurrent networks and boosting need 2 to 1000 samples; the others take one, (1, 1)."
            raise ConfigError(msg, cure=cure)
        if len(self.hidden) < self.kind.least_hidden:
            msg = f"{self.network} with {len(self.hidden)} hidden layers"
            raise ConfigError(msg, cure=f"It needs at least {self.kind.least_hidden}.")
        numbers = (self.noise_m, self.forecast_weight)
        if not all(0 <= number < math.inf for number in numbers) or (self.patience is not None and self.patience < 1):
            msg = f"noise {self.noise_m} m, forecast weight {self.forecast_weight}, patience {self.patience}"
            raise ConfigError(msg, cure="Noise and weight are not negative; patience is at least one epoch.")

    @property
    def kind(self) -> Network:
        """Description of its network."""
        return NETWORKS[self.network]

    @classmethod
    def of(
        cls,
        problem: str = "now",
        network: str | None = None,
        horizon_s: float | None = None,
        *,
        hidden: tuple[int, ...] | None = None,
        norm: Norm = "batch",
        **settings: Unpack[RunSettings],
    ) -> ModelSpec:
        """Return a spec with the paper's network, widths and horizon as defaults.

        `settings` are the numbers of the training run (seed, epochs, batch, ...), see the attributes of this class.

        Raises:
            UnknownName: There is no such problem, network or setting.
            ConfigError: The settings are incompatible, or a number is out of range.
        """
        if problem not in PROBLEMS:
            raise UnknownName("the model", "problem", problem, PROBLEMS)
        network = network or networks_for(problem)[0]
        check_network(problem, network)
        horizon_s = HORIZON_S[problem] if horizon_s is None else horizon_s
        if unknown := sorted(set(settings) - set(RunSettings.__annotations__)):
            raise UnknownName("ModelSpec.of", "setting", unknown[0], RunSettings.__annotations__)
        widths = hidden or NETWORKS[network].hidden
        return cls(problem=problem, network=network, horizon_s=horizon_s, hidden=widths, norm=norm, **settings)

    def card(self) -> SpecCard:
        """Return the settings for a model's card."""
        values = {name: value for name, value in asdict(self).items() if value is not None}
        return SpecCard(**values)

    def at_rate(self, rate_hz: float) -> ModelSpec:
        """Return this with the default history of its network at a sample rate, if none was given."""
        if self.history is not None:
            return self
        every = samples_in(HISTORY_S / (HISTORY - 1), rate_hz)
        count = min(HISTORY, samples_in(HISTORY_S, rate_hz) // every + 1)
        return replace(self, history=(max(count, 2), every) if self.kind.sees_history else (1, 1))

    def with_features(self) -> ModelSpec:
        """Return this with default inputs if none were given: the distance for `now`, else positions.

        Measured on new executions after training with few: the distance lowers the error for safety functions of the
        distance, of zones, and of both (docs/models.md).
        """
        if self.features != "auto":
            return self
        other: Features = "past" if self.kind.trees else "positions"
        return replace(self, features="distance" if self.problem == "now" else other)

    def for_rows(self, count: int) -> ModelSpec:
        """Return this with the optimiser for `count` training rows, and the default of `freeze_norm_after`."""
        best: Optimiser = "muon" if self.problem != "average" and count >= MUON_ROWS else "adamw"
        optimiser = best if self.optimiser == "auto" else self.optimiser
        after = FREEZE_NORM_AFTER[optimiser] if self.freeze_norm_after is None else self.freeze_norm_after
        return replace(self, optimiser=optimiser, freeze_norm_after=after)


def check_network(problem: str, network: str) -> None:
    """Refuse a network that does not exist or does not suit the problem.

    Raises:
        UnknownName: There is no such problem or network.
        ConfigError: The network does not suit this problem.
    """
    if problem not in PROBLEMS:
        raise UnknownName("the model", "problem", problem, PROBLEMS)
    suits = ", ".join(networks_for(problem))
    if network not in NETWORKS:
        raise UnknownName(
            "the model", "network", network, NETWORKS, cure=f"For problem {problem!r} there are: {suits}."
        )
    if problem not in NETWORKS[network].problems:
        msg = f"network {network!r} does not solve problem {problem!r}"
        raise ConfigError(msg, cure=f"For problem {problem!r} there are: {suits}.")
