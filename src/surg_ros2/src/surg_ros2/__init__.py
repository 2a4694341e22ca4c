"""The graph's topics and services for ROS 2, over DDS and without an installation of ROS 2.

Pure modules: ``cdr`` (bytes of ROS 1 to bytes of ROS 2 and back), ``bridged_topics`` (which topics,
and how they are offered), ``dds_port`` (DDS; the only user of ``cyclonedds``). Three kinds of
process: the gateway ``ros2_gateway_node`` (``outgoing_node``, ``incoming_node``), its child for
services ``ros2_services_node``, and a ``ros2_caller_node`` for each ROS 2 process with commands.
"""

__version__ = "0.1.0"
