"""The arm's joints and its TCP tell one story, and its motion keeps the limits."""

from __future__ import annotations

import numpy as np
import pytest
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit_sim import SimulationError, scene_places
from cyclekit_sim.arm import forward, jacobian, quaternion, reach, rotation_vector
from cyclekit_sim.motion import ACCELERATION_RAD_S2, SPEED_RAD_S, plan_moves

JOINTS = st.lists(st.floats(-6.0, 6.0), min_size=6, max_size=6)


def fk_from_first_principles(q: np.ndarray) -> np.ndarray:
    """Multiply plain 4x4 Denavit-Hartenberg matrices of the UR5e data sheet."""
    pose = np.eye(4)
    d, a = (0.1625, 0, 0, 0.1333, 0.0997, 0.0996), (0, -0.425, -0.3922, 0, 0, 0)
    for angle, d_i, a_i, alpha in zip(q, d, a, (np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0), strict=True):
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
        pose = pose @ np.array(
            [[c, -s * ca, s * sa, a_i * c], [s, c * ca, -c * sa, a_i * s], [0, sa, ca, d_i], [0, 0, 0, 1]]
        )
    return pose


@given(JOINTS)
def test_the_tcp_is_where_the_data_sheet_puts_it(q: list[float]) -> None:
    position, rotation = forward(np.array([q]))
    wanted = fk_from_first_principles(np.array(q))
    assert np.allclose(position[0], wanted[:3, 3], atol=1e-12)
    assert np.allclose(rotation[0], wanted[:3, :3], atol=1e-12)


@given(JOINTS, st.integers(0, 5))
@at_most(30)
def test_the_jacobian_is_the_slope_of_the_tcp(q: list[float], joint: int) -> None:
    nudge = np.zeros(6)
    nudge[joint] = 1e-6
    ahead, behind = forward(np.array([q]) + nudge)[0], forward(np.array([q]) - nudge)[0]
    assert np.allclose(jacobian(np.array([q]))[0][:3, joint], (ahead - behind)[0] / 2e-6, atol=1e-7)


@given(JOINTS)
def test_a_rotation_vector_turns_back_into_its_rotation(q: list[float]) -> None:
    _, rotation = forward(np.array([q]))
    vector = rotation_vector(quaternion(rotation))[0]
    angle = np.linalg.norm(vector)
    x, y, z = vector / max(angle, 1e-300)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rodrigues = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    assert np.allclose(rodrigues, rotation[0], atol=1e-7)


@pytest.mark.parametrize("scene", ["box-picking", "pick-and-package", "laser-zones"])
def test_every_place_is_reached_with_the_tool_pointing_down(scene: str) -> None:
    for xyz in scene_places(scene).values():
        position, rotation = forward(reach(xyz)[None])
        assert np.abs(position[0] - xyz).max() < 1e-9
        assert rotation[0, 2, 2] == pytest.approx(-1.0, abs=1e-9)


def test_a_place_beyond_the_arm_is_refused_by_its_coordinates() -> None:
    with pytest.raises(SimulationError, match=r"1\.5.*reach"):
        reach((1.5, 0.0, 0.1))


def test_a_move_keeps_speed_and_acceleration_limits_and_ends_at_rest() -> None:
    places = scene_places("box-picking")
    table = plan_moves(places, [("conveyor", "left_1"), ("left_1", "conveyor")])
    first, rows = table.first_row["conveyor", "left_1"], table.rows["conveyor", "left_1"]
    part = slice(first, first + rows + 1)
    step = table.duration_s["conveyor", "left_1"] / rows
    assert np.abs(table.qd_rad_s[part]).max() <= SPEED_RAD_S + 1e-9
    assert np.abs(np.diff(table.qd_rad_s[part], axis=0)).max() / step <= ACCELERATION_RAD_S2 + 1e-6
    assert np.all(table.qd_rad_s[[first, first + rows]] == 0)
    assert np.allclose(table.tcp_m[[first, first + rows]], [places["conveyor"], places["left_1"]], atol=1e-9)
    # The speed is the slope of the joints, and the twist the slope of the TCP.
    slope = np.gradient(table.q_rad[part], step, axis=0)[1:-1]
    assert np.abs(slope - table.qd_rad_s[part][1:-1]).max() < 1e-4
    tcp_slope = np.gradient(table.tcp_m[part], step, axis=0)[1:-1]
    assert np.abs(tcp_slope - table.twist[part][1:-1, :3]).max() < 1e-4
