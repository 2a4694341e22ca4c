"""Servos on one half-duplex line: their answers to instructions, and what goes wrong on the way."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

from surg_emulators.drive.servo_frames import STATUS, Frame, FrameParser, status
from surg_emulators.drive.servo_motor import (
    DELAY,
    LEVEL,
    OVERHEAT,
    OVERLOAD,
    UNDERVOLTAGE,
    Servo,
)
from surg_emulators.fault_lines import FaultError, Kind, Schedule, number, switch

EVERYBODY = 0xFE
QUIET = 0.002
"""[s] Without a byte, after which the beginning of a frame is given up."""
STEP = 0.001
"""[s] Of the motors."""
UNKNOWN, LENGTH = 2, 5
"""Errors of a status packet: instruction, data length."""


class ServoLine:
    """A line with servos, in time that the caller gives.

    Args:
        servos: Two may have one id; then their answers collide.
        seed: Of the noise.

    Attributes:
        now: Time of the motors [s].
        delay: Of every answer [s].
    """

    def __init__(self, servos: Sequence[Servo], seed: int = 0) -> None:
        self.servos = list(servos)
        self.now = 0.0
        self.delay = 0.0
        self._parser = FrameParser()
        self._fed = 0.0
        self._random = random.Random(seed)
        self._damage = self._noise = self._loss = 0.0  # share of answers
        self.schedule = Schedule(self._kinds())

    def step(self, now: float) -> None:
        """Move the motors on to a time [s], and let the faults happen that are due."""
        while self.now + STEP <= now:
            self.now += STEP
            self.schedule.due(self.now)
            for servo in self.servos:
                servo.step(self.now, STEP)

    def receive(self, data: bytes, now: float, baud: int) -> list[tuple[float, bytes]]:
        """Take bytes of the host at a time [s] and a baud [bit/s].

        Returns:
            When the answers leave [s], and their bytes.
        """
        if now - self._fed > QUIET:
            self._parser.pause()
        self._fed = now
        answers = []
        at = now + self.delay
        for frame in self._parser.feed(data):
            if frame.instruction == STATUS:
                continue
            for servos, answer in self._answers(frame, now, baud):
                at += 2e-6 * servos[0].table[DELAY] + 10 * len(answer) / baud
                if self._random.random() >= self._loss:
                    answers.append((at, self._spoiled(answer)))
        return answers

    def _answers(self, frame: Frame, now: float, baud: int) -> list[tuple[list[Servo], bytes]]:
        """Servos and their answer, in the order on the line; servos of one id collide."""
        heard = [servo for servo in self.servos if servo.hears(now, baud)]
        found = []
        for servo_id, instruction, parameters in _parts(frame, [s.id for s in heard]):
            named = [servo for servo in heard if servo.id == servo_id]
            told = [self._obey(servo, instruction, parameters) for servo in named]
            answers = [answer for answer in told if answer]
            if answers and (frame.id != EVERYBODY or frame.instruction in (0x01, 0x82)):
                found.append((named, _together(answers)))
        return found

    def _obey(self, servo: Servo, instruction: int, parameters: bytes) -> bytes:
        """One servo's answer; empty: none."""
        level, error = servo.table[LEVEL], 0
        if instruction == 0x01:
            return status(servo.id, servo.alert, bytes([*servo.table[:2], servo.table[6]]))
        if instruction == 0x02:
            address, size = _words(parameters)
            data = bytes(servo.table[address : address + size])
            error = 0 if data and len(data) == size and len(parameters) == 4 else LENGTH
            return status(servo.id, error | servo.alert, data) if level else b""
        address, content = int.from_bytes(parameters[:2], "little"), parameters[2:]
        servo_id = servo.id  # as it answers, also where it gets another one
        if instruction == 0x03:
            error = servo.write(address, content)
        elif instruction == 0x08:
            servo.reboot(self.now)
        else:
            error = UNKNOWN
        return status(servo_id, error | servo.alert) if level == 2 else b""

    def _spoiled(self, answer: bytes) -> bytes:
        """The answer as the host gets it."""
        found = bytearray(answer)
        if self._random.random() < self._damage:
            found[self._random.randrange(4, len(found))] ^= 1 << self._random.randrange(8)
        if self._random.random() < self._noise:
            found = bytearray(self._random.randbytes(self._random.randrange(1, 12))) + found
        return bytes(found)

    # --- faults ---------------------------------------------------------------------------------

    def _kinds(self) -> dict[str, Kind]:
        def each(do: Callable[[Servo], object]) -> Callable[[str], None]:
            def act(word: str) -> None:
                for servo in self._named(word):
                    do(servo)

            return act

        def share(name: str) -> Callable[[str], None]:
            return lambda word: setattr(self, name, number(word, "share", 0.0, 1.0))

        return {
            "damage": Kind(share("_damage"), "SHARE", "answers with a wrong bit"),
            "noise": Kind(share("_noise"), "SHARE", "bytes of noise in front of answers"),
            "loss": Kind(share("_loss"), "SHARE", "answers that do not come"),
            "delay": Kind(self._delay, "SECONDS", "answers come later"),
            "stall": Kind(self._stall, "ID on|off", "the motor is blocked"),
            "heat": Kind(self._heat, "ID DEGC", "temperature; above 80 it switches itself off"),
            "voltage": Kind(self._voltage, "V", "of all servos; below 9.5 they switch off"),
            "overload": Kind(each(lambda s: s.fail(OVERLOAD)), "ID", "it switches itself off"),
            "unplug": Kind(each(lambda s: setattr(s, "unplugged", True)), "ID", "of the chain"),
        }

    def _named(self, word: str) -> list[Servo]:
        found = [servo for servo in self.servos if str(servo.id) == word]
        if not found:
            known = ", ".join(str(servo.id) for servo in self.servos)
            raise FaultError(f"id {word!r}: must be one of {known}")
        return found

    def _delay(self, seconds: str) -> None:
        self.delay = number(seconds, "delay", 0.0, 10.0)

    def _stall(self, word: str, on: str) -> None:
        for servo in self._named(word):
            servo.stalled = switch(on)

    def _heat(self, word: str, degrees: str) -> None:
        for servo in self._named(word):
            servo.put("temperature", int(number(degrees, "temperature", 0.0, 150.0)))
            if servo.get("temperature") > servo.table[31]:
                servo.fail(OVERHEAT)

    def _voltage(self, volts: str) -> None:
        for servo in self.servos:
            servo.put("voltage", round(10 * number(volts, "voltage", 0.0, 30.0)))
            if servo.get("voltage") < 95:
                servo.fail(UNDERVOLTAGE)


def _parts(frame: Frame, ids: Sequence[int]) -> list[tuple[int, int, bytes]]:
    """Id, instruction and parameters for each servo that a frame speaks to."""
    p = frame.parameters
    if frame.instruction == 0x82:  # sync read
        return [(servo_id, 0x02, p[:4]) for servo_id in p[4:]]
    if frame.instruction == 0x83:  # sync write
        size = _words(p)[1]
        return [
            (p[i], 0x03, p[:2] + p[i + 1 : i + 1 + size]) for i in range(4, len(p) - size, size + 1)
        ]
    to = sorted(set(ids)) if frame.id == EVERYBODY else [frame.id]
    return [(servo_id, frame.instruction, p) for servo_id in to]


def _words(parameters: bytes) -> tuple[int, int]:
    """Address and size."""
    return int.from_bytes(parameters[:2], "little"), int.from_bytes(parameters[2:4], "little")


def _together(answers: Sequence[bytes]) -> bytes:
    """What a line carries where several drive it: a zero wins."""
    found = answers[0]
    for other in answers[1:]:
        found = bytes(a & b for a, b in zip(found, other, strict=False))
    return found
