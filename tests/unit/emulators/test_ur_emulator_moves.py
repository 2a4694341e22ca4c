"""Moves, sockets and messages that the maker's own programs need, without its library."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.hardware.emulated_ur import cycle, primary_parts, settle
from surg_emulators.ur.joint_motion import DT, MAX_ACCELERATION
from surg_emulators.ur.primary_server import (
    CONFIGURATION_DATA,
    KINEMATICS_DATA,
    MASTERBOARD_DATA,
    PrimarySession,
)
from surg_emulators.ur.robot_states import RobotMode, Runtime, SafetyMode
from surg_emulators.ur.ur_controller import HOME, UrController

GOAL = "[0.2, -1.5708, -1.5708, -1.5708, 1.5708, 0.0]"


def run(body: str, limit: float = 20.0) -> tuple[UrController, np.ndarray]:
    """A program to its end: the controller, and target positions of every cycle (n, 6) [rad]."""
    controller = UrController()
    assert controller.run_script(f"def test():\n{body}\nend\n"), controller.messages
    way = [list(controller.motion.q)]
    while controller.program is not None:
        cycle(controller)
        way.append(list(controller.motion.q))
        assert len(way) < limit / DT, "it does not end"
    assert controller.safety_mode == SafetyMode.NORMAL, controller.messages
    return controller, np.array(way)


@pytest.mark.parametrize("seconds", [0.4, 1.0, 3.0])
def test_a_movej_takes_its_time(seconds: float) -> None:
    controller, way = run(f"movej({GOAL}, t={seconds})")
    assert DT * len(way) == pytest.approx(seconds, abs=0.02)
    assert controller.motion.q[0] == pytest.approx(0.2, abs=1e-3)
    mean = 0.2 / seconds
    assert np.abs(np.diff(way[:, 0])).max() / DT == pytest.approx(1.5 * mean, rel=0.02)


@pytest.mark.parametrize("move", [f"movej({GOAL}, t=0.02)", "movel(pose, t=0.05)"])
def test_a_move_in_too_short_a_time_takes_longer_and_arrives(move: str) -> None:
    body = f"q = {GOAL}\nq[1] = -1.2\npose = get_forward_kin(q)\n{move}\nstopj(5)"
    controller, way = run(body)
    assert np.abs(np.diff(way, 2, axis=0)).max() / DT**2 < MAX_ACCELERATION
    assert DT * len(way) > 0.1
    assert controller.motion.q[0] == pytest.approx(0.2, abs=2e-3)


@pytest.mark.parametrize("slider", [1.0, 0.25])
def test_speedj_goes_as_far_in_its_time_at_any_slider(slider: float) -> None:
    """So the maker's splines arrive: they add up the times of their speedj's."""
    controller = UrController()
    controller.slider = slider
    speed = "speedj([0.1, 0, 0, 0, 0, 0], 10, 0.002)"
    loop = f"n = 0\nwhile n < 500:\n{speed}\nn = n + 1\nend\nspeedj([0, 0, 0, 0, 0, 0], 0, 0.002)"
    assert controller.run_script(f"def far():\n{loop}\nsync()\nend\n")
    settle(controller, 1.1 / slider)
    assert controller.program is None, controller.messages
    assert controller.motion.q[0] == pytest.approx(0.1, abs=2e-3)


def test_a_blend_does_not_stop_and_ends_at_the_last_goal() -> None:
    via = "[0.1, -1.3, -1.5708, -1.5708, 1.5708, 0.0]"
    controller, way = run(f"movej({via}, r=0.05)\nmovej({GOAL})")
    speed = np.linalg.norm(np.diff(way, axis=0), axis=1) / DT
    moving = np.flatnonzero(speed > 0.05)
    print(f"least speed on the way {speed[moving[0] : moving[-1]].min():.2f} rad/s")
    assert speed[moving[0] : moving[-1]].min() > 0.05, "it never stands"
    assert np.abs(np.diff(way, 2, axis=0)).max() / DT**2 < MAX_ACCELERATION
    assert controller.motion.q == pytest.approx([0.2, *HOME[1:]], abs=1e-6)
    assert np.abs(way - [0.1, -1.3, *HOME[2:]]).max(axis=1).min() > 1e-3, "not through the corner"


@pytest.mark.parametrize("how", ["", ", t=1.5", ", v=0.1, a=0.5"])
def test_a_movel_goes_straight(how: str) -> None:
    controller, way = run(f"movel(pose_add(get_target_tcp_pose(), p[0, 0.15, -0.1, 0, 0, 0]){how})")
    points = np.array([controller.tcp_pose(q)[:3] for q in way[::10]])
    start = points[0]
    line = np.array([0.0, 0.15, -0.1]) / np.hypot(0.15, 0.1)
    off = points - start
    away = np.linalg.norm(off - np.outer(off @ line, line), axis=1).max()
    print(f"{1e6 * away:.1f} um off the line")
    assert away < 1e-4
    end = np.array(controller.tcp_pose(way[-1])[:3])
    assert end - start == pytest.approx([0.0, 0.15, -0.1], abs=1e-5)
    if "t=" in how:
        assert DT * len(way) == pytest.approx(1.5, abs=0.02)


@pytest.mark.parametrize("mode", [0, 1])
def test_a_movec_goes_by_its_middle_point_along_a_circle(mode: int) -> None:
    via, goal = np.array([0.05, 0.05, 0.0]), np.array([0.1, 0.0, 0.02])  # from the start [m]
    start = "start = get_target_tcp_pose()"
    points = ", ".join(f"pose_add(start, p{[*each.tolist(), 0, 0, 0]})" for each in (via, goal))
    controller, way = run(f"{start}\nmovec({points}, v=0.1, mode={mode})")
    tool = np.array([controller.tcp_pose(q) for q in way[::5]])
    went = tool[:, :3] - tool[0, :3]
    # Of the sphere through the start, whose points p have p.p = 2 c.p, within the plane.
    plane = np.cross(via, goal)
    centre = np.linalg.solve([2 * via, 2 * goal, plane], [via @ via, goal @ goal, 0.0])
    radius = np.linalg.norm(centre)
    off = np.abs(np.linalg.norm(went - centre, axis=1) - radius).max()
    print(f"{1e6 * off:.1f} um off the circle of {1e3 * radius:.0f} mm")
    assert off < 1e-4 and np.abs(went @ plane).max() / np.linalg.norm(plane) < 1e-4
    assert np.linalg.norm(went - via, axis=1).min() < 2e-3
    assert went[-1] == pytest.approx(goal, abs=1e-4)
    turned = Rotation.from_rotvec(tool[-1, 3:]) * Rotation.from_rotvec(tool[0, 3:]).inv()
    arc = np.arccos(np.clip(-centre @ (goal - centre) / radius**2, -1, 1))
    arc = arc if np.linalg.norm(via - goal / 2) < radius else 2 * np.pi - arc
    assert turned.magnitude() == pytest.approx(arc if mode else 0.0, abs=0.02)


def test_three_points_on_a_line_make_no_circle() -> None:
    controller = UrController()
    points = ", ".join(
        f"pose_add(get_target_tcp_pose(), p[0, {y}, 0, 0, 0, 0])" for y in (0.1, 0.2)
    )
    assert controller.run_script(f"def test():\nmovec({points})\nend\n")
    cycle(controller)
    assert controller.program is None
    assert "on a line" in controller.messages[-1]


def test_joints_out_of_range_end_the_program_before_anything_moves() -> None:
    controller = UrController()
    assert controller.run_script("def far():\n movej([-123, 0, 0, 0, 0, 0])\nend\n")
    settle(controller, 0.1)
    assert controller.program is None and "-123" in controller.messages[-1]
    assert controller.motion.q == list(HOME) and controller.safety_mode == SafetyMode.NORMAL


def test_a_line_out_of_reach_is_a_protective_stop() -> None:
    controller = UrController()
    assert controller.run_script("def test():\nmovel(p[10, 0, 0, 0, 0, 0])\nend\n")
    cycle(controller)
    assert controller.safety_mode == SafetyMode.PROTECTIVE_STOP


@pytest.fixture
def peer() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(60.0)
        yield server


def test_a_program_reads_and_sends_integers(peer: socket.socket) -> None:
    port = peer.getsockname()[1]
    controller = UrController()
    assert controller.run_script(
        f"""def test():
          write_output_boolean_register(0, socket_open("127.0.0.1", {port}, "s"))
          none = socket_read_binary_integer(2, "s", 0.1)
          some = socket_read_binary_integer(2, "s", 0)
          write_output_integer_register(0, none[0])
          write_output_integer_register(1, some[0])
          write_output_integer_register(2, some[2])
          socket_send_int(some[1], "s")
          socket_close("s")
        end
        """
    )
    settle(controller, 0.2)
    assert controller.runtime == Runtime.PLAYING, "it waits without end"
    client, _ = peer.accept()
    with client:
        client.settimeout(60.0)
        client.sendall(struct.pack(">2i", -7, 11)[:5])
        settle(controller, 0.1)
        assert controller.runtime == Runtime.PLAYING, "half an integer is none"
        client.sendall(struct.pack(">2i", -7, 11)[5:])
        while controller.program is not None:
            cycle(controller)
        assert struct.unpack(">i", client.recv(4)) == (-7,)
        assert client.recv(1) == b"", "the end of the program closes the socket"
    assert controller.outputs["bit"][0] is True
    assert controller.outputs["int"][:3] == [0, 2, 11]


def test_a_flood_of_integers_is_read_and_is_no_infinite_loop(peer: socket.socket) -> None:
    controller = UrController()
    assert controller.run_script(
        f"""def test():
          socket_open("127.0.0.1", {peer.getsockname()[1]}, "s")
          sum = 0
          while sum < 4000:
            sum = sum + socket_read_binary_integer(1, "s", 0)[1]
          end
          write_output_integer_register(0, sum)
        end
        """
    )
    cycle(controller)
    client, _ = peer.accept()
    with client:
        client.sendall(struct.pack(">i", 1) * 5000)
        settle(controller, 1.0)
    assert controller.outputs["int"][0] == 4000, controller.messages


def test_where_nobody_listens_a_socket_stays_closed(peer: socket.socket) -> None:
    port = peer.getsockname()[1]
    peer.close()
    controller, _ = run(
        f'write_output_boolean_register(1, socket_open("127.0.0.1", {port}, "s"))\n'
        'write_output_integer_register(3, socket_read_binary_integer(1, "s", 0)[0])\n'
        'write_output_boolean_register(2, socket_send_int(1, "s"))'
    )
    assert not any(controller.outputs["bit"]) and controller.outputs["int"][3] == 0


def messages(session: PrimarySession, controller: UrController) -> list[tuple[int, bytes]]:
    """Kinds and bodies of the robot messages of the next tenth of a second."""
    data = b""
    for _ in range(50):
        cycle(controller)
        data += session.output()
    return [(part, body) for kind, part, body in primary_parts(data) if kind == 20]


def test_primary_clients_hear_start_end_and_failure_of_a_program() -> None:
    controller = UrController()
    session = PrimarySession(controller, "primary")
    session.greeting()
    session.receive(b"def good():\n  sync()\nend\n")
    heard = messages(session, controller)
    assert [(kind, body[9:]) for kind, body in heard] == [
        (7, b"PROGRAM_XXX_STARTEDgood"),
        (7, b"PROGRAM_XXX_STOPPEDgood"),
    ]
    session.receive(b"def bad():\n  sync()\n  x = y\nend\n")
    failed = [body for kind, body in messages(session, controller) if kind == 10]
    assert [struct.unpack_from(">i", body)[0] for body in failed] == [3]
    session.receive(b"def bad():\n  unheard()\nend\n")
    failed = [body for kind, body in messages(session, controller) if kind == 10]
    word = b"compile_error_name_not_found:unheard:"  # the maker's, at line and column
    assert failed == [struct.pack(">2i", 2, 3) + word]
    controller.protective_stop("test")
    heard = messages(session, controller)
    assert (5, 3) in [(kind, body[8]) for kind, body in heard]
    assert [struct.unpack_from(">3i", body)[2] for kind, body in heard if kind == 6] == [2]
    controller.unlock(at_once=True)
    session.receive(b"sec stop():\n protective_stop()\nend\n")
    codes = [body for kind, body in messages(session, controller) if kind == 6]
    assert [struct.unpack_from(">2i", body) for body in codes] == [(209, 0)]
    controller.remote = False
    session.receive(b"def good():\n  sync()\nend\n")
    codes = [body for kind, body in messages(session, controller) if kind == 6]
    assert [struct.unpack_from(">i", body)[0] for body in codes] == [210]


def test_the_primary_interface_powers_and_unlocks() -> None:
    controller = UrController(ready=False)
    session = PrimarySession(controller, "primary")
    session.receive(b"power on\n")
    settle(controller, 1.1)
    assert controller.robot_mode == RobotMode.IDLE
    session.receive(b"set robotmode run\n")
    settle(controller, 1.1)
    assert controller.robot_mode == RobotMode.RUNNING
    controller.protective_stop("test")
    settle(controller, 0.1)
    assert not controller.unlock(), "the dashboard is refused for 5 s"
    session.receive(b"set unlock protective stop\n")
    assert controller.safety_mode == SafetyMode.NORMAL
    session.receive(b"power off\n")
    assert controller.robot_mode == RobotMode.POWER_OFF


def test_the_state_tells_configuration_and_calibration() -> None:
    state = PrimarySession(UrController(model="UR10e"), "primary").state()
    parts = {part: body for _, part, body in primary_parts(state)}
    configuration = struct.unpack(">53d4i", parts[CONFIGURATION_DATA])
    assert configuration[29:35] == pytest.approx([0, -0.6127, -0.57155, 0, 0, 0])
    assert configuration[-2] == 2, "a UR10"
    assert parts[KINEMATICS_DATA][-1] == 2
    assert len(parts[MASTERBOARD_DATA]) == 70 and parts[MASTERBOARD_DATA][60] == SafetyMode.NORMAL


def test_a_persons_program_replaces_the_one_that_runs() -> None:
    controller = UrController()
    loop = "def {}():\n  while True:\n    sync()\n  end\nend\n"
    assert controller.run_script(loop.format("ours"))
    controller.programs["theirs.urp"] = loop.format("theirs")
    assert controller.load("theirs.urp") and controller.play()
    assert controller.program is not None and controller.program.name == "theirs"
