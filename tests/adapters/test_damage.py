"""A damaged log gives what is whole in it or one of our refusals, never a foreign exception."""

import pytest
from damage import read_damaged

from cyclekit.adapter import ReadOptions
from cyclekit_adapters import rosbag
from cyclekit_adapters.formats import mapped_csv, motive, ur_rtde, ur_split


def test_ur_rtde(tmp_path, ur):
    path = tmp_path / "run.csv"
    read_damaged(
        ur_rtde.ADAPTER, path, ur.text([ur.row(1.0 + i / 500) for i in range(6)]).encode(), seed=1, partly=True
    )


def test_motive(tmp_path, motive):
    text = motive({"Helmet": [(1.0, 1.7, 3.0), None, (1.1, 1.7, 3.0)] * 10, "Box": [(0, 0, 0)] * 30})
    path = tmp_path / "take.csv"
    read_damaged(_motive, path, text.encode(), seed=2, partly=True)


def test_mapped_csv(tmp_path):
    options = ReadOptions(role="people", map={"time": "t", "x": "x", "y": "y", "person": "id"})
    path = tmp_path / "log.csv"
    read_damaged(
        mapped_csv.ADAPTER,
        path,
        b't,id,x,y\n0.0,ann,1.5,2\n0.5,"bo, jr",,\n1.0,ann,1.25,-2e-3\n',
        seed=3,
        options=options,
        partly=True,
    )


def test_ur_split(tmp_path):
    whole_rows = "".join(f"{i * 0.008:.6f}, 0.1, 0.2, 0.3, 0, 0, 0\n" for i in range(8)).encode()
    for name in ("log_q_actual", "log_tcp_speed"):
        (tmp_path / f"{name}.csv").write_bytes(whole_rows)
    read_damaged(ur_split.ADAPTER, tmp_path / "log_tool_vector.csv", whole_rows, seed=4, place=tmp_path, partly=True)


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_rosbag(tmp_path, bag, kind):
    path = tmp_path / ("run.bag" if kind == "bag" else "run")
    writer = bag(path, kind)
    for i in range(4):
        writer.tcp(1.7e9 + i, x=float(i))
        writer.joints(1.7e9 + i, ["a", "b"], [0.0, float(i)])
        writer.number("/speed_scaling_factor", "Float64", 1.7e9 + i, 1.0)
        writer.poses(1.7e9 + i, [(1.0, 2.0, 3.0)])
    writer.transform(1.7e9, ("base", "tool0", (0.5, 0.0, 0.0)))
    writer.close()
    file = path if kind == "bag" else next(path.glob(f"*.{kind}"))
    rows = kind != "db3"  # its pages are of no use one by one
    read_damaged(rosbag.ADAPTER, file, file.read_bytes(), seed=5, partly=rows)


def test_the_metadata_of_a_ros_2_folder(tmp_path, bag):
    path = tmp_path / "run"
    writer = bag(path, "mcap")
    writer.tcp(1.7e9, x=0.0)
    writer.close()
    read_damaged(rosbag.ADAPTER, path / "metadata.yaml", (path / "metadata.yaml").read_bytes(), seed=6, place=path)


_motive = motive.ADAPTER
