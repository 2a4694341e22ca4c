"""Faults of an emulated Franka arm: name -> what happens."""

from __future__ import annotations

from typing import TYPE_CHECKING

from surg_emulators.fault_lines import Kind, choice, number, numbers, switch
from surg_emulators.franka.franka_errors import Error

if TYPE_CHECKING:
    from surg_emulators.franka.franka_controller import FrankaController
    from surg_emulators.franka.franka_emulator import FrankaEmulator


def kinds(emulator: FrankaEmulator) -> dict[str, Kind]:
    """The faults that only this arm has."""
    return {**_people(emulator.controller), **_network(emulator)}


def _people(c: FrankaController) -> dict[str, Kind]:
    def collision(joint: str = "1") -> None:
        which = number(joint, "collision", 1, 7)
        c.reflex(Error.joint_reflex, f"joint {which:.0f} met something")

    def reflex(name: str) -> None:
        c.reflex(choice(name, {error.name: error for error in Error}, "reflex"), "fault")

    def push(*wrench: str) -> None:
        c.push(numbers(wrench, 6, "push", 1000.0))

    def guide(on: str = "on", *dq: str) -> str | None:
        worked = c.guide(switch(on), numbers(dq, 7, "guide", 2.0))
        return None if worked else "error: only an idle arm can be guided, or one beyond its limits"

    def load(mass: str, *centre: str) -> None:
        place = numbers(centre, 3, "load", 1.0)
        c.load = [number(mass, "load: mass", 0.0, 20.0), *place, *[0.0] * 9]

    def brakes(how: str) -> None:
        c.brakes(choice(how, {"release": True, "close": False}, "brakes"))

    return {
        "user_stop": Kind(lambda on="on": c.user_stop(switch(on)), "[on|off]", "user stop"),
        "guide": Kind(guide, "[on|off] [DQ1 ... DQ7]", "a hand guides the arm [rad/s]"),
        "brakes": Kind(brakes, "release|close", "brakes of the joints, as in Desk"),
        "load": Kind(load, "MASS [X Y Z]", "load that is set in Desk [kg, m]"),
        "collision": Kind(collision, "[JOINT]", "a joint meets something: joint_reflex"),
        "push": Kind(push, "[FX FY FZ TX TY TZ]", "a wrench at the end effector [N, Nm]"),
        "reflex": Kind(reflex, "NAME", "any other error, by libfranka's name"),
    }


def _network(emulator: FrankaEmulator) -> dict[str, Kind]:
    def share(name: str) -> Kind:
        def act(value: str, direction: str = "both") -> None:
            for channel in emulator.channels(_direction(direction)):
                setattr(channel, name, number(value, name, 0.0, 1.0))

        return Kind(act, "SHARE [states|commands|both]", _SHARES[name])

    def burst(count: str, direction: str = "both") -> None:
        for channel in emulator.channels(_direction(direction)):
            channel.burst = int(number(count, "burst", 0, 10_000))

    return {
        **{name: share(name) for name in _SHARES},
        "burst": Kind(burst, "COUNT [states|commands|both]", "so many datagrams in a row are lost"),
        "reboot": Kind(emulator.reboot, "", "the controller starts again, with its brakes closed"),
        "garbage": Kind(emulator.send_garbage, "", "a datagram that is no state"),
    }


_SHARES = {
    "loss": "share of datagrams that are lost",
    "reorder": "share of datagrams that arrive after the next one",
    "duplicate": "share of datagrams that arrive twice",
}


def _direction(word: str) -> str:
    return choice(word, {each: each for each in ("states", "commands", "both")}, "direction")
