"""Dashboard, primary interface and faults of the emulated controller, without sockets."""

import struct

import pytest

from helpers.hardware.emulated_ur import primary_parts, settle
from surg_emulators.fault_lines import FaultError, Kind, Schedule, parse
from surg_emulators.ur import dh_kinematics as dh
from surg_emulators.ur.dashboard_server import LOCAL, DashboardSession
from surg_emulators.ur.primary_server import PrimarySession, ScriptBuffer
from surg_emulators.ur.robot_states import RobotMode, Runtime, SafetyMode
from surg_emulators.ur.ur_controller import UNLOCK_AFTER, UrController

LOOP = "def loop():\n  while True:\n    sync()\n  end\nend\n"


def ask(controller: UrController, *lines: str) -> list[str]:
    session = DashboardSession(controller)
    said = session.receive("".join(f"{line}\n" for line in lines).encode())
    return said.decode().splitlines()


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("robotmode", "Robotmode: RUNNING"),
        ("safetystatus", "Safetystatus: NORMAL"),
        ("safetymode", "Safetymode: NORMAL"),
        ("running", "Program running: false"),
        ("programState", "STOPPED <unnamed>"),
        ("get serial number", "20225500001"),
        ("get robot model", "UR5"),
        ("is in remote control", "true"),
        ("get loaded program", "No program loaded"),
        ("play", "Failed to execute: play"),
        ("stop", "Stopped"),
        ("load nothing.urp", "File not found: nothing.urp"),
        ("power on", "Powering on"),
        ("quit", "Disconnected"),
        ("dance", "could not understand: 'dance'"),
    ],
)
def test_the_dashboard_answers_as_an_arm_does(line: str, answer: str) -> None:
    assert ask(UrController(), line) == [answer]


def test_the_dashboard_brings_an_arm_up() -> None:
    controller = UrController(ready=False)
    assert ask(controller, "robotmode", "power on") == ["Robotmode: POWER_OFF", "Powering on"]
    settle(controller, 1.1)
    assert ask(controller, "robotmode", "brake release") == ["Robotmode: IDLE", "Brake releasing"]
    settle(controller, 1.1)
    assert ask(controller, "robotmode") == ["Robotmode: RUNNING"]


def test_the_dashboard_unlocks_after_five_seconds() -> None:
    controller = UrController()
    controller.protective_stop("test")
    (early,) = ask(controller, "unlock protective stop")
    assert early.startswith("Cannot unlock protective stop until 5s")
    assert controller.safety_mode == SafetyMode.PROTECTIVE_STOP
    settle(controller, UNLOCK_AFTER)
    assert ask(controller, "unlock protective stop") == ["Protective stop releasing"]
    assert controller.safety_mode == SafetyMode.NORMAL


def test_local_control_answers_questions_and_refuses_orders() -> None:
    controller = UrController()
    before = DashboardSession(controller)
    controller.remote = False
    asked = ask(controller, "robotmode", "is in remote control", "play", "unlock protective stop")
    assert asked == ["Robotmode: RUNNING", "false", LOCAL, LOCAL]
    assert before.answer("stop") == LOCAL
    session = DashboardSession(controller)
    controller.remote = True
    assert session.answer("stop") == LOCAL  # until it connects again
    assert DashboardSession(controller).answer("stop") == "Stopped"


def test_a_long_line_ends_the_connection() -> None:
    session = DashboardSession(UrController())
    assert session.receive(b"x" * 5000) == b""
    assert session.closed


def test_a_loaded_program_is_played_paused_and_stopped() -> None:
    controller = UrController()
    controller.programs["loop.urp"] = LOOP
    said = ask(controller, "load loop.urp", "play", "running", "pause", "programState")
    assert said[:2] == ["Loading program: loop.urp", "Starting program"]
    assert said[2:] == ["Program running: true", "Pausing program", "PAUSED loop.urp"]
    assert ask(controller, "play", "stop") == ["Starting program", "Stopped"]
    assert ask(controller, "load /programs/loop.urp") == ["Loading program: /programs/loop.urp"]
    assert ask(controller, "load /tmp/loop.urp") == ["File not found: /tmp/loop.urp"]


def test_the_primary_interface_tells_version_state_and_kinematics() -> None:
    controller = UrController(dh_errors=[(0.001, 0.0, 0.0), *[(0.0, 0.0, 0.0)] * 5])
    session = PrimarySession(controller, "primary")
    parts = {(kind, part): body for kind, part, body in primary_parts(session.greeting())}
    assert parts[20, 3][1:10] == b"URControl"
    assert tuple(parts[20, 3][10:12]) == (5, 12)
    mode = struct.unpack(">Q7?bB3d", parts[16, 0][:-1])
    assert mode[1:8] == (True, True, True, False, False, False, False)
    assert mode[8] == RobotMode.RUNNING
    assert mode[10:] == (1.0, 1.0, 1.0)
    joints = [struct.unpack_from(">3d4fB", parts[16, 1], 41 * joint) for joint in range(6)]
    assert [joint[0] for joint in joints] == controller.motion.actual_q
    assert {joint[-1] for joint in joints} == {253}
    kinematics = struct.unpack(">6I24dI", parts[16, 5])
    d = [row[0] for row in dh.TABLES["UR5e"]]
    assert kinematics[18:24] == pytest.approx([d[0] + 0.001, *d[1:]])
    assert kinematics[-1] == 2, "as an arm that has left the works"


def test_messages_reach_the_primary_interface_only() -> None:
    controller = UrController()
    sessions = [PrimarySession(controller, name) for name in ("primary", "secondary", "script")]
    for session in sessions:
        session.greeting()
    controller.say("hello")
    texts = []
    for _ in range(50):
        controller.advance()
        texts.append([session.output() for session in sessions])
    said = [b"".join(row) for row in zip(*texts, strict=True)]
    assert (b"hello" in said[0], b"hello" in said[1]) == (True, False)
    assert said[2] == b""


def test_scripts_arrive_in_pieces_and_run_whole() -> None:
    controller = UrController()
    session = PrimarySession(controller, "secondary")
    for place in range(0, len(LOOP), 5):
        assert controller.program is None
        session.receive(LOOP[place : place + 5].encode())
    assert controller.runtime == Runtime.PLAYING
    session.receive(b"stop program\n")
    assert controller.program is None


def test_scripts_are_ignored_in_local_control() -> None:
    controller = UrController()
    controller.remote = False
    PrimarySession(controller, "secondary").receive(LOOP.encode())
    assert controller.program is None
    assert "local control" in controller.messages[-1]


def test_a_stream_of_text_is_cut_into_programs() -> None:
    buffer = ScriptBuffer()
    assert buffer.feed(b"set_tcp(p[0,0,0,0,0,0])\n\n" + LOOP.encode()) == [
        "set_tcp(p[0,0,0,0,0,0])",
        LOOP.rstrip("\n"),
    ]
    buffer.feed(b"x" * (1 << 20))
    assert not buffer.too_long
    buffer.feed(b"x")
    assert buffer.too_long


def test_faults_are_parsed() -> None:
    assert parse("  # nothing") is None
    fault = parse("at 2.5 slider 50  # percent")
    assert fault is not None
    assert (fault.delay, fault.name, fault.words) == (2.5, "slider", ("50",))


@pytest.mark.parametrize("line", ["at", "at x stop", "at -1 stop", "at 1"])
def test_wrong_times_are_refused(line: str) -> None:
    with pytest.raises(FaultError):
        parse(line)


def test_faults_happen_in_their_order_and_once() -> None:
    done: list[str] = []
    schedule = Schedule({"note": Kind(done.append, "TEXT", "")})
    schedule.read("at 2 note b\nat 1 note a\n\nnote c", 10.0)
    assert schedule.due(10.0) == ["note c: ok"]
    assert schedule.due(10.9) == []
    assert schedule.due(13.0) == ["note a: ok", "note b: ok"]
    assert schedule.due(99.0) == []
    assert done == ["c", "a", "b"]


@pytest.mark.parametrize("text", ["note", "note a b", "other", "at 1 other"])
def test_a_wrong_line_of_a_file_takes_over_nothing(text: str) -> None:
    done: list[str] = []
    schedule = Schedule({"note": Kind(done.append, "TEXT", "")})
    assert schedule.answer(text, 0.0).startswith("error: ")
    if "other" in text:
        with pytest.raises(FaultError, match="line 2"):
            schedule.read(f"note a\n{text}", 0.0)
        assert schedule.due(9.0) == []
    assert done == []


def test_only_the_newest_messages_are_kept() -> None:
    controller = UrController()
    for count in range(500):
        controller.say(f"message {count}")
    assert controller.messages[-1] == "message 499"
    assert len(controller.messages) == 200
