"""Runs PyPI's franky-sim with its arm at given joints: ADDRESS Q1 ... Q7. Needs nothing of ours."""

import sys

import franky_sim  # type: ignore[import]
from franky_sim.mujoco_simulator import MujocoSimulator  # type: ignore[import]


def main(words: list[str]) -> None:
    """Serve until the process is ended."""
    with MujocoSimulator(enable_visualization=False) as simulator:
        simulator.add_robot(initial_q=tuple(map(float, words[1:8])))
        with franky_sim.SimulationServer(simulator, hostname_candidates=[words[0]]) as server:
            print("ready", flush=True)
            server.run_forever()


if __name__ == "__main__":
    main(sys.argv[1:])
