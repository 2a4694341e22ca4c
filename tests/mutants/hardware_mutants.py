"""Hand-written mutants of the links to real arms and of their emulators.

As in `mutants`, but the files are below `src/surg_hardware/src/surg_hardware`, and `first` names
test files of `tests/unit/hardware`.
"""

from __future__ import annotations

from mutants.mutants import Mutant, one

LINK, CHAIN = ("test_robot_link",), ("test_ur_link_on_emulator",)
STATES, RTDE = ("test_ur_emulator_states",), ("test_ur_emulator_rtde",)
MUTANTS: tuple[Mutant, ...] = (
    # -- link and program
    one(
        "dead_man_of_the_link_off",
        "a controller that hangs leaves the arm in motion",
        "robot_link.py",
        "silent = command is None or not now - command.received <= self._settings.dead_man",
        "silent = command is None",
        LINK,
    ),
    one(
        "dead_man_of_the_robot_off",
        "a killed driver leaves the arm in motion",
        "ur/urscript.py",
        "  while silent < {cycles}:",
        "  while True:",
        CHAIN,
    ),
    one(
        "latch_off",
        "an unlocked arm goes on by itself",
        "robot_link.py",
        "        self._phase, self._why = _Phase.IDLE, why\n",
        "        self._why = why\n",
        LINK,
    ),
    one(
        "start_while_enabled",
        "the arm leaps to the set-point as its program starts",
        "robot_link.py",
        "        if enabled:\n",
        "        if False:\n",
        LINK,
    ),
    one(
        "start_under_a_command",
        "the arm moves as soon as its program starts",
        "robot_link.py",
        "        if now - self._last_motion < QUIET:\n",
        "        if False:\n",
        LINK,
    ),
    one(
        "start_of_a_booting_robot",
        "a program is lost in the restart of RTDE",
        "robot_link.py",
        "        if known_for < SETTLED:\n",
        "        if False:\n",
        LINK,
    ),
    one(
        "any_velocity",
        "a wrong command reaches the arm",
        "robot_link.py",
        "            if not abs(value) <= limit:\n",
        "            if False:\n",
        LINK,
    ),
    one(
        "any_number_of_joints",
        "a command of another arm is obeyed",
        "robot_link.py",
        "        if len(command.qd) != len(limits):\n",
        "        if False:\n",
        LINK,
    ),
    one(
        "any_acceleration",
        "the robot stops itself at a jump of the command",
        "robot_link.py",
        "            if abs(then - now) > acceleration * elapsed:\n",
        "            if False:\n",
        LINK,
    ),
    one(
        "ended_program_unnoticed",
        "the controller moves an arm that stands",
        "robot_link.py",
        "            not state.program or now - self._echoed > ECHO_TIMEOUT\n",
        "            False\n",
        LINK,
    ),
    one(
        "joints_in_another_order",
        "the arm moves another joint",
        "ur/urscript.py",
        "for i in range(6))",
        "for i in (1, 0, 2, 3, 4, 5))",
        CHAIN,
    ),
    one(
        "paused_program_left_on_the_robot",
        "play on the pendant gives the arm its old speed back",
        "robot_link.py",
        "self._ours and state.paused)",
        "False)",
        CHAIN,
    ),
    one(
        "watchdog_of_the_robot_off",
        "play in local control gives the arm its old speed back",
        "ur/urscript.py",
        '  rtde_set_watchdog("input_int_register_{n0}", {watchdog}, "stop")\n',
        "",
        CHAIN,
    ),
    one(
        "slider_unseen",
        "the arm is slower than the controller believes",
        "conditions.py",
        "    if not speed_scaling >= FULL_SPEED:\n",
        "    if False:\n",
        ("test_conditions",),
    ),
    one(
        "clock_goes_back_unnoticed",
        "states of a restarted robot are taken for late ones",
        "robot_clock.py",
        "        return not robot_time >= self._last - REBOOT\n",
        "        return False\n",
        ("test_robot_clock",),
    ),
    one(
        "packet_of_length_0",
        "the driver hangs on a malformed packet",
        "ur/rtde.py",
        "            if length < _HEADER.size:\n",
        "            if False:\n",
        ("test_hardware_fuzz",),
    ),
    # -- emulated arm
    one(
        "unlocked_too_early",
        "an early unlock works on the emulator and not on the arm",
        "emulators/ur/ur_controller.py",
        "        if self.cycles * DT - self._stopped_at < UNLOCK_AFTER:\n",
        "        if False:\n",
        STATES,
    ),
    one(
        "any_target_speed",
        "a command that stops the arm does not stop the emulator",
        "emulators/ur/joint_motion.py",
        "            if not abs(qd[joint]) <= MAX_SPEED:\n",
        "            if False:\n",
        STATES,
    ),
    one(
        "joints_without_ramps",
        "delays of the emulator are shorter than an arm's",
        "emulators/ur/joint_motion.py",
        "share = min(1.0, self.a * dt / largest) if largest > 0.0 else 1.0",
        "share = 1.0",
        ("test_ur_emulator_motion",),
    ),
    one(
        "inputs_at_once",
        "a command takes effect a cycle too early",
        "emulators/ur/ur_controller.py",
        "        for name, value in self._arrived.items():\n",
        "        self._arrived = self._arrived | self._staged\n"
        "        for name, value in self._arrived.items():\n",
        CHAIN,
    ),
    one(
        "registers_never_in_use",
        "two clients command one arm",
        "emulators/ur/rtde_server.py",
        "            taken = claims.get(name, self) is not self\n",
        "            taken = False\n",
        RTDE,
    ),
    one(
        "packets_of_any_size",
        "a client's wrong recipe goes unnoticed",
        "emulators/ur/rtde_server.py",
        "        if len(body) - 1 != recipe.body.size:\n",
        "        if len(body) - 1 < recipe.body.size:\n",
        RTDE,
    ),
    one(
        "power_after_an_emergency_stop",
        "the emulator moves again without power and brakes",
        "emulators/ur/ur_controller.py",
        "            if self.safety_mode in DEAD:\n                self._power_down()\n",
        "",
        STATES,
    ),
    one(
        "two_threads_in_motion",
        "a program runs on the emulator and not on the arm",
        "emulators/ur/urscript_machine.py",
        "                if other is not thread and other.alive and other.wait and "
        "other.wait.motion:\n",
        "                if False:\n",
        ("test_ur_emulator_script",),
    ),
    one(
        "wrong_forearm",
        "the emulator's flange is 1 mm off",
        "emulators/ur/dh_kinematics.py",
        "(0.0, -0.3922, 0.0)",
        "(0.0, -0.3932, 0.0)",
        ("test_ur_emulator_motion",),
    ),
)
