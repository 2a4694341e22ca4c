"""Messages of an episode without ROS, as ``surg_recording.episode.table_rows`` reads them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

import surg_core
from surg_core.contract import SECOND_NS, TICK_NS
from surg_core.wrist_joints import WristView
from surg_recording.episode import table_columns
from surg_sim.envs.cell_session import Tick
from surg_sim.physics.ground_truth import ArmTruth
from surg_sim.tasks import State

SENDER = "/expert"
"""Whose commands the recording says they are, as in a graph."""
JAW = "jaw/servo_jp"


def message_of(stamp_ns: int, **members: Any) -> SimpleNamespace:
    """A message with a header of this stamp."""
    secs, nsecs = divmod(stamp_ns, SECOND_NS)
    header = SimpleNamespace(stamp=SimpleNamespace(secs=secs, nsecs=nsecs))
    return SimpleNamespace(header=header, **members)


def _xyz(v: Any) -> SimpleNamespace:
    x, y, z = np.asarray(v).tolist()
    return SimpleNamespace(x=x, y=y, z=z)


def wrench(force: Any) -> SimpleNamespace:
    """A force (3,) [N] as geometry_msgs/Wrench has it."""
    return SimpleNamespace(force=_xyz(force))


def command_of(command: surg_core.MotionCommand, stamp_ns: int) -> tuple[str, SimpleNamespace]:
    """A command of a scripted sender, which speaks in poses and jaw angles."""
    if command.motion == surg_core.Motion.JAW_SERVO_JP:
        return JAW, message_of(stamp_ns, position=[command.jaw])
    if command.motion == surg_core.Motion.HOLD:
        return "hold", message_of(stamp_ns)
    x, y, z, w = np.asarray(command.rotation).tolist()
    rotation = SimpleNamespace(x=x, y=y, z=z, w=w)
    pose = SimpleNamespace(position=_xyz(command.p), orientation=rotation)
    return "servo_cp", message_of(stamp_ns, pose=pose)


OUTPUTS = {"p_tip": "p_BTip", "s": "s_B", "p_rcm": "p_BRcm"}
"""Members of surg_core.Outputs that surg_msgs/Cycle calls otherwise."""


def cycle_of(
    out: surg_core.Outputs, tick: int, measured: Any, q_BR: list[float]
) -> SimpleNamespace:
    """A control cycle as surg_msgs/Cycle has it."""
    known: dict[str, Any] = {
        "tick": tick,
        "state": int(out.state),
        "reason": surg_core.reason_name(out.reason) if int(out.reason) else "",
        "command": int(out.motion),
        "source": SENDER if int(out.source) else "",
        "q": measured.q,
        "qd": measured.qd,
        "q_br": q_BR,
        "compute_us": None,
        "period_us": 0.0,
        "overruns": 0,
    }
    known |= wrist_members(out.wrist)
    for field in table_columns.CYCLE:
        if field.source and field.source not in known:
            known[field.source] = getattr(out, OUTPUTS.get(field.source, field.source))
    for name, value in known.items():
        known[name] = value.tolist() if isinstance(value, np.ndarray) else value
    return message_of(tick * TICK_NS, **known)


def wrist_members(wrist: surg_core.WristOutputs | None) -> dict[str, Any]:
    """Members of surg_msgs/Cycle about the wrist."""
    if wrist is None:
        return {"wrist": []}
    view, geometry = WristView.of(wrist), wrist.geometry
    return {
        "wrist_geometry": [geometry.pitch_to_yaw, geometry.yaw_to_tip, geometry.turn],
        "wrist": view.measured,
        "wrist_set": view.set,
        "wrist_goal": view.goal,
        "q_tip": view.q_RTip,
        "q_set": view.q_RSet,
        "q_goal": view.q_RGoal,
    }


def truth_of(name: str, truth: ArmTruth) -> SimpleNamespace:
    """An arm's truth as surg_msgs/ArmTruth has it."""
    members = truth._asdict()
    for key, value in members.items():
        members[key] = _xyz(value) if isinstance(value, np.ndarray) else value
    return SimpleNamespace(arm=name, **members)


def state_numbers(state: State) -> tuple[list[str], list[float]]:
    """A task's state as names of surg_msgs/TaskState, such as ``place[3]``, and all its numbers."""
    names, values = [], []
    for key, value in state.items():
        array = np.asarray(value, dtype=np.float64)
        shape = ",".join(map(str, array.shape))
        names.append(f"{key}[{shape}]" if shape else key)
        values += array.ravel().tolist()
    return names, values


def task_state_of(tick: Tick, state: State) -> SimpleNamespace:
    """A task's state as surg_msgs/TaskState has it."""
    names, values = state_numbers(state)
    verdict = vars(tick.verdict)
    judged = {key: verdict[key] for key in ("phase", "done", "success", "reason", "reward")}
    stamp_ns = tick.tick * TICK_NS
    return message_of(stamp_ns, tick=tick.tick, names=names, values=values, **judged)
