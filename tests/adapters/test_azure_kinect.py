import json

import pytest
from damage import read_damaged, read_or_refuse
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog, LogError
from cyclekit.ingest.registry import adapters
from cyclekit_adapters.formats.azure_kinect import _SDK, ADAPTER

NAMES = ["PELVIS", "SPINE_NAVEL", "SPINE_CHEST", "NECK"]


def joints(x, y, z):
    """Return four joints in millimetres, y down: each 250 mm above the one before."""
    return [[x, y - 250.0 * i, z] for i in range(4)]


def dump(frames, names=NAMES, order=("k4abt_sdk_version", "source_file", "joint_names", "frames")):
    """Return the offline processor's document; `frames` is time in us -> {body id: joints}."""
    content = {
        "k4abt_sdk_version": "1.1.2",
        "source_file": "cell.mkv",
        "joint_names": names,
        "frames": [
            {
                "timestamp_usec": micros,
                "frame_id": 2 * i,
                "num_bodies": len(bodies),
                "bodies": [{"body_id": who, "joint_positions": found} for who, found in bodies.items()],
            }
            for i, (micros, bodies) in enumerate(frames.items())
        ],
    }
    return {key: content[key] for key in order}


def read(path, content, **options):
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["azure-kinect"]
    return ADAPTER.read(path, ReadOptions(**options))


def test_the_pelvis_comes_in_metres_and_the_cameras_y_is_turned_up(tmp_path):
    log = read(tmp_path / "out.json", dump({66_000: {1: joints(100.0, 300.0, 2000.0)}, 99_000: {}}))
    assert log.people.rows() == [(0.066, "1", 0.1, -0.3, -2.0, 0)]
    assert (log.up, log.clock, log.rows_read) == ("y", "uptime", 2)
    assert log.facts["frames_without_bodies"] == "1"


def test_joints_are_found_by_the_names_in_the_file_even_behind_the_frames(tmp_path):
    content = dump(
        {0: {1: [[0, 0, 0], [1.0, 2.0, 3.0]]}},
        names=["NOSE", "PELVIS"],
        order=("k4abt_sdk_version", "frames", "joint_names"),
    )
    assert read(tmp_path / "out.json", content).people["x_m"].to_list() == [0.001]


def test_without_a_pelvis_the_spine_stands_for_it_and_that_is_said(tmp_path):
    lost = joints(100.0, 0.0, 2000.0)
    lost[0] = [None, None, None]
    log = read(tmp_path / "out.json", dump({0: {1: lost}}))
    assert log.people.select("x_m", "y_m", "z_m").rows() == [pytest.approx((0.1, 0.375, -2.0))]
    assert any("1 of 1 bodies have no PELVIS" in said for said in log.warnings)


def test_several_bodies_are_several_people_unless_one_is_chosen(tmp_path):
    content = dump({0: {1: joints(0.0, 0, 0), 2: joints(500.0, 0, 0)}})
    assert read(tmp_path / "out.json", content).people["person"].to_list() == ["1", "2"]
    assert read(tmp_path / "out.json", content, body="2").people["x_m"].to_list() == [0.5]
    with pytest.raises(LogError, match="no body '3'"):
        read(tmp_path / "out.json", content, body="3")


def test_a_file_without_joint_names_or_bodies_is_refused(tmp_path):
    with pytest.raises(DamagedLog, match="joint_names"):
        read(tmp_path / "out.json", dump({0: {1: joints(0, 0, 0)}}, names=[]))
    with pytest.raises(DamagedLog, match="no body in any of its 1 frames"):
        read(tmp_path / "out.json", dump({0: {}}))


def test_a_file_cut_before_its_joint_names_is_read_in_the_order_of_the_sdk_and_that_is_said(tmp_path):
    many = [[float(i), 0.0, 0.0] for i in range(7, 39)]
    text = json.dumps(dump({0: {1: many}, 33_000: {1: many}}, order=("k4abt_sdk_version", "frames", "joint_names")))
    log = read(tmp_path / "out.json", text[: text.index("33000")])
    assert log.people["x_m"].to_list() == [0.007]
    assert any("order of the SDK" in said for said in log.warnings)


def test_a_dump_cut_while_being_written_gives_the_frames_before_the_cut(tmp_path):
    text = json.dumps(dump({0: {1: joints(0.0, 0, 0)}, 33_000: {1: joints(1.0, 0, 0)}}))
    log = read(tmp_path / "out.json", text[: text.rindex("timestamp_usec")])
    assert log.people["t_s"].to_list() == [0.0]
    assert "cut or garbled after 1 frames" in log.warnings[0]


def test_damage_gives_what_is_whole_or_a_refusal(tmp_path):
    path = tmp_path / "out.json"
    read_damaged(ADAPTER, path, json.dumps(dump({0: {1: joints(1, 2, 3)}, 33_000: {}})).encode(), seed=4)


_LEAF = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
_KEYS = st.sampled_from(["frames", "bodies", "timestamp_usec", "joint_positions", "body_id", "joint_names"])
_ANY = st.recursive(_LEAF, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_KEYS, inner, max_size=4))


@pytest.mark.slow  # many drawn files
@given(frames=_ANY)
def test_any_json_is_read_or_refused(tmp_path_factory, frames):
    path = tmp_path_factory.getbasetemp() / "any_azure.json"
    path.write_text(json.dumps({"k4abt_sdk_version": "1", "joint_names": NAMES, "frames": frames}))
    read_or_refuse(ADAPTER, path)


def test_all_joints_by_their_names_in_the_file_on_request(tmp_path):
    content = dump({66_000: {1: joints(100.0, 300.0, 2000.0), 2: [[1, 2, None], *joints(0, 0, 0)[1:]]}})
    log = read(tmp_path / "out.json", content, skeletons=True)
    assert log.skeletons.rows()[:2] == [
        (0.066, "1", "pelvis", 0.1, -0.3, -2.0, 0),
        (0.066, "1", "spine_navel", 0.1, -0.05, -2.0, 0),
    ]
    assert log.skeletons.row(4) == (0.066, "2", "pelvis", None, None, None, 0)
    assert read(tmp_path / "out.json", content, skeletons=True, body="2").skeletons.height == 4
    assert read(tmp_path / "out.json", content).skeletons is None


def test_without_names_the_joints_are_those_of_the_sdk():
    assert len(_SDK) == 32
    assert {i: _SDK[i] for i in (4, 10, 11, 18, 25, 26, 31)} == {
        4: "CLAVICLE_LEFT",
        10: "THUMB_LEFT",
        11: "CLAVICLE_RIGHT",
        18: "HIP_LEFT",
        25: "FOOT_RIGHT",
        26: "HEAD",
        31: "EAR_RIGHT",
    }
