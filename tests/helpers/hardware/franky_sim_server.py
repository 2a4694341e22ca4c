"""Runs PyPI's franky-sim with its arm at given joints: ADDRESS Q1 ... Q7. Needs nothing of ours."""

import sys

import franky_sim  # type: ignore[import]
from franky_sim.mujoco_simulator import MujocoSimulator  # type: ignore[import]

DAMPING = (450.0, 450.0, 350.0, 350.0, 200.0, 200.0, 100.0)
"""[Nm s/rad] Gains of its velocity controller. Its own gain of joint 7, 200, times its step of 1 ms
over the joint's inertia of 0.085 kg m^2 is above 2: the joint swings by 0.08 rad/s every other
step, and a link that reads every other state sees a motion that nobody has commanded."""


def main(words: list[str]) -> None:
    """Serve until the process is ended."""
    with MujocoSimulator(enable_visualization=False) as simulator:
        simulator.add_robot(initial_q=tuple(map(float, words[1:8])), kv=DAMPING)
        with franky_sim.SimulationServer(simulator, hostname_candidates=[words[0]]) as server:
            print("ready", flush=True)
            server.run_forever()


if __name__ == "__main__":
    main(sys.argv[1:])
