"""Numbers of the comparison, those of the paper and additional ones: one `Entry` per number of a table."""

from __future__ import annotations

from dataclasses import dataclass

Settings = tuple[tuple[str, str], ...]

SCENES = ("box-picking", "pick-and-package", "laser-zones")
DELTAS_M = (0.0, 0.02, 0.05)
AHEAD_S, AVERAGES_S = 2.0, (14.0, 19.0)
PLAIN, SLOWER = (("norm", "none"),), (("optimiser", "adamw"),)
OURS = (("features", "distance"), ("norm", "none"))
"""Our settings for the present scaling; ahead, the present distance helps less, and LSTMs have positions only."""
RIVALS = ("persistence", "distance staircase", "gradient boosting", "MLP")
RIVALS_AHEAD = (*RIVALS, "gradient boosting, last second")
"""Rivals for the scaling ahead: also trees with the inputs of recurrent networks, one second of history."""
FLOORS = ("true staircase, noisy position", "Bayes estimate, flat prior")
PAPER = {
    ("now", 0.0, "classifier"): 3.32e-4,
    ("now", 0.02, "classifier"): 8.23e-4,
    ("now", 0.05, "classifier"): 21.7e-4,
    ("now", 0.0, "regressor"): 2.59e-4,
    ("now", 0.02, "regressor"): 7.01e-4,
    ("now", 0.05, "regressor"): 15.2e-4,
    ("ahead", 0.0, "classifier"): 5.44e-3,
    ("ahead", 0.0, "regressor"): 8.92e-3,
    ("ahead", 0.0, "lstm-1"): 78.6e-3,
    ("ahead", 0.0, "lstm-2"): 71.9e-3,
}
"""MSE in Tables I and II of the paper (arXiv 2512.17579), by problem, tracker noise in m, and network."""


@dataclass(frozen=True)
class Entry:
    """One number: a network, a rival or a floor for one problem at one tracker noise.

    Attributes:
        problem: `now`, `ahead` or `average`.
        horizon_s: 0 for `now`.
        delta_m: Noise of the operator's position, standard deviation per axis, m.
        name: Name of a network, or one of `RIVALS_AHEAD` and `FLOORS`.
        settings: Values of `ModelSpec` that differ from the default, as sorted pairs; empty for rivals and floors.
    """

    problem: str
    horizon_s: float
    delta_m: float
    name: str
    settings: Settings = ()

    @property
    def is_network(self) -> bool:
        """Whether the entry is a network to train."""
        return self.name not in (*RIVALS_AHEAD, *FLOORS)

    @property
    def shown(self) -> str:
        """Name in a table."""
        said = {"norm=none": "no normalisation", "optimiser=adamw": "AdamW", "features=distance": "distance"}
        differs = [said.get(f"{key}={value}", f"{key} {value}") for key, value in self.settings]
        return ", ".join([self.name, *sorted(differs)])

    @property
    def key(self) -> str:
        """File name of the result, without suffix."""
        words = [self.problem, f"{self.horizon_s:g}s", f"{self.delta_m:g}m", self.name.replace(",", ""), *(
            f"{key}-{value}" for key, value in self.settings
        )]  # fmt: skip
        return "_".join(words).replace(" ", "-")


def entries() -> list[Entry]:
    """Return all numbers of one scene and seed, those of the paper's tables first."""
    found = []
    for delta_m in DELTAS_M:
        names: list[tuple[str, Settings]] = [("classifier", OURS), ("classifier", ()), ("regressor", ())]
        names += [("regressor", OURS), ("classifier", PLAIN), ("regressor", PLAIN), ("classifier", SLOWER)]
        names += [("regressor", SLOWER)]
        found += [Entry("now", 0.0, delta_m, name, settings) for name, settings in names]
        found += [Entry("now", 0.0, delta_m, name) for name in (*FLOORS, *RIVALS)]
    names = [("classifier", ()), ("regressor", ()), ("lstm-1", ()), ("lstm-2", ()), ("classifier", PLAIN)]
    names += [("regressor", PLAIN), ("lstm-1", PLAIN), ("lstm-2", PLAIN)]
    found += [Entry("ahead", AHEAD_S, 0.0, name, settings) for name, settings in names]
    found += [Entry("ahead", AHEAD_S, 0.0, name) for name in RIVALS_AHEAD]
    for horizon_s in AVERAGES_S:
        names = [("mixed", ()), ("regressor", ()), ("mixed", PLAIN), ("regressor", PLAIN)]
        found += [Entry("average", horizon_s, 0.0, name, settings) for name, settings in names]
        found += [Entry("average", horizon_s, 0.0, name) for name in RIVALS_AHEAD]
    return found
