"""Episode folders: writing, reading, metrics, figures and reports.

Everything here runs without ROS except ``recorder_node``, which nobody imports. Start with
``episode.read`` for the data, ``metrics`` for the numbers, ``report.make`` for the page.
"""

__version__ = "0.1.0"
