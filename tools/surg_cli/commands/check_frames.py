"""`./surg check-frames [CELL]`: compares the commanded tip motion with the endoscope's images."""

from __future__ import annotations

import argparse
import json
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from surg_cli.graph import join, master, network, processes, roles, running, system
from surg_cli.graph.follow import death_notice
from surg_cli.graph.system import Node
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import cells, environment, frames_picture, paths, terminal
from surg_cli.host.terminal import CliError, Progress, say

NODE = "check_frames"
DEFAULT_CELL = "sim_two_arms"
TIMEOUT_S = 600.0
CONNECT_S = 180.0
"""Longest wait of the simulator for two renderers on a busy machine [s]."""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("cell", metavar="CELL", nargs="?", default=DEFAULT_CELL, help="name in cells/, or a folder")
    add("--arm", metavar="ARM", help="the arm that moves (default: the first without a camera)")
    add("--out", type=Path, metavar="DIR", help="folder for the result (default: runs/<time>)")
    add(
        "--setting",
        metavar="W",
        help="of the simulation that it starts, such as phantom+unregistered+lens",
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Check a running system, or start a simulated one."""
    cell = cells.find(options.cell)
    config = cells.load(cell)
    _refuse(config, cell, options.arm)
    setting = _setting(options.setting)
    out = paths.run_folder(options.out)
    out.mkdir(parents=True, exist_ok=True)
    attached = running.of_cell(cell)
    params: dict[str, object] = {"cell": str(cell), "out": str(out / "check_frames.json")}
    if options.arm:
        params["arm"] = options.arm
    try:
        if attached is not None:
            if setting:
                raise CliError(
                    f"--setting {setting}: the system on port {attached.port} already runs; stop "
                    "it, or omit --setting",
                    2,
                )
            _attached(attached, config, params, out)
        else:
            _alone(cell, config, params, out, setting)
        return _print_result(out)
    finally:
        if not any(out.iterdir()):
            out.rmdir()


def _refuse(config: Any, cell: Path, arm: str | None) -> None:
    """Check that an arm holds an endoscope and that the arm to move is another one."""
    scopes = [a.name for a in config.arms.values() if a.instrument.camera is not None]
    if not scopes:
        raise CliError(
            f"{cell.name}: no arm holds an endoscope, so there is no camera registration to check; "
            f"the bundled cell {DEFAULT_CELL} has one",
            2,
        )
    others = [name for name in config.arms if name != scopes[0]]
    if not others:
        raise CliError(
            f"{cell.name}: {scopes[0]} holds the endoscope, and no other arm holds an instrument "
            "whose tip it could see",
            2,
        )
    if arm not in (None, *others):
        why = "it holds the endoscope" if arm in scopes else "no such arm in the cell"
        raise CliError(f"--arm {arm}: {why}; allowed: {', '.join(others)}", 2)


def _attached(attached: running.System, config: Any, params: dict[str, object], out: Path) -> None:
    """Check a running system; the operator enables the arms."""
    say(f"check-frames: the running system on port {attached.port}")
    env = environment.for_nodes(attached.port, out / "logs" / "ros")
    if attached.role:  # one machine of several: the others must reach the node
        place = join.link(config.config, roles.Role(attached.role), attached.port)
        env = place.environment(env, network.GUARD)
    env["ROS_MASTER_URI"] = attached.master_uri
    with processes.Supervisor(env, out / "logs") as supervisor:
        _await(system.start(supervisor, _node(params)), supervisor)


def _setting(name: str | None) -> str:
    """A setting of the simulator by its name; empty: none is stated."""
    from surg_sim.physics.patient_settings import find_setting

    if name is None:
        return ""
    try:
        find_setting(name)
    except ValueError as error:
        raise CliError(f"--setting: {error}", 2) from error
    return name


def _alone(
    cell: Path, config: Any, params: dict[str, object], out: Path, setting: str = ""
) -> None:
    """Simulate the cell in lock-step for the time of the check."""
    arms = tuple(str(name) for name in config.arms)
    camera = next(a.instrument.camera for a in config.arms.values() if a.instrument.camera)
    plan = SystemPlan(
        cell=cell,
        arms=arms,
        lockstep=True,
        cameras=("left", "right")[: len(camera.frames)],
        out=out,
        record=False,
        setting=setting,
        extra_participants=(NODE,),
    )
    say(f"check-frames: {cell.name}, simulated")
    env = environment.for_nodes(ros_home=out / "logs" / "ros")
    with processes.orphans_adopted(), processes.Supervisor(env, out / "logs") as supervisor:
        master.start(supervisor, master.free_port())
        sim, *others = system.nodes(plan)
        patient: dict[str, object] = {**sim.params, "connect_timeout": CONNECT_S}
        for node in (replace(sim, params=patient), *others):
            system.start(supervisor, node)
        os.environ.update(supervisor.env)
        child = system.start(supervisor, _node({**params, "enable": True, "lockstep": True}))
        _await(child, supervisor)


def _node(params: dict[str, object]) -> Node:
    return Node(f"/{NODE}", "surg_teleop", "check_frames_node.py", params, essential=False)


def _await(child: processes.Child, supervisor: processes.Supervisor) -> None:
    """Wait for the node's end and show its instructions to the operator."""
    deadline = time.monotonic() + TIMEOUT_S
    with Progress("check-frames") as progress:
        while child.exit_code is None:
            dead = supervisor.first_dead()
            if dead is not None and dead.exit_code != 0:
                raise CliError(death_notice(dead))
            if time.monotonic() > deadline:
                raise CliError(f"the check did not end within {TIMEOUT_S:.0f} s; see {child.log}")
            text = child.log_tail(1)
            progress.update(None, text if text.startswith("the tip must") else "looking")
            time.sleep(0.1)
    if child.exit_code not in (0, 1) or "check_frames: " in child.log_tail(1):
        raise CliError(child.log_tail(4).partition("check_frames: ")[2] or death_notice(child))


def _print_result(out: Path) -> int:
    """Print the result; 0 only if commanded and observed motion agree."""
    file = out / "check_frames.json"
    if not file.is_file():
        raise CliError(f"the check wrote no result; see {out / 'logs'}")
    result = json.loads(file.read_text("utf-8"))
    rows = [["commanded", "observed in the left image", "disparity"]]
    for seen in result["seen"]:
        x, y = seen["pixels"]
        depth = "–" if seen["disparity"] is None else f"{seen['disparity']:+.1f} px"
        rows.append([seen["told"], _motion_text(x, y), depth])
    if result["seen"]:
        say(terminal.table(rows))
    picture = frames_picture.draw(out)
    if picture is not None:
        say(f"picture: {picture}")
    say(f"check-frames: {result['outcome'].replace('_', ' ')}: {result['text']}")
    return 0 if result["outcome"] == "pass" else 1


def _motion_text(x: float, y: float) -> str:
    """A motion in an image in words."""
    parts = [f"{abs(x):.0f} px {'right' if x > 0 else 'left'}"] if abs(x) >= 0.5 else []
    parts += [f"{abs(y):.0f} px {'down' if y > 0 else 'up'}"] if abs(y) >= 0.5 else []
    return ", ".join(parts) or "still"
