"""docs/results/hardware.md: what the emulated arms did, and how they stop."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

_HEAD = """# Emulated arms

Written by `./surg test --full` of the tests below; each row is of its own last run. **Robot and
faults are emulated: a real arm brakes in its own way.** Deviation: of the shaft from its pivot, by
the emulated arm's own joints. Rest counts from the fault. Below 250 mm/s: the sideways speed that
the limits of the joints allow.

- *chain* (`tests/faults/test_faults_hardware_stops.py`): controller, link and emulated UR5e in one
  thread on a made-up clock; the same figures on any machine. The emulated joints lag behind their
  targets by 5 to 8.5 ms, each by its own (assumed). A stop of the link or of its program on the
  robot ends on the way that the controller has kept. A robot that stops itself ends at its targets,
  beside that way: from 50 mm/s by 0.239 mm, more than the goal of 0.2 mm. Nothing of the platform
  runs in such a stop. While the joints hold the pivot, each target is ahead by the joint's lag
  times its velocity, and no command can hold both; the rows with other lags show it.
  *started*: `tests/faults/test_faults_hardware.py`; people mend the robot after a stop in motion,
  and start it, while sender and controller go on: how far the tip moves before `enable`.
  *panda*, *fr3*: `tests/faults/test_faults_hardware_franka.py`, and as processes with the maker's
  libraries `tests/ros/hardware/test_franka_processes.py`; the emulated arm stops by a reflex where
  a command is above Franka's limits.
  *pivot*: `tests/faults/test_faults_hardware_motion.py`; motions at scale 1. The recording is no
  part of the project: `SURG_TEST_MOTION=FILE`. `links/ur.yaml` states the lag of each joint, so
  that the joints move in step; with one lag for all of them the recording deviated by 0.168 mm.
- *demo* (`tests/ros/hardware/test_emulated_demo.py`): `./surg demo --robot`, from the emulator to
  the report, in real time; by the joints in its recording.
- *policy* (`tests/faults/test_faults_hardware_policy.py`): an episode of bowel grasping and
  retraction, seed 3, by the task's expert, and by the learned policy of `SURG_BGR_WEIGHTS=FILE`.
  The emulated UR5e stands in the simulator's tissue: the drawn arm follows the emulated joints.
- *fuzz* (`tests/unit/hardware`): random and broken input; nobody hangs or dies, memory stays flat.
- *processes* (`tests/faults/test_faults_ur_driver.py`): the UR driver and `./surg emulate ur5e` in
  real time, without ROS and without the controller. The shaft of a 0.3 m tool turns about a pivot;
  nothing corrects the arm. The deviation is what the stop adds.

| what | runs | result |
|---|---|---|
"""
SPEEDS = (0.012, 0.05, 0.25)
"""Of the tip [m/s]."""
CHAIN = (
    "protective stop",
    "emergency stop",
    "user stop",
    "user pause",
    "power off",
    "reboot",
    "slider at 50 %",
    "stall 15 ms",
    "stall 100 ms",
    "driver killed",
    "driver frozen 0.5 s",
    "controller silent",
    "node gone",
)
SPREADS = (0.0, 2.0, 3.5)
"""[ms] Largest less least lag of the emulated joints."""
FAULTS = (
    "protective stop",
    "emergency stop",
    "user stop",
    "user pause, then play",
    "slider at 50 %",
    "stall 15 ms",
    "stall 100 ms",
    "connections reset",
    "reboot",
    "driver killed",
    "driver frozen",
    "controller silent",
    "node gone",
)
RECOVERIES = (
    "protective stop, unlocked",
    "protective stop, unlocked and played",
    "pause, played",
    "emergency stop, released",
    "reboot",
)
SCALES = ("scale 0.1", "scale 1")
SURGEON = "chain: synthetic surgeon's motions, pivot"
BUNDLED = "chain: bundled motion, pivot"
RECORDED = "chain: recorded knot tying, pivot"
HASH = "chain: a seeded motion with a protective stop, twice"
FUZZ_STATES = "fuzz: states to the driver"
FUZZ_DATAGRAMS = "fuzz: datagrams between driver and node"
FUZZ_DASHBOARD = "fuzz: answers of the dashboard server"
FUZZ_SERVER = "fuzz: packets to the emulated RTDE server"
POLICIES, ROBOTS = ("expert", "learned"), ("simulated arm", "emulated UR5e")
AGE = "a command until it is executed"


FRANKY = "processes, fr3 of franky-sim: bundled motion, pivot"
FRANKY_CHAIN = "chain, fr3 with the joints of franky-sim: bundled motion, pivot"
FRANKA = (("panda", 0.0), ("panda", 0.002), ("fr3", 0.0))


def franka(name: str, loss: float, where: str = "chain") -> str:
    """Name of a row of a Franka arm that plays the bundled motion."""
    lost = f", {100 * loss:g} % of the commands lost" if loss else ""
    return f"{where}, {name}: bundled motion, pivot{lost}"


DEMOS = ("emulated_ur5e", "emulated_panda", "emulated_fr3")
MOTIONS = ("bundled", "recorded")


def demo(cell: str, motion: str) -> str:
    """Name of a row of `./surg demo --robot`."""
    return f"demo: {cell}, {motion} motion, pivot"


def chain_row(what: str, speed: float) -> str:
    """Name of a row of the chain."""
    return f"chain: {what}, {1e3 * speed:.0f} mm/s"


def spread_row(spread: float) -> str:
    """Name of a row of a robot that stops itself, by the spread of its joints' lags [ms]."""
    return f"chain: protective stop, 50 mm/s, lags of the joints differ by {spread:.1f} ms"


def recovery_row(what: str, scale: str) -> str:
    """Name of a row of what people do after a stop."""
    return f"chain: {what}, started, {scale}"


def policy_row(which: str, robot: str) -> str:
    """Name of a row of a policy for bowel grasping and retraction."""
    return f"policy: bgr, {which}, {robot}"


def row(what: str, speed: float) -> str:
    """Name of a row of the processes."""
    return f"processes: {what}, {1e3 * speed:.0f} mm/s"


note = ResultsPage(
    "hardware.md",
    _HEAD,
    (
        BUNDLED,
        SURGEON,
        RECORDED,
        HASH,
        *(franka(name, loss) for name in ("panda", "fr3") for loss in (0.0, 0.002)),
        *(franka(name, loss, "processes") for name, loss in FRANKA),
        FRANKY_CHAIN,
        FRANKY,
        *(demo(cell, motion) for cell in DEMOS for motion in MOTIONS),
        *(policy_row(which, robot) for which in POLICIES for robot in ROBOTS),
        FUZZ_STATES,
        FUZZ_DATAGRAMS,
        FUZZ_DASHBOARD,
        FUZZ_SERVER,
        *(chain_row(what, speed) for what in CHAIN for speed in SPEEDS),
        *(spread_row(spread) for spread in SPREADS),
        *(recovery_row(what, scale) for what in RECOVERIES for scale in SCALES),
        AGE,
        *(row(what, speed) for what in FAULTS for speed in SPEEDS),
    ),
    keep=True,
).note
