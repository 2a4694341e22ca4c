"""Episodes made up for tests: every number in their summary is known by construction."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from surg_recording.episode.episode_recorder import Recording

TICK_NS = 2_000_000
P_RCM = np.array([0.45, -0.10, 0.20])
# The rcm frame: z points down into the patient, x stays the base's x.
R_BR = np.diag([1.0, -1.0, -1.0])
Q_BR = (1.0, 0.0, 0.0, 0.0)


def xyz(values: Any) -> SimpleNamespace:
    """A message-like point."""
    return SimpleNamespace(x=float(values[0]), y=float(values[1]), z=float(values[2]))


def stamp(ns: int) -> SimpleNamespace:
    """A message-like time."""
    return SimpleNamespace(secs=ns // 1_000_000_000, nsecs=ns % 1_000_000_000)


def header(ns: int) -> SimpleNamespace:
    """A message-like header."""
    return SimpleNamespace(stamp=stamp(ns))


def path(t: float) -> np.ndarray:
    """The input's tip path in the rcm frame [m]: 50 x 45 x 20 mm, centred 120 mm deep."""
    return np.array(
        [
            0.025 * np.sin(2 * np.pi * 0.31 * t),
            0.0225 * np.sin(2 * np.pi * 0.23 * t + 0.4) - 0.0225 * np.sin(0.4),
            0.120 + 0.010 * np.sin(2 * np.pi * 0.17 * t),
        ]
    )


@dataclasses.dataclass
class Synthetic:
    """What to make up."""

    seconds: float = 6.0
    lag_s: float = 0.0124
    kinematic_offset: float = 0.02e-3
    """The measured shaft passes the pivot at this distance [m]."""
    true_offset: float = 0.2e-3
    """The true shaft passes the trocar at this distance [m]."""
    tip_offset: float = 0.0
    """The executed tip lies this far off its place, along x [m]."""
    command: str = "servo_cp"
    spherical: bool = False
    fault_at: float | None = None
    hold: tuple[float, float] | None = None
    """From, to [s]: the set-point and the arm stand still while the input goes on."""
    refused_from: float | None = None
    """From then on [s] the arm refuses every command and holds."""
    constant: bool = False
    disabled_ticks: int = 0
    scaled_ticks: int = 0
    force: tuple[float, float, float] = (0.3, 0.0, 0.4)
    displacement: tuple[float, float, float] = (0.0, 0.12e-3, 0.0)
    compute_us: float = 8.0
    mode: str = "lockstep"
    repeats: int = 1
    """Cycles that show one state, as those behind a starved link do."""
    truth: bool = True
    frames: int = 0
    joints: int = 6

    def executed(self, t: float) -> np.ndarray:
        """Executed tip in the rcm frame at time t [m]."""
        t = max(t - self.lag_s, -0.5)
        if self.refused_from is not None:
            t = min(t, self.refused_from)
        if self.hold and t > self.hold[0]:
            t = self.hold[0] if t < self.hold[1] else t
        return path(0.0 if self.constant else t)


def shaft(tip: np.ndarray, offset: float) -> np.ndarray:
    """Shaft axis of a shaft that ends at ``tip`` and passes the origin at ``offset`` [m]."""
    toward = tip / np.linalg.norm(tip)
    side = np.cross(toward, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    tilt = np.arcsin(offset / np.linalg.norm(tip))
    return np.cos(tilt) * toward + np.sin(tilt) * side


def cycle(what: Synthetic, tick: int, command: int) -> SimpleNamespace:
    """A message-like surg_msgs/Cycle."""
    shown = tick - tick % what.repeats
    t = shown * TICK_NS * 1e-9
    tip_R = what.executed(t)
    s_B = R_BR @ shaft(tip_R, what.kinematic_offset)
    tip = P_RCM + R_BR @ tip_R
    fault = what.fault_at is not None and t >= what.fault_at
    ns = shown * TICK_NS
    refusing = 0
    if what.refused_from is not None and t >= what.refused_from:
        refusing = 1 + round((t - what.refused_from) * 1e9 / TICK_NS)
        command = 0
    v = np.full(what.joints, 0.1)
    return SimpleNamespace(
        header=header(ns),
        tick=tick,
        state=3 if fault else (0 if tick <= 50 + what.disabled_ticks and command else 1),
        homed=True,
        busy=False,
        reason="rcm_error, 2.1 mm" if fault else ("stale" if refusing > 50 else ""),
        command=command,
        source="/operator",
        p_goal=list(P_RCM + R_BR @ path(t)),
        roll_goal=0.0,
        accepted=tick - refusing,
        refused=refusing,
        q=list(np.sin(t + np.arange(what.joints))),
        qd=list(v),
        p_tip=list(tip),
        s=list(s_B),
        p_rcm=list(P_RCM),
        q_br=list(Q_BR),
        roll=0.0,
        depth=float(np.linalg.norm(tip_R)),
        rcm_error=123.0,  # never copied into a figure
        p_set=list(tip),
        v_set=[0.0, 0.0, 0.0],
        roll_set=0.0,
        jaw_set=0.1,
        jaw=0.1,
        wrist=[],
        scale=0.5 if tick <= 50 + what.scaled_ticks and command else 1.0,
        limited_by="",
        tier=0,
        stop_bound_tip=0.002,
        stop_bound_pivot=0.0005,
        qd_command=list(v),
        twist_command=[0.0] * 6,
        compute_us=what.compute_us,
        period_us=0.0 if what.mode == "lockstep" else 2000.0 + (tick % 7),
        overruns=0,
    )


def ground_truth(what: Synthetic, tick: int) -> SimpleNamespace:
    """A message-like surg_msgs/GroundTruth."""
    tip_R = what.executed(tick * TICK_NS * 1e-9)
    s_B = R_BR @ shaft(tip_R, what.true_offset)
    tip = P_RCM + R_BR @ tip_R + [what.tip_offset, 0.0, 0.0]
    arm = SimpleNamespace(
        arm="PSM1",
        # A point of the axis somewhere else than the tip. With a tip offset the shaft stays.
        shaft_point=xyz(P_RCM + R_BR @ tip_R - 0.3 * s_B),
        shaft_axis=xyz(s_B),
        tip=xyz(tip),
        tip_velocity=xyz([0, 0, 0]),
        trocar=xyz(P_RCM),
        trocar_loaded=xyz(P_RCM + what.displacement),
        trocar_force=xyz(what.force),
        jaw=0.1,
    )
    return SimpleNamespace(header=header(tick * TICK_NS), tick=tick, arms=[arm])


def pose(what: Synthetic, tick: int) -> SimpleNamespace:
    """A message-like command for one tick: PoseStamped, or JointState when spherical."""
    p = path(tick * TICK_NS * 1e-9)
    if what.spherical:
        insertion = np.linalg.norm(p)
        pitch = np.arcsin(p[1] / insertion)
        yaw = np.arctan2(p[0], p[2])
        return SimpleNamespace(header=header(tick * TICK_NS), position=[yaw, pitch, insertion, 0.0])
    orientation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    return SimpleNamespace(
        header=header(tick * TICK_NS),
        pose=SimpleNamespace(position=xyz(p), orientation=orientation),
    )


def image(ns: int, number: int, width: int = 96, height: int = 64) -> SimpleNamespace:
    """A message-like rgb8 image whose number can be read from its brightness."""
    data = np.full((height, width, 3), (number * 7) % 256, np.uint8)
    return SimpleNamespace(
        header=header(ns),
        width=width,
        height=height,
        step=3 * width,
        encoding="rgb8",
        data=data.tobytes(),
    )


def record(folder: Path, what: Synthetic | None = None, **run: Any) -> Path:
    """Record a made-up run; returns the finished episode folder.

    50 ticks at rest, then the motion, then 50 ticks at rest.
    """
    what = what or Synthetic()
    info = {
        "robot": "ur5e",
        "motion": "synthetic",
        "mode": "spherical" if what.spherical else "cartesian",
        "law": "ours",
        "link": "joint",
        "scale": 1.0,
        "seed": 1,
        **run,
    }
    recording = Recording(
        folder,
        mode=what.mode,
        arms=["PSM1"],
        cameras=["endoscope_left"] if what.frames else [],
        manifest={"run": info, "versions": {"surg_recording": "test"}},
        min_free_bytes=0,
    )
    ticks = round(what.seconds / 0.002)
    topic = "servo_jp" if what.spherical else what.command
    number = 2 if what.spherical else 1
    for tick in range(1, ticks + 101):
        moving = 50 < tick <= 50 + ticks
        if moving:
            recording.command("PSM1", topic, pose(what, tick), "/operator", tick)
        recording.cycle("PSM1", cycle(what, tick, number if moving else 0), tick)
        if what.truth:
            recording.ground_truth(ground_truth(what, tick), tick)
        if what.frames and tick % 25 == 0 and tick // 25 <= what.frames:
            recording.image("endoscope_left", image(tick * TICK_NS, tick // 25), tick)
    recording.event("/PSM1/status", "/controller", "ENABLED", 1)
    sim = {"tick": ticks + 100, "deterministic": True, "state_hash": "ab" * 32, "done": True}
    return recording.close({"sim": {**sim, "aborted": None}})
