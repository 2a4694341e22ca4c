"""Runs PyPI's franky-sim with its arm at given joints: ADDRESS Q1 ... Q7. Needs nothing of ours."""

import sys
import time

import franky_sim  # type: ignore[import]
from franky_sim.mujoco_simulator import MujocoSimulator  # type: ignore[import]

DAMPING = (450.0, 450.0, 350.0, 350.0, 200.0, 200.0, 100.0)
"""[Nm s/rad] Gains of its velocity controller. Its own gain of joint 7, 200, times its step of 1 ms
over the joint's inertia of 0.085 kg m^2 is above 2: the joint swings by 0.08 rad/s every other
step, and a link that reads every other state sees a motion that nobody has commanded."""
TICK, SHORTEST, LATE, LONG = 1e-3, 0.8e-3, 0.02, 0.01
"""[s] Of its clock; the shortest one while it catches up; how much it catches up; what is told."""


def main(words: list[str]) -> None:
    """Serve until the process is ended.

    Its own loop sleeps for what is left of a millisecond and wakes a little late each time: its
    clock runs 4 % slow, and an arm that is slow by 4 % looks like one that lags. Each tick here has
    its moment.
    """
    with MujocoSimulator(enable_visualization=False) as simulator:
        simulator.add_robot(initial_q=tuple(map(float, words[1:8])), kv=DAMPING)
        with franky_sim.SimulationServer(simulator, hostname_candidates=[words[0]]) as server:
            print("ready", flush=True)
            wake = time.monotonic()
            while True:
                began, worked = time.monotonic(), time.thread_time()
                server.run_once(realtime=False)
                if (took := time.monotonic() - began) > LONG:
                    worked = time.thread_time() - worked
                    print(f"a tick of {1e3 * took:.1f} ms, {1e3 * worked:.1f} of work", flush=True)
                wake = max(wake + TICK, began - LATE)
                time.sleep(max(0.0, max(wake, began + SHORTEST) - time.monotonic()))


if __name__ == "__main__":
    main(sys.argv[1:])
