"""A gamepad: the sticks say how fast the tip moves, the triggers move the jaw."""

from surg_teleop.leaders.evdev.device_leader import InputLeader


class Gamepad(InputLeader):
    """Nothing moves unless the right shoulder button is held (``layouts/gamepad.yaml``)."""

    kind, mapping = "gamepad", "rate"
