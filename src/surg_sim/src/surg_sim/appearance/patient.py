"""What the patient looks like: bed, bowel, abdominal wall with its ports, body under the drape.

Everything in patient axes about the work point (``patient_site``); the body's frame lies
``BED_DEPTH`` below it. Only the wall's height is of use elsewhere: a port must lie in it.
"""

from __future__ import annotations

import mujoco
import numpy as np

from surg_sim.appearance import anatomy
from surg_sim.appearance.drawing import OUTSIDE, add_mesh, add_seen
from surg_sim.appearance.room import BED_DEPTH, table_of
from surg_sim.arrays import Array
from surg_sim.physics.patient_site import Site
from surg_sim.physics.spec_parts import quaternion

_LOOPS = {
    "near": (0.0125, [(-0.17, 0.036, 0.010), (-0.090, 0.040, 0.011), (-0.052, 0.008, 0.010),
                      (-0.046, -0.038, 0.010), (-0.006, -0.062, 0.011), (0.034, -0.042, 0.011),
                      (0.040, 0.000, 0.012), (0.072, 0.034, 0.011), (0.17, 0.030, 0.010)]),
    "first": (0.0155, [(-0.18, 0.070, 0.014), (-0.08, 0.066, 0.015), (0.0, 0.074, 0.014),
                       (0.085, 0.064, 0.015), (0.18, 0.074, 0.014)]),
    "second": (0.0185, [(-0.18, 0.100, 0.026), (-0.07, 0.106, 0.031), (0.02, 0.100, 0.030),
                        (0.09, 0.108, 0.031), (0.18, 0.100, 0.026)]),
    "third": (0.0215, [(-0.18, 0.135, 0.048), (-0.06, 0.130, 0.058), (0.03, 0.137, 0.060),
                       (0.1, 0.130, 0.056), (0.18, 0.136, 0.048)]),
}  # fmt: skip
"""Pieces of bowel in patient axes about the bed below the work point: radius [m], knots [m]."""


_AT_WORK = ("bowel_0", "boards")
"""Bodies of tasks that lie where the near piece would: living bowel, a training board."""


def wall_height(site: Site, x: float, y: float) -> float:
    """Height of the abdominal wall above the work point at a place in patient axes [m]."""
    dome, middle = _dome(site)
    radius = min((x / dome.half_length) ** 2 + ((y - middle) / dome.half_width) ** 2, 1.0)
    return float(dome.height * np.sqrt(1.0 - radius)) - BED_DEPTH


def _dome(site: Site) -> tuple[anatomy.Dome, float]:
    """The wall over the bed, through the ports, and the y of its middle [m].

    One port fixes its height; with a second one it is moved along the patient until it holds both.
    """
    room = -table_of(site).near - 0.012
    ports = np.array([site.local(port) for port in site.ports[:2]])
    ports[:, 2] += BED_DEPTH
    two = len(ports) == 2
    half_length, half_width = min(0.190 if two else 0.180, room), 0.270 if two else 0.225

    def height(port: Array, middle: float) -> float:
        across = (port[0] / half_length) ** 2 + ((port[1] - middle) / half_width) ** 2
        return float(port[2] / np.sqrt(1.0 - min(across, 0.8)))

    places = np.linspace(-0.12, 0.12, 241) if two else np.zeros(1)
    misfit = [abs(height(ports[0], y) - height(ports[-1], y)) for y in places]
    middle = float(places[int(np.argmin(misfit))])
    return anatomy.Dome(
        half_length=half_length,
        half_width=half_width,
        height=height(ports[0], middle),
        window=np.radians(50.0),
        window_top=np.radians(60.0 if two else 50.0),
        towards=np.radians(-62.0 if two else -90.0),  # to the spectator
    ), middle


def add_patient(spec: mujoco.MjSpec, site: Site, rng: np.random.Generator) -> None:
    """Tissue bed, bowel, abdominal wall and the body under its drape."""
    (dome, middle), table = _dome(site), table_of(site)
    patient = spec.worldbody.add_body(
        name="patient",
        pos=site.place([0, middle, -BED_DEPTH]).tolist(),
        quat=quaternion(site.R).tolist(),
    )

    def bed(x: Array, y: Array) -> Array:
        y = y + middle
        hills = 0.0035 * np.sin(41 * x + 1.0) * np.cos(37 * y) + 0.0025 * np.sin(83 * x - 61 * y)
        return hills + 0.05 * np.clip((y - 0.05) / 0.15, 0, 1) ** 1.5

    # What is in front is drawn first, so that what it hides costs nothing.
    for name, (radius, knots) in _LOOPS.items():
        if name == "near" and any(spec.body(thing) is not None for thing in _AT_WORK):
            continue
        share = 0.94 - 1.15 * radius / dome.half_length
        course = anatomy.smooth_curve(np.array(knots), 50) - [0.0, middle, 0.0]
        loop = anatomy.bowel_loop(dome.inside(course, share), radius, rng)
        add_mesh(spec, patient, f"loop_{name}", loop, "bowel")

    edge = 0.97
    fat = anatomy.disc(bed, edge * dome.half_length, edge * dome.half_width, 0.13)
    add_mesh(spec, patient, "bed", fat, "fat")
    add_mesh(spec, patient, "wall_outside", dome.wall(), "skin", OUTSIDE)
    add_mesh(spec, patient, "wall_inside", dome.wall(60, 20).flipped(), "peritoneum")
    add_mesh(spec, patient, "wall_rim", dome.rim(0.0055), "skin", OUTSIDE)

    def drape(x: Array, y: Array) -> Array:
        r = np.hypot(x / dome.half_length, y / dome.half_width)
        angle = np.arctan2(y, x)
        crease = 0.004 * np.sin(11 * angle + 2.5 * np.sin(2 * angle)) * np.clip(3 * (r - 1), 0, 1)
        skirt = _TORSO * _smooth((1.85 - r) / 0.85)
        up = y + middle
        over = np.maximum(np.maximum(table.near - x, x - table.far), table.foot - up)
        hang = 0.18 * np.clip(over / 0.025, 0, 1)
        within = 0.09 * np.clip(4 * (1.0 - r), 0, 1)
        lying = np.maximum(skirt, _body(x, up)) + crease
        screen = _smooth((up - _SCREEN_AT) / 0.02)  # before the patient's head
        return lying + screen * (_SCREEN - lying) - _TORSO - hang - within

    x = np.linspace(table.near - 0.03, table.far + 0.03, 121)
    y = np.concatenate(
        [
            np.linspace(table.foot - 0.03, _SCREEN_AT - 0.01, 190),
            np.linspace(_SCREEN_AT, _SCREEN_AT + 0.02, 9),
        ]
    )
    add_mesh(spec, patient, "drape", anatomy.surface(drape, x, y - middle, 0.3), "cloth", OUTSIDE)


_TORSO = 0.072  # [m] from the drape on the table to where the inflated wall begins
_SCREEN, _SCREEN_AT = 0.30, 0.42  # [m] the drape before the patient's head: height, place


def _smooth(share: Array) -> Array:
    """0 to 1 over a share of 0 to 1, flat at both ends."""
    t = np.clip(share, 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def _body(x: Array, y: Array) -> Array:
    """Height of trunk and legs under the drape, above the table's drape [m]."""

    def hump(x: Array, half: float) -> Array:
        return np.asarray(np.clip(1 - np.abs(x / half) ** 2.4, 0, 1) ** 0.6)

    trunk = (_TORSO + 0.035 * _smooth((y - 0.17) / 0.16)) * hump(x, 0.205)
    leg = 0.088 - 0.035 * _smooth((-0.55 - y) / 0.4)
    legs = leg * (hump(x - 0.100, 0.088) + hump(x + 0.100, 0.088))
    hip = _smooth((y + 0.47) / 0.16)
    return np.asarray(hip * trunk + (1 - hip) * legs)


def draw_cannula(sleeve: mujoco.MjsBody, axis: Array, bore: float = 0.0045) -> None:
    """Draw a cannula on a body whose origin is the trocar point.

    Unit vector into the patient in the body's axes, (3,); outer radius of the tube [m].
    """

    def ring(start: float, end: float, radius: float, material: str) -> None:
        add_seen(
            sleeve,
            mujoco.mjtGeom.mjGEOM_CYLINDER,
            material,
            fromto=[*(start * axis), *(end * axis)],
            size=[radius, 0, 0],
        )

    ring(-0.030, 0.022, bore, "cannula")
    ring(-0.046, -0.028, bore + 0.005, "seal")
    ring(-0.050, -0.046, bore + 0.006, "cannula")
    ring(-0.003, 0.003, bore + 0.004, "hole")
