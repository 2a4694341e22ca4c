"""Which nodes make up a running system, and their parameters.

`nodes` turns a `SystemPlan` into a list that `start` brings up. Every entry is also a `rosrun` line
(`Node.rosrun_line`): there are no launch files.
"""

from __future__ import annotations

import contextlib
import json
import os
import shlex
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from surg_cli.graph import master, scheduler_slices
from surg_cli.graph.processes import Child, Supervisor, keep_niceness
from surg_cli.graph.system_plan import ENDOSCOPE, OPERATOR, RECORDER, SystemPlan
from surg_cli.host import paths, provision
from surg_cli.host.terminal import CliError

EYES = "eyes"
GATEWAY = "/ros2"
POLICY = "policy"
CAMERA_START_S = 180.0
"""[s] Lock-step: longest wait for everybody where a camera is drawn, which on a machine that has
other work takes its time to compile the scene."""
GIVES_WAY = 5
"""Niceness of what only draws, above that of the system."""
DRIVES_PRIORITY = 20
"""Of the threads of nodes that a robot waits for; their own loops have higher ones."""
POLICY_TOPICS = ("/policy/action", "/policy/rejected", "/policy/plan", "/policy/status")


@dataclass(frozen=True)
class Node:
    """One node to start."""

    name: str  # absolute node name
    package: str
    executable: str  # as `rosrun` takes it
    params: dict[str, object] = field(default_factory=dict)  # private parameters
    arguments: tuple[str, ...] = ()  # words behind the executable
    essential: bool = True  # whether its end ends the system
    prompt: bool = False  # whether it must answer soon: it gets short slices of the processor
    drives: bool = False  # whether a robot waits for it, or it is one: real-time priority
    gives_way: bool = False  # whether it only draws: all others go first

    def needs_opencv(self) -> bool:
        """Whether it is a real endoscope, or simulates a lens."""
        return self.package == "surg_perception" or "lens" in str(self.params.get("setting", ""))

    def words(self) -> list[str]:
        """Name and namespace in the form ROS nodes take on their command line."""
        namespace, _, base = self.name.rpartition("/")
        return [f"__name:={base}", f"__ns:={namespace or '/'}"]

    def rosrun_line(self) -> str:
        """The line a person types to start this node by hand."""
        params = [f"_{key}:={_as_text(value)}" for key, value in self.params.items() if value != []]
        words = [*self.arguments, *self.words(), *params]
        return shlex.join(["rosrun", self.package, self.executable, *words])


def nodes(plan: SystemPlan) -> list[Node]:
    """The nodes of a system in the order they are started, without those that play."""
    params: dict[str, object] = {
        **plan.scene,
        "participants": plan.participants,
        "observers": plan.observers,
        **({"view": True} if plan.view else {}),
        **({"connect_timeout": CAMERA_START_S} if plan.cameras and plan.lockstep else {}),
    }
    prompt = not plan.lockstep  # where time waits, nobody is in a hurry
    started = []
    if plan.simulates:
        made = ("surg_sim", "bridge_node.py", params)
        started.append(Node("/sim", *made, prompt=prompt, drives=prompt and has_room()))
    started += pictures(plan)
    for arm in plan.driven:
        params = {"cell": str(plan.cell), "arm": arm}
        started.append(Node(f"/{arm}/link", "surg_hardware", "link_node.py", params, drives=True))
    for arm in plan.arms:
        params = {
            "cell": str(plan.cell),
            "arm": arm,
            "mode": plan.mode,
            "participants": plan.commanders(arm),
            "others": [other for other in plan.arms if other != arm],
            "law": plan.law,
        }
        if arm in plan.driven:
            params["realtime"] = True
        if plan.link is not None:
            params["link"] = plan.link
        if plan.feedback_gain is not None:
            params["feedback_gain"] = float(plan.feedback_gain)
        started.append(
            Node(
                f"/{arm}/controller",
                "nodelet",
                "nodelet",
                params,
                ("standalone", "surg_control/RcmNodelet"),
                prompt=prompt,
                drives=prompt,
            )
        )
    if plan.record:
        params = {
            "out": str(plan.out / "episode"),
            "cell": str(plan.cell),
            "mode": plan.mode,
            "arms": list(plan.arms),
            "autostart": plan.lockstep,  # before the first tick; a later start would miss some
            "cameras": [*plan.streams, *plan.record_cameras],
            "topics": list(plan.record_topics),
            "run_info": json.dumps(plan.run_info),  # stages keep their order
            **plan.record_quality,
            **({"topics": list(POLICY_TOPICS)} if plan.policy is not None else {}),
        }
        started.append(Node(f"/{RECORDER}", "surg_recording", "recorder_node.py", params))
    return started + force_nodes(plan) + drive_nodes(plan) + gateways(plan)


def has_room() -> bool:
    """Whether nodes with real-time priority leave a processor to the others."""
    return len(os.sched_getaffinity(0)) > 1


def gateways(plan: SystemPlan) -> list[Node]:
    """The node that publishes the topics for ROS 2, if it is wanted."""
    if plan.ros2 is None:
        return []
    params: dict[str, object] = {**plan.ros2, "mode": plan.mode}
    made = ("surg_ros2", "ros2_gateway_node.py", params)
    return [Node(GATEWAY, *made, essential=False, prompt=not plan.lockstep)]


def force_nodes(plan: SystemPlan) -> list[Node]:
    """Nodes that make forces of the sensors at the flanges; in lock-step the simulator does."""
    return _for_each(plan, () if plan.lockstep else plan.sensed, "force", prompt=True)


def drive_nodes(plan: SystemPlan) -> list[Node]:
    """Nodes that turn the instruments of real and emulated arms."""
    return _for_each(plan, plan.turned, "drive")


def _for_each(plan: SystemPlan, arms: Iterable[str], what: str, prompt: bool = False) -> list[Node]:
    made = ("surg_hardware", f"{what}_node.py")
    return [
        Node(f"/{arm}/{what}", *made, {"cell": str(plan.cell), "arm": arm}, prompt=prompt)
        for arm in arms
    ]


def pictures(plan: SystemPlan) -> list[Node]:
    """The endoscope's node, and the one that makes depth and marks of its pictures."""
    found = [endoscope(plan)] if plan.cameras else []
    if plan.eyes is not None:
        made = ("surg_perception", "stereo_depth_node.py", dict(plan.eyes))
        found.append(Node(f"/{EYES}", *made, essential=False))
    return found


def endoscope(plan: SystemPlan) -> Node:
    """The node that publishes the endoscope's pictures: a real one's, or the simulator's."""
    params: dict[str, object]
    if plan.capture is not None:
        params = {"cell": str(plan.cell), **plan.capture}
        return Node(f"/{ENDOSCOPE}", "surg_perception", "capture_node.py", params)
    params = {**plan.scene, "views": list(plan.cameras)}
    made = ("surg_sim", "endoscope_node.py", params)
    return Node(f"/{ENDOSCOPE}", *made, gives_way=not plan.lockstep)


def senders(plan: SystemPlan) -> list[Node]:
    """The scripted nodes that play the plan's task."""
    params: dict[str, object] = {"cell": str(plan.cell), "task": plan.task, "seed": plan.seed}
    if not plan.lockstep and plan.policy is not None:
        # In real time the arms come up in seconds: what is shown before that, nobody sees.
        params["after"] = list(plan.senders[POLICY])
    return [
        Node(f"/{name}", "surg_sim", "expert_node.py", dict(params))
        for name in plan.senders
        if name != POLICY
    ]


def model_server(plan: SystemPlan) -> Node:
    """The node that the plan's policy connects to."""
    policy = plan.policy
    assert policy is not None
    params: dict[str, object] = {
        "bind": policy.address,
        "keys": policy.keys,
        "cell": str(plan.cell),
        "arms": list(plan.senders[POLICY]),
        "mode": plan.mode,
        "task": str(plan.run_info.get("task", "")),
        "instruction": str(plan.run_info.get("instruction", "")),
        "privileged": policy.privileged,
        "forces": policy.forces,
        "cameras": plan.streams,
        "autostart": True,
        "need_teleop": False,  # a roll-out has no operator
    }
    if not plan.lockstep:
        from surg_policy_bridge.server.safety_controller import PACED

        params["clip"] = list(PACED)  # answers are late in real time
    return Node(f"/{POLICY}", "surg_policy_bridge", "model_server_node.py", params)


def operator_node(plan: SystemPlan) -> Node:
    """The plan's operator; one that answers late is refused for good by an arm in real time."""
    assert plan.operator is not None
    params: dict[str, object] = {**plan.operator, "realtime": DRIVES_PRIORITY if plan.driven else 0}
    return Node(f"/{OPERATOR}", "surg_teleop", "operator_node.py", params)


def robot_state_publisher(arm: str) -> Node:
    """The node that puts an arm's links on /tf for rviz."""
    remaps = (
        "joint_states:=robot/measured_js",
        f"robot_description:=/{arm}/robot_description",
    )
    return Node(
        f"/{arm}/robot_state_publisher",
        "robot_state_publisher",
        "robot_state_publisher",
        arguments=remaps,
        essential=False,
    )


def start(supervisor: Supervisor, node: Node) -> Child:
    """Set a node's parameters and start it at the master that the supervisor's environment names.

    Raises:
        CliError: Its executable does not exist, or packages that it needs cannot be installed.
    """
    if node.needs_opencv():
        provision.need_opencv()
    uri = supervisor.env["ROS_MASTER_URI"]
    for key, value in node.params.items():
        master.call(uri, "setParam", f"{node.name}/{key}", value)
    argv = [str(executable(node.package, node.executable)), *node.arguments, *node.words()]
    with scheduler_slices.short() if node.prompt else contextlib.nullcontext():
        child = supervisor.start(node.name, argv, essential=node.essential)
    if node.drives:
        prefer(child)
    if node.gives_way:
        give_way(child)
    return child


def prefer(child: Child) -> bool:
    """Give a process that has just begun a real-time priority, which its threads inherit.

    Without it the threads that receive states wait for other work of the machine. Returns whether
    it was granted; a node that needs it asks by itself and says so.
    """
    try:
        os.sched_setscheduler(child.process.pid, os.SCHED_FIFO, os.sched_param(DRIVES_PRIORITY))
    except OSError:
        return False
    return True


def give_way(child: Child) -> None:
    """Let all others go first: a picture that is late harms less than a hand that is."""
    pid = child.process.pid
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, pid, os.getpriority(os.PRIO_PROCESS, 0) + GIVES_WAY)
    keep_niceness(pid, GIVES_WAY)


def executable(package: str, name: str) -> Path:
    """What `rosrun PACKAGE NAME` would start.

    Raises:
        CliError: It is neither in the devel space nor in the system.
    """
    for prefix in (paths.DEVEL, Path("/usr")):
        candidate = prefix / "lib" / package / name
        if candidate.is_file() and os.access(candidate, os.X_OK):
            return candidate
    raise CliError(f"no executable {name!r} of package {package!r}; run ./surg dev build")


def _as_text(value: object) -> str:
    """A parameter on a command line; a list as names with commas, which C++ nodes read too."""
    if isinstance(value, list):
        return ",".join(str(item) for item in value)
    return value if isinstance(value, str) else json.dumps(value)
