"""A robot's URDF as MuJoCo can read it: without meshes, and with every link kept.

Vendors' files name meshes by ``package://`` and in formats that MuJoCo does not read. The physics
needs none of them, so they are left out; primitive shapes stay.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from xml.etree import ElementTree


def read_urdf(path: Path) -> str:
    """The text of a URDF for MuJoCo; a ``UserWarning`` states how many meshes are left out.

    Without meshes and with a ``<mujoco>`` element it is the file's own text. Else a missing
    ``<mujoco>`` element is added: MuJoCo would merge fixed links into their parents, and the
    flange would disappear.

    Raises:
        ValueError: The file is no URDF.
    """
    text = path.read_text("utf-8")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"{path}: no XML: {error}; a URDF is needed (no xacro)") from error
    left_out = without_meshes(root)
    own = root.find("mujoco") is not None
    if left_out:
        warnings.warn(
            f"{path}: {left_out} meshes are left out; links without a basic shape are invisible",
            stacklevel=2,
        )
    if own and not left_out:
        return text
    if not own:
        options = {"fusestatic": "false", "discardvisual": "false", "balanceinertia": "true"}
        ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", options)
    return ElementTree.tostring(root, encoding="unicode")


def without_meshes(root: ElementTree.Element) -> int:
    """Remove every visual and collision element with a mesh; returns how many."""
    removed = 0
    for link in root.iter("link"):
        for kind in ("visual", "collision"):
            for part in link.findall(kind):
                if part.find("geometry/mesh") is not None:
                    link.remove(part)
                    removed += 1
    return removed
