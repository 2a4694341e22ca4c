"""A curved surgical needle: half a circle of wire, free in the scene.

Its frame N has its origin in the arc's centre and z along the arc's axis. The point of the arc at
angle a is (r cos a, r sin a, 0): 0 is the rear end, pi the point, and a positive turn about z
drives the needle point first.
"""

from __future__ import annotations

import mujoco
import numpy as np

from surg_sim.arrays import Array
from surg_sim.physics.spec_parts import add_part, add_wire
from surg_sim.tasks.needle_driving.needle_board import BOARD_BIT, NEEDLE_BIT

NEEDLE = "needle"
RADIUS, WIRE_RADIUS = 0.0115, 0.00035
"""Of the arc and of the wire [m]: a needle of 36 mm, as for fascia; assumed."""
MASS = 0.002
"""[kg]; assumed: 18 times a steel wire's, so that steps of 1 ms are stable in stiff contact."""
_PIECES = 18


def arc(angle: float) -> Array:
    """Point of the arc in N [m], (3,); beyond pi the arc goes on ahead of the point."""
    return RADIUS * np.array([np.cos(angle), np.sin(angle), 0.0])


def tangent(angle: float) -> Array:
    """Direction of the arc towards the point in N, unit vector (3,)."""
    return np.array([-np.sin(angle), np.cos(angle), 0.0])


def add_needle(spec: mujoco.MjSpec, p_W: Array) -> None:
    """Put a free needle into the scene, its centre at p_W (3,) [m]."""
    inertia = MASS * RADIUS**2
    about = [inertia / 2, inertia / 2, inertia]
    body = add_part(spec.worldbody, NEEDLE, MASS, about, pos=p_W.tolist())
    body.add_freejoint(name=NEEDLE)
    places = [arc(angle) for angle in np.linspace(0.0, np.pi, _PIECES + 1)]
    add_wire(
        body,
        places,
        WIRE_RADIUS,
        rgba=[0.86, 0.88, 0.92, 1],
        contype=NEEDLE_BIT,
        conaffinity=BOARD_BIT,
        condim=3,
        friction=[0.3, 0.001, 0.0001],
        solref=[0.003, 1.0],
        solimp=[0.9, 0.99, 0.0002, 0.5, 2.0],
    )
