"""The operator's nodes: teleoperation, and the console with its page. Parameters only."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surg_cli.graph import master, running
from surg_cli.graph.system import Node, has_room
from surg_cli.graph.system_plan import ENDOSCOPE, SystemPlan
from surg_cli.host import cells
from surg_cli.host.terminal import CliError

BROWSER = "browser"
"""The console as a leader, and the namespace of its topics."""
ASSISTANT = "assistant"
"""The instrument of a task that has no controller (docs/reference/tasks.md)."""
TELEOP, CONSOLE = "/teleop", "/console"
WEB_PORT = 8090


def plan_beside(attached: running.System) -> SystemPlan:
    """The plan of a running system, as far as the operator's nodes need it."""
    uri, cell = attached.master_uri, Path(attached.cell)

    def parameter(name: str) -> str:
        return str(master.parameter(uri, name) or "")

    topics = master.publications(uri)
    views = ("left", "right")
    # The recorder's folder may be on another machine: then its episodes are not listed.
    out = parameter("/recorder/out")
    return SystemPlan(
        cell=cell,
        arms=tuple(str(name) for name in cells.load(cell).arms),
        lockstep=False,
        cameras=tuple(view for view in views if f"/endoscope/{view}/image_raw" in topics),
        out=Path(out).parent,
        record=bool(out),
        task=parameter("/sim/task"),
    )


def teleoperation(
    plan: SystemPlan, leader: str, page: bool, scale: float | None = None, second: str = ""
) -> Node:
    """The node that maps hands to arms.

    Args:
        plan: The system that it drives.
        leader: What the first hand holds, ``browser`` for the console's page.
        page: Whether a console reports the operator's presence; without it nothing then moves.
        scale: Motion of the tip per motion of that hand; None: the node's own.
        second: What a second hand holds, which moves the assistant's instrument; empty: nobody.

    Raises:
        CliError: The cell has nothing to drive, or the task has no assistant.
    """
    loaded = cells.load(plan.cell)
    params: dict[str, object] = {
        "cell": str(plan.cell),
        "arm": driven_arm(plan),
        **_leader(leader),
        "picture": f"/{ENDOSCOPE}/left/image_raw" if plan.cameras else "",
        "need_present": page,
    }
    if scale is not None:
        params["scale"] = scale
    if all(arm.instrument.camera is None for arm in loaded.arms.values()):
        params["view"] = _standing_view(loaded)
    if second:
        given = {f"second_{key}": value for key, value in _leader(second).items()}
        frame = _assistant_frame(plan, loaded)
        params.update(given, second_arm=ASSISTANT, assistant_frame=frame)
    made = ("surg_teleop", "teleop_node.py", params)
    # A stream of commands that falls silent stops the arm.
    return Node(TELEOP, *made, prompt=True, drives=has_room())


def scripted_assistant(plan: SystemPlan) -> list[Node]:
    """Who holds the assistant's instrument of the plan's task, from when an arm is enabled on."""
    if not plan.task:
        return []
    from surg_sim import tasks

    if ASSISTANT not in tasks.load(plan.task).experts(cells.load(plan.cell), plan.seed):
        return []
    params: dict[str, object] = {
        "cell": str(plan.cell),
        "task": plan.task,
        "seed": plan.seed,
        "after": [driven_arm(plan)],
    }
    return [Node(f"/{ASSISTANT}", "surg_sim", "expert_node.py", params)]


def console(plan: SystemPlan, leads: bool, web: Mapping[str, object]) -> Node:
    """The node that serves the operator's page; ``web`` holds who may open it.

    ``leads``: the page is the hand. If not, it shows, enables, stops and records.

    Raises:
        CliError: The cell has nothing to drive.
    """
    params: dict[str, object] = {
        "cell": str(plan.cell),
        "arm": driven_arm(plan),
        "arms": list(plan.arms),
        "leader": BROWSER if leads else "",
        "views": list(plan.cameras),
        **({"episodes": str(plan.out / "episode")} if plan.record else {}),
        **_language(plan.task),
        **web,
    }
    return Node(CONSOLE, "surg_console", "console_node.py", params, prompt=True)


def driven_arm(plan: SystemPlan) -> str:
    """The first arm of the cell that holds an instrument.

    Raises:
        CliError: There is none.
    """
    arms = cells.load(plan.cell).arms.values()
    driven = next((str(arm.name) for arm in arms if arm.instrument.camera is None), None)
    if driven is None:
        raise CliError(f"{plan.cell}: no arm of this cell holds an instrument to drive", 2)
    return driven


def _leader(leader: str) -> dict[str, object]:
    if leader == BROWSER:
        return {"leader": "crtk", "settings": {"name": BROWSER}}
    return {"leader": str(Path(leader).absolute()) if leader.endswith(".py") else leader}


def _assistant_frame(plan: SystemPlan, loaded: Any) -> list[float]:
    """Orientation x, y, z, w in the world of the assistant's trocar frame."""
    from surg_core.transforms import matrix_to_quaternion_xyzw

    world = _world(loaded, plan.task)
    assistant = None if world.task is None else world.task.assistant
    if assistant is None:
        what = f"task {plan.task}" if plan.task else "a phantom without a task"
        raise CliError(
            f"--leader: {what} has no assistant's instrument for a second hand to hold; "
            "bgr has one",
            2,
        )
    return list(map(float, matrix_to_quaternion_xyzw(assistant.X_WRcm[:3, :3])))


def _language(task: str) -> dict[str, object]:
    """The words of a task for the page; nothing for a task that is not found here."""
    from surg_sim import tasks

    try:
        words = tasks.load(task)
    except tasks.TaskError:  # "": there is none; a file of another machine
        return {}
    stated = {"instruction": words.instruction, "stages": dict(words.stages)}
    return {"language": json.dumps(stated)}


def _standing_view(loaded: Any) -> list[float]:
    """Orientation x, y, z, w in the world of the phantom's camera that no arm holds."""
    import mujoco
    import numpy as np

    from surg_core.transforms import matrix_to_quaternion_xyzw
    from surg_sim.physics.endoscope_rig import LEFT

    world = _world(loaded)
    mujoco.mj_forward(world.model, world.data)
    # A MuJoCo camera looks along -z with y up.
    R_WV = world.data.camera(LEFT).xmat.reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])
    return list(map(float, matrix_to_quaternion_xyzw(R_WV)))


def _world(loaded: Any, task: str = "") -> Any:
    """What moves in the phantom, without its looks: 50 ms."""
    from surg_sim import tasks
    from surg_sim.physics.world import World

    return World(loaded, 0, task=tasks.load(task) if task else None)
