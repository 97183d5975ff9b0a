"""The cell files of the page "KUKA with scanner bits" read logs of the clients that it shows."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from cyclekit.config import load_cell
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "kuka-scanner.md"
MAPPED, BESIDE, NAMED = re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
EVERY_MS, STARTED_MS, ENTERED = 12, 4_360_512, 1600


def rsi() -> pl.DataFrame:
    """An arm that goes to and fro between two places, 40 s, with the bits of two fields."""
    t_s = np.arange(3333) * EVERY_MS / 1000
    there = np.clip(np.abs((t_s / 4) % 2 - 1) * 1.5 - 0.25, 0.0, 1.0)
    axes = {f"A{axis}_AIPos": 10.0 * axis + 20.0 * there for axis in range(1, 7)}
    bits = {"DIN_WF": (np.arange(3333) >= ENTERED).astype(int), "DIN_PF": (np.arange(3333) < ENTERED + 300).astype(int)}
    place = {"X_RIst": 400.0 + 300.0 * there, "Y_RIst": np.zeros(3333), "Z_RIst": np.full(3333, 250.0)}
    ticks = STARTED_MS + EVERY_MS * np.arange(3333)
    return pl.DataFrame({"IPOC": ticks, **place, **axes, "OV_PRO": np.where(bits["DIN_WF"], 50, 100), **bits})


def ingested(folder: Path, cell: str) -> Dataset:
    file = folder / "cell.toml"
    file.write_text(cell, encoding="utf-8")
    return Dataset.open(ingest([folder / "logs"], folder / "dataset", cell=load_cell(file)).dataset)


def events(data: Dataset) -> pl.DataFrame:
    found = (data.recorded(one.id, "events") for one in data.recordings)
    return pl.concat([table for table in found if table is not None])


@pytest.fixture
def shift(tmp_path: Path) -> Path:
    (tmp_path / "logs" / "shift").mkdir(parents=True)
    return tmp_path / "logs" / "shift"


def test_bits_among_the_columns_are_events_and_the_override_is_read(shift: Path, tmp_path: Path) -> None:
    rsi().write_csv(shift / "rsi.csv")
    data = ingested(tmp_path, MAPPED + NAMED)
    assert data.samples()["scaling"].is_in([0.5, 1.0]).all()
    assert [(one.name, one.occupied) for one in data.card.operator_signals] == [("protective field", "0")]
    changes = events(data).filter(pl.col("signal") == "warning field").sort("t_s")
    assert changes["value"].to_list() == ["0", "1"]
    assert changes["t_s"][1] - changes["t_s"][0] == pytest.approx(ENTERED * EVERY_MS / 1000)


def test_bits_in_a_file_beside_are_on_the_clock_of_the_controller(shift: Path, tmp_path: Path) -> None:
    log = rsi()
    log.drop("OV_PRO", "DIN_WF", "DIN_PF").write_csv(shift / "rsi.csv")
    rows = [(STARTED_MS, "DIN_WF", 0), (STARTED_MS + EVERY_MS * ENTERED, "DIN_WF", 1)]
    pl.DataFrame(rows, schema=["IPOC", "input", "value"], orient="row").write_csv(shift / "inputs.csv")
    data = ingested(tmp_path, BESIDE)
    assert events(data)["t_s"].to_list() == pytest.approx([STARTED_MS / 1000, (STARTED_MS + EVERY_MS * ENTERED) / 1000])
    assert {one.clock.method for one in data.recordings if one.tables == ("events",)} == {"cell-file"}


def test_inputs_as_one_number_are_kept_as_a_bit_field(shift: Path, tmp_path: Path) -> None:
    log = rsi()
    log.with_columns(DIN=pl.col("DIN_WF") + 2 * pl.col("DIN_PF")).drop("DIN_WF", "DIN_PF").write_csv(shift / "rsi.csv")
    data = ingested(tmp_path, re.sub(r"tags = .*\nnames = .*", 'digital_in = "DIN"', MAPPED))
    (robot,) = (table for one in data.recordings if (table := data.recorded(one.id, "robot")) is not None)
    assert robot["digital_in_bits"].unique().sort().to_list() == [1, 2, 3]
