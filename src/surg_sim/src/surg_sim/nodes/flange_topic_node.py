"""The bridge's topic of a force sensor at the flange: ``<arm>/flange/measured_cf``."""

from __future__ import annotations

from geometry_msgs.msg import WrenchStamped

from surg_ros import link_messages
from surg_ros.byte_topics import BytesPublisher
from surg_sim.nodes import bridge_messages
from surg_sim.physics.world import World


class FlangeTopics:
    """Publishes the readings of every arm that has a sensor, in free-run."""

    def __init__(self, world: World) -> None:
        self._outputs = [
            (
                sensor,
                link_messages.text(f"{name}_force_sensor"),
                BytesPublisher(f"/{name}/flange/measured_cf", WrenchStamped, blocking=False),
            )
            for name, sensor in world.force_sensors.items()
        ]

    def publish(self, tick: int, stamp_ns: int) -> None:
        """The readings of the state that is there."""
        for sensor, frame, output in self._outputs:
            if output.connections:
                force, torque = sensor.reading[:3], sensor.reading[3:]
                output.send(bridge_messages.pack_wrench(stamp_ns, tick, frame, force, torque))
