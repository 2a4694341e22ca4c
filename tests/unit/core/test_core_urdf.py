"""The URDF reader: folding of fixed joints, and every way a URDF can be wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from surg_core import ConfigError, chain_from_urdf, fixed_transform
from surg_core.transforms import axis_angle_to_matrix, make_pose

JOINTS = """
  <joint name="stand" type="fixed">
    <parent link="world"/><child link="base"/>
    <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/>
  </joint>
  <joint name="one" type="revolute">
    <parent link="base"/><child link="arm"/>
    <origin xyz="0.1 0 0.2" rpy="0.3 0 0"/><axis xyz="0 0 2"/>
    <limit lower="-3" upper="3" velocity="2"/>
  </joint>
  <joint name="bracket" type="fixed">
    <parent link="arm"/><child link="bracket"/><origin xyz="0 0.05 0" rpy="0 0.7 0"/>
  </joint>
  <joint name="two" type="continuous"><parent link="bracket"/><child link="wrist"/></joint>
  <joint name="plate" type="fixed">
    <parent link="wrist"/><child link="flange"/><origin xyz="0 0 0.1"/>
  </joint>
  <joint name="camera" type="fixed"><parent link="wrist"/><child link="camera"/></joint>
"""
LINKS = "".join(
    f'<link name="{name}"/>'
    for name in ("world", "base", "arm", "bracket", "wrist", "flange", "camera")
)


def _write(folder: Path, body: str = LINKS + JOINTS, tag: str = "robot") -> Path:
    path = folder / "arm.urdf"
    path.write_text(f'<?xml version="1.0"?><{tag} name="arm">{body}</{tag}>', encoding="utf-8")
    return path


def test_chain_folds_fixed_joints_into_the_turning_ones(tmp_path: Path) -> None:
    chain = chain_from_urdf(_write(tmp_path), "base", "flange", ["one", "two"])
    q = np.array([0.4, -0.9])
    X = (
        make_pose([0.1, 0, 0.2], [0.3, 0, 0])
        @ make_pose(rotation=axis_angle_to_matrix([0, 0, 1], q[0]))
        @ make_pose([0, 0.05, 0], [0, 0.7, 0])
        @ make_pose(rotation=axis_angle_to_matrix([1, 0, 0], q[1]))  # URDF's default axis
        @ make_pose([0, 0, 0.1])
    )
    np.testing.assert_allclose(chain.forward(q), X, atol=1e-14)
    assert [joint.name for joint in chain.joints] == ["one", "two"]


def test_fixed_transform_multiplies_the_fixed_joints(tmp_path: Path) -> None:
    path = _write(tmp_path)
    np.testing.assert_allclose(
        fixed_transform(path, "world", "base"), make_pose([0, 0, 1], [0, 0, np.pi / 2]), atol=1e-15
    )
    np.testing.assert_array_equal(fixed_transform(path, "base", "base"), np.eye(4))
    with pytest.raises(ConfigError, match=r"'one'.*revolute.*must be fixed"):
        fixed_transform(path, "world", "arm")


@pytest.mark.parametrize(
    ("change", "base", "flange", "names", "message"),
    [
        (("", ""), "nowhere", "flange", ["one", "two"], "no link 'nowhere'; it has world, base"),
        (("", ""), "flange", "base", ["one", "two"], "'base' does not hang below link 'flange'"),
        (("", ""), "camera", "flange", [], "does not hang below"),
        (("", ""), "base", "flange", ["two", "one"], "one, two; .* says two, one"),
        (("", ""), "base", "flange", ["one"], "one, two; .* says one"),
        (('type="continuous"', 'type="prismatic"'), "base", "flange", ["one", "two"], "prismatic"),
        (('"0 0 2"', '"0 0 0"'), "base", "flange", ["one", "two"], "'one'.*axis.*zero"),
        (('"0 0 2"', '"0 nan 2"'), "base", "flange", ["one", "two"], "'one'.*0 nan 2"),
        (('"0.1 0 0.2"', '"0.1 0"'), "base", "flange", ["one", "two"], "'one'.*three finite"),
        (('"0.1 0 0.2"', '"a b c"'), "base", "flange", ["one", "two"], "'one'.*three finite"),
        (
            ('<parent link="arm"/>', ""),
            "base",
            "flange",
            ["one", "two"],
            "'bracket' has no <parent",
        ),
        (('<child link="camera"/>', '<child link="arm"/>'), "base", "flange", [], "two joints"),
        (('<parent link="base"/>', '<parent link="flange"/>'), "base", "flange", [], "hang below"),
    ],
)
def test_what_is_wrong_is_said(
    tmp_path: Path,
    change: tuple[str, str],
    base: str,
    flange: str,
    names: list[str],
    message: str,
) -> None:
    path = _write(tmp_path, LINKS + JOINTS.replace(*change))
    with pytest.raises(ConfigError, match=message) as error:
        chain_from_urdf(path, base, flange, names)
    assert str(path) in str(error.value)


def test_files_that_are_no_urdf(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        chain_from_urdf(tmp_path / "none.urdf", "a", "b", [])
    with pytest.raises(ConfigError, match="root element is <sdf>"):
        chain_from_urdf(_write(tmp_path, tag="sdf"), "a", "b", [])
    broken = tmp_path / "broken.urdf"
    broken.write_text("<robot>\n<link\n</robot>", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"broken\.urdf:3: not well-formed"):
        chain_from_urdf(broken, "a", "b", [])


def test_too_many_joints_are_refused(tmp_path: Path) -> None:
    links = "".join(f'<link name="l{i}"/>' for i in range(10))
    joints = "".join(
        f'<joint name="j{i}" type="continuous">'
        f'<parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        for i in range(9)
    )
    with pytest.raises(ConfigError, match="1 to 8 joints, not 9"):
        chain_from_urdf(_write(tmp_path, links + joints), "l0", "l9", [f"j{i}" for i in range(9)])
