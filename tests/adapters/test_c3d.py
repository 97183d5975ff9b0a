import struct
import tracemalloc

import ezc3d
import numpy as np
import pytest
from damage import read_damaged, read_or_refuse
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog
from cyclekit_adapters.formats.c3d import ADAPTER
from cyclekit_adapters.tracking.c3d_file import read_c3d

LABELS = ["Subject:LASI", "Subject:RASI", "Subject:HEAD", "box:1"]


def write(path, points, *, labels=LABELS, unit="mm", rate=100.0, screen=None, analogs=0):
    """Write (T, M, 3) with the library that others use; NaN = not seen."""
    log = ezc3d.c3d()
    log["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    log["parameters"]["POINT"]["RATE"]["value"] = [rate]
    log["parameters"]["POINT"]["LABELS"]["value"] = labels[: points.shape[1]]
    if screen:
        log.add_parameter("POINT", "X_SCREEN", "+X")
        log.add_parameter("POINT", "Y_SCREEN", screen)
    log["data"]["points"] = np.concatenate([points.transpose(2, 1, 0), np.ones((1, *points.shape[1::-1]))])
    if analogs:
        log["parameters"]["ANALOG"]["RATE"]["value"] = [rate * 2]
        log["parameters"]["ANALOG"]["LABELS"]["value"] = [f"emg{i}" for i in range(analogs)]
        log["data"]["analogs"] = np.arange(2.0 * analogs * len(points)).reshape(1, analogs, -1)
    log.write(str(path))
    return path


def some_points(frames=4, markers=4):
    return np.arange(frames * markers * 3, dtype=float).reshape(frames, markers, 3)


def plain(points, residuals, *, processor=84, scale=-1.0, unit=b"mm", rate=50.0, first=1, stated=None):
    """Write a C3D file byte by byte: (T, M, 3) and (T, M), for the machines whose order ezc3d does not write."""
    order = ">" if processor == 86 else "<"

    def real(value):
        return _dec(value) if processor == 85 else struct.pack(order + "f", value)

    frames, markers = residuals.shape
    head = struct.pack("BB", 2, 0x50) + struct.pack(order + "5H", markers, 0, first, first + frames - 1, 0)
    head += real(scale) + struct.pack(order + "2H", 4, 0) + real(rate)
    body = b"\0\0" + struct.pack("BB", 2, processor)
    body += _entry(order, -1, b"POINT", b"\0", last=False)
    parameters = {
        b"USED": (2, struct.pack(order + "h", markers)),
        b"FRAMES": (2, struct.pack(order + "H", stated or frames)),
        b"SCALE": (4, real(scale)),
        b"RATE": (4, real(rate)),
        b"DATA_START": (2, struct.pack(order + "h", 4)),
    }
    for name, (kind, raw) in parameters.items():
        body += _entry(order, 1, name, struct.pack("bB", kind, 0) + raw + b"\0", last=False)
    body += _entry(order, 1, b"UNITS", struct.pack("bBB", -1, 1, len(unit)) + unit + b"\0", last=True)
    data = b""
    for t in range(frames):
        for m in range(markers):
            values = [*points[t, m], residuals[t, m]]
            data += b"".join(real(v) if scale < 0 else struct.pack(order + "h", int(v)) for v in values)
    return head.ljust(512, b"\0") + body.ljust(1024, b"\0") + data.ljust(512, b"\0")


def _entry(order, group, name, content, *, last):
    return (
        struct.pack("bb", len(name), group) + name + struct.pack(order + "H", 0 if last else 2 + len(content)) + content
    )


def _dec(value):
    low, high = struct.unpack("<2H", struct.pack("<f", value * 4.0))
    return struct.pack("<2H", high, low) if value else b"\0\0\0\0"


def test_the_person_is_the_middle_of_the_pelvis_markers_seen(tmp_path):
    points = np.full((2, 4, 3), 500.0)
    points[:, 0], points[:, 1] = (0.0, 100.0, 900.0), (200.0, 100.0, 1000.0)
    points[1, 1] = np.nan
    path = write(tmp_path / "walk.c3d", points)
    assert ADAPTER.recognises(path)
    log = ADAPTER.read(path, ReadOptions())
    assert log.people.select("t_s", "person", "x_m", "y_m", "z_m").rows() == [
        (0.0, "Subject", 0.1, 0.1, pytest.approx(0.95)),
        (0.01, "Subject", 0.0, 0.1, 0.9),
    ]
    assert log.facts["not_people"] == "box"
    assert (log.clock, log.up) == ("relative", "z")


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("Meters", 1.0)])
def test_lengths_come_in_the_unit_of_the_file(tmp_path, unit, metres):
    log = ADAPTER.read(write(tmp_path / "a.c3d", np.full((1, 1, 3), 8.0), unit=unit), ReadOptions())
    assert log.people["x_m"].to_list() == [pytest.approx(8.0 * metres)]


def test_an_unknown_unit_is_refused(tmp_path):
    with pytest.raises(DamagedLog, match="'furlong'"):
        ADAPTER.read(write(tmp_path / "a.c3d", some_points(), unit="furlong"), ReadOptions())


@pytest.mark.parametrize(("screen", "up"), [("+Z", "z"), ("+Y", "y"), (None, "z")])
def test_up_is_the_axis_that_points_up_on_the_screen(tmp_path, screen, up):
    path = write(tmp_path / "a.c3d", some_points(), screen=screen)
    assert ADAPTER.read(path, ReadOptions()).up == up
    assert ADAPTER.read(path, ReadOptions(map={"up": "y"})).up == "y"


@at_most(30)
@given(frames=st.integers(1, 6), markers=st.integers(1, 4), analogs=st.integers(0, 3), seed=st.integers(0, 99))
def test_points_are_what_ezc3d_reads_with_analog_samples_between_them_or_not(
    tmp_path_factory, frames, markers, analogs, seed
):
    chance = np.random.default_rng(seed)
    points = chance.normal(0.0, 1000.0, (frames, markers, 3))
    points[chance.random((frames, markers)) < 0.2] = np.nan
    path = write(tmp_path_factory.getbasetemp() / "judge.c3d", points, analogs=analogs)
    judge = ezc3d.c3d(str(path))["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_array_equal(read_c3d(path).points, judge)


@pytest.mark.parametrize("processor", [84, 85, 86])
@pytest.mark.parametrize("scale", [-1.0, 0.5])
def test_intel_dec_and_mips_machines_write_the_same_points(tmp_path, processor, scale):
    points = np.array([[[100.0, -200.0, 300.0]], [[104.0, -208.0, 312.0]], [[1.0, 1.0, 1.0]]])
    residuals = np.array([[1.0], [0.0], [-1.0]])
    path = tmp_path / "old.c3d"
    path.write_bytes(plain(points, residuals, processor=processor, scale=scale, first=51))
    log = ADAPTER.read(path, ReadOptions())
    size = 1e-3 if scale < 0 else 0.5e-3
    assert log.people["x_m"].to_list() == [pytest.approx(100 * size), pytest.approx(104 * size), None]
    assert log.people["y_m"].to_list() == [pytest.approx(-200 * size), pytest.approx(-208 * size), None]
    assert log.people["t_s"].to_list() == pytest.approx([1.0, 1.02, 1.04])


def test_more_frames_than_15_bits_can_count_are_no_negative_number(tmp_path):
    path = tmp_path / "long.c3d"
    path.write_bytes(plain(np.ones((33_000, 1, 3)), np.zeros((33_000, 1))))
    assert ADAPTER.read(path, ReadOptions()).people.height == 33_000


@pytest.mark.parametrize("markers", [1, 3])
@pytest.mark.parametrize("frames", [65_535, 65_536, 70_001])
def test_a_counter_of_frames_at_its_bound_does_not_cut_the_file(tmp_path, frames, markers):
    points = np.arange(frames, dtype=float)[:, None, None] * 0.01 + np.arange(1.0, 3 * markers + 1).reshape(markers, 3)
    log = ADAPTER.read(write(tmp_path / "a.c3d", points), ReadOptions(body="Subject:LASI"))
    assert log.people.height == log.rows_read == frames
    assert log.people["x_m"][-1] == pytest.approx(points[-1, 0, 0] / 1000)
    assert any("its counter of frames is at its bound" in text for text in log.warnings) is (frames > 65_535)


def test_a_cut_file_gives_its_whole_frames_and_says_what_is_missing(tmp_path):
    whole = plain(some_points(40, 1), np.zeros((40, 1)))
    path = tmp_path / "cut.c3d"
    path.write_bytes(whole[: 1536 + 16 * 10 + 5])
    log = ADAPTER.read(path, ReadOptions())
    assert log.people.height == 10
    assert any("30 of 40 frames are missing" in said for said in log.warnings)


def test_a_file_that_states_more_frames_than_it_can_hold_takes_no_more_memory_than_it_has(tmp_path):
    path = tmp_path / "lie.c3d"
    path.write_bytes(plain(some_points(4, 1), np.zeros((4, 1)), stated=65_000))
    assert ADAPTER.read(path, ReadOptions()).people.height <= 512 // 16


def test_a_file_without_points_is_refused(tmp_path):
    path = tmp_path / "a.c3d"
    path.write_bytes(plain(np.ones((0, 0, 3)), np.ones((0, 0))))
    with pytest.raises(DamagedLog, match="no positions"):
        ADAPTER.read(path, ReadOptions())


def test_damage_gives_what_is_whole_or_a_refusal(tmp_path):
    path = tmp_path / "a.c3d"
    read_damaged(ADAPTER, path, write(path, some_points()).read_bytes(), seed=5, cuts=60, flips=300)


@given(noise=st.binary(max_size=600), block=st.integers(0, 255), processor=st.sampled_from([84, 85, 86]))
def test_any_parameters_are_read_or_refused(tmp_path_factory, noise, block, processor):
    path = tmp_path_factory.getbasetemp() / "any.c3d"
    whole = plain(some_points(4, 1), np.zeros((4, 1)), processor=processor)
    path.write_bytes(whole[:514] + bytes([block]) + whole[515:516] + noise + whole[516 + len(noise) :])
    read_or_refuse(ADAPTER, path)


def test_the_labelled_markers_of_the_subject_are_joints_on_request_and_angles_are_no_places(tmp_path):
    path = tmp_path / "trial.c3d"
    log = ezc3d.c3d()
    log["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    log["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    log["parameters"]["POINT"]["LABELS"]["value"] = ["Ann:LASI", "Ann:LHipAngles", "Ann:HEAD"]
    log.add_parameter("POINT", "ANGLES", ["Ann:LHipAngles"])
    places = np.array([[[1000.0, 0, 900], [45.0, 5, 1], [np.nan] * 3]])
    log["data"]["points"] = np.concatenate([places.transpose(2, 1, 0), np.ones((1, 3, 1))])
    log.write(str(path))
    read = ADAPTER.read(path, ReadOptions(skeletons=True))
    assert read.skeletons.rows() == [
        (0.0, "Ann", "lasi", 1.0, 0.0, 0.9, 0),
        (0.0, "Ann", "head", None, None, None, 0),
    ]
    assert "LHipAngles" not in read.facts["names_in_file"]
    assert ADAPTER.read(path, ReadOptions()).skeletons is None


def test_what_lies_behind_the_frames_is_not_read_into_memory(tmp_path):
    whole = write(tmp_path / "take.c3d", some_points())
    padded = tmp_path / "padded.c3d"
    padded.write_bytes(whole.read_bytes())
    with padded.open("r+b") as log:
        log.truncate(256 << 20)
    tracemalloc.start()
    points = read_c3d(padded).points
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_array_equal(points, read_c3d(whole).points)
    assert peak < 64 << 20


def test_an_axis_that_is_neither_y_nor_z_up_is_said(tmp_path):
    log = ADAPTER.read(write(tmp_path / "trial.c3d", some_points(), screen="-Z"), ReadOptions())
    assert log.up == "z"
    assert any("Y_SCREEN is -Z" in said for said in log.warnings)
    chosen = ADAPTER.read(tmp_path / "trial.c3d", ReadOptions(map={"up": "y"}))
    assert (chosen.up, any("Y_SCREEN" in said for said in chosen.warnings)) == ("y", False)


@pytest.mark.parametrize(
    ("labels", "used"),
    [
        (["L_IAS", "R_IAS", "R_HM2", "CV7"], "L_IAS, R_IAS"),
        (["r should", "r asis", "l asis", "r bar 1"], "r asis, l asis"),
        (["Nose", "RHip", "LHip", "RKnee"], "RHip, LHip"),
    ],
)
def test_the_pelvis_is_found_by_the_names_of_isb_bts_and_keypoints(tmp_path, labels, used):
    log = ADAPTER.read(write(tmp_path / "walk.c3d", some_points(), labels=labels), ReadOptions())
    assert log.facts["markers_used"] == used
    assert log.facts["point"] == "middle of the pelvis markers seen"


@pytest.mark.parametrize(("axis", "up"), [(1, "y"), (2, "z")])
def test_without_a_screen_axis_heads_above_feet_tell_which_axis_is_up(tmp_path, axis, up):
    points = np.zeros((4, 3, 3)) + 50.0
    points[:, 1, axis], points[:, 2, axis] = 900.0, 1700.0
    path = write(tmp_path / "walk.c3d", points, labels=["l heel", "sacrum", "c7"])
    log = ADAPTER.read(path, ReadOptions())
    assert (log.up, log.facts["up"]) == (up, f"{up}, since heads are above feet")
    told = ADAPTER.read(path, ReadOptions(map={"up": "z"}))
    assert (told.up, told.facts["up"]) == ("z", "z, from the cell file")
    screen = ADAPTER.read(write(path, points, labels=["l heel", "sacrum", "c7"], screen="+Z"), ReadOptions())
    assert (screen.up, screen.facts["up"]) == ("z", "z, by POINT:Y_SCREEN")
