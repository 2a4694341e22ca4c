"""Our FR3 link on a simulator at ADDRESS; prints JSON. Needs our sources and pylibfranka."""

import json
import math
import sys

from surg_hardware.franka.fr3_adapter import Driver
from surg_hardware.franka.joint_limits import FR3

T = 0.001
SHARES = (0.5, -0.4, 0.6, 0.8, -1.0, -0.9, 1.0)
OPTIONS = {
    "collision_torque": [20.0] * 7,
    "collision_force": [25.0] * 6,
    "success_rate": 0.95,
}


class Watched(Driver):
    """Notes the largest acceleration and jerk on the wire, as shares of the limits."""

    largest = [0.0, 0.0]
    before = [0.0] * 7
    a_before = [0.0] * 7

    def _write(self, velocities, finished):  # type: ignore[no-untyped-def]
        a = [(v - b) / T for v, b in zip(velocities, self.before, strict=True)]
        jerk = [(x - y) / T for x, y in zip(a, self.a_before, strict=True)]
        shares = (
            max(abs(x) / joint.acceleration for x, joint in zip(a, FR3, strict=True)),
            max(abs(x) / joint.jerk for x, joint in zip(jerk, FR3, strict=True)),
        )
        self.largest = [max(pair) for pair in zip(self.largest, shares, strict=True)]
        self.before, self.a_before = list(velocities), a
        super()._write(velocities, finished)


def main(address: str) -> None:
    """Two swings of all joints, then rest; a staircase of commands every 2 ms."""
    arm = Watched(address, OPTIONS)
    arm.connect()
    state = arm.state()
    start, began = state.q, state.time
    far, wanted = [0.0] * 7, [0.0] * 7
    for cycle in range(4200):
        t = state.time - began
        if cycle % 2 == 0:
            rate = 0.2 * math.sin(math.pi * t) if t < 4.0 else 0.0
            wanted = [share * rate for share in SHARES]
        arm.send(wanted)
        state = arm.state()
        far = [max(f, abs(q - s)) for f, q, s in zip(far, state.q, start, strict=True)]
    arm.stop()
    for _ in range(100):
        state = arm.state()
    identity = arm.identity()
    print(
        json.dumps(
            {
                "way": far,
                "back": max(abs(q - s) for q, s in zip(state.q, start, strict=True)),
                "acceleration": arm.largest[0],
                "jerk": arm.largest[1],
                "obeys": state.obeys,
                "condition": int(state.reading.condition),
                "q": state.q,
                "flange": identity.flange,
                "mass": identity.mass,
            }
        )
    )
    arm.close()


if __name__ == "__main__":
    main(sys.argv[1])
