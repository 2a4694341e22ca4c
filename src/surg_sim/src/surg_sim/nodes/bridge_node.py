"""The node ``/sim``: the simulated world behind the robot-link contract.

It runs in lock-step or in real time (``~mode``) and renders nothing. Faults can be injected
(``~faults``, ``/sim/inject``) only if the ROS master is on this machine.
"""

from __future__ import annotations

import os
import sys
from urllib.parse import urlparse

import mujoco
import rospy

import surg_core
from surg_ros.params import read
from surg_sim import tasks
from surg_sim.nodes import faults
from surg_sim.nodes.fault_injector import Injector, tool_errors
from surg_sim.nodes.sim_bridge_node import Bridge
from surg_sim.nodes.sim_parameters import BridgeSettings
from surg_sim.physics import patient_settings
from surg_sim.physics.world import World


def _require_loopback(settings: BridgeSettings) -> None:
    """Refuse fault injection if another machine could reach it."""
    host = urlparse(os.environ.get("ROS_MASTER_URI", "")).hostname or ""
    local = host == "localhost" or host.startswith("127.")
    if (settings.inject or settings.faults) and not local:
        raise ValueError(
            f"parameters ~inject and ~faults need a ROS master on this machine's loopback "
            f"(localhost or 127.x.x.x); ROS_MASTER_URI names {host!r}"
        )


def main() -> int:
    """Entry point; returns the exit code (0 done, 1 aborted, 2 broken configuration)."""
    rospy.init_node("sim")
    # By default MuJoCo writes a log file into the working directory.
    mujoco.set_mju_user_warning(lambda text: rospy.logwarn(f"MuJoCo: {text}"))
    try:
        settings = read(BridgeSettings, rospy.get_param("~", {}))
        _require_loopback(settings)
        cell = surg_core.load_cell(settings.cell)
        known = faults.parse(settings.faults, settings.arms or tuple(cell.arms))
        world = World(
            cell,
            settings.seed,
            arms=settings.arms,
            tool_errors=tool_errors(known, settings.seed) or None,
            setting=patient_settings.find_setting(settings.setting) if settings.setting else None,
            task=tasks.load(settings.task) if settings.task else None,
        )
        injector = Injector(world, known, settings.seed, settings.mode == "lockstep")
    except (ValueError, OSError) as error:
        print(f"surg_sim: {error}", file=sys.stderr, flush=True)
        return 2
    # Switch threads quickly: answers arrive on threads of their own.
    sys.setswitchinterval(1e-4)
    return Bridge(settings, world, injector).run()


if __name__ == "__main__":
    sys.exit(main())
