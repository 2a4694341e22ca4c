"""What an episode of a task needs: cell, physical setting, control law, and who plays it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from surg_cli.graph import policy_program, system
from surg_cli.graph.system_plan import Policy, SystemPlan
from surg_cli.host import cells
from surg_cli.host.terminal import CliError

VIEWS = {"none": (), "left": ("left",), "stereo": ("left", "right")}
ROBOT_CELLS = {"ur5e": "sim_two_arms", "panda": "sim_two_arms_panda"}
EXPERT = "expert"
"""The scripted sender that a policy replaces; a task's other senders stay scripted."""


@dataclass(frozen=True)
class Condition:
    """What the episodes of one box in the plots have in common."""

    setting: str
    law: str


def find_cell(robot: str) -> Path:
    """The two-arm cell of `--robot`: of a bundled robot, or a cell's own name.

    Raises:
        CliError: It is neither.
    """
    try:
        return cells.find(ROBOT_CELLS.get(robot, robot))
    except CliError as problem:
        known = ", ".join(ROBOT_CELLS)
        raise CliError(f"--robot {robot}: neither {known} nor a cell ({problem})", 2) from problem


def parse_settings(text: str) -> list[str]:
    """Physical settings of `--setting`, names with commas or `all`, each once.

    Raises:
        CliError: One does not exist; lists those that do.
    """
    from surg_sim.physics.patient_settings import SETTINGS, find_setting

    wanted = list(SETTINGS) if text == "all" else text.split(",")
    for name in wanted:
        try:
            find_setting(name)
        except ValueError as error:
            raise CliError(f"--setting {text}: {error}", 2) from error
    return list(dict.fromkeys(wanted))


def cell_of(task: str, robot: str | None) -> Path:
    """The cell of `--robot`; without it the task's `home_cell`.

    Raises:
        CliError: There is no such cell, or no such task.
    """
    from surg_sim import tasks

    if robot is not None:
        return find_cell(robot)
    try:
        home = tasks.load(task).home_cell
    except ValueError as error:  # a TaskError is one
        raise CliError(str(error), 2) from error
    try:
        return cells.find(home)
    except CliError as problem:
        raise CliError(f"task '{task}': its home_cell: {problem}", 2) from problem


def make_plan(
    task: str,
    cell: Path,
    loaded: Any,
    conditions: Sequence[Condition],
    seed: int,
    cameras: tuple[str, ...],
    out: Path,
    policy: Policy | None = None,
) -> SystemPlan:
    """What all episodes of a run have in common; starts nothing.

    ``task`` is a name or the path of a file; ``policy`` plays in the place of the scripted expert.

    Raises:
        CliError: The task is unknown, does not fit the cell, or nobody plays it.
    """
    if task.endswith(".py"):
        task = str(Path(task).absolute())
    loaded_task, senders = _load_task(task, loaded, conditions, seed, policy)
    arms = tuple(str(arm) for arm in loaded.arms)
    return SystemPlan(
        cell=cell,
        arms=arms,
        lockstep=True,
        cameras=cameras,
        task=task,
        senders=senders,
        policy=policy,
        out=out,
        run_info={
            "task": loaded_task.name,
            **loaded_task.language(),
            "operator": "scripted expert" if policy is None else f"policy {policy.label}",
            "robot": loaded.arms[arms[0]].robot.name,
            "mode": "cartesian",
            "timing": "lockstep",
        },
    )


def _load_task(
    task: str,
    loaded: Any,
    conditions: Sequence[Condition],
    seed: int,
    policy: Policy | None,
) -> tuple[Any, Mapping[str, tuple[str, ...]]]:
    """The task, and the names of the nodes that play it with the arms that each commands."""
    from surg_sim import tasks
    from surg_sim.physics.patient_settings import find_setting

    try:
        for each in conditions:
            loaded_task = tasks.load(task)
            loaded_task.prepare(loaded, find_setting(each.setting))
        senders = {name: tuple(e.arms) for name, e in loaded_task.experts(loaded, seed).items()}
    except ValueError as error:  # a TaskError is one
        raise CliError(str(error), 2) from error
    if policy is not None:
        senders.pop(EXPERT, None)
        senders[system.POLICY] = tuple(loaded_task.commanded)
    if not senders:
        raise CliError(f"task '{loaded_task.name}' has no scripted sender; name a --policy", 2)
    return loaded_task, senders


def for_episode(plan: SystemPlan, condition: Condition, seed: int, folder: Path) -> SystemPlan:
    """The plan of one episode of a run."""
    info = {**plan.run_info, "seed": seed, "setting": condition.setting, "law": condition.law}
    policy = None if plan.policy is None else policy_program.addressed(plan.policy)
    return replace(
        plan,
        setting=condition.setting,
        law=condition.law,
        seed=seed,
        policy=policy,
        out=folder,
        run_info=info,
    )
