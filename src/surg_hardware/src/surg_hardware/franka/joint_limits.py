"""Joint limits that Franka publishes, for the interfaces that take joint velocities.

Source: Franka Control Interface documentation, robot specifications.
"""

from __future__ import annotations

from surg_hardware.shaper import JointLimits

PANDA = tuple(
    JointLimits(*each)
    for each in (
        (2.1750, 15.0, 7500.0, -2.8973, 2.8973),
        (2.1750, 7.5, 3750.0, -1.7628, 1.7628),
        (2.1750, 10.0, 5000.0, -2.8973, 2.8973),
        (2.1750, 12.5, 6250.0, -3.0718, -0.0698),
        (2.6100, 15.0, 7500.0, -2.8973, 2.8973),
        (2.6100, 20.0, 10000.0, -0.0175, 3.7525),
        (2.6100, 20.0, 10000.0, -2.8973, 2.8973),
    )
)
FR3 = tuple(
    JointLimits(velocity, 10.0, 5000.0, *posture)
    for velocity, *posture in (
        (2.62, -2.750100, 2.75010, 0.30, 12.00),
        (2.62, -1.791800, 1.79180, 0.20, 5.17),
        (2.62, -2.906500, 2.90650, 0.20, 7.00),
        (2.62, -3.048100, -0.1458, 0.30, 8.00),
        (5.26, -2.810100, 2.81010, 0.35, 34.00),
        (4.18, 0.540920, 4.52050, 0.35, 11.00),
        (5.26, -3.019600, 3.01960, 0.35, 34.00),
    )
)
"""Each joint: velocity far from the ends, the ends of the formula, its offset and its slope."""
