"""docs/results/ros2.md: what the tests of the gateway to ROS 2 measured."""

from __future__ import annotations

from helpers.results.results_page import ResultsPage

note = ResultsPage("ros2.md").note
