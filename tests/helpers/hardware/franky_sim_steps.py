"""Steps the arm of PyPI's franky-sim on request, on no clock: Q1 ... Q7. Needs nothing of ours.

A request on stdin is eight doubles: whether the arm moves, and its velocities [rad/s]. After one
step of 1 ms, positions [rad] and velocities come back on stdout, seven doubles each.
"""

import struct
import sys

import numpy as np
from franky_sim.mujoco_simulator import MujocoSimulator  # type: ignore[import]
from franky_sim_server import DAMPING  # type: ignore[import]

ASKED, SAID = struct.Struct("<8d"), struct.Struct("<14d")


def main(words: list[str]) -> None:
    """Serve until stdin ends."""
    with MujocoSimulator(enable_visualization=False) as simulator:
        arm = simulator.add_robot(initial_q=tuple(map(float, words)), kv=DAMPING)
        simulator.start()
        rest = np.array(arm.initial_q)
        while len(data := sys.stdin.buffer.read(ASKED.size)) == ASKED.size:
            moves, *velocities = ASKED.unpack(data)
            if moves:
                arm.joint_velocity_control(np.array(velocities))
                rest = np.array(arm.inner_state.q)
            else:
                arm.joint_position_control(rest)
            simulator.step()
            state = arm.inner_state
            sys.stdout.buffer.write(SAID.pack(*state.q, *state.dq))
            sys.stdout.buffer.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
