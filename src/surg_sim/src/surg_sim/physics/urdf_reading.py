"""A URDF as MuJoCo can simulate it, made from what the platform's one reader has accepted.

Vendors' files name meshes by ``package://`` and in formats that MuJoCo does not read, and they hold
joints, links and pictures that the platform does not drive. Physics needs the chain and its masses,
so the rest is left out or held still here. What the reader accepts, the simulator accepts.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from surg_core import load_urdf

Element = ElementTree.Element

SHAPES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
"""What MuJoCo draws of a URDF, and the attributes that must be above 0."""
OPTIONS = {"fusestatic": "false", "discardvisual": "false", "balanceinertia": "true"}
"""MuJoCo would merge fixed links into their parents, and the flange would disappear."""
MASS, INERTIA = 1.0, 0.01
"""[kg], [kg m^2] Of a link whose file states none; the drives' rotors weigh more."""
LEAST_MASS, LEAST_INERTIA = 1e-6, 1e-9
"""[kg], [kg m^2] Smaller ones are rounding, and MuJoCo refuses 0."""
HEAVY = ("inertial", "collision")
"""Elements of a link that give MuJoCo a mass."""


def read_urdf(path: Path, driven: Collection[str]) -> str:
    """The text of a URDF for MuJoCo.

    Args:
        path: The file.
        driven: Names of the joints that move; all others are held still.

    Raises:
        ConfigError: The file is no usable URDF.

    A ``UserWarning`` states what is left out or made up.
    """
    urdf = load_urdf(path)
    root = ElementTree.fromstring(urdf.text.encode("utf-8"))
    for joint in root.findall("joint"):
        if joint.get("name") not in driven:
            joint.set("type", "fixed")
        for dynamics in joint.findall("dynamics"):  # the drive's business
            joint.remove(dynamics)
    for theirs in root.findall("mujoco"):
        root.remove(theirs)
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", OPTIONS)
    left_out = without_pictures(root)
    if left_out:
        warnings.warn(
            f"{path}: {left_out} meshes are left out; links without a basic shape are invisible",
            stacklevel=2,
        )
    given = with_masses(root)
    if given:
        warnings.warn(
            f"{path}: links without a mass: {', '.join(given)}; the simulator takes {MASS:g} kg "
            "for each",
            stacklevel=2,
        )
    return ElementTree.tostring(root, encoding="unicode")


def without_pictures(root: Element) -> int:
    """Remove every visual and collision that is no basic shape of some size; returns how many.

    Materials that nobody defines and names of shapes go, too.
    """
    defined = {material.get("name") for material in root.iter("material") if len(material)}
    removed = 0
    for link in root.findall("link"):
        for kind in ("visual", "collision"):
            for part in link.findall(kind):
                if not _drawable(part):
                    link.remove(part)
                    removed += 1
                    continue
                part.attrib.pop("name", None)
                for material in part.findall("material"):
                    if material.get("name") not in defined:
                        part.remove(material)
    return removed


def with_masses(root: Element) -> list[str]:
    """Give a mass to every moving link that has none, nor anything fixed to it; returns which."""
    links = {link.get("name", ""): link for link in root.findall("link")}
    for each in links.values():
        _make_sound(each)
    joints = [(_link(j, "parent"), _link(j, "child"), j.get("type")) for j in root.findall("joint")]
    given = []
    for _, child, kind in joints:
        if kind == "fixed":
            continue
        group = [child]
        for link in group:
            group += [c for p, c, k in joints if p == link and k == "fixed"]
        if not any(links[name].findall(part) for name in group for part in HEAVY):
            _give_mass(links[child])
            given.append(child)
    return given


def _drawable(part: Element) -> bool:
    for shape in part.findall("geometry/*"):
        sizes = SHAPES.get(shape.tag)
        if sizes is not None:
            numbers = [float(n) for size in sizes for n in shape.get(size, "0").split()]
            return min(numbers) > 0.0
    return False


def _make_sound(link: Element) -> None:
    """Leave out a mass that is none, and give a mass without extent the least inertia."""
    for inertial in link.findall("inertial"):
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        assert mass is not None and inertia is not None  # the reader has seen them
        xx, yy, zz, xy, xz, yz = (
            float(inertia.get(key, "0")) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        )
        least = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])[0]
        if float(mass.get("value", "0")) < LEAST_MASS:
            link.remove(inertial)
        elif least < LEAST_INERTIA:
            for key, value in (("ixx", xx), ("iyy", yy), ("izz", zz)):
                inertia.set(key, str(value + LEAST_INERTIA - min(least, 0.0)))


def _give_mass(link: Element) -> None:
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "mass", {"value": str(MASS)})
    moments = dict.fromkeys(("ixx", "iyy", "izz"), str(INERTIA))
    ElementTree.SubElement(inertial, "inertia", moments | dict.fromkeys(("ixy", "ixz", "iyz"), "0"))


def _link(joint: Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")
