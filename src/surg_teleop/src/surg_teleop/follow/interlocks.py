"""Conditions that an arm needs to follow its leader, each with what to do when it is not met.

Pure functions of what one tick reads. ``following`` conditions hold all the time; ``engagement``
conditions only at the moment when following starts.
"""

from __future__ import annotations

import numpy as np

from surg_core.arm_view import ArmState, ArmView
from surg_core.hand.leader_sample import HandRate, LeaderSample
from surg_teleop.follow.teleop_types import (
    NEUTRAL,
    CameraView,
    ControlMode,
    Notice,
    Reason,
    TeleopInputs,
    TeleopSettings,
    fresh,
)

RESTS_ON_IT = 1e-3
"""[m] A tip so little above the depth of an inserted one is inserted, as the controller counts."""


def following(
    inputs: TeleopInputs, settings: TeleopSettings, mode: ControlMode, enabling: bool
) -> Notice | None:
    """What blocks the arm from following now; None if nothing does.

    `enabling`: the operator has just enabled the arm, which may clear its fault.
    """
    return (
        _arm(inputs.now, inputs.arm, settings, enabling)
        or _leader(inputs, settings, mode)
        or _camera(inputs.now, inputs.camera)
        or _node(inputs.dt)
    )


def engagement(
    sample: LeaderSample,
    arm: ArmView,
    camera: CameraView,
    settings: TeleopSettings,
    mode: ControlMode,
    since_hold: float,
) -> Notice | None:
    """What keeps the arm from starting to follow; None if nothing does.

    `since_hold`: time since the arm was told to hold [s].
    """
    if arm.busy:
        return Notice(Reason.ARM_BUSY, f"{settings.arm} is busy")
    if camera.moved:
        return Notice(Reason.CAMERA_MOVED, camera.moved)
    try:
        wrist = settings.wrist_of(arm)
    except ValueError as error:
        return Notice(Reason.ARM_NOT_READY, f"{settings.arm}: {error}")
    depth = float(np.linalg.norm(arm.p_end))
    least = settings.depth_inserted
    if depth < least - RESTS_ON_IT:
        return Notice(
            Reason.TOO_SHALLOW,
            f"the tip is {1e3 * depth:.0f} mm deep; at least {1e3 * least:.0f} mm are needed: "
            f"use {settings.arm}/rcm/insert",
        )
    rate = sample.rate if mode is ControlMode.RATE else None
    if rate is not None and not _at_rest(rate, wristed=wrist is not None):
        return Notice(Reason.LEADER_DEFLECTED, f"{settings.leader} is deflected; release its stick")
    if since_hold < settings.quiet:
        return Notice(Reason.ARM_STOPPING, f"{settings.arm} is coming to rest")
    return None


def _arm(
    now: float, arm: ArmView | None, settings: TeleopSettings, enabling: bool
) -> Notice | None:
    name = settings.arm
    if arm is None or not fresh(now, arm.received):
        text = f"{name} is silent; check that its controller is running"
        return Notice(Reason.ARM_SILENT, text)
    cause = f" ({arm.reason})" if arm.reason else ""
    if arm.state == ArmState.FAULT:
        text = f"{name} is in FAULT{cause}; remove the cause, then press enable"
        return Notice(Reason.ARM_FAULT, text, fault=not enabling)
    if not arm.homed or arm.state != ArmState.ENABLED:
        state = f"{arm.state.name}{cause}" if arm.homed else "not homed"
        return Notice(Reason.ARM_NOT_READY, f"{name} is {state}; press enable")
    if arm.holder not in ("", settings.node):
        text = f"{name} is held by {arm.holder}; pause {name}, then press enable"
        return Notice(Reason.ARM_HELD, text)
    return None


def _leader(inputs: TeleopInputs, settings: TeleopSettings, mode: ControlMode) -> Notice | None:
    name, sample = settings.leader, inputs.sample
    if sample is None or not fresh(inputs.now, sample.stamp):
        if sample is not None and sample.problem:
            return Notice(Reason.LEADER_PROBLEM, f"{name}: {sample.problem}")
        return Notice(
            Reason.LEADER_SILENT,
            f"{name} is silent; check its connection and power, then press the clutch or enable",
        )
    if not inputs.valid:
        return Notice(
            Reason.LEADER_INVALID,
            f"{name} sends values that are not finite or no unit quaternion x, y, z, w; check the "
            "device and its driver, then press enable",
            fault=True,
        )
    if sample.problem:
        return Notice(Reason.LEADER_PROBLEM, f"{name}: {sample.problem}")
    if mode.read(sample) is None:
        text = f"{name} has no {mode.value} mode; press 'rate' to select the other mode"
        return Notice(Reason.NO_SUCH_MODE, text)
    if settings.need_present and "present" not in sample.buttons:
        return Notice(Reason.NOT_PRESENT, "no operator at the controls (operator_present)")
    return None


def _camera(now: float, camera: CameraView | None) -> Notice | None:
    if camera is None or not fresh(now, camera.received):
        return Notice(
            Reason.CAMERA_SILENT,
            "the endoscope arm is silent, so the view's orientation is unknown; check that its "
            "controller is running",
        )
    if not np.isfinite(camera.R_WV).all():
        text = "the endoscope arm sends values that are not finite; check it, then press enable"
        return Notice(Reason.CAMERA_INVALID, text, fault=True)
    return None


def _node(dt: float) -> Notice | None:
    if fresh(dt, 0.0):
        return None
    text = f"teleoperation stalled for {dt:.1f} s; press the clutch or enable"
    return Notice(Reason.NODE_STALLED, text)


def _at_rest(rate: HandRate, wristed: bool) -> bool:
    linear, angular = float(np.linalg.norm(rate.v_V)), abs(rate.roll)
    if wristed and rate.tilt is not None:
        angular = max(angular, float(np.abs(rate.tilt).max()))
    if rate.spherical is not None:
        yaw, pitch, insertion = rate.spherical.tolist()
        linear, angular = abs(insertion), max(angular, abs(yaw), abs(pitch))
    return linear <= NEUTRAL and angular <= 10.0 * NEUTRAL
