import gzip
import json

import pytest
from damage import read_damaged, read_or_refuse
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import ConfigError, DamagedLog, LogError
from cyclekit.ingest.registry import adapters
from cyclekit_adapters.formats.zed import ADAPTER

PELVIS = {18: (8, 11), 34: (0,), 38: (0,)}
NECK = {18: 1, 34: 3, 38: 4}
NOON_MS = 1_700_000_000_000


def skeleton(x, y, z, *, joints=34, scale=1.0, up=(0.0, 1.0, 0.0)):
    """Return a body 1.6 m tall, pelvis at (x, y, z) metres, in units of which `scale` make a metre."""

    def at(height, side=0.0):
        return [
            scale * (c + height * u + (side if i == 0 else 0))
            for i, (c, u) in enumerate(zip((x, y, z), up, strict=True))
        ]

    points = [at(-0.8 + 1.6 * i / (joints - 1)) for i in range(joints)]
    for index, side in zip(PELVIS[joints], (-0.1, 0.1) if joints == 18 else (0.0,), strict=True):
        points[index] = at(0.0, side)
    points[NECK[joints]] = at(0.5)
    return points


def body(name, x, y=0.0, z=-2.0, **kind):
    return {"id": name, "keypoint": skeleton(x, y, z, **kind)}


def python_dump(frames):
    """Return what the SDK's Python sample writes: keys in ms, timestamps in ns."""
    return {
        str(NOON_MS + ms): {"is_new": True, "is_tracked": True, "timestamp": (NOON_MS + ms) * 10**6, "body_list": found}
        for ms, found in frames.items()
    }


def read(path, content, **options):
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["zed"]
    return ADAPTER.read(path, ReadOptions(**options))


def places(log):
    return [tuple(round(v, 9) for v in row) for row in log.people.select("x_m", "y_m", "z_m").rows()]


@pytest.mark.parametrize("joints", [18, 34, 38])
@pytest.mark.parametrize(("scale", "unit"), [(1.0, "m"), (1000.0, "mm")])
def test_the_pelvis_is_given_in_metres_whatever_the_unit_of_the_bodies(tmp_path, joints, scale, unit):
    dump = python_dump({ms: [body(3, 0.25, 1.0, joints=joints, scale=scale)] for ms in (0, 100)})
    log = read(tmp_path / "bodies.json", dump)
    assert places(log) == [(0.25, 1.0, -2.0)] * 2
    assert log.people["t_s"].to_list() == pytest.approx([1.7e9, 1.7e9 + 0.1])
    assert (log.clock, log.up) == ("epoch", "y")
    assert log.people["person"].to_list() == ["3", "3"]
    assert log.facts["unit"].startswith(f"{unit}, since bodies are 1")
    assert log.facts["body_format"] == f"BODY_{joints}"


def test_a_body_of_neither_a_persons_metres_nor_millimetres_is_refused_and_the_option_decides(tmp_path):
    dump = python_dump({0: [body(1, 0.0, scale=39.37)]})
    with pytest.raises(LogError, match="may be metres or millimetres") as refusal:
        read(tmp_path / "bodies.json", dump)
    assert 'unit = "mm"' in refusal.value.cure
    log = read(tmp_path / "bodies.json", dump, map={"unit": "mm"})
    assert places(log) == [(0.0, 0.0, pytest.approx(-0.07874))]
    assert log.facts["unit"] == "mm, from the cell file"
    with pytest.raises(ConfigError, match="'inch'"):
        read(tmp_path / "bodies.json", dump, map={"unit": "inch"})


def test_a_body_with_only_a_position_has_no_size_so_the_unit_must_be_said(tmp_path):
    dump = python_dump({0: [{"id": 1, "position": [1.0, 2.0, 3.0]}]})
    with pytest.raises(LogError, match="no body shows its size"):
        read(tmp_path / "bodies.json", dump)
    assert places(read(tmp_path / "bodies.json", dump, map={"unit": "m"})) == [(1.0, 2.0, 3.0)]


def test_a_picture_frame_whose_y_points_down_is_turned_upright(tmp_path):
    dump = python_dump({0: [body(1, 0.5, 0.3, 2.0, up=(0.0, -1.0, 0.0))]})
    log = read(tmp_path / "bodies.json", dump)
    assert places(log) == [(0.5, -0.3, -2.0)]
    assert log.up == "y"
    assert "turned" in log.facts["axes"]


def test_z_up_is_seen_from_how_people_stand_and_lying_people_are_refused(tmp_path):
    log = read(tmp_path / "bodies.json", python_dump({0: [body(1, 0.5, 0.3, 1.0, up=(0.0, 0.0, 1.0))]}))
    assert (log.up, places(log)) == ("z", [(0.5, 0.3, 1.0)])
    lying = python_dump({0: [body(1, 0.5, 0.3, 1.0, up=(1.0, 0.0, 0.0))]})
    with pytest.raises(LogError, match="which axis is up") as refusal:
        read(tmp_path / "bodies.json", lying)
    assert "axes" in refusal.value.cure
    mirrored = read(tmp_path / "bodies.json", lying, map={"axes": "left_handed_y_up"})
    assert places(mirrored) == [(0.5, 0.3, -1.0)]


def test_nan_null_and_zeros_are_a_keypoint_that_was_not_seen(tmp_path):
    lost = [[float("nan")] * 3, [None] * 3, [0, 0, 0]]
    frames = {}
    for i, nothing in enumerate(lost):
        frames[100 * i] = [{**body(1, 1.0), "position": [1.5, 0.1, -2.0]}]
        frames[100 * i][0]["keypoint"][0] = nothing
    log = read(tmp_path / "bodies.json", python_dump(frames))
    assert places(log) == [(1.5, 0.1, -2.0)] * 3


def test_the_cpp_sample_leaves_the_body_list_out_where_nobody_is_and_its_keys_need_not_be_in_order(tmp_path):
    dump = python_dump({200: [body(1, 2.0)], 0: [body(1, 1.0)], 100: []})
    del dump[str(NOON_MS + 100)]["body_list"]
    log = read(tmp_path / "bodies.json", dump)
    assert log.people["x_m"].to_list() == [1.0, 2.0]
    assert log.rows_read == 3
    assert log.facts["frames_without_bodies"] == "1"


def test_ids_that_live_one_frame_are_one_person_where_no_frame_has_two(tmp_path):
    frames = [[{**body(f"u{i}", 0.1 * i), "ts": NOON_MS + 50 * i}] for i in range(4)]
    log = read(tmp_path / "bodies.json", [[], *frames, []])
    assert log.people["person"].to_list() == ["1"] * 4
    assert log.people["source_row"].to_list() == [1, 2, 3, 4]
    assert log.facts["ids"].startswith("new in every frame")


def test_ids_that_live_one_frame_are_linked_by_motion_where_there_are_two_people(tmp_path):
    frames = []
    for i in range(6):
        two = [{**body(f"a{i}", 0.1 * i), "ts": NOON_MS + 50 * i}, {**body(f"b{i}", 3.0), "ts": NOON_MS + 50 * i}]
        frames.append(two if i % 2 else two[::-1])
    log = read(tmp_path / "bodies.json", frames)
    tracks = {who[0]: rows["x_m"].to_list() for who, rows in log.people.group_by("person")}
    assert sorted(tracks.values()) == [pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5]), [3.0] * 6]
    assert any("linked by motion" in said for said in log.warnings)


def test_an_id_that_two_bodies_of_a_frame_share_is_none(tmp_path):
    log = read(tmp_path / "bodies.json", python_dump({ms: [body(-1, 1.0), body(-1, 3.0)] for ms in (0, 50, 100)}))
    assert log.people.group_by("person").agg("x_m").sort("person").rows() == [("1", [1.0] * 3), ("2", [3.0] * 3)]


def test_a_flat_list_of_bodies_is_read_as_well(tmp_path):
    flat = [{**body(7, 1.0), "ts": NOON_MS + 50 * (i // 2)} | {"id": 7 + i % 2} for i in range(4)]
    log = read(tmp_path / "bodies.json", flat)
    assert log.people["person"].to_list() == ["7", "8", "7", "8"]


def test_real_ids_are_kept_and_body_chooses_one(tmp_path):
    dump = python_dump({ms: [body(4, 1.0), body(9, 2.0)] for ms in (0, 50)})
    assert read(tmp_path / "bodies.json", dump).people["person"].to_list() == ["4", "9", "4", "9"]
    assert read(tmp_path / "bodies.json", dump, body="9").people["x_m"].to_list() == [2.0, 2.0]
    with pytest.raises(LogError, match="no body '5'"):
        read(tmp_path / "bodies.json", dump, body="5")


@pytest.mark.parametrize("empty", ["[]", "[[], []]", '{"1700000000000": {"is_new": true, "is_tracked": false}}'])
def test_a_recording_without_anybody_is_said_to_be_one(tmp_path, empty):
    with pytest.raises(LogError, match="no body in any") as refusal:
        read(tmp_path / "bodies.json", empty)
    assert "leave the file out" in refusal.value.cure


def test_a_dump_cut_while_being_written_gives_the_frames_before_the_cut(tmp_path):
    whole = json.dumps([[{**body("a", 1.0 + i), "ts": NOON_MS + 50 * i}] for i in range(3)])
    log = read(tmp_path / "bodies.json", whole[: whole.rindex("keypoint") + 40])
    assert log.people["x_m"].to_list() == [1.0, 2.0]
    assert log.set_aside["source_row"].to_list() == [2]
    assert "cut or garbled after 2 frames" in log.warnings[0]


def test_another_number_of_keypoints_is_another_skeleton(tmp_path):
    dump = python_dump({0: [{"id": 1, "keypoint": [[1.0, 1.0, 1.0]] * 25}]})
    with pytest.raises(DamagedLog, match="25 keypoints"):
        read(tmp_path / "bodies.json", dump)


@pytest.mark.parametrize("content", ["[" * 200_000, '{"1":' * 100_000, f'[{{"id":1,"keypoint":[[{"9" * 6000},1,1]]}}]'])
def test_depth_and_digits_without_end_are_refused(tmp_path, content):
    path = tmp_path / "bodies.json"
    path.write_text(content)
    with pytest.raises(LogError):
        ADAPTER.read(path, ReadOptions())


@pytest.mark.parametrize(
    "other", ['{"a": 1}', "[1, 2]", '[{"x": 1}]', '{"frames": []}', "", "no json", '"[]"', "null", "{}", "["]
)
def test_other_json_is_not_recognised(tmp_path, other):
    path = tmp_path / "a.json"
    path.write_text(other)
    assert not ADAPTER.recognises(path)


def test_damage_gives_what_is_whole_or_a_refusal(tmp_path):
    path = tmp_path / "bodies.json"
    read_damaged(
        ADAPTER, path, json.dumps(python_dump({0: [body(1, 1.0)], 50: [], 100: [body(1, 1.1)]})).encode(), seed=1
    )


_LEAF = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
_KEYS = st.sampled_from(["id", "ts", "keypoint", "position", "body_list", "timestamp", "1700000000000", "x"])
_ANY = st.recursive(_LEAF, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_KEYS, inner, max_size=4))


@given(content=_ANY)
def test_any_json_is_read_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "any.json"
    path.write_text(json.dumps(content))
    read_or_refuse(ADAPTER, path, ReadOptions(map={"unit": "m"}))


def resting(joints=34):
    """Return the pose in which the SDK writes a body that it has not fitted: its neck at the camera."""
    points = [[0.05 * (i % 3 - 1), 0.1 - 1.6 * i / joints, 0.1] for i in range(joints)]
    points[0], points[NECK[joints]] = [0.0, -0.55, 0.0], [0.0, -1.5e-08, 0.0]
    return points


def test_a_body_not_fitted_yet_is_where_the_sdk_says_and_not_at_the_camera(tmp_path):
    dump = python_dump(
        {0: [body(0, 1.0) | {"keypoint": resting(), "position": [0.07, -0.02, -0.57]}], 50: [body(0, 1.0)]}
    )
    log = read(tmp_path / "bodies.json", dump, skeletons=True)
    assert places(log) == [(0.07, -0.02, -0.57), (1.0, 0.0, -2.0)]
    assert any("1 bodies are in the SDK's rest pose" in said for said in log.warnings)
    assert log.skeletons.filter(log.skeletons["source_row"] == 0)["x_m"].null_count() == 34


@pytest.mark.parametrize("state", [2, "SEARCHING", "OBJECT_TRACKING_STATE.SEARCHING"])
def test_a_body_that_is_searched_for_is_hidden_and_its_place_unknown(tmp_path, state):
    dump = python_dump({ms: [body(4, 1.0) | {"tracking_state": state if ms else 1}] for ms in (0, 50)})
    log = read(tmp_path / "bodies.json", dump)
    assert log.people.select("person", "x_m").rows() == [("4", 1.0), ("4", None)]
    assert any("1 bodies are searched for" in said for said in log.warnings)


@pytest.mark.parametrize(
    ("joints", "names"),
    [
        (18, {0: "nose", 8: "right_hip", 11: "left_hip", 17: "left_ear"}),
        (34, {0: "pelvis", 8: "left_hand", 18: "left_hip", 22: "right_hip", 26: "head", 33: "right_heel"}),
        (
            38,
            {
                0: "pelvis",
                4: "neck",
                16: "left_wrist",
                19: "right_hip",
                30: "left_hand_thumb_4",
                37: "right_hand_pinky_1",
            },
        ),
    ],
)
def test_the_keypoints_have_the_names_of_the_sdk_on_request(tmp_path, joints, names):
    dump = python_dump({ms: [body(4, 0.25, joints=joints, scale=1000.0)] for ms in (0, 50)})
    dump[str(NOON_MS)]["body_list"][0]["keypoint"][5] = [float("nan")] * 3
    log = read(tmp_path / "bodies.json", dump, skeletons=True)
    assert log.skeletons.height == 2 * joints
    assert {index: log.skeletons["joint"][index] for index in names} == names
    assert log.skeletons["x_m"][5] is None
    pelvis = log.skeletons.row(joints + PELVIS[joints][0], named=True)
    assert pelvis["x_m"] == pytest.approx(0.15 if joints == 18 else 0.25)
    assert (pelvis["person"], pelvis["z_m"], pelvis["source_row"]) == ("4", pytest.approx(-2.0), 1)
    assert read(tmp_path / "bodies.json", dump).skeletons is None


def test_a_packed_dump_is_read_as_well(tmp_path):
    path = tmp_path / "bodies.json.gz"
    path.write_bytes(gzip.compress(json.dumps(python_dump({0: [body(1, 1.0)]})).encode()))
    assert ADAPTER.recognises(path)
    assert ADAPTER.read(path, ReadOptions()).people["x_m"].to_list() == [1.0]


def test_a_timestamp_that_the_writer_left_at_zero_is_told_by_the_key(tmp_path):
    dump = python_dump({ms: [body(3, 0.25, 1.0)] for ms in (0, 100)})
    for frame in dump.values():
        frame["timestamp"] = 0
    log = read(tmp_path / "bodies.json", dump)
    assert log.people["t_s"].to_list() == pytest.approx([1.7e9, 1.7e9 + 0.1])
    assert log.clock == "epoch"
