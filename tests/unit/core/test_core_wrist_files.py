"""Instrument files with a wrist: what is wrong is refused by file, key and value."""

from pathlib import Path

import pytest

import surg_core
from surg_cli.host import paths
from surg_description.make_cell import make_cell

DESCRIBED = paths.ROOT / "src" / "surg_description"
YAML = (DESCRIBED / "instruments" / "wristed_grasper.yaml").read_text("utf-8")
URDF = (DESCRIBED / "urdf" / "wristed_grasper.urdf").read_text("utf-8")


def load(folder: Path, yaml: str, urdf: str = URDF) -> surg_core.InstrumentConfig:
    """The instrument of a cell that holds these files."""
    (folder / "tool.urdf").write_text(urdf, "utf-8")
    instrument = folder / "tool.yaml"
    instrument.write_text(yaml.replace("../urdf/wristed_grasper.urdf", "tool.urdf"), "utf-8")
    cell = make_cell(DESCRIBED / "robots" / "ur5e.yaml", folder / "cell", instrument)
    return surg_core.load_cell(cell.parent).arms["PSM1"].instrument


def test_the_bundled_wrist_is_read(tmp_path: Path) -> None:
    wrist = load(tmp_path, YAML).wrist
    assert wrist is not None
    assert (wrist.geometry.pitch_to_yaw, wrist.geometry.yaw_to_tip) == (0.0091, 0.0102)
    assert (list(wrist.max), wrist.rolls) == ([1.396, 1.396, 4.5], True)
    straight = surg_core.load_instrument(DESCRIBED / "instruments" / "grasper.yaml")
    assert straight.wrist is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("pitch_to_yaw: 0.0091", "pitch_to_yaw: -0.01", ["wrist.pitch_to_yaw", "-0.01", "0.03"]),
        ("yaw_to_tip: 0.0102", "yaw_to_tip: 0.3", ["wrist.yaw_to_tip", "0.3", "0.05"]),
        ("yaw_to_tip: 0.0102", "yaw_to_tip: 0.02", ["wrist.yaw_to_tip", "draws 0.0102", "equal"]),
        ("max: 1.396}  # rad; 80", "max: 1.57}  # rad; 80", ["wrist.pitch.max", "1.57", "1.5 rad"]),
        (
            "roll: {min: -4.5, max: 4.5}",
            "roll: {min: -4.5, max: 7}",
            ["wrist.roll.max", "6.28"],
        ),
        ("roll: {min: -4.5, max: 4.5}", "roll: {min: 0.0, max: 0.0}", ["wrist.roll.min", "below"]),
        ("roll: {min: -4.5, max: 4.5}", "roll: {max: 4.5}", ["wrist.roll.min"]),
        ("  roll: {min: -4.5, max: 4.5}", "", ["draws wrist_roll: state wrist.roll"]),
        ("velocity: 8.0", "velocity: .nan", ["wrist.velocity"]),
        ("drive_lag: 0.04", "drive_lag: 0.5", ["wrist.drive_lag", "0.5", "0.1 s"]),
        ("drive_lag: 0.04", "drive_lags: 0.04", ["wrist.drive_lag"]),
        ("\njaw:\n", "\npassive: true\njaw:\n", ["passive"]),
    ],
)
def test_a_wrong_wrist_is_refused_by_key(
    tmp_path: Path, old: str, new: str, words: list[str]
) -> None:
    assert old in YAML
    with pytest.raises(surg_core.ConfigError) as refused:
        load(tmp_path, YAML.replace(old, new))
    assert "tool.yaml" in str(refused.value)
    for word in words:
        assert word in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 1"/>', ["wrist_pitch (axis 0 1 0)"]),
        ('name="wrist_yaw" type="revolute"', 'name="wrist_yaw" type="fixed"', ["wrist_yaw"]),
        ('name="wrist_pitch"', 'name="pitch"', ["'pitch'", "must be fixed"]),
        (
            'name="wrist_roll" type="revolute"',
            'name="wrist_roll" type="fixed"',
            ["wrist_roll"],
        ),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 1 0"/>', ["wrist_roll (axis 0 0 1"]),
        ('<origin xyz="0 0 0.2807"', '<origin xyz="0.001 0 0.2807"', ["along the shaft"]),
    ],
)
def test_a_drawing_that_shows_another_wrist_is_refused(
    tmp_path: Path, old: str, new: str, words: list[str]
) -> None:
    assert old in URDF
    with pytest.raises((surg_core.ConfigError, ValueError)) as refused:
        load(tmp_path, YAML, URDF.replace(old, new))
    for word in words:
        assert word in str(refused.value)


def test_where_the_drive_rolls_its_limits_take_the_place_of_the_arms(tmp_path: Path) -> None:
    load(tmp_path, YAML)
    limits = surg_core.load_cell(tmp_path / "cell").arms["PSM1"].limits
    assert (limits.roll_velocity, limits.roll_acceleration, limits.roll_max) == (8.0, 120.0, 4.5)
    still = URDF.replace('name="wrist_roll" type="revolute"', 'name="wrist_roll" type="fixed"')
    load(tmp_path, YAML.replace("  roll: {min: -4.5, max: 4.5}", ""), still)
    assert surg_core.load_cell(tmp_path / "cell").arms["PSM1"].limits.roll_velocity == 2.0


def test_a_cell_tightens_the_roll_of_a_drive_and_never_loosens_it(tmp_path: Path) -> None:
    load(tmp_path, YAML)
    file = tmp_path / "cell" / "cell.yaml"
    bare = file.read_text("utf-8")

    def limited(limits: str) -> surg_core.Arm:
        assert "limits: {}" in bare
        file.write_text(bare.replace("limits: {}", f"limits: {limits}"), "utf-8")
        return surg_core.load_cell(tmp_path / "cell").arms["PSM1"]

    arm = limited("{roll_velocity: 3.0, roll_acceleration: 20.0, roll_max: 1.0}")
    wrist = arm.instrument.wrist
    assert wrist is not None
    assert (wrist.velocity, wrist.acceleration) == (3.0, 20.0) and arm.limits.roll_max == 1.0
    assert (wrist.min[2], wrist.max[2]) == (-1.0, 1.0) and list(wrist.max[:2]) == [1.396, 1.396]
    with pytest.raises(surg_core.ConfigError, match="would loosen"):
        limited("{roll_velocity: 9.0}")


def test_a_drawn_wrist_that_the_file_does_not_state_is_refused(tmp_path: Path) -> None:
    start, end = YAML.index("wrist:  "), YAML.index("jaw:\n")
    with pytest.raises(surg_core.ConfigError, match="wrist: none is stated"):
        load(tmp_path, YAML[:start] + YAML[end:])
