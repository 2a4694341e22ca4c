"""Other people's URDFs: the bundled arms with one or two small changes, drawn by a seed.

Each change is something that a vendor's or a colleague's file has. ``wanted`` is the verdict that
the platform decided on.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import yaml

from surg_cli.host import paths

DESCRIPTION = paths.ROOT / "src" / "surg_description"
LAST = {"ur5e": "wrist_3_joint", "panda": "joint7"}
"""A joint that may be continuous: the last one."""


@dataclass(frozen=True)
class Variant:
    """A robot's YAML with its changed URDF."""

    robot: Path
    bundled: str  # name of the bundled robot
    changes: tuple[str, ...]
    wanted: bool  # whether the arm is usable


@dataclass(frozen=True)
class Change:
    """One change of a URDF's text."""

    part: str  # of the file; a second change takes another part
    usable: bool  # the file still describes an arm
    make: Callable[[str, str], str]  # from text and name of the last joint
    encoding: str = "utf-8"
    links: tuple[str, str] = ("base_link", "flange")  # other names of base and flange


def _limits(pattern: str, replacement: str) -> Callable[[str, str], str]:
    """Change every <limit>."""
    return lambda text, _: re.sub(
        r"<limit[^>]*/>", lambda m: re.sub(pattern, replacement, m[0]), text
    )


def _inside(addition: str) -> Callable[[str, str], str]:
    """Add elements to the robot, beside its chain."""
    return lambda text, _: text.replace("</robot>", addition + "</robot>")


def _endless(limit: str) -> Callable[[str, str], str]:
    """Make the last joint continuous, with this limit."""

    def make(text: str, last: str) -> str:
        joint = re.search(rf'<joint name="{last}".*?</joint>', text, flags=re.S)
        assert joint
        changed = re.sub("<limit[^>]*/>", limit, joint[0]).replace('"revolute"', '"continuous"')
        return text.replace(joint[0], changed)

    return make


def _encoded(name: str) -> Callable[[str, str], str]:
    def make(text: str, _: str) -> str:
        body = text[text.index("?>") + 2 :] if text.startswith("<?xml") else text
        return f'<?xml version="1.0" encoding="{name}"?>\n<!-- Prüfstand -->{body}'

    return make


def _first(old: str, new: str) -> Callable[[str, str], str]:
    return lambda text, _: text.replace(old, new, 1)


def _beside(link: str, kind: str, more: str = "") -> Callable[[str, str], str]:
    """Hang a link on the base, beside the chain."""
    return _inside(
        f'<link name="{link}"/><joint name="to_{link}" type="{kind}"><parent link="base_link"/>'
        f'<child link="{link}"/>{more}</joint>'
    )


def standing(root: str, kind: str, origin: str) -> Callable[[str, str], str]:
    """Put a link above the base, and a camera's mast on it."""
    links = f'<link name="{root}"/><link name="mast"/>'
    below = f'<parent link="{root}"/><axis xyz="0 0 1"/>'
    stand = (
        f'<joint name="stands" type="{kind}">{below}<child link="base_link"/>{origin}'
        '<limit lower="-1" upper="1" velocity="1"/></joint>'
        f'<joint name="rises" type="fixed">{below}<child link="mast"/></joint>'
    )
    return _inside(links + stand)


def _colliding(text: str, _: str) -> str:
    """A ball about every link with a mass: neighbours of neighbours overlap."""
    ball = '<collision><geometry><sphere radius="0.3"/></geometry></collision>'
    return text.replace("</inertial>", f"</inertial>{ball}")


def _pictured(geometry: str) -> Callable[[str, str], str]:
    return _first("<visual>", f"<visual><geometry>{geometry}</geometry></visual><visual>")


def _sliding(text: str, last: str) -> str:
    return text.replace(f'"{last}" type="revolute"', f'"{last}" type="prismatic"')


FINGER = '<axis xyz="1 0 0"/><limit lower="0" upper="0.04" effort="1" velocity="0.1"/>'
UP, DOWN = '<origin xyz="0.2 -0.1 0.9" rpy="0 0 0.6"/>', '<origin xyz="0 0 2" rpy="3.14 0 0.5"/>'
OTHERS = (
    '<transmission name="t"><joint name="elbow"/></transmission>'
    '<gazebo reference="base_link"><material>Gazebo/Red</material></gazebo>'
)
CHANGES = {
    "efforts left out": Change("limit", True, _limits(r' effort="[^"]*"', "")),
    "endless last joint": Change("limit", True, _endless("")),
    "endless last joint with a speed": Change("limit", True, _endless('<limit velocity="4"/>')),
    "no range": Change("limit", False, _limits(r' (lower|upper)="[^"]*"', "")),
    "no speed": Change("limit", False, _limits(r' velocity="[^"]*"', "")),
    "no limits": Change("limit", False, lambda text, _: re.sub("<limit[^>]*/>", "", text)),
    "speed 0": Change("limit", False, _limits(r'velocity="[^"]*"', 'velocity="0"')),
    "slower than the YAML": Change("limit", False, _limits(r'velocity="[^"]*"', 'velocity="0.5"')),
    "narrower than the YAML": Change("limit", False, _limits(r'upper="[^"]*"', 'upper="0.1"')),
    "xacro left": Change("limit", False, _limits(r'velocity="[^"]*"', 'velocity="${2*pi}"')),
    "a number with a unit": Change("limit", False, _limits(r'effort="[^"]*"', 'effort="12 Nm"')),
    "a last joint that slides": Change("limit", False, _sliding),
    "Latin-1": Change("encoding", True, _encoded("ISO-8859-1"), "iso-8859-1"),
    "UTF-16": Change("encoding", True, _encoded("UTF-16"), "utf-16"),
    "byte order mark": Change("encoding", True, lambda text, _: text, "utf-8-sig"),
    "Windows' line ends": Change("encoding", True, lambda text, _: text.replace("\n", "\r\n")),
    "meshes": Change("visual", True, _pictured('<mesh filename="package://a b/c.dae"/>')),
    "a box without size": Change("visual", True, _pictured('<box size="0 0 0"/>')),
    "an unknown colour": Change(
        "visual", True, _first("<visual>", '<visual><material name="RAL 7035"/>')
    ),
    "no inertia": Change(
        "inertial", True, lambda text, _: re.sub("<inertial>.*?</inertial>", "", text, flags=re.S)
    ),
    "rods without thickness": Change(
        "inertial", True, lambda text, _: re.sub('izz="[^"]*"', 'izz="0"', text)
    ),
    "a mass of nothing": Change(
        "inertial", True, _first('<mass value="', '<mass value="1e-20" was="')
    ),
    "a negative mass": Change("inertial", False, _first('<mass value="', '<mass value="-')),
    "commas": Change("inertial", False, _first('rpy="0 0 0"', 'rpy="0, 0, 0"')),
    "a gripper beside the chain": Change("tree", True, _beside("finger", "prismatic", FINGER)),
    "an instrument's link name": Change("tree", True, _beside("tip", "fixed")),
    "a floating body": Change("tree", True, _beside("ball", "floating")),
    "other programs' elements": Change("tree", True, _inside(OTHERS)),
    "a pedestal": Change("root", True, standing("pedestal", "fixed", UP)),
    "a ceiling in the world": Change("root", True, standing("world", "fixed", DOWN)),
    "a cart's column": Change("root", True, standing("cart", "prismatic", UP)),
    "a turntable": Change("root", True, standing("table", "revolute", DOWN)),
    "a joint of no kind": Change("root", False, standing("cart", "welded", UP)),
    "shapes that overlap": Change("visual", True, _colliding),
    "the instrument's link names": Change(
        "root", True, lambda text, _: text, links=("mount", "tip")
    ),
    "the simulator's names": Change("root", True, lambda text, _: text, links=("world", "sleeve")),
    "options for MuJoCo": Change(
        "mujoco",
        True,
        _inside('<mujoco><compiler meshdir="a" other="1"/><size nuser="x"/></mujoco>'),
    ),
    "a tilted tool plate": Change("tree", True, _beside("tool0", "fixed", UP)),
    "no end": Change("tree", False, _first("</robot>", "")),
    "a second root": Change("tree", False, _inside('<link name="table"/>')),
    "a link twice": Change("tree", False, _inside('<link name="base_link"/>')),
    "a parent that is not there": Change(
        "tree", False, _first('<parent link="', '<parent link="no')
    ),
}


def draw(folder: Path, count: int, seed: int) -> list[Variant]:
    """Write that many variants, half of them of one change, half of two."""
    draws = random.Random(seed)
    names = draws.sample(sorted(CHANGES), len(CHANGES))
    variants = []
    for number in range(count):
        first = names[number % len(names)]
        changes = [first]
        if number % 2:
            others = [name for name in names if CHANGES[name].part != CHANGES[first].part]
            changes.append(draws.choice(others))
        variants.append(_write(folder, number, draws.choice(sorted(LAST)), changes))
    return variants


def _write(folder: Path, number: int, robot: str, names: list[str]) -> Variant:
    document = yaml.safe_load((DESCRIPTION / "robots" / f"{robot}.yaml").read_text("utf-8"))
    text = (DESCRIPTION / "robots" / document["urdf"]).resolve().read_text("utf-8")
    encoding = "utf-8"
    for name in names:
        text = CHANGES[name].make(text, LAST[robot])
        encoding = encoding if CHANGES[name].encoding == "utf-8" else CHANGES[name].encoding
    for name in names:
        for key, link in zip(("base_link", "flange_link"), CHANGES[name].links, strict=True):
            text = text.replace(f'"{document[key]}"', f'"{link}"')
            document[key] = link
    document["urdf"] = f"v{number}.urdf"
    (folder / document["urdf"]).write_bytes(text.encode(encoding))
    file = folder / f"v{number}.yaml"
    file.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    return Variant(file, robot, tuple(names), all(CHANGES[name].usable for name in names))


def write_cell(folder: Path, variant: Variant) -> Path:
    """A bundled cell with the variant as its robot."""
    bundled = paths.CELLS / f"sim_{variant.bundled}"
    cell = folder / "cell"
    (cell / "calibration").mkdir(parents=True)
    text = (bundled / "cell.yaml").read_text("utf-8").replace("../../src", str(paths.ROOT / "src"))
    text = re.sub(r"( robot:) \S+", rf"\1 {variant.robot}", text)
    (cell / "cell.yaml").write_text(text, encoding="utf-8")
    for file in (bundled / "calibration").iterdir():
        (cell / "calibration" / file.name).write_bytes(file.read_bytes())
    return cell
