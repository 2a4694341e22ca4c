"""Modes, safety and program of the emulated UR controller, exact in cycles."""

import pytest

from helpers.hardware.emulated_ur import QD_REGISTERS, Client, cycle, follow, settle
from surg_emulators.ur.joint_motion import AT_REST, BRAKING, DT
from surg_emulators.ur.robot_states import RobotMode, Runtime, SafetyMode
from surg_emulators.ur.rtde_server import RtdeSession
from surg_emulators.ur.ur_controller import POWER_TIME, UNLOCK_AFTER, UrController

TURN = "def turn():\n speedj([0.5, 0, 0, 0, 0, 0], 10, 100)\nend\n"


def turning(seconds: float = 0.3) -> UrController:
    """An arm that turns its first joint at 0.5 rad/s."""
    controller = UrController()
    assert controller.run_script(TURN)
    settle(controller, seconds)
    assert controller.motion.actual_qd[0] == pytest.approx(0.5, abs=1e-3)
    return controller


def cycles_to_rest(controller: UrController) -> int:
    for count in range(1000):
        if controller.motion.at_rest:
            return count
        cycle(controller)
    raise AssertionError("the arm does not stop")


def test_a_register_acts_in_the_next_cycle_and_moves_the_arm_in_the_one_after() -> None:
    controller = UrController()
    client = Client(RtdeSession(controller))
    number = client.set_up(
        ["output_int_register_24", "target_qd", "actual_qd"],
        ["input_int_register_24", *QD_REGISTERS],
    )
    assert controller.run_script(follow())
    settle(controller, 0.1)
    states = []
    for count in range(12):
        states.append(cycle(controller, client))
        if count == 3:  # the answer to state 3
            assert client.send(number, 7, 0.05, 0, 0, 0, 0, 0) == []
    echoed = next(n for n, state in enumerate(states) if state["output_int_register_24"] == 7)
    moved = next(n for n, state in enumerate(states) if state["target_qd"][0] > 0.0)
    # Read in cycle 4; both the answer and the motion are in state 5.
    assert echoed == 5
    assert moved == 5
    assert states[moved]["actual_qd"][0] > 0.0


@pytest.mark.parametrize(
    ("script", "word"),
    [
        ("speedj([3.3, 0, 0, 0, 0, 0], 10, 100)", "speed"),
        ("speedj([1.0, 0, 0, 0, 0, 0], 50, 100)", "acceleration"),
        ("servoj([1.0, -1.5708, -1.5708, -1.5708, 1.5708, 0])", "speed"),
    ],
)
def test_what_the_arm_refuses_is_a_protective_stop(script: str, word: str) -> None:
    controller = UrController()
    assert controller.run_script(f"def a():\n {script}\n sleep(10)\nend\n")
    settle(controller, 1.0)
    assert controller.safety_mode == SafetyMode.PROTECTIVE_STOP
    assert word in controller.messages[-1]
    assert controller.motion.at_rest


def test_a_protective_stop_brakes_pauses_and_unlocks_after_five_seconds() -> None:
    controller = turning()
    start = controller.motion.actual_q[0]
    controller.protective_stop("test")
    assert cycles_to_rest(controller) * DT == pytest.approx(0.5 / BRAKING, abs=0.04)
    assert controller.motion.actual_q[0] - start == pytest.approx(0.25 / 2 / BRAKING, abs=0.005)
    assert controller.runtime == Runtime.PAUSED
    assert not controller.play()
    while controller.cycles * DT - controller._stopped_at < UNLOCK_AFTER - 1.5 * DT:
        assert not controller.unlock()
        cycle(controller)
    cycle(controller)
    cycle(controller)
    assert controller.unlock()
    rest = list(controller.motion.actual_q)
    settle(controller, 0.5)
    assert controller.motion.actual_q == rest  # unlocking moves nothing
    assert controller.play()
    settle(controller, 0.5)
    assert controller.motion.actual_qd[0] == pytest.approx(0.5, abs=1e-3)  # but play goes on


@pytest.mark.parametrize("mode", [SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.FAULT])
def test_an_emergency_stop_cuts_the_power_at_rest(mode: SafetyMode) -> None:
    controller = turning()
    controller.fall_to(mode, "test")
    assert controller.robot_mode == RobotMode.RUNNING
    cycles_to_rest(controller)
    cycle(controller)
    assert controller.robot_mode == RobotMode.POWER_OFF
    assert controller.program is None
    controller.power_on()
    settle(controller, 2.5)
    assert controller.robot_mode == RobotMode.POWER_OFF  # refused until it is released
    controller.release()
    controller.release_brakes()
    settle(controller, 2 * POWER_TIME + 0.1)
    assert (controller.robot_mode, controller.safety_mode) == (7, 1)
    assert controller.motion.at_rest
    assert not controller.play()


def test_power_and_brakes_follow_one_another() -> None:
    controller = UrController(ready=False)
    assert not controller.run_script(TURN)
    controller.power_on()
    assert controller.robot_mode == RobotMode.POWER_ON
    settle(controller, POWER_TIME + 0.01)
    assert controller.robot_mode == RobotMode.IDLE
    settle(controller, 3 * POWER_TIME)
    assert controller.robot_mode == RobotMode.IDLE
    controller.release_brakes()
    settle(controller, POWER_TIME + 0.01)
    assert controller.robot_mode == RobotMode.RUNNING
    controller.engage_brakes()
    assert controller.robot_mode == RobotMode.IDLE
    controller.power_off()
    assert controller.robot_mode == RobotMode.POWER_OFF


def test_the_slider_scales_speedj() -> None:
    controller = turning()
    controller.slider = 0.5
    settle(controller, 0.05)
    assert 0.5 < controller.motion.scale < 1.0
    settle(controller, 0.3)
    assert controller.motion.scale == 0.5
    assert controller.motion.actual_qd[0] == pytest.approx(0.25, abs=1e-3)
    assert controller.safety_mode == SafetyMode.NORMAL


def test_pause_slows_down_along_the_way_and_play_goes_on() -> None:
    controller = turning()
    assert controller.pause()
    settle(controller, 0.4)
    assert controller.runtime == Runtime.PAUSED
    assert controller.motion.at_rest
    assert controller.play()
    settle(controller, 0.5)
    assert controller.motion.actual_qd[0] == pytest.approx(0.5, abs=1e-3)
    assert controller.safety_mode == SafetyMode.NORMAL


def test_stop_ends_the_program_and_the_motion() -> None:
    controller = turning()
    controller.stop()
    assert controller.runtime == Runtime.STOPPED
    cycles_to_rest(controller)
    assert not controller.play()


def test_a_new_program_begins_when_the_arm_has_stopped() -> None:
    controller = turning()
    assert controller.run_script(TURN.replace("0.5", "-0.5"))
    assert not controller.motion.at_rest
    cycles_to_rest(controller)
    settle(controller, 0.3)
    assert controller.motion.actual_qd[0] == pytest.approx(-0.5, abs=1e-3)


def test_a_hand_moves_the_arm_and_the_program_does_not() -> None:
    controller = turning()
    controller.guide(True, [0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    before = list(controller.motion.actual_q)
    settle(controller, 1.0)
    moved = [b - a for a, b in zip(before, controller.motion.actual_q, strict=True)]
    assert moved == pytest.approx([0.0, 0.1, 0.0, 0.0, 0.0, 0.0], abs=1e-9)
    assert controller.motion.actual_qd[1] == pytest.approx(0.1)


def test_the_safeguard_stop_pauses_until_it_is_reset_and_played() -> None:
    controller = turning()
    controller.safeguard(True)
    settle(controller, 0.3)
    assert controller.motion.at_rest
    assert controller.safety_mode == SafetyMode.SAFEGUARD_STOP
    controller.safeguard(False)
    settle(controller, 0.3)
    assert controller.motion.at_rest
    assert controller.play()


def test_reduced_mode_is_told() -> None:
    controller = UrController()
    controller.reduce(True)
    assert controller.safety_mode == SafetyMode.REDUCED
    assert controller.run_script(TURN)
    controller.protective_stop("test")
    settle(controller, UNLOCK_AFTER + 0.01)
    assert controller.unlock()
    assert controller.safety_mode == SafetyMode.REDUCED


def test_booting_loses_program_registers_and_time() -> None:
    controller = turning()
    controller.outputs["int"][24] = 5
    controller.tcp_offset = [0.0, 0.0, 0.2, 0.0, 0.0, 0.0]
    controller.boot()
    assert controller.timestamp == 0.0
    assert controller.robot_mode == RobotMode.BOOTING
    assert controller.program is None
    assert controller.outputs["int"][24] == 0
    assert controller.tcp_offset[2] == 0.2
    assert cycles_to_rest(controller) * DT < 0.1  # the brakes
    q = list(controller.motion.actual_q)
    settle(controller, 4.1)
    assert controller.robot_mode == RobotMode.POWER_OFF
    assert controller.motion.actual_q == q


@pytest.mark.parametrize(("action", "runtime"), [("stop", 1), ("pause", 4), ("ignore", 2)])
def test_the_watchdog_acts_when_a_field_is_no_longer_written(action: str, runtime: int) -> None:
    controller = UrController()
    watch = f'rtde_set_watchdog("input_int_register_24", 25, "{action}")'
    assert controller.run_script(
        f"def a():\n {watch}\n while True:\n speedj([0.1, 0, 0, 0, 0, 0], 5, 0.002)\n end\nend\n"
    )
    for _ in range(100):
        controller.stage({"input_int_register_24": 1})
        cycle(controller)
    assert controller.runtime == Runtime.PLAYING
    for _ in range(20):
        cycle(controller)
    assert controller.runtime == Runtime.PLAYING  # 40 ms are allowed
    for _ in range(110):
        cycle(controller)
    assert controller.runtime == runtime
    assert (abs(controller.motion.qd[0]) < AT_REST) == (action != "ignore")


def test_inputs_set_the_slider_and_the_outputs() -> None:
    controller = UrController()
    client = Client(RtdeSession(controller))
    number = client.set_up(
        ["target_speed_fraction", "actual_digital_output_bits", "input_bit_registers0_to_31"],
        [
            "speed_slider_mask",
            "speed_slider_fraction",
            "standard_digital_output_mask",
            "standard_digital_output",
            "input_bit_registers0_to_31",
        ],
    )
    client.send(number, 1, 0.25, 0b1111, 0b0101, 0x80000001)
    cycle(controller, client)
    state = cycle(controller, client)
    assert state["target_speed_fraction"] == 0.25
    assert state["actual_digital_output_bits"] == 0b0101
    assert state["input_bit_registers0_to_31"] == 0x80000001
    client.send(number, 0, 0.75, 0b0001, 0b0000, 0)  # the masks say what is meant
    cycle(controller, client)
    state = cycle(controller, client)
    assert state["target_speed_fraction"] == 0.25
    assert state["actual_digital_output_bits"] == 0b0100
