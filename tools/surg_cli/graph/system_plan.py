"""What a system to be started shall be; `system` makes nodes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

OPERATOR = "operator"
RECORDER = "recorder"
ENDOSCOPE = "endoscope"


@dataclass(frozen=True)
class Policy:
    """A policy in the place of the scripted expert.

    ``script`` is a client that is started with the server (empty: somebody connects), ``keys`` the
    folder of CURVE keys (empty: none), ``privileged`` whether the simulator's truth is served,
    ``forces`` whether the forces at tip and trocar are.
    """

    address: str
    script: str = ""
    keys: str = ""
    privileged: bool = False
    forces: bool = False

    @property
    def label(self) -> str:
        """In the manifest."""
        return Path(self.script).name if self.script else f"at {self.address}"


@dataclass(frozen=True)
class SystemPlan:
    """A system to bring up."""

    cell: Path  # folder of the cell
    arms: tuple[str, ...]  # CRTK names of its arms
    lockstep: bool  # step by step and reproducible, or in real time
    # views of the endoscope: "left", "right"; none: there is no endoscope
    cameras: tuple[str, ...]
    out: Path  # folder of the run
    # parameters of the node that captures a real endoscope's pictures; None: the simulator's
    capture: dict[str, object] | None = None
    # parameters of the node that makes depth and marks of the pictures; None: there is none
    eyes: dict[str, object] | None = None
    view: bool = False  # whether the simulator opens its window
    # arms that the simulator drives; None: all. Without any there is no simulator and no picture
    simulated: tuple[str, ...] | None = None
    sensed: tuple[str, ...] = ()  # arms with a force sensor at the flange
    driven: tuple[str, ...] = ()  # arms whose link is started: those with `hardware` in the cell
    turned: tuple[str, ...] = ()  # arms whose instrument has a drive of the platform's
    law: str = "ours"  # "ours", "velocity" or "paper"
    link: str | None = None  # "joint", "twist", or None for what the robot's YAML says
    # lateral feedback [1/s], or None for what the robot's YAML says
    feedback_gain: float | None = None
    seed: int = 0
    record: bool = True
    record_topics: tuple[str, ...] = ()  # names and patterns of further topics to record
    record_cameras: tuple[str, ...] = ()  # topics of further cameras to record
    record_quality: Mapping[str, object] = field(default_factory=dict)  # of videos: ~video_…
    # parameters of the operator node, None for a system without one
    operator: dict[str, object] | None = None
    task: str = ""  # name or file of the task that is played; empty: none
    setting: str = ""  # physical setting of the simulation; empty: the phantom's without a task
    # names of the scripted nodes that play it, with the arms that each commands
    senders: Mapping[str, Sequence[str]] = field(default_factory=dict)
    policy: Policy | None = None  # who plays as the sender `POLICY`; None: there is none
    extra_participants: tuple[str, ...] = ()  # nodes from elsewhere that a lock-step tick waits for
    # parameters of the gateway to ROS 2; None: nothing is opened for it
    ros2: Mapping[str, object] | None = None
    # what the recorder writes into the manifest
    run_info: dict[str, object] = field(default_factory=dict)

    @property
    def mode(self) -> str:
        """The word the nodes know the timing by."""
        return "lockstep" if self.lockstep else "freerun"

    @property
    def simulates(self) -> bool:
        """Whether the simulator drives an arm."""
        return self.simulated is None or bool(self.simulated)

    @property
    def participants(self) -> list[str]:
        """Names of the nodes whose commands a lock-step tick waits for."""
        ours = [OPERATOR] if self.operator is not None else []
        return [*ours, *self.senders, *self.extra_participants]

    def commanders(self, arm: str) -> list[str]:
        """Names of the nodes whose commands an arm's controller waits for.

        A scripted node that does not command an arm does not look at its cycles either: it may be a
        tick ahead of them, and must not be waited for.
        """
        senders = [name for name, arms in self.senders.items() if arm in arms]
        return [name for name in self.participants if name not in self.senders or name in senders]

    @property
    def streams(self) -> list[str]:
        """Names of the recorded cameras."""
        return [f"{ENDOSCOPE}_{view}" for view in self.cameras]

    @property
    def scene(self) -> dict[str, object]:
        """Parameters that every node that builds the scene must agree on."""
        params: dict[str, object] = {
            "cell": str(self.cell),
            "mode": self.mode,
            "arms": list(self.arms if self.simulated is None else self.simulated),
            "seed": self.seed,
        }
        if self.task or self.setting:
            params.update(task=self.task, setting=self.setting)
        return params

    @property
    def observers(self) -> list[str]:
        """Names of the nodes that may fall behind by a bounded number of ticks only."""
        names = [RECORDER] if self.record else []
        return [*names, ENDOSCOPE] if self.cameras and self.capture is None else names
