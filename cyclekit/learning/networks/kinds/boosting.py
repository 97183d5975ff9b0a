"""`boosting`: gradient-boosted trees on the last second, including past scaling; selected like a network."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

from cyclekit.learning.networks.kinds.kind import Inputs, Network, Widths

if TYPE_CHECKING:
    from collections.abc import Sequence


def _build(spec: Widths, inputs: Inputs, levels: Sequence[float]) -> NoReturn:
    raise NotImplementedError  # `boosting.fit_trees` grows them


BOOSTING = Network("boosting", ("ahead",), (), _build, trees=True, least_hidden=0)
