"""Applies faults between a world and its links. No ROS, no clock, no threads.

In every tick the caller asks which states the links send, which commands the world executes, and
where a tracker sees the trocar.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Generic, TypeVar

import numpy as np

import surg_core
from surg_sim.arrays import Array
from surg_sim.nodes.faults import (
    Fault,
    FaultError,
    Freeze,
    Lasting,
    NotFinite,
    RobotStop,
    ToolLost,
    ToolOff,
    TrackLost,
    TrocarJump,
    TrocarMotion,
    Wire,
)
from surg_sim.physics.sim_arm import ArmCommand, ToolError
from surg_sim.physics.trocar_motion import Sinusoid
from surg_sim.physics.world import ArmState, World

Packet = TypeVar("Packet")
Active = TypeVar("Active", bound=Lasting)

STATE, COMMAND = "state", "command"
"""The two directions of a robot's wire."""


def tool_errors(faults: Iterable[Fault], seed: int = 0) -> dict[str, ToolError]:
    """The calibration errors among the faults, for the builder of a world, by arm name."""
    return {f.arm: ToolError(f.tip, f.axis, seed) for f in faults if isinstance(f, ToolOff)}


class Channel(Generic[Packet]):
    """A lossy channel: packets are lost, duplicated and reordered.

    Three numbers are drawn for every packet in any case, so that a change of one probability does
    not affect the other two faults.
    """

    def __init__(self, wire: Wire, rng: np.random.Generator) -> None:
        self._wire, self._rng = wire, rng
        self._to_lose = 0
        self._late: list[Packet] = []
        self.lost = self.doubled = self.swapped = 0
        """Counts so far."""

    def transmit(self, packet: Packet) -> list[Packet]:
        """Send one packet; returns the packets that arrive, in order of arrival."""
        wire = self._wire
        loses, doubles, swaps = self._rng.random(3) < (wire.loss, wire.duplicate, wire.reorder)
        late, self._late = self._late, []
        if self._to_lose == 0 and loses:
            self._to_lose = self._wire.burst
        if self._to_lose > 0:
            self._to_lose -= 1
            self.lost += 1
            return late
        if swaps and not late:
            self.swapped += 1
            self._late = [packet]
            return []
        self.doubled += int(doubles)
        return [packet] * (1 + int(doubles)) + late


class Injector:
    """The faults of one run, in a world at tick 1; the seed is that of the wires.

    In lock-step every tick must have one state and one answer; see ``Wire``, ``Freeze``.

    Raises:
        FaultError: A fault does not fit the world.
    """

    def __init__(
        self, world: World, faults: Iterable[Fault] = (), seed: int = 0, lockstep: bool = True
    ) -> None:
        self._world, self._seed, self._lockstep = world, seed, lockstep
        self._coming: list[TrocarMotion | TrocarJump] = []
        self._lasting: list[Lasting] = []
        self._channels: dict[tuple[str, str], tuple[Wire, Channel]] = {}
        self._shown: dict[str, tuple[int, ArmState]] = {}  # newest that has arrived, lock-step
        self._read: dict[str, tuple[int, ArmState]] = {}
        # By arm: tick, and the states that leave in it.
        self._answers: dict[str, tuple[int, list[tuple[int, ArmState]]]] = {}
        for fault in faults:
            if not isinstance(fault, ToolOff):
                self.add(fault)

    def add(self, fault: Fault) -> None:
        """Schedule a fault, for the next tick at the earliest.

        Raises:
            FaultError: It does not fit the world.
        """
        if isinstance(fault, ToolOff):
            raise FaultError(f"{fault.kind}: an instrument can be mounted at the start only")
        if fault.arm not in self._world.arms:
            raise FaultError(f"{fault.kind}: no arm {fault.arm!r}, only {list(self._world.arms)}")
        dof = len(self._world.state(fault.arm).q)
        if isinstance(fault, NotFinite) and fault.joint >= dof:
            raise FaultError(f"{fault.kind}: joint is {fault.joint}; allowed is 0 to {dof - 1}")
        if fault.at <= self._world.tick:
            fault = replace(fault, at=self._world.tick + 1)
        if isinstance(fault, TrocarMotion | TrocarJump):
            self._coming.append(fault)
        elif isinstance(fault, Lasting):
            self._lasting.append(fault)

    @property
    def active(self) -> list[str]:
        """Kinds of faults that are active or scheduled, sorted."""
        tick = self._world.tick
        waiting = [f.kind for f in self._coming]
        return sorted({f.kind for f in self._lasting if tick < f.at or f.active(tick)} | {*waiting})

    # --- outgoing ------------------------------------------------------------------------

    def states(self, arm: str, stamp: int) -> list[tuple[int, ArmState]]:
        """Stamps and states that leave the robot link in this tick, in order of arrival.

        In lock-step exactly one, with the present stamp. A repeated call returns the same.
        """
        if not self._lasting:
            return [(stamp, self._measured(arm))]
        tick, answer = self._answers.get(arm, (0, []))
        if tick != self._world.tick:
            answer = self._sent(arm, stamp)
            self._answers[arm] = (self._world.tick, answer)
        return answer

    def _measured(self, arm: str) -> ArmState:
        """Measurement of the links in the present tick; read once per tick."""
        tick, state = self._read.get(arm, (0, None))
        if state is None or tick != self._world.tick:
            state = self._world.state(arm)
            self._read[arm] = (self._world.tick, state)
        return state

    def _sent(self, arm: str, stamp: int) -> list[tuple[int, ArmState]]:
        state = self._measured(arm)
        bad = self._active(NotFinite, arm)
        if bad is not None:
            name = "q" if bad.quantity == "position" else "qd"
            values: Array = getattr(state, name).copy()
            values[bad.joint] = float(bad.value)
            state = replace(state, **{name: values})
        arrived = [(stamp, state)]
        if self._active(Freeze, arm) is not None:
            arrived = []
        elif (channel := self._channel(arm, STATE)) is not None:
            arrived = channel.transmit((stamp, state))
        if not self._lockstep:
            return arrived
        # A receiver keeps the newest content; there is none before the first packet.
        shown = self._shown.get(arm, (stamp, state))
        self._shown[arm] = max([shown, *arrived], key=lambda item: item[0])
        return [(stamp, self._shown[arm][1])]

    def speaks(self, arm: str) -> bool:
        """Whether the robot link sends its status in this tick."""
        return self._lockstep or self._active(Freeze, arm) is None

    def robot(self, arm: str) -> tuple[surg_core.RobotCondition, float]:
        """The robot's condition and speed scaling in this tick."""
        stop = self._active(RobotStop, arm)
        if stop is None:
            return surg_core.RobotCondition.ACTIVE, 1.0
        condition = surg_core.RobotCondition.__members__[stop.condition.upper()]
        slowed = condition == surg_core.RobotCondition.SLOWED
        return condition, stop.scaling if slowed else 1.0

    def tool(self, arm: str) -> tuple[Array, Array] | None:
        """Joints [rad] and rates [rad/s] that leave the tool link; None: nothing does.

        They are the jaw's, behind a wrist's pitch and yaw and before its drive's roll.
        """
        state = self._measured(arm)
        joints, rates = np.array([state.jaw]), np.array([state.jaw_velocity])
        if state.wrist is not None and state.wrist_velocity is not None:
            joints = np.insert(state.wrist, 2, joints)
            rates = np.insert(state.wrist_velocity, 2, rates)
        if self._active(ToolLost, arm) is None:
            return joints, rates
        return (np.full_like(joints, np.nan), np.zeros_like(rates)) if self._lockstep else None

    def tool_lost(self, arm: str) -> bool:
        """Whether nobody can answer for the tool link in this tick."""
        return self._active(ToolLost, arm) is not None

    def track(self, arm: str, stale: int) -> tuple[int, Array, Array] | None:
        """What a tracker says of the trocar: tick, point [m], velocity [m/s]; None: nothing."""
        if self._active(TrackLost, arm) is not None:
            return None
        return self._world.trocar(arm).point.observed(stale)

    # --- incoming ------------------------------------------------------------------------

    def commands(self, arrived: Mapping[str, tuple[int, ArmCommand]]) -> dict[str, ArmCommand]:
        """Commands that the world executes; call it right before ``World.step``.

        ``arrived`` by arm: stamp of the robot command, and what came for robot and tool.
        """
        self._apply_trocar_faults()
        for arm in arrived:
            link = self._world.link(arm)
            link.condition, link.speed_scaling = self.robot(arm)
        if not self._lasting:
            return {arm: command for arm, (_, command) in arrived.items()}
        return {arm: self._command(arm, *item) for arm, item in arrived.items()}

    def _command(self, arm: str, stamp: int, command: ArmCommand) -> ArmCommand:
        lost = self.tool_lost(arm)
        jaw, wrist = (None, None) if lost else (command.jaw, command.wrist)
        silent = command.velocity is None and command.twist is None
        packets = [] if silent else [(stamp, command)]
        if self._active(Freeze, arm) is not None:
            packets = []
        elif packets and (channel := self._channel(arm, COMMAND)) is not None:
            packets = channel.transmit(packets[0])
        # A link takes the newest command of a tick and drops those that it overtook.
        _, command = max(packets, key=lambda item: item[0], default=(0, ArmCommand()))
        return ArmCommand(command.velocity, command.twist, jaw, wrist)

    def _apply_trocar_faults(self) -> None:
        """Apply due trocar faults; they show in the state of the next tick."""
        due = [fault for fault in self._coming if fault.at <= self._world.tick + 1]
        for fault in due:
            self._coming.remove(fault)
            point = self._world.trocar(fault.arm).point
            if isinstance(fault, TrocarJump):
                point.jump(np.array(fault.offset))
            elif fault.amplitude > 0.0:
                point.move(Sinusoid(fault.amplitude, fault.frequency, fault.axis))
            else:
                point.move(None)

    # --- active faults --------------------------------------------------------------------------

    def _active(self, kind: type[Active], arm: str) -> Active | None:
        """The latest fault of a kind that shows on an arm at the present tick."""
        tick = self._world.tick
        for fault in reversed(self._lasting):
            if isinstance(fault, kind) and fault.arm == arm and fault.active(tick):
                return fault
        return None

    def _channel(self, arm: str, direction: str) -> Channel | None:
        """The lossy wire in one direction at the present tick; each fault has its own draws."""
        tick = self._world.tick
        for fault in reversed(self._lasting):
            if not isinstance(fault, Wire) or fault.arm != arm or not fault.active(tick):
                continue
            if (STATE if fault.topic.endswith("measured_js") else COMMAND) != direction:
                continue
            held = self._channels.get((arm, direction))
            if held is None or held[0] is not fault:
                key = zlib.crc32(f"{arm} {direction} {fault.at}".encode())
                held = (fault, Channel(fault, np.random.default_rng([self._seed, key])))
                self._channels[arm, direction] = held
            return held[1]
        return None
