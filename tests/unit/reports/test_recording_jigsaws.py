"""The JIGSAWS reader on made-up files, and reference sets of every kind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from helpers.recording import jigsaws_synthetic as made_up
from surg_recording import metrics
from surg_recording.metrics import jigsaws, reference_sets
from surg_recording.recording_errors import ReferenceSetError

SKILLS = {"B001": "N", "C001": "I", "D001": "E", "E002": "E"}


def place(folder: Path, name: str) -> Path:
    return folder / "kinematics" / "AllGestures" / f"Knot_Tying_{name}.txt"


# --- the format ---------------------------------------------------------------------------------


def test_the_position_of_psm1_is_read(tmp_path: Path) -> None:
    values = np.arange(76.0) + 1000.0 * np.arange(jigsaws.SHORTEST)[:, None]
    made_up.write_trial(place(tmp_path, "B001"), values)
    (motion,) = jigsaws.read(tmp_path).motions
    # PSM1 is the left slave: columns 39 to 57, counted from one.
    assert motion.p[0].tolist() == [38.0, 39.0, 40.0]
    assert motion.p[3].tolist() == [3038.0, 3039.0, 3040.0]


def test_a_task_with_skills(tmp_path: Path) -> None:
    folder = made_up.write_task(tmp_path, SKILLS)
    for given in (folder, tmp_path):
        data = jigsaws.read(given)
        assert data.name == "JIGSAWS Knot Tying" and data.warnings == ()
        assert [t.name for t in data.motions] == [f"Knot_Tying_{name}" for name in SKILLS]
        assert [t.skill for t in data.motions] == [jigsaws.SKILLS[s] for s in SKILLS.values()]
    bare = jigsaws.read(folder / "kinematics" / "AllGestures")
    assert len(bare.motions) == 4
    samples = jigsaws.read_samples(place(folder, "B001"))
    slave_left = samples[:, 38:57]
    R, v = slave_left[:, 3:12].reshape(-1, 3, 3), slave_left[:, 12:15]
    assert np.allclose(R @ np.swapaxes(R, 1, 2), np.eye(3), atol=1e-5)
    assert np.allclose(np.gradient(bare.motions[0].p, 1 / jigsaws.FS, axis=0), v, atol=1e-4)


BROKEN = {
    "empty": ("", "empty"),
    "blank": ("\n \n", "empty"),
    "short": ("0 " * 76 + "\n", "1 samples, at least 60"),
    "cut": ("0 " * 76 + "\n" + "0 " * 70, "line 2: 70 numbers, 76 are needed"),
    "words": ("0 " * 75 + "x\n", "line 1: could not convert string to float: 'x'"),
    "nan": ("0 " * 76 + "\n" + "nan " * 76, "line 2: a number is not finite"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_file_is_left_out_and_named(what: str, tmp_path: Path) -> None:
    content, said = BROKEN[what]
    folder = made_up.write_task(tmp_path, SKILLS)
    place(folder, "C001").write_text(content)
    data = jigsaws.read(folder)
    assert [t.name[-4] for t in data.motions] == ["B", "D", "E"]
    (warning,) = data.warnings
    assert str(place(folder, "C001")) in warning and said in warning


def test_a_file_that_is_no_text_is_left_out(tmp_path: Path) -> None:
    folder = made_up.write_task(tmp_path, SKILLS)
    place(folder, "C001").write_bytes(b"\xff\xfe\x00")
    assert "not a text file" in jigsaws.read(folder).warnings[0]


def test_a_meta_file_that_is_missing_or_strange_costs_the_skills_only(tmp_path: Path) -> None:
    folder = made_up.write_task(tmp_path, SKILLS)
    meta = folder / "meta_file_Knot_Tying.txt"
    meta.write_text(meta.read_text().replace("\tI\t", "\tX\t") + "Knot_Tying_Z001\n")
    data = jigsaws.read(folder)
    assert [t.skill for t in data.motions] == ["novice", None, "expert", "expert"]
    assert len(data.warnings) == 2 and "line 2" in data.warnings[0]
    meta.unlink()
    data = jigsaws.read(folder)
    assert len(data.motions) == 4 and not any(t.skill for t in data.motions)
    assert "not found" in data.warnings[0]


def test_folders_that_are_no_task(tmp_path: Path) -> None:
    with pytest.raises(ReferenceSetError, match="no such folder"):
        jigsaws.read(tmp_path / "nowhere")
    with pytest.raises(ReferenceSetError, match="no JIGSAWS trial"):
        jigsaws.read(tmp_path)
    made_up.write_task(tmp_path, SKILLS)
    made_up.write_task(tmp_path, SKILLS, "Suturing")
    with pytest.raises(ReferenceSetError, match=r"several tasks \(Knot_Tying, Suturing\)"):
        jigsaws.read(tmp_path)
    for name in SKILLS:
        place(tmp_path / "Knot_Tying", name).write_text("")
    with pytest.raises(ReferenceSetError, match=r"no trial can be read.*empty"):
        jigsaws.read(tmp_path / "Knot_Tying")


# --- as a reference -----------------------------------------------------------------------------


def test_a_reference_is_measured_as_the_episodes_are(tmp_path: Path) -> None:
    folder = made_up.write_task(tmp_path, SKILLS)
    found = reference_sets.load(f"jigsaws:{folder}")
    assert found.name == "JIGSAWS Knot Tying"
    measured = [reference_sets.measure(motion) for motion in found.motions]
    for preset in metrics.PRESETS:
        compared = reference_sets.summarise(found, measured, preset)
        values = [metrics.smoothness(t.p, 30.0, preset) for t in jigsaws.read(folder).motions]
        assert compared["trials"] == 4
        for name in ("sparc", "ldlj"):
            numbers = [getattr(value, name) for value in values]
            assert compared[name]["median"] == pytest.approx(np.median(numbers))
            quartiles = np.percentile(numbers, (25, 75))
            assert compared[name]["iqr"] == pytest.approx(quartiles[1] - quartiles[0])
        assert {k: v["trials"] for k, v in compared["by_skill"].items()} == {
            "novice": 1, "intermediate": 1, "expert": 2,
        }  # fmt: skip
    assert measured[0]["duration_s"] == pytest.approx(12.0 - 1 / 30)


def test_a_motion_file_as_reference(tmp_path: Path) -> None:
    t = np.arange(0, 10, 1 / 30)
    p = 0.02 * np.stack([np.sin(t), np.cos(2 * t), 0 * t], axis=1)
    lines = ["t_s,gripper,x_m,y_m,z_m"]
    lines += [f"{a:.6f},0,{x:.6f},{y:.6f},{z:.6f}" for a, (x, y, z) in zip(t, p, strict=True)]
    file = tmp_path / "knot.csv"
    file.write_text("\n".join(lines))
    (tmp_path / "broken.csv").write_text("a,b\n1,2\n")
    alone, folder = reference_sets.load(f"motion:{file}"), reference_sets.load(f"motion:{tmp_path}")
    assert alone.name == "knot" and alone.warnings == ()
    assert len(folder.motions) == 1 and "t_s, x_m, y_m, z_m" in folder.warnings[0]
    assert np.allclose(alone.motions[0].p, p, atol=1e-4)
    assert alone.motions[0].fs == pytest.approx(30.0, rel=1e-4)
    numbers = reference_sets.measure(alone.motions[0])
    assert numbers["smoothness"]["presets"]["reference"]["sparc"] < 0
    assert numbers["idle"]["s"] == 0.0


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("", "is empty"),
        ("t_s,x_m,y_m\n0,0,0", "no column z_m"),
        ("t_s,x_m,y_m,z_m\n0,0,0,0\n0.03,0,zero,0", ":3: y_m: 'zero'"),
        ("t_s,x_m,y_m,z_m\n0,0,0,0\n0.03,0,inf,0", ":3: y_m: 'inf' is not a finite number"),
        ("t_s,x_m,y_m,z_m\n0,0,0,0\n0.03,0,0,0\n0.03,0,0,0", ":4: t_s does not increase"),
        ("t_s,x_m,y_m,z_m\n0,0,0,0\n0.1,0,0,0\n0.9,0,0,0", ":4: 0.2 s without"),
        ("t_s,x_m,y_m,z_m\n0,0,0,0\n0.1,0,0,0", "lasts 0.10 s"),
        ("t_s,x_m,y_m,z_m\n", "lasts 0.00 s"),
    ],
)
def test_a_broken_motion_says_where(rows: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    file.write_text(rows)
    with pytest.raises(ReferenceSetError) as caught:
        reference_sets.load(f"motion:{file}")
    assert str(file) in str(caught.value) and said in str(caught.value)


@pytest.mark.parametrize("spec", ["", "jigsaws", "jigsaws:", "Knot_Tying", "dvrk:here"])
def test_an_unknown_kind_lists_the_known_ones(spec: str) -> None:
    with pytest.raises(ReferenceSetError, match=r"jigsaws:DIR or motion:CSV_OR_DIR is needed"):
        reference_sets.load(spec)
