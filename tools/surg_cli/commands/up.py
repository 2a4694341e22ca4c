"""`./surg up CELL`: runs a whole system, or one machine's part of it, until Ctrl-C."""

from __future__ import annotations

import argparse
import datetime
import os
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from surg_cli.graph import (
    endoscope,
    follow,
    join,
    master,
    network,
    processes,
    roles,
    ros2_gateway,
    running,
    system,
)
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.graph.watch import Watch
from surg_cli.host import cells, environment, link_environments, paths, preflight
from surg_cli.host.option_types import add_video_quality, tcp_port, video_quality
from surg_cli.host.terminal import CliError, Progress, say, warn

READY_TICKS = 100
"""Ticks of the simulator after which every controller has received its link's state."""
RECORDED = (
    ("--record-topics", "TOPIC", "record these too: names or patterns, such as '/PSM1/measured_*'"),
    ("--record-cameras", "TOPIC", "record these image topics too, raw or compressed"),
)
"""Option, metavar, help."""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("cell", metavar="CELL", help="name in cells/, or a cell's folder")
    add("--port", type=tcp_port, default=master.DEFAULT_PORT, metavar="P", help="of the ROS master")
    add(
        "--role",
        choices=[role.value for role in roles.Role],
        help="role of this machine in a cell of several machines (docs/guide/two_machines.md)",
    )
    add(
        "--port-guard",
        action="store_true",
        help="--role on a machine with a second network: preload a library into every node that "
        "binds its ports to the role's address and drops unacknowledged data",
    )
    add(
        "--leader",
        metavar="L",
        help="--role operator: what the hand holds (default: crtk, a CRTK leader on topics; "
        "browser: the console's page)",
    )
    add(
        "--lock-step",
        nargs="*",
        metavar="NODE",
        help="step by step instead of in real time; NODE: every step waits for its commands",
    )
    add("--law", choices=("ours", "velocity", "paper"), default="ours", help="the control law")
    endoscope.add_cameras(parser)
    add("--view", action="store_true", help="open the simulator's window (needs a display)")
    add_video_quality(parser)
    for option, metavar, what in RECORDED:
        add(option, nargs="+", action="extend", default=[], metavar=metavar, help=what)
    ros2_gateway.add_arguments(parser)
    add("--print", action="store_true", help="only print the rosrun line of every node")


def main(options: argparse.Namespace, command: str) -> int:
    """Start everything, print how to reach it, wait."""
    if options.leader is not None and options.role != roles.Role.OPERATOR:
        raise CliError("--leader: only with --role operator; see ./surg teleop for one machine", 2)
    if options.port_guard and options.role is None:
        raise CliError("--port-guard: only with --role", 2)
    if (ros2 := ros2_gateway.asked(options)) and options.role not in (None, roles.Role.ROBOT):
        raise CliError(f"{ros2}: give it to the robot's machine, whose graph it publishes", 2)
    cell = cells.find(options.cell)
    loaded = cells.load(cell)
    arms = tuple(str(name) for name in loaded.arms)
    simulated = tuple(arm for arm in arms if loaded.arms[arm].link == "simulator")
    lock_step = options.lock_step is not None
    if lock_step and simulated != arms:
        raise CliError("--lock-step needs a cell whose arms are all driven by the simulator", 2)
    link = None
    if options.role is not None:
        if lock_step:
            raise CliError("--lock-step needs one machine; leave --role or --lock-step out", 2)
        link = join.link(loaded.config, roles.Role(options.role), options.port, options.port_guard)
    leader = options.leader or join.LEADER
    scope = endoscope.of_cell(loaded.config, bool(simulated), options.cameras.eyes, lock_step)
    recorded = recorded_too(options.record_topics, options.record_cameras, link)
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H-%M-%SZ")
    plan = SystemPlan(
        cell=cell,
        arms=arms,
        simulated=simulated,
        sensed=tuple(arm for arm in arms if loaded.arms[arm].force_sensor is not None),
        driven=tuple(arm for arm in arms if loaded.arms[arm].hardware is not None),
        turned=cells.with_drive(loaded),
        lockstep=lock_step,
        cameras=scope.views,
        capture=scope.capture,
        eyes=endoscope.eyes_of(options.cameras, scope, loaded),
        view=options.view,
        law=options.law,
        out=paths.RUNS / now,
        extra_participants=tuple(options.lock_step or ()),
        record_topics=recorded[0],
        record_cameras=recorded[1],
        record_quality=video_quality(options),
        ros2=ros2_gateway.parameters(options),
        run_info={"task": "up", "cell": str(cell)},
    )
    if options.print:
        return _print_lines(plan, link, leader)
    if link is None or link.role is roles.Role.ROBOT:
        for arm in plan.driven:
            link_environments.make_ready(loaded.arms[arm])
    preflight.check_space(plan.out)
    logs = paths.SYSTEMS / f"{running.tag(options.port, options.role or '')}_logs"
    with processes.orphans_adopted():
        if link is not None and link.role is not roles.Role.ROBOT:
            return join.keep(plan, link, logs, leader)
        return _keep(plan, options.port, logs, link)


def recorded_too(
    topics: Sequence[str], cameras: Sequence[str], link: roles.Link | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Check the further topics and cameras of the recording; returns both without duplicates.

    Raises:
        CliError: One is not a topic name, or another machine records.
    """
    if (topics or cameras) and link is not None and link.role is not roles.Role.ROBOT:
        raise CliError("--record-topics, --record-cameras: only the robot's machine records", 2)
    wild = set("*?[")
    for option, given, patterns in (
        ("--record-topics", topics, True),
        ("--record-cameras", cameras, False),
    ):
        for topic in given:
            good = topic.startswith("/") and not any(c.isspace() or c == "," for c in topic)
            if not good or (wild & set(topic) and not patterns):
                shape = "name or pattern" if patterns else "name"
                raise CliError(f"{option} {topic!r}: expected a {shape} that begins with /", 2)
    return tuple(dict.fromkeys(topics)), tuple(dict.fromkeys(cameras))


def _print_lines(plan: SystemPlan, link: roles.Link | None, leader: str) -> int:
    """Print the command lines of all nodes of this machine."""
    if link is None or link.role is roles.Role.ROBOT:
        say("rosmaster --core")
    with_links = link is None or link.role is roles.Role.ROBOT
    links = [system.robot_state_publisher(arm) for arm in plan.arms] if with_links else []
    for node in [*join.nodes(plan, link, leader), *links]:
        say(node.rosrun_line())
    return 0


def _keep(plan: SystemPlan, port: int, logs: Path, link: roles.Link | None) -> NoReturn:
    """Start all nodes and stay until a signal arrives or a node dies."""
    env = environment.for_nodes(ros_home=logs / "ros")
    if link is not None:
        env = link.environment(env, network.GUARD)
    host, uri = ("localhost", "") if link is None else (link.address, link.uri)
    with processes.Supervisor(env, logs) as supervisor:
        master.start(supervisor, port, host)
        role = "" if link is None else link.role.value
        with running.announced("up", port, plan.cell, logs, role, uri) as entry:
            for node in join.nodes(plan, link):
                system.start(supervisor, node)
            os.environ.update(supervisor.env)
            with Watch(plan.arms) as watch:
                if not plan.lockstep:
                    watch.stay_connected()
                with Progress("up") as progress:
                    _await_arms(plan, watch, supervisor, progress)
                for arm in plan.arms:
                    system.start(supervisor, system.robot_state_publisher(arm))
                entry.list_nodes(supervisor.children)
                if link is not None:
                    network.refuse_foreign_ports(supervisor.children, link)
                _greet(plan, port, logs, link)
                describe_arms(cells.load(plan.cell).arms)
                follow.keep(watch, supervisor, entry)


def _await_arms(
    plan: SystemPlan, watch: Watch, supervisor: processes.Supervisor, progress: Progress
) -> None:
    """Wait until every arm has a state and a robot_description, and its controller has its link."""
    uri = supervisor.env["ROS_MASTER_URI"]

    def missing() -> list[str]:
        absent = [arm for arm in plan.arms if arm not in watch.states]
        if plan.simulates and not plan.lockstep and watch.sim.tick < READY_TICKS:
            absent.append("the simulator")  # "enable" would be refused
        descriptions = [f"/{arm}/robot_description" for arm in plan.arms]
        return absent + [name for name in descriptions if not master.call(uri, "hasParam", name)]

    follow.wait_for(missing, supervisor, progress.update)


def describe_arms(arms: Mapping[str, Any]) -> None:
    """Print which arms the simulator does not drive, and what nobody has measured of them."""
    for name, arm in arms.items():
        real = arm.link != "simulator"
        if arm.hardware is not None:
            emulated = ", emulated" if arm.hardware.emulated else ""
            say(
                f"{name} is driven by the link '{arm.link}'{emulated}, at {arm.hardware.address}. "
                "Start the robot: ./surg robot CELL start"
            )
        elif real:
            say(
                f"{name} is driven by '{arm.link}': start its link now. enable is refused until "
                "its robot/status is ACTIVE."
            )
        for what, source in (("tool", arm.tool.source), ("trocar", arm.trocar.source)):
            if source == "measured":
                continue
            text = f"{name}: the calibration of its {what} is {source}, not measured"
            if real:
                warn(f"{text}: measure it with ./surg calibrate before you trust the pivot")
            else:
                say(f"{text}.")


def _greet(plan: SystemPlan, port: int, logs: Path, link: roles.Link | None) -> None:
    """Print what runs and how to reach it."""
    arm = plan.arms[0]
    say(f"{plan.cell.name} is up: {', '.join(plan.arms)}; every arm is DISABLED and not homed.")
    if link is not None:
        say(f"ROS ports are open on {link.address} alone. The other machines join with:")
        for role in link.others:
            say(f"  ./surg up {plan.cell.name} --role {role} --port {port}")
        join.warn_without_ptp(link)
    say("In another terminal: ./surg status, ./surg dev shell, or by hand:")
    say(f"  export ROS_MASTER_URI={link.uri if link else f'http://localhost:{port}'}")
    for word in ("enable", "home"):
        message = shlex.quote(f"string: {word}")
        say(f"  rostopic pub -1 /{arm}/state_command crtk_msgs/StringStamped {message}")
    say(f"Logs: {logs}. Ctrl-C or ./surg down ends it.")
