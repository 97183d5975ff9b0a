import json

import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.errors import LogError
from cyclekit.registry import find_adapter
from cyclekit_adapters.mediapipe import ADAPTER

LANDMARK = {"x": 0.01, "y": -0.5, "z": 0.1, "visibility": 0.99}
NAMES = ["NOSE", "LEFT_EYE_INNER", "RIGHT_EYE_INNER", "MOUTH_LEFT", "LEFT_HIP", "RIGHT_HIP", "LEFT_FOOT_INDEX"]
DUMPS = {
    "frames.json": json.dumps([{"timestamp": 33, "pose_world_landmarks": [LANDMARK] * 33}]),
    "camel.json": json.dumps({"poseWorldLandmarks": [LANDMARK] * 33}),
    "web.json": json.dumps([{"timestamp": 33, "landmarks": [LANDMARK] * 33, "worldLandmarks": [LANDMARK] * 33}]),
    "named.json": json.dumps([{"time": 0.0, **dict.fromkeys(NAMES, LANDMARK)}]),
    "named.csv": ",".join(["frame", *(f"{n.lower()}_{a}" for n in NAMES * 2 for a in "xyz")]) + "\n1,2,3\n",
    "numbered.csv": ",".join(["class", *(f"{a}{i}" for i in range(1, 34) for a in "xyzv")]) + "\n",
    "spelt.csv": ",".join(f"landmark_{i}_{a}" for i in range(33) for a in ("x", "y", "z", "visibility")) + "\n",
}


@pytest.mark.parametrize("name", DUMPS)
def test_landmarks_around_the_persons_own_hips_are_refused_with_the_reason(tmp_path, name):
    path = tmp_path / name
    path.write_text(DUMPS[name])
    found = find_adapter(path)
    assert found is not None
    assert found.name == "mediapipe"
    with pytest.raises(LogError, match="middle of the person's own hips") as refusal:
        found.adapter.read(path, ReadOptions())
    assert "depth camera" in refusal.value.cure


@pytest.mark.parametrize(
    "other",
    [
        "t,x,y,z\n0,1,2,3\n",
        json.dumps([{"id": 1, "keypoint": [[1, 2, 3]] * 34, "ts": 1}]),
        json.dumps({"landmarks": [{"lat": 1.0}]}),
        ",".join(f"{a}{i}" for i in range(25) for a in "xyz"),
        "LEFT_EYE_INNER and LEFT_FOOT_INDEX are names of landmarks, one of x, y, z\n",
    ],
)
def test_other_files_are_not_taken_for_landmarks(tmp_path, other):
    path = tmp_path / "a"
    path.write_text(other)
    assert not ADAPTER.recognises(path)
