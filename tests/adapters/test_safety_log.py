"""A safety system's log of itself: override and distance over time, and no positions."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import ConfigError, LogError
from cyclekit.ingest.registry import adapters
from cyclekit_adapters.formats.safety_log import ADAPTER

T0 = 1_684_429_047.5
SAMPLES = Path(os.environ.get("CYCLEKIT_SAMPLES", "absent")) / "cnr-override"


def read(path, **said):
    return ADAPTER.read(path, ReadOptions(map=said))


def table(path, *lines):
    path.write_text("\n".join(lines) + "\n")
    return path


def test_an_override_in_percent_becomes_a_fraction(tmp_path):
    path = table(tmp_path / "a.csv", ",Timestamp,Safe_Ovr", f"0,{T0},100.0", f"1,{T0 + 0.03},50", f"2,{T0 + 0.06},1")
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["safety-log"]
    log = read(path)
    assert log.safety["override"].to_list() == [1.0, 0.5, 0.01]
    assert log.safety["t_s"].to_list() == [T0, T0 + 0.03, T0 + 0.06]
    assert log.safety["source_row"].to_list() == [2, 3, 4]
    assert (log.clock, log.robot, log.people) == ("epoch", None, None)
    assert log.facts["override"] == "Safe_Ovr: percent"


def test_overrides_multiply(tmp_path):
    path = table(tmp_path / "a.csv", "time_s,speed_ovr,safe_ovr_1", "0,50,50", "1,100,30", "2,,30")
    assert read(path).safety["override"].to_list() == [0.25, 0.3, None]


def test_a_distance_may_be_called_so_in_the_name_of_the_file_alone(tmp_path):
    lines = [",Timestamp,Mean,Std,Recipe", f"0,{T0},1.9,0.1,run 0", f"1,{T0 + 0.06},0.4,0.0,run 1"]
    assert not ADAPTER.recognises(table(tmp_path / "temperature.csv", *lines))
    path = table(tmp_path / "distance_monitoring.csv", *lines)
    assert ADAPTER.recognises(path)
    log = read(path)
    assert log.safety["distance_m"].to_list() == [1.9, 0.4]
    assert log.safety["distance_sd_m"].to_list() == [0.1, 0.0]
    assert log.safety["execution"].to_list() == ["run 0", "run 1"]
    assert log.safety["override"].null_count() == 2


def test_override_and_distance_may_stand_in_one_log_in_millimetres(tmp_path):
    path = table(tmp_path / "a.csv", "Zeit [ms];Override;min_distance_mm", "0;100;1900,5", "40;50;400")
    log = read(path)
    assert log.safety.select("t_s", "override", "distance_m").rows() == [(0.0, 1.0, 1.9005), (0.04, 0.5, 0.4)]


@pytest.mark.parametrize(
    "header",
    [
        "time_s,override,x,y,z",
        "time_s,distance,heart_rate",
        "time_s,mean,std",
        "override,distance",
        "time_s,distortion",
        "time_s,q0,safe_ovr",
    ],
)
def test_what_holds_more_or_less_is_no_such_log(tmp_path, header):
    path = table(tmp_path / "distances.txt" if "mean" not in header else tmp_path / "a.csv", header, "1,2,3")
    assert not ADAPTER.recognises(path)


def test_an_override_that_could_be_a_fraction_is_refused_until_it_is_said(tmp_path):
    path = table(tmp_path / "a.csv", "time_s,override", "0,1", "1,0.5")
    with pytest.raises(LogError, match="never exceeds 1: it may be percent or a fraction"):
        read(path)
    assert read(path, override_max=1).safety["override"].to_list() == [1.0, 0.5]
    assert read(path, override_max=100).safety["override"].to_list() == [0.01, 0.005]


def test_a_robot_that_stands_all_the_time_is_no_doubt(tmp_path):
    path = table(tmp_path / "a.csv", "time_s,override", "0,0", "1,0")
    assert read(path).safety["override"].to_list() == [0.0, 0.0]


def test_values_that_cannot_be_are_unknown_and_counted(tmp_path):
    path = table(tmp_path / "a.csv", "time_s,override", "0,100", "1,-5", "2,130", "3,20")
    log = read(path)
    assert log.safety["override"].to_list() == [1.0, None, None, 0.2]
    assert "the override is below 0 or above full speed in 2 rows: unknown there" in log.warnings


def test_millimetres_taken_for_metres_are_named(tmp_path):
    path = table(tmp_path / "a.csv", "time_s,distance", "0,1900", "1,400")
    assert "distances reach 1900 m: check the unit and give length_unit" in read(path).warnings
    assert read(path, length_unit="mm").safety["distance_m"].to_list() == pytest.approx([1.9, 0.4])


def test_columns_of_other_names_are_named_in_the_map(tmp_path):
    path = table(tmp_path / "a.csv", "stamp_s,v_proz,abst", "0.5,100,1.5", "1,50,0.5")
    assert not ADAPTER.recognises(path)
    with pytest.raises(LogError, match="no columns for a time and for an override or a distance"):
        read(path)
    log = read(path, time="stamp_s", override="v_proz", distance="abst")
    assert log.safety.select("t_s", "override", "distance_m").rows() == [(0.5, 1.0, 1.5), (1.0, 0.5, 0.5)]
    with pytest.raises(LogError, match="no column 'v'"):
        read(path, time="stamp_s", override="v")
    with pytest.raises(ConfigError, match="unknown key 'overide'"):
        read(path, overide="v_proz")


@given(st.lists(st.tuples(st.integers(0, 10_000), st.integers(2, 100)), min_size=1, max_size=40))
def test_every_percent_comes_back_as_its_hundredth(tmp_path_factory, rows):
    lines = [f"{ms / 1000!r},{percent}" for ms, percent in rows]
    path = table(tmp_path_factory.mktemp("ovr") / "a.csv", "time_s,override", *lines)
    found = read(path).safety.select("t_s", "override").rows()
    assert found == [(ms / 1000, percent / 100) for ms, percent in rows]


@pytest.mark.skipif(not SAMPLES.is_dir(), reason="CYCLEKIT_SAMPLES names no folder")
def test_the_override_and_the_distance_of_a_research_cell():
    override = read(SAMPLES / "ovr_monitoring_safety_area.csv")
    assert override.safety.height == 28_466
    assert override.safety["override"].n_unique() == 101
    assert override.safety["t_s"].diff().median() == pytest.approx(1 / 30, rel=0.01)
    share = override.safety["override"].is_in([0.0, 0.5, 1.0]).mean()
    assert share == pytest.approx(0.646, abs=0.001)
    distance = read(SAMPLES / "distance_monitoring_safety_area.csv")
    assert distance.safety.height == 15_811
    assert distance.safety["distance_m"].min() == pytest.approx(0.287912, abs=1e-6)
    assert distance.safety["distance_m"].max() == pytest.approx(2.363074, abs=1e-6)
    assert distance.safety["execution"].n_unique() == 10
    assert override.set_aside.is_empty()
    assert override.warnings == distance.warnings == ()
    assert override.clock == distance.clock == "epoch"
