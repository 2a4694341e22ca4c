"""The programs that the link uploads to a UR controller.

There is no motion through RTDE alone: its registers only feed a program on the robot. This program
obeys joint velocities, and has a dead-man of its own.
"""

from __future__ import annotations

from surg_hardware.stop_ramp import LARGEST_LAG, LEAST

REGISTER = 24
"""First of the registers that belong to external RTDE clients. Input: integer REGISTER is the
command's number, doubles REGISTER to REGISTER + 5 are the velocities. Output: integer REGISTER is
the number of the command in force."""
ACCELERATION = 40.0
"""[rad/s^2] Of ``speedj``; the link itself limits the change of a command below it."""
GUIDING = 1
"""In output integer REGISTER + 1 while a person guides the arm."""
DEAD_MAN_CYCLES = 10
"""Cycles without a new command number after which the program stops the arm: 20 ms."""
WATCHDOG = 25.0
"""[1/s] The controller itself stops a program whose command number is written less often. It also
stops a program that wakes from a pause, before the arm has its old speed again."""

_FOLLOW = """\
def surg_link():
  rtde_set_watchdog("input_int_register_{n0}", {watchdog}, "stop")
  write_output_integer_register({n1}, 0)
  global command = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  thread drive():
    while True:
      speedj(command, {acceleration}, 0.002)
    end
  end
  last = read_input_integer_register({n0})
  silent = 0
  driving = run drive()
  while silent < {cycles}:
    number = read_input_integer_register({n0})
    command = [{velocities}]
    if number == last:
      silent = silent + 1
    else:
      silent = 0
      last = number
      write_output_integer_register({n0}, number)
    end
    sync()
  end
  rtde_set_watchdog("input_int_register_{n0}", 0.0, "ignore")
  start = command
  targets = get_target_joint_positions()
  angles = get_actual_joint_positions()
  back = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  leading = 0.0
  square = 0.0
  along = 0.0
  i = 0
  while i < 6:
    back[i] = targets[i] - angles[i]
    along = along + back[i] * start[i]
    square = square + start[i] * start[i]
    if norm(start[i]) > leading:
      leading = norm(start[i])
    end
    i = i + 1
  end
  i = 0
  while i < 6 and square > 0.0:
    back[i] = back[i] - start[i] * along / square
    if norm(back[i]) > {lag} * leading:
      back[i] = back[i] / norm(back[i]) * {lag} * leading
    end
    i = i + 1
  end
  braking = leading / {deceleration}
  duration = braking
  if duration < {least}:
    duration = {least}
  end
  passed = 0.001
  while passed < duration and square > 0.0:
    share = 1.0 - passed / braking
    if share < 0.0:
      share = 0.0
    end
    rate = 6.0 * passed * (duration - passed) / pow(duration, 3)
    next = start
    i = 0
    while i < 6:
      next[i] = share * start[i] - rate * back[i]
      i = i + 1
    end
    command = next
    passed = passed + 0.002
    sync()
  end
  kill driving
  stopj({deceleration})
end
"""
"""When commands cease, the program brings the arm to rest as `stop_ramp.StopRamp` does, evaluated
in the middle of each cycle. It uses only loops and scalars, which every version of URScript has."""
_GUIDE = """\
def surg_guide():
  write_output_integer_register({n1}, {guiding})
  freedrive_mode()
  while True:
    sync()
  end
end
"""


def follow_program(deceleration: float) -> str:
    """The program that follows the link's velocities.

    Args:
        deceleration: [rad/s^2] of the leading joint when commands cease.
    """
    velocities = ", ".join(f"read_input_float_register({REGISTER + i})" for i in range(6))
    return _FOLLOW.format(
        acceleration=ACCELERATION,
        watchdog=WATCHDOG,
        n0=REGISTER,
        n1=REGISTER + 1,
        cycles=DEAD_MAN_CYCLES,
        velocities=velocities,
        lag=LARGEST_LAG,
        least=LEAST,
        deceleration=float(deceleration),
    )


def guide_program() -> str:
    """The program that lets a person guide the arm by hand, until it is stopped."""
    return _GUIDE.format(n1=REGISTER + 1, guiding=GUIDING)
