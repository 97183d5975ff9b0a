"""A log as one table: its rows as they are, or averaged without looking across gaps."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st
from polars.testing import assert_frame_equal

from cyclekit.errors import ConfigError, LogError, UnknownName
from cyclekit.ingest.convert import Thinner, convert
from cyclekit.schema import ROBOT, conform


def averaged(frame: pl.DataFrame, cuts: list[int], rate_hz: float = 10.0) -> pl.DataFrame:
    thin, edges = Thinner(rate_hz), [0, *sorted(cuts), frame.height]
    parts = [thin.add(frame[a:b]) for a, b in pairwise(edges) if b > a]
    return pl.concat([*parts, thin.rest()])


def robot(t_s: Any, **columns: Any) -> pl.DataFrame:
    return conform(pl.DataFrame({"t_s": np.asarray(t_s, float), **columns}), ROBOT)


def test_every_row_of_a_log_comes_through(tmp_path: Path, robot_log: Any):
    log = robot_log(tmp_path / "run.csv", [("stand", 0.5), ("move", 0.3)])
    done = convert(log, tmp_path / "run.parquet")
    table = pl.read_parquet(tmp_path / "run.parquet")
    rows = len(log.read_text(encoding="utf-8").splitlines()) - 1
    assert (done.table, done.rows, table.height, done.adapter) == ("robot", rows, rows, "ur-rtde")
    assert table["tcp_x_m"].max() == pytest.approx(0.3)
    convert(log, tmp_path / "run.csv.csv", columns=["tcp_x_m"])
    same = pl.read_csv(tmp_path / "run.csv.csv")
    assert same.columns == ["t_s", "tcp_x_m"]
    assert same["tcp_x_m"].to_list() == pytest.approx(table["tcp_x_m"].to_list())


def test_columns_that_nobody_asks_for_are_not_read_and_those_asked_for_are_the_same(tmp_path: Path, robot_log: Any):
    log = robot_log(tmp_path / "run.csv", [("stand", 0.5), ("move", 0.3)])
    convert(log, tmp_path / "all.parquet")
    every = pl.read_parquet(tmp_path / "all.parquet")
    for columns in (["tcp_y_m"], ["scaling", "state"], ["slider"], ["source_row"], ["tcp_speed_m_s", "q2_rad"]):
        known = [name for name in columns if name in every.columns]
        done = convert(log, tmp_path / "some.parquet", columns=known)
        assert_frame_equal(pl.read_parquet(tmp_path / "some.parquet"), every.select("t_s", *known))
        assert done.warnings == ()
    lines = log.read_text(encoding="utf-8").splitlines()
    cells = lines[0].replace(",", " ").split()
    place = cells.index("speed_scaling")
    mark = "," if "," in lines[0] else " "
    broken = lines[7].split(mark)
    broken[place] = "x7"
    lines[7] = mark.join(broken)
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert convert(log, tmp_path / "some.parquet", columns=["scaling"]).rows_set_aside == 1
    assert convert(log, tmp_path / "some.parquet", columns=["tcp_x_m"]).rows_set_aside == 0


def test_numbers_are_averaged_and_words_are_those_in_force_at_the_end():
    frame = robot(
        [0.0, 0.04, 0.08, 0.1, 0.19], scaling=[1.0, 0.5, None, 0.2, 0.4], state=["playing"] * 2 + ["paused"] * 3
    )
    found = averaged(frame, [])
    assert found["t_s"].to_list() == pytest.approx([0.04, 0.145])
    assert found["scaling"].to_list() == pytest.approx([0.75, 0.3])
    assert found["state"].to_list() == ["paused", "paused"]


def test_nothing_is_averaged_across_a_gap_or_a_restart_of_the_clock():
    t = [0.90, 0.92, 0.94, 0.96, 7.01, 7.03, 0.91, 0.93, 0.95]
    found = averaged(robot(t, tcp_x_m=[0.0] * 4 + [1.0] * 2 + [2.0] * 3), [])
    assert found["tcp_x_m"].to_list() == [0.0, 1.0, 2.0]


@at_most(60)
@given(
    st.lists(st.sampled_from([0.008, 0.004, 0.1, 3.0, -0.5]), min_size=1, max_size=80),
    st.lists(st.integers(0, 80), max_size=5),
    st.sampled_from([1.0, 10.0, 33.0]),
)
def test_an_average_does_not_depend_on_where_the_log_was_cut_into_parts(
    steps: list[float], cuts: list[int], rate: float
):
    t = np.concatenate([np.arange(5) * 0.008, 0.04 + np.cumsum(steps)])
    frame = robot(t, tcp_x_m=np.sin(37 * np.arange(len(t))), source_row=np.arange(len(t)))
    whole = averaged(frame, [], rate)
    in_parts = averaged(frame, [5, *(c for c in cuts if 5 < c < len(t))], rate)
    assert in_parts["source_row"].to_list() == whole["source_row"].to_list()
    np.testing.assert_allclose(in_parts["tcp_x_m"], whole["tcp_x_m"], atol=1e-12)
    counts = np.diff([-1, *whole["source_row"].to_list()])
    assert float((whole["tcp_x_m"] * counts).sum()) == pytest.approx(float(frame["tcp_x_m"].sum()), abs=1e-9)


def test_people_are_kept_apart(tmp_path: Path):
    lines = ["frame,id,x,y"] + [f"{n},{p},{p + 0.01 * n},{0.1 * (n % 2)}" for n in range(40) for p in (1, 2)]
    (tmp_path / "crowd.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    from cyclekit.config import Cell, Source

    cell = Cell(sources=(Source("crowd.csv", rate_hz=20.0),))
    convert(tmp_path / "crowd.csv", tmp_path / "slow.parquet", rate_hz=10.0, cell=cell)
    found = pl.read_parquet(tmp_path / "slow.parquet")
    assert found.filter(pl.col("person") == "1")["x_m"].to_list() == pytest.approx(
        [1.005 + 0.02 * k for k in range(20)]
    )
    assert found.filter(pl.col("person") == "2")["y_m"].to_list() == pytest.approx([0.05] * 20)


def test_what_cannot_be_followed_is_refused_and_the_old_file_stays(tmp_path: Path, robot_log: Any):
    log, out = robot_log(tmp_path / "run.csv", [("stand", 0.5), ("move", 0.3)]), tmp_path / "out.parquet"
    convert(log, out, rate_hz=5.0)
    before = out.read_bytes()
    with pytest.raises(LogError, match="has no table 'people'; its tables: robot"):
        convert(log, out, table="people")
    with pytest.raises(UnknownName, match="tcp_w_m"):
        convert(log, out, columns=["tcp_w_m"])
    with pytest.raises(UnknownName, match="robots"):
        convert(log, out, table="robots")
    with pytest.raises(ConfigError, match="rate"):
        convert(log, out, rate_hz=-1.0)
    with pytest.raises(ConfigError, match="not known"):
        convert(log, tmp_path / "out.xlsx")
    assert out.read_bytes() == before
    assert sorted(file.name for file in tmp_path.iterdir()) == ["out.parquet", "run.csv"]


def test_a_file_that_is_not_there_is_said_to_be_missing(tmp_path: Path):
    with pytest.raises(LogError, match="no such file or folder"):
        convert(tmp_path / "no.csv", tmp_path / "x.csv")
