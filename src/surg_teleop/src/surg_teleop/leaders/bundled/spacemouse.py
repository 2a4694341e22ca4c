"""A SpaceMouse: pushing and turning its cap says how fast the tip moves and rolls."""

from surg_teleop.leaders.evdev.device_leader import InputLeader


class SpaceMouse(InputLeader):
    """Nothing moves unless its left button is held (``layouts/spacemouse.yaml``)."""

    kind, mapping = "spacemouse", "rate"
