"""The graph's topics for ROS 2, over DDS and without an installation of ROS 2.

Pure modules: ``cdr`` (bytes of ROS 1 to bytes of ROS 2 and back), ``bridged_topics`` (which topics,
and how they are offered), ``dds_port`` (DDS; the only user of ``cyclonedds``). Nodes:
``ros2_gateway_node``, and ``ros2_caller_node``, one for each ROS 2 process that sends commands.
"""

__version__ = "0.1.0"
