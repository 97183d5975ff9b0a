"""A small simulated cell of two products with different process times at the same place."""

from __future__ import annotations

import pytest
from made_once import made_once, simulated

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit_sim.options import Product

P = Product(("home", "conveyor", "left_1", "conveyor", "right_1", "home"), {"conveyor": 4.0})
Q = Product(("home", "conveyor", "right_1", "home"), {"conveyor": 9.0})


@pytest.fixture(scope="module")
def products(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Fourteen executions of the box-picking cell, of two products in turn."""
    logs = simulated(tmp_path_factory, "box-picking", 14, seed=6, products=(P, Q))
    made = made_once(tmp_path_factory, "two_products", lambda place: ingest([logs], place / "dataset"))
    return Dataset.open(made / "dataset")
