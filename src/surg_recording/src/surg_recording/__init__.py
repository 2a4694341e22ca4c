"""Episode folders: writing, reading, metrics, figures and reports.

Everything but ``nodes`` runs without ROS. Start with ``episode.read`` for the data, ``metrics`` for
the numbers, ``reports.run_report.make`` for the page, ``datasets`` for training.
"""

__version__ = "0.1.0"
