"""`./surg teleop [CELL]`: teleoperation of the phantom in real time, with the browser console.

Starts simulator, controllers, endoscope, recorder, the task's scripted assistant, teleoperation and
console. Beside a system of `./surg up`, also one machine's part of it, only teleoperation and
console are started.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from surg_cli.graph import (
    endoscope,
    follow,
    join,
    master,
    network,
    operator_nodes,
    processes,
    roles,
    ros2_gateway,
    running,
    system,
)
from surg_cli.graph.operator_nodes import BROWSER, WEB_PORT
from surg_cli.graph.system import Node
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.graph.watch import Watch
from surg_cli.host import cells, environment, paths, preflight
from surg_cli.host.option_types import add_video_quality, address_and_port, tcp_port, video_quality
from surg_cli.host.terminal import CliError, Progress, say

DEFAULT_CELL = "sim_two_arms"
TASK_OF_TWO_ARMS = "bgr"


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("cell", nargs="?", metavar="CELL", help=f"name in cells/, or a folder ({DEFAULT_CELL})")
    add(
        "--task",
        metavar="T",
        help="task of the phantom, or none (default: bgr in a cell with two arms)",
    )
    add("--setting", default="phantom", metavar="W", help="phantom, ex_vivo or in_vivo")
    add("--seed", type=int, default=0, metavar="N", help="seed of the phantom")
    endoscope.add_cameras(parser)
    add_video_quality(parser)
    add("--scale", type=float, default=0.2, metavar="K", help="tip motion per hand motion")
    add(
        "--leader",
        action="append",
        default=[],
        metavar="L",
        help="input device: browser (default), a bundled leader, or a leader's .py file; given "
        "twice, the second one moves the assistant's instrument instead of the task's script",
    )
    add("--out", type=Path, metavar="DIR", help="folder of the episodes (runs/<UTC time>)")
    add("--port", type=tcp_port, default=master.DEFAULT_PORT, metavar="P", help="of the ROS master")
    ros2_gateway.add_arguments(parser)
    web = parser.add_argument_group("access to the page (docs/guide/console.md)")
    add = web.add_argument
    add(
        "--bind",
        type=address_and_port,
        default=("127.0.0.1", None),
        metavar="ADDRESS[:PORT]",
        help=f"default 127.0.0.1:{WEB_PORT}: this machine only",
    )
    add(
        "--host-name",
        action="append",
        default=[],
        metavar="NAME",
        help="host name in the page's address",
    )
    add("--tls", nargs=2, type=Path, metavar=("CERT", "KEY"), help="certificate, its private key")
    add("--token-file", type=Path, metavar="FILE", help="file with the secret that pages must send")


def main(options: argparse.Namespace, command: str) -> int:
    """Check, start or attach, print the address, wait."""
    attached = next((s for s in running.systems() if s.port == options.port), None)
    asked = options.cameras.asked if options.cameras.depth or options.cameras.marks else ""
    asked = asked or ros2_gateway.asked(options)
    if attached is not None and asked:
        raise CliError(
            f"{asked}: port {options.port}: {attached.command} of {attached.cell} runs there; "
            f"omit {asked}, or start that system with it: ./surg up CELL {asked}",
            2,
        )
    place = None if attached is None else _place(attached, options)
    web, fragment = _web(options)
    plan = _plan(options) if attached is None else operator_nodes.plan_beside(attached)
    preflight.check_space(plan.out)
    logs = paths.SYSTEMS / f"{options.port}_teleop_logs"
    nodes = _operator_nodes(options, plan, web, [] if attached is None else _there(attached))
    env = environment.for_nodes(ros_home=logs / "ros")
    if place is not None:
        env = place.environment(env, network.GUARD)
    with processes.orphans_adopted(), processes.Supervisor(env, logs) as supervisor:
        if attached is not None:
            supervisor.env["ROS_MASTER_URI"] = attached.master_uri
            _keep(plan, supervisor, nodes, fragment, None, place)
        master.start(supervisor, options.port)
        with running.announced(command, options.port, plan.cell, logs) as entry:
            _keep(plan, supervisor, [*_phantom(plan), *nodes], fragment, entry)


def _place(attached: running.System, options: argparse.Namespace) -> roles.Link | None:
    """This machine's place in a running cell of several machines; None for a single machine."""
    if options.cell and cells.find(options.cell) != Path(attached.cell):
        raise CliError(
            f"port {options.port}: {attached.command} of {attached.cell} runs there; end it with "
            "./surg down, or choose another --port",
            2,
        )
    if not attached.role:
        return None
    config = cells.load(Path(attached.cell)).config
    return join.link(config, roles.Role(attached.role), attached.port)


def _there(attached: running.System) -> list[str]:
    """Names of the nodes that run already, on any machine."""
    nodes = master.nodes(attached.master_uri)
    if operator_nodes.CONSOLE in nodes:
        page = master.parameter(attached.master_uri, operator_nodes.CONSOLE) or {}
        scheme = "https" if page.get("cert") else "http"
        where = f"{page.get('bind', '127.0.0.1')}:{page.get('port', WEB_PORT)}"
        raise CliError(
            f"a console runs already: open {scheme}://{where}/, or end it with Ctrl-C where it "
            "was started",
            2,
        )
    return nodes


def _operator_nodes(
    options: argparse.Namespace, plan: SystemPlan, web: dict[str, object], there: list[str]
) -> list[Node]:
    """Teleoperation and console, or the console alone if a teleoperation runs already.

    ``web`` holds who may open the page, ``there`` the names of the nodes that run already.
    """
    if operator_nodes.TELEOP in there:
        if set(options.leader) - {BROWSER} or len(options.leader) > 1:
            raise CliError(
                "a teleoperation with its own leaders runs already: omit --leader to start the "
                "console alone",
                2,
            )
        return [operator_nodes.console(plan, False, web)]
    first, *second = options.leader or [BROWSER]
    if len(second) > 1:
        raise CliError(f"--leader {second[1]}: two leaders at most are allowed", 2)
    nobody = not second and f"/{operator_nodes.ASSISTANT}" not in there
    return [
        *(operator_nodes.scripted_assistant(plan) if nobody else []),
        operator_nodes.teleoperation(plan, first, True, options.scale, *second),
        operator_nodes.console(plan, first == BROWSER, web),
    ]


def _web(options: argparse.Namespace) -> tuple[dict[str, object], str]:
    """Check who may open the page; returns the console's parameters and the address's token."""
    from surg_console.web import access

    address, port = options.bind[0], options.bind[1] or WEB_PORT
    cert, key = options.tls or (None, None)
    try:
        token = access.read_token(options.token_file) if options.token_file else ""
        rules = access.rules(address, port, tuple(options.host_name), cert, key, token)
    except access.AccessError as error:
        raise CliError(str(error), 2) from error
    if master.port_in_use(rules.port) and access.is_loopback(rules.bind):
        raise CliError(
            f"port {rules.port} is in use on this machine; choose another with --bind", 2
        )
    files = {"cert": cert, "key": key, "token_file": options.token_file}
    params = {
        "bind": address,
        "port": port,
        "host_names": list(options.host_name),
        **{name: str(file.absolute()) for name, file in files.items() if file is not None},
    }
    return params, rules.fragment


def _plan(options: argparse.Namespace) -> SystemPlan:
    """The system to start."""
    cell = cells.find(options.cell or DEFAULT_CELL)
    loaded = cells.load(cell)
    arms = tuple(str(name) for name in loaded.arms)
    task = options.task or (TASK_OF_TWO_ARMS if len(arms) > 1 else "none")
    if task.endswith(".py"):
        task = str(Path(task).absolute())
    language = {} if task == "none" else _language_of(loaded, task, options.setting)
    scope = endoscope.of_cell(loaded.config, True, options.cameras.eyes)
    return SystemPlan(
        cell=cell,
        arms=arms,
        lockstep=False,
        cameras=scope.views,
        capture=scope.capture,
        eyes=endoscope.eyes_of(options.cameras, scope, loaded),
        record_quality=video_quality(options),
        seed=options.seed,
        out=paths.run_folder(options.out),
        task="" if task == "none" else task,
        setting=options.setting if task != "none" else "",
        ros2=ros2_gateway.parameters(options),
        run_info={
            "task": "teleop" if task == "none" else task,
            "cell": str(cell),
            "seed": options.seed,
            "operator": (options.leader or [BROWSER])[0],
            **language,
        },
    )


def _language_of(loaded: Any, task: str, setting: str) -> dict[str, Any]:
    """The task's instructions; task and setting are checked as the simulator does later."""
    from surg_sim import tasks
    from surg_sim.physics.patient_settings import find_setting

    try:
        found = tasks.load(task)
        found.prepare(loaded, find_setting(setting))
        return found.language()
    except ValueError as error:  # a TaskError is one
        raise CliError(str(error), 2) from error


def _phantom(plan: SystemPlan) -> list[Node]:
    """The nodes of the phantom, which runs on when its task has ended."""
    nodes = system.nodes(plan)
    sim = nodes[0]
    if plan.task:
        nodes[0] = replace(sim, params={**sim.params, "endless": True})
    return nodes


def _keep(
    plan: SystemPlan,
    supervisor: processes.Supervisor,
    nodes: list[Node],
    fragment: str,
    entry: running.System | None,
    place: roles.Link | None = None,
) -> NoReturn:
    """Start the nodes and stay until a signal arrives or a node dies."""
    for node in nodes:
        system.start(supervisor, node)
    os.environ.update(supervisor.env)
    with Watch(plan.arms) as watch:
        watch.stay_connected()
        with Progress("teleop") as progress:
            address = _await_page(plan, watch, supervisor, progress)
        if entry is not None:
            entry.list_nodes(supervisor.children)
        if place is not None:
            network.refuse_foreign_ports(supervisor.children, place)
        say(f"Open {address}{fragment} in a browser (Chromium, Chrome, Edge, Firefox, Safari).")
        if plan.record:
            say(f"Episodes: {plan.out}.")
        say(f"Logs: {supervisor.logs}. Ctrl-C ends everything started here.")
        follow.keep(watch, supervisor, entry)


def _await_page(
    plan: SystemPlan, watch: Watch, supervisor: processes.Supervisor, progress: Progress
) -> str:
    """Wait until every arm has a state and the page is served; returns its address."""
    console = supervisor.children[-1]
    begin, address = "console: http", ""

    def missing() -> list[str]:
        nonlocal address
        follow.raise_if_failed(watch, supervisor)
        lines = [line for line in console.log_tail(50).splitlines() if line.startswith(begin)]
        address = lines[0].removeprefix("console: ") if lines else ""
        return [arm for arm in plan.arms if arm not in watch.states] + ["the page"] * (not lines)

    follow.wait_for(missing, supervisor, progress.update)
    return address
