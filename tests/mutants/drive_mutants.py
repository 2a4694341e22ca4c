"""Hand-written mutants of an instrument's drive and of its emulated servos.

As in `hardware_mutants`; files below `drive`.
"""

from __future__ import annotations

from mutants.mutants import Mutant, one

DRIVE, FILE = ("test_instrument_drive",), ("test_drive_file",)
SERVOS = ("test_servo_emulator",)
MUTANTS: tuple[Mutant, ...] = (
    one(
        "drive_turns_unasked",
        "the instrument moves as soon as its power is on",
        "drive/instrument_drive.py",
        "        self._homing = self._coupling = self._q = None\n",
        "        self._homing, self._coupling = Homing(self._drive), None\n",
        DRIVE,
    ),
    one(
        "dropped_needle",
        "jaws that grip open when another motor fails",
        "drive/instrument_drive.py",
        "            joints[jaw] = self._goal[jaw]\n",
        "            pass\n",
        DRIVE,
    ),
    one(
        "jaws_never_open",
        "a cell's `open` does nothing",
        "drive/instrument_drive.py",
        '        if self._drive.when_lost == "open":\n',
        "        if False:\n",
        DRIVE,
    ),
    one(
        "old_angle_said_again",
        "the controller believes in jaws that nobody measures",
        "drive/instrument_drive.py",
        '        self.status = DriveStatus(self.status.state, "")\n',
        "        pass\n",
        DRIVE,
    ),
    one(
        "failure_of_a_drive_does_not_latch",
        "a motor that has failed goes on by itself",
        "drive/instrument_drive.py",
        "        if self.status.state not in (DriveState.DISCONNECTED, DriveState.FAILED):\n",
        "        if self.status.state is not DriveState.DISCONNECTED:\n",
        DRIVE,
    ),
    one(
        "silent_motor_unnoticed",
        "the arm moves with an instrument that nobody drives",
        "drive/motor_guard.py",
        "self._missed[motor_id] >= MISSED and now",
        "False and now",
        DRIVE,
    ),
    one(
        "stalled_motor_unnoticed",
        "a wrist that is stuck counts as good",
        "drive/motor_guard.py",
        "            elif now - self._stalls.setdefault(motor_id, now) > STALLED:\n",
        "            elif False:\n",
        DRIVE,
    ),
    one(
        "hot_motor_unnoticed",
        "a motor burns",
        "drive/motor_guard.py",
        "        if reading.temperature > hottest:\n",
        "        if False:\n",
        DRIVE,
    ),
    one(
        "homing_with_all_current",
        "a motor breaks the instrument's stop",
        "drive/homing.py",
        "        return MotorOrder(goal, homing.current, SPEED * motor.gear)\n",
        "        return MotorOrder(goal, motor.current, SPEED * motor.gear)\n",
        DRIVE,
    ),
    one(
        "homing_without_an_end",
        "a motor without a stop winds its cables up",
        "drive/homing.py",
        "        if turned > homing.travel - ARRIVED:\n",
        "        if False:\n",
        DRIVE,
    ),
    one(
        "dead_motor_is_at_its_stop",
        "a motor without power counts as homed",
        "drive/homing.py",
        "            if abs(reading.current) < PUSHING * homing.current:\n",
        "            if False:\n",
        DRIVE,
    ),
    one(
        "force_bound_of_the_model",
        "the motor itself allows more current than the file",
        "drive/dynamixel_bus.py",
        '                ("Current Limit", _steps(motor.current)),\n',
        "",
        DRIVE,
    ),
    one(
        "motor_without_a_watchdog",
        "a motor goes on when the program has died",
        "drive/dynamixel_bus.py",
        '            self.write(motor_id, "Bus Watchdog", WATCHDOG)\n',
        "",
        DRIVE,
    ),
    one(
        "shortened_answer_is_read",
        "an angle is wrong by the SDK's missing byte",
        "drive/dynamixel_bus.py",
        " and packet[5] | packet[6] << 8 == self._read_size + 4\n",
        "\n",
        DRIVE,
    ),
    one(
        "goals_beyond_the_limits",
        "the wrist turns against its stop",
        "drive/coupling.py",
        "        within = np.clip(joints, self._lower, self._upper)\n",
        "        within = joints\n",
        FILE,
    ),
    one(
        "singular_coupling_is_taken",
        "a joint without a motor of its own counts as driven",
        "drive/drive_file.py",
        "    if not np.linalg.cond(coupling) < SINGULAR:\n",
        "    if False:\n",
        FILE,
    ),
)
EMULATED: tuple[Mutant, ...] = (
    one(
        "frames_without_stuffing",
        "parameters look like a header",
        "drive/servo_frames.py",
        ".replace(_MARK, _STUFFED)",
        "",
        SERVOS,
    ),
    one(
        "noise_swallows_a_frame",
        "a servo is deaf behind a broken header",
        "drive/servo_frames.py",
        "            self._held = self._held[1:]\n            found += self.feed",
        "            self._held = b''\n            found += self.feed",
        SERVOS,
    ),
    one(
        "emulated_watchdog_off",
        "the emulator hides that nobody speaks to the motors",
        "drive/servo_motor.py",
        "            self.table[WATCHDOG] = 0xFF\n",
        "            pass\n",
        SERVOS,
    ),
    one(
        "emulated_servo_without_a_bound",
        "a homing against a stop looks harmless",
        "drive/servo_motor.py",
        "        wanted = min(max(STIFFNESS * off, -bound), bound)\n",
        "        wanted = STIFFNESS * off\n",
        SERVOS,
    ),
)
