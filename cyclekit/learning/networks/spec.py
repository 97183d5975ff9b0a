"""What to train: the problem, the network, and the settings of the training run.

Which networks there are is said by `networks`. What differs from the paper is an option with its own name, and its
default says whether it was measured better.
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
"""What a recurrent network sees where nothing else is asked for: six samples over one second, fewer where the rate is
less than 5 Hz."""
HORIZON_S: Mapping[str, float] = {"now": 0.0, "ahead": 2.0, "average": 14.0}
"""Horizon where none is given: that of the paper's figures."""
MUON_ROWS = 100_000
"""From this many rows to learn from on Muon is the default for `now` and `ahead`. Measured for `now`, MSE x 1e4: 3.4
with AdamW and 2.2 with Muon on 700 000 rows, 3.3 and 2.1 on 140 000, but 5.5 and 7.4 on 28 000. For averages, most
of which is the operator's luck, Muon is 1 % worse."""
FREEZE_NORM_AFTER: Mapping[str, float] = {"muon": 0.1, "adamw": 0.25}
"""Where no part of the run is given, by optimiser."""


class RunSettings(TypedDict, total=False):
    """Numbers of a training run that `ModelSpec.of` takes; what they mean stands with the attributes of `ModelSpec`."""

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
    """One training run, resolved. Use `ModelSpec.of` to have the defaults filled in.

    Attributes:
        problem: `now`, `ahead` or `average`.
        network: One of `networks.networks_for(problem)`.
        horizon_s: How far the target lies ahead or reaches; 0 for `now`.
        hidden: Widths of the hidden layers.
        norm: `batch` normalises inside the network as the paper does; `none` leaves that out.
        seed: Of the split, the first weights and the order of the rows. Same data and seed, same model (on a CPU).
        epochs: Passes over the training rows, None for as many as the rows need (see `fitting`); the learning rate
            rises and falls once over all of them.
        patience: Epochs without a better validation error after which training stops; None = never: the learning rate
            falls to the end, and the last epochs gain most. The best epoch's weights are kept in either case.
        batch: Rows per step.
        learning_rate: The highest learning rate of the run.
        test_fraction: Part of the executions held out to judge by.
        validation_fraction: Part of the remaining executions that decides which epoch's weights are kept.
        noise_m: Noise of the operator's position, standard deviation per axis, m, that is added afresh to every row
            in every epoch: for logs that are cleaner than what the model will be asked about.
        optimiser: `muon` for the square matrices and AdamW for the rest (Jordan et al. 2024), `adamw` for all, or
            `auto` for the one that was measured better for the problem and that many rows (`MUON_ROWS`).
        features: `distance` gives the network ||x_r - x_h|| beside the positions. The paper's networks see `positions`
            only. With `past` a network that sees a history also gets `last_second.PAST`. `auto` is the distance for
            `now` and the past for trees, see `with_features`.
        target: What `now` learns. `commanded` is the level that the safety system heads for: what was read of its
            response (reaction time, ramps) is undone, and applied again where cycles are simulated. `logged` is the
            scaling at that instant, as in the paper. `auto` is `commanded` for a network that names levels.
        balance: `classes` weighs every level alike in a classifier's loss, however rare; its probabilities then say
            nothing about how often a level is in force, so `none` is the default.
        history: Samples that a recurrent network sees, and rows between them; (1, 1) for the others. None for the
            usual ones at the rate of the dataset, see `at_rate`.
        forecast_weight: How much `lstm-2` is held to forecast where the operator will be, beside the scaling: weight of
            that squared error, in standard deviations.
        weight_decay: How strongly weights are drawn to zero (as AdamW), None for what suits the number of rows.
        freeze_norm_after: Part of the run after which batch normalisation keeps its statistics; 1 = never, as usual;
            None for what suits the optimiser.
            Statistics that change with every batch shake the boundaries between levels, which is what limits the
            network in the end; with the default the error is less than half as large after the same time.
        centre: Shift the output of a network that answers with a value so that its mean error over the rows it learned
            from is zero: the epoch that is kept may come from the middle of the run, where every step moves the mean.
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
        """What its network is."""
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
        """Return a spec with the paper's network, widths and horizon where none are given.

        `settings` are the numbers of the training run (seed, epochs, batch, ...), as the attributes of this class.

        Raises:
            UnknownName: There is no such problem, network or setting.
            ConfigError: They do not go together, or a number is out of its range.
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
        """Return what a model's card says of it."""
        told = {name: value for name, value in asdict(self).items() if value is not None}
        return SpecCard(**told)

    def at_rate(self, rate_hz: float) -> ModelSpec:
        """Return this with the history that a recurrent network sees of samples of that rate, where none was given."""
        if self.history is not None:
            return self
        every = samples_in(HISTORY_S / (HISTORY - 1), rate_hz)
        count = min(HISTORY, samples_in(HISTORY_S, rate_hz) // every + 1)
        return replace(self, history=(max(count, 2), every) if self.kind.sees_history else (1, 1))

    def with_features(self) -> ModelSpec:
        """Return this with what the network sees, where that was left open: the distance too for `now`, else positions.

        Measured with few executions, by fresh ones: the distance lowers the error where the safety function is one of
        the distance, where it is one of zones, and where it is both (docs/models.md).
        """
        if self.features != "auto":
            return self
        other: Features = "past" if self.kind.trees else "positions"
        return replace(self, features="distance" if self.problem == "now" else other)

    def for_rows(self, count: int) -> ModelSpec:
        """Return this with the optimiser for `count` training rows, and its default of `freeze_norm_after`."""
        best: Optimiser = "muon" if self.problem != "average" and count >= MUON_ROWS else "adamw"
        optimiser = best if self.optimiser == "auto" else self.optimiser
        after = FREEZE_NORM_AFTER[optimiser] if self.freeze_norm_after is None else self.freeze_norm_after
        return replace(self, optimiser=optimiser, freeze_norm_after=after)


def check_network(problem: str, network: str) -> None:
    """Refuse a network that does not exist or does not suit the problem.

    Raises:
        UnknownName: There is no such problem or network.
        ConfigError: The network exists but not for this problem.
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
