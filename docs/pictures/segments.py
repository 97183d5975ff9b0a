"""Draw what was found in robot logs: speed over time, motions between places, and the inferred scaling.

    python docs/pictures/segments.py LOGS... --out docs/pictures/segments.png

Each LOGS is a folder that `cyclekit ingest` reads; it is ingested into a temporary folder.
"""

from __future__ import annotations

import argparse
import io
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
import polars as pl
from PIL import Image

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest

mpl.use("Agg")
import matplotlib.pyplot as plt

COLOURS = ("#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442", "#0072b2")  # Okabe and Ito 2008


def draw(axes: plt.Axes, logs: Path, title: str) -> None:
    """Draw one folder of logs."""
    with tempfile.TemporaryDirectory() as scratch:
        dataset = Dataset.open(ingest([logs], Path(scratch) / "dataset").dataset)
        robot = next(file for file in sorted(dataset.path.glob("recordings/*/robot.parquet")))
        log, tasks, samples = pl.read_parquet(robot), dataset.tasks(), dataset.samples()
    axes.plot(log["t_s"], log["tcp_speed_m_s"], color="0.15", lw=1.0, label="TCP speed")
    names = tasks["task"].unique(maintain_order=True).to_list()
    for row in tasks.iter_rows(named=True):
        colour = COLOURS[names.index(row["task"]) % len(COLOURS)]
        axes.axvspan(row["start_s"], row["arrival_s"], color=colour, alpha=0.35, lw=0)
        middle = 0.5 * (row["start_s"] + row["arrival_s"])
        axes.text(middle, 0.06, row["task"].replace("->", " → "), ha="center", fontsize=8)
    known = samples.filter(pl.col("scaling").is_not_null())
    if known.height:
        times, values = known["t_s"].to_numpy(), known["scaling"].to_numpy().copy()
        values[np.flatnonzero(np.diff(times) > 0.5)] = np.nan
        right = axes.twinx()
        right.plot(times, values, color="#d55e00", lw=1.6, ls="--")
        right.set_ylim(0.0, 1.08)
        right.set_ylabel("speed override, inferred (dashed)", color="#d55e00", fontsize=8)
    axes.set(title=title, xlabel="time in s", ylabel="TCP speed in m/s", xlim=(0.0, float(log["t_s"][-1])))
    axes.set_ylim(0.0, None)


def main() -> None:
    """Draw each folder under the other."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("logs", type=Path, nargs="+")
    ask.add_argument("--out", type=Path, required=True)
    given = ask.parse_args()
    figure, rows = plt.subplots(len(given.logs), 1, figsize=(9.0, 2.7 * len(given.logs)), squeeze=False)
    for axes, logs in zip(rows[:, 0], given.logs, strict=True):
        draw(axes, logs, logs.name)
    figure.tight_layout()
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110)
    image = Image.open(buffer).convert("RGB").quantize(64, dither=Image.Dither.NONE)
    image.save(given.out, optimize=True)


if __name__ == "__main__":
    main()
