"""One servo XM430-W350: its control table, and a motor that lags and hits its stops."""

from __future__ import annotations

import math

MODEL = 1020
TURN = 4096
RAD = 2 * math.pi / TURN
"""[rad] of a step of the encoder."""
SPEED, AMPERE, VOLT = 0.229 * 2 * math.pi / 60, 2.69e-3, 0.1
"""[rad/s], [A], [V] of a step."""
STIFFNESS = 4.0
"""[A/rad] Current of the position loop."""
FRICTION = 0.03
"""[A] Below it nothing turns."""
FASTEST = 4.8
"""[rad/s] At 12 V without a load."""
SIZE = 147
"""Bytes of the control table; what lies behind is not emulated."""

ID, BAUD, DELAY, MODE = 7, 8, 9, 11
TORQUE, LEVEL, ERROR, WATCHDOG = 64, 68, 70, 98
VALUES = {
    "current_limit": (38, 2),
    "goal_current": (102, 2),
    "profile_velocity": (112, 4),
    "goal_position": (116, 4),
    "tick": (120, 2),
    "current": (126, 2),
    "velocity": (128, 4),
    "position": (132, 4),
    "voltage": (144, 2),
    "temperature": (146, 1),
}
"""Name -> address and size of what the motor reads or writes; all but the first two are signed."""
DEFAULTS = {
    6: 46,
    ID: 1,
    BAUD: 1,
    DELAY: 250,
    MODE: 3,
    13: 2,
    31: 80,
    32: 160,
    34: 95,
    36: 117,
    37: 3,
    38: 169,
    39: 4,
    44: 200,
    63: 52,
    LEVEL: 2,
    102: 169,
    103: 4,
    144: 120,
    146: 30,
}
"""Address -> first value; all others are 0."""
READ_ONLY = {*range(7), ERROR, *range(120, SIZE)}
BAUDS = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
"""By the number in the control table."""
BOOT = 0.25
"""[s] A restarted servo is silent."""
ACCESS, RANGE, LIMIT = 7, 4, 6
"""Errors of a status packet."""
OVERLOAD, OVERHEAT, UNDERVOLTAGE = 0x20, 0x04, 0x01
"""Bits of the hardware error."""


class Servo:
    """A servo and its motor.

    Args:
        servo_id: On the bus.
        baud: [bit/s].
        position: Of its encoder [rad].
        stops: Ends of its way, of the encoder [rad].
        lag: Of the motor behind its goal [s].
        model: Its number in the table.

    Attributes:
        stalled: Whether the motor is blocked.
        unplugged: Whether it has neither power nor line.
        load: Current that its load takes [A].
    """

    def __init__(
        self,
        servo_id: int,
        baud: int = BAUDS[3],
        position: float = 0.0,
        stops: tuple[float, float] = (-math.inf, math.inf),
        lag: float = 0.04,
        model: int = MODEL,
    ) -> None:
        self.table = bytearray(SIZE)
        for address, value in {**DEFAULTS, ID: servo_id, BAUD: BAUDS.index(baud)}.items():
            self.table[address] = value
        self.table[:2] = model.to_bytes(2, "little")
        self.position, self.velocity = position, 0.0
        self._stops, self._lag = stops, lag
        self._reference = position  # what the profile has reached
        self.silent_until = 0.0
        self.stalled = self.unplugged = False
        self.load = FRICTION
        self._heard = self._current = 0.0

    @property
    def id(self) -> int:
        """On the bus."""
        return self.table[ID]

    @property
    def baud(self) -> int:
        """[bit/s]."""
        return BAUDS[self.table[BAUD]]

    @property
    def alert(self) -> int:
        """The bit of a hardware error in a status packet."""
        return 0x80 if self.table[ERROR] else 0

    def hears(self, now: float, baud: int) -> bool:
        """Whether it takes instructions now [s] at this baud; it counts as heard."""
        if self.unplugged or now < self.silent_until or baud != self.baud:
            return False
        self._heard = now
        self.put("tick", int(1e3 * now) % 32768)
        self.put("current", round(self._current / AMPERE))
        self.put("velocity", round(self.velocity / SPEED))
        self.put("position", round(self.position / RAD))
        return True

    def fail(self, bit: int) -> None:
        """Its own protection switches the motor off."""
        self.table[ERROR] |= bit
        self.table[TORQUE] = 0

    def reboot(self, now: float) -> None:
        """Start again [s]."""
        self.table[ERROR] = self.table[TORQUE] = self.table[WATCHDOG] = 0
        self.silent_until = now + BOOT

    def write(self, address: int, data: bytes) -> int:
        """Write into the table; returns the error of the status packet, 0: none."""
        places = range(address, address + len(data))
        if not data or places[-1] >= SIZE:
            return RANGE
        if READ_ONLY.intersection(places) or (address < TORQUE and self.table[TORQUE]):
            return ACCESS
        if self.table[WATCHDOG] == 0xFF and set(range(100, 120)).intersection(places):
            return RANGE  # after the watchdog the goals are read-only
        if (ID in places and data[ID - address] > 252) or (
            BAUD in places and data[BAUD - address] >= len(BAUDS)
        ):
            return RANGE
        before = bytes(self.table)
        self.table[address : address + len(data)] = data
        limit = self.get("current_limit")
        if address < TORQUE:
            self.put("goal_current", limit)
        elif abs(self.get("goal_current")) > limit:
            self.table[:] = before
            return LIMIT
        if TORQUE in places and self.table[TORQUE]:
            if self.table[ERROR]:
                self.table[TORQUE] = 0  # until it is restarted
            self._reference = self.position
            if not before[TORQUE]:
                self.put("goal_position", round(self.position / RAD))
        return 0

    def step(self, now: float, dt: float) -> None:
        """Move for a time [s] that ends now."""
        self._watch(now)
        if self.unplugged or not self.table[TORQUE]:
            self.velocity = self._current = 0.0
        else:
            self._current = self._turn(dt)

    def _turn(self, dt: float) -> float:
        """Follow the profile behind a lag; returns the current [A]."""
        profile = self.get("profile_velocity") * SPEED or FASTEST
        goal = self.get("goal_position") * RAD
        step = min(profile, FASTEST) * dt
        self._reference += min(max(goal - self._reference, -step), step)
        off = self._reference - self.position
        bound = abs(self.get("goal_current")) * AMPERE
        wanted = min(max(STIFFNESS * off, -bound), bound)
        before = self.position
        low, high = self._stops
        if not self.stalled and bound > self.load:
            way = min(max(off / self._lag, -FASTEST), FASTEST) * dt
            self.position = min(max(before + way, low), high)
        self.velocity = (self.position - before) / dt
        blocked = self.stalled or self.position in (low, high) or bound <= self.load
        return wanted if blocked else math.copysign(min(abs(wanted), self.load), wanted)

    def _watch(self, now: float) -> None:
        """Stop and hold where no instruction has come for the watchdog's time."""
        limit = self.table[WATCHDOG]
        if self.table[TORQUE] and 0 < limit < 128 and now - self._heard > 0.02 * limit:
            self.table[WATCHDOG] = 0xFF
            self._reference = self.position
            self.put("goal_position", round(self.position / RAD))

    def get(self, name: str) -> int:
        """A value of `VALUES`."""
        address, size = VALUES[name]
        return int.from_bytes(self.table[address : address + size], "little", signed=size > 1)

    def put(self, name: str, value: int) -> None:
        """Set a value of `VALUES`."""
        address, size = VALUES[name]
        self.table[address : address + size] = value.to_bytes(size, "little", signed=size > 1)
