"""Drawn looks: within their ranges, repeatable, only seen; the camera moves as geometry says."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from surg_core import ConfigError
from surg_sim.appearance.domain_randomization import TISSUES, Appearance, DomainRandomization
from surg_sim.appearance.endoscope_renderer import EndoscopeRenderer
from surg_sim.appearance.opengl import NoOpenGL
from surg_sim.appearance.scene_appearance import Finish
from surg_sim.arrays import Picture

pytest.importorskip("gymnasium", reason="gymnasium is not installed: ./surg dev setup")

from surg_sim.envs.surg_env import SurgEnv

WIDE = DomainRandomization()
PLAIN = DomainRandomization.none().draw(0)
SIZE = (320, 240)


@pytest.fixture(scope="module")
def env() -> Iterator[SurgEnv]:
    """Bowel with both eyes and the wide looks."""
    made = SurgEnv(images=("left", "right"), width=SIZE[0], height=SIZE[1], randomization=WIDE)
    try:
        made.reset(seed=0)
    except NoOpenGL as error:
        pytest.skip(str(error))
    yield made
    made.close()


@pytest.fixture(scope="module")
def eyes(env: SurgEnv) -> EndoscopeRenderer:
    """The renderer of the environment."""
    return env._renderers[("left", "right")]  # type: ignore[no-any-return]


def seen(eyes: EndoscopeRenderer, env: SurgEnv, look: Appearance | None) -> Picture:
    eyes.set_appearance(look)
    return eyes.render(env._qpos)["left"]


def content(observation: dict[str, Any]) -> str:
    pictures = observation["images"]
    return hashlib.sha256(
        b"".join(pictures[view].tobytes() for view in sorted(pictures))
    ).hexdigest()


def numbers(look: Appearance) -> dict[str, list[float]]:
    """What each range of ``DomainRandomization`` has drawn."""
    return {
        "light_strength": [look.light_strength],
        "light_warmth": [look.light_warmth],
        "light_tilt_deg": [float(np.linalg.norm(look.light_tilt_deg))],
        "exposure": [look.exposure],
        "blur_px": [look.blur_px],
        "edge": [look.edge],
        "camera_shift_mm": [float(np.linalg.norm(look.camera_shift_mm))],
        "camera_turn_deg": [float(np.linalg.norm(look.camera_turn_deg))],
        "tissue_colour": [c for each in look.tissues for c in each.colour],
        "tissue_contrast": [each.contrast for each in look.tissues],
        "tissue_gloss": [each.gloss for each in look.tissues],
        "tissue_shift": [s for each in look.tissues for s in each.shift],
    }


# --- what is drawn ------------------------------------------------------------------------------


def test_two_hundred_seeds_fill_their_ranges_and_stay_inside() -> None:
    drawn = [numbers(WIDE.draw(seed)) for seed in range(200)]
    assert set(drawn[0]) == {f.name for f in fields(DomainRandomization)}
    for name in drawn[0]:
        low, high = getattr(WIDE, name)
        values = np.concatenate([each[name] for each in drawn])
        assert values.min() >= low - 1e-12 and values.max() <= high + 1e-12, name
        # 200 even draws leave 5 % of a range empty at an end once in 29,000 times.
        margin = 0.05 * (high - low)
        assert values.min() < low + margin and values.max() > high - margin, name
    around = np.array([WIDE.draw(seed).camera_shift_mm for seed in range(200)])
    assert (np.abs(np.mean(np.sign(around), axis=0)) < 0.3).all(), "no direction is preferred"


def test_a_range_without_width_leaves_the_other_draws_alone() -> None:
    fixed = replace(WIDE, light_strength=(1.0, 1.0), tissue_gloss=(1.0, 1.0))
    a, b = WIDE.draw(7), fixed.draw(7)
    assert b.light_strength == 1.0 and {each.gloss for each in b.tissues} == {1.0}
    tissues = tuple(replace(each, gloss=1.0) for each in a.tissues)
    assert replace(a, light_strength=1.0, tissues=tissues) == b
    assert WIDE.draw(7) == a != WIDE.draw(8)
    json.dumps(a.described(), allow_nan=False)
    assert list(a.described()["tissues"]) == list(TISSUES)


def test_a_file_of_ranges(tmp_path: Path) -> None:
    file = tmp_path / "looks.yaml"
    file.write_text("format: surg_looks/1\nlight_strength: [0.5, 2.0]\ncamera_turn_deg: [0, 5]\n")
    found = DomainRandomization.read(file)
    expected = replace(
        DomainRandomization.none(), light_strength=(0.5, 2.0), camera_turn_deg=(0.0, 5.0)
    )
    assert found == expected
    for line, reason in (
        ("light_strength: [2.0, 0.5]", "within 0 to 4"),
        ("light_strength: [0.5, 9.0]", "-4 to 4"),
        ("edge: [-0.5, 0.5]", "within 0 to 1"),
        ("exposure: 1.0", "2 numbers"),
        ("colour: [0, 1]", "not a known key"),
    ):
        file.write_text(f"format: surg_looks/1\n{line}\n")
        with pytest.raises(ConfigError, match=reason) as error:
            DomainRandomization.read(file)
        assert f"{file}:2: {line.split(':')[0]}" in str(error.value)
    with pytest.raises(ValueError, match="blur_px: 0 to 99; allowed"):
        replace(WIDE, blur_px=(0.0, 99.0))
    with pytest.raises(ValueError, match="randomization needs pictures"):
        SurgEnv("pick_and_place", randomization=WIDE)


# --- what is seen -------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_pictures_whatever_was_worn_before(env: SurgEnv) -> None:
    found: dict[int, set[str]] = {3: set(), 4: set()}
    for seed in (3, 4, 3, 4):
        observation, info = env.reset(seed=seed)
        assert info["look"] == WIDE.draw(seed).described()
        found[seed].add(content(observation))
    assert len(found[3]) == len(found[4]) == 1 and found[3] != found[4]


def test_off_is_bit_for_bit_the_scene_as_built(env: SurgEnv, eyes: EndoscopeRenderer) -> None:
    """A fresh renderer that never wore anything is the judge."""
    env.reset(seed=3)
    worn = seen(eyes, env, WIDE.draw(3))
    never = EndoscopeRenderer(env.session.world, ("left", "right"), *SIZE)
    plain = never.render(env._qpos)
    for look in (None, PLAIN):
        eyes.set_appearance(look)
        for view, picture in eyes.render(env._qpos).items():
            np.testing.assert_array_equal(picture, plain[view])
    never.close()
    assert np.abs(worn.astype(int) - plain["left"]).mean() > 3.0


def test_physics_truth_and_model_do_not_know_of_looks(env: SurgEnv) -> None:
    """The same episode without pictures: same states, phases and ground truth in every step."""
    other = SurgEnv()
    model = env.session.world.model
    parts = ("cam_pos", "cam_quat", "light_pos", "light_dir", "light_diffuse", "tex_data")
    before = {part: np.array(getattr(model, part)) for part in parts}
    a, b = env.reset(seed=5)[0], other.reset(seed=5)[0]
    for _ in range(60):
        for key, value in b["privileged"].items():
            np.testing.assert_array_equal(a["privileged"][key], value)
        np.testing.assert_array_equal(a["state"], b["state"])
        a, *_ = env.step(env.expert_action())
        b, *_ = other.step(other.expert_action())
    assert env.session.hash == other.session.hash
    for part, value in before.items():
        np.testing.assert_array_equal(getattr(model, part), value)


def test_more_light_is_brighter(env: SurgEnv, eyes: EndoscopeRenderer) -> None:
    means = [
        seen(eyes, env, replace(PLAIN, light_strength=strength)).mean()
        for strength in (0.0, 0.3, 0.6, 0.9, 1.2, 1.5)
    ]
    assert (np.diff(means) > 1.0).all(), means
    cold, warm = (seen(eyes, env, replace(PLAIN, light_warmth=w)) for w in (-0.3, 0.3))
    red, _, blue = warm.mean(axis=(0, 1)) - cold.mean(axis=(0, 1))
    assert red > 1.0 and blue < -1.0


@pytest.mark.parametrize(
    ("tilt", "towards"), [((0, 20), (1, 0)), ((0, -20), (-1, 0)), ((20, 0), (0, -1))]
)
def test_a_tilted_light_brightens_the_side_it_turns_to(
    env: SurgEnv, eyes: EndoscopeRenderer, tilt: Any, towards: Any
) -> None:
    """Right-handed about x (right) and y (down): about y to the right, about x up."""
    gain = seen(eyes, env, replace(PLAIN, light_tilt_deg=tilt)).astype(float).sum(axis=2)
    gain -= seen(eyes, env, PLAIN).astype(float).sum(axis=2)
    height, width = gain.shape
    x = np.arange(width)[None, :] - (width - 1) / 2
    y = np.arange(height)[:, None] - (height - 1) / 2
    moment = np.array([(gain * x).sum(), (gain * y).sum()])
    assert moment @ towards > 3.0 * np.abs(np.cross(moment, towards))


def test_tissues_differ_in_colour_pattern_and_gloss(env: SurgEnv, eyes: EndoscopeRenderer) -> None:
    plain = seen(eyes, env, PLAIN).astype(float)
    bowel = TISSUES.index("bowel")

    def with_bowel(**changes: Any) -> np.ndarray:
        tissues = list(PLAIN.tissues)
        tissues[bowel] = replace(tissues[bowel], **changes)
        return seen(eyes, env, replace(PLAIN, tissues=tuple(tissues))).astype(float)

    green = with_bowel(colour=(0.5, 1.0, 0.5)) - plain
    changed = np.abs(green).max(axis=2) > 20
    assert 0.1 < changed.mean() < 0.7, "the bowel and nothing else"
    assert green[changed].mean(axis=0)[1] > -1.0 > green[changed].mean(axis=0)[0]
    flat = with_bowel(contrast=0.0)
    assert flat[changed].std(axis=0).mean() < plain[changed].std(axis=0).mean()
    assert with_bowel(gloss=0.0)[changed].mean() < plain[changed].mean()
    assert np.abs(with_bowel(shift=(0.5, 0.5)) - plain)[changed].mean() > 2.0
    np.testing.assert_array_equal(with_bowel(shift=(1.0, 1.0)), plain)


def test_the_picture_moves_as_the_camera_says(env: SurgEnv, eyes: EndoscopeRenderer) -> None:
    """A ball at known places appears where a pinhole that moved by the look would see it."""
    env.reset(seed=0)
    eyes.set_appearance(None)
    model, world = env.session.world.model, env.session.world
    eyes.render(env._qpos)
    X_WV, ball = eyes._renderer.camera_pose(), model.site("PSM1/wall").id
    members = (model.site_size, model.site_pos, model.site_rgba, model.site_sameframe)
    kept = [member[ball].copy() for member in members]
    model.site_sameframe[ball], model.site_size[ball] = 0, 0.0012
    model.site_rgba[ball] = [0, 1, 0, 1]
    eyes._renderer._option.sitegroup[4] = 1
    wall = model.site_bodyid[ball]
    strong = replace(DomainRandomization.none(), camera_shift_mm=(2, 6), camera_turn_deg=(3, 8))
    K, worst = eyes.intrinsics, 0.0
    for seed in range(6):
        look = strong.draw(seed) if seed else PLAIN
        place = np.array([0.002 * (seed - 3), 0.001, 0.030])
        centre = X_WV[:3, :3] @ place + X_WV[:3, 3]
        model.site_pos[ball] = world.data.xmat[wall].reshape(3, 3).T @ (
            centre - world.data.xpos[wall]
        )
        eyes.set_appearance(look)
        R = Rotation.from_rotvec(look.camera_turn_deg, degrees=True).as_matrix()
        in_left = R.T @ (place - 1e-3 * np.array(look.camera_shift_mm))
        for view, picture in eyes.render(env._qpos).items():
            p = in_left - [eyes.baseline if view == "right" else 0.0, 0.0, 0.0]
            expected = np.array([K.f * p[0] / p[2] + K.cx, K.f * p[1] / p[2] + K.cy])
            colours = picture.astype(float)
            green = colours[..., 1] - np.maximum(colours[..., 0], colours[..., 2]) > 15
            rows, columns = np.nonzero(green)
            assert len(rows) > 20
            found = np.array([columns.min() + columns.max(), rows.min() + rows.max()]) / 2
            worst = max(worst, float(np.abs(found - expected).max()))
    for member, value in zip(members, kept, strict=True):
        member[ball] = value
    eyes._renderer._option.sitegroup[4] = 0
    print(f"worst {worst:.2f} px")
    assert worst < 1.0


# --- lens and sensor ----------------------------------------------------------------------------


def test_exposure_and_edge_are_factors_of_the_pixels() -> None:
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 256, (48, 64, 3), np.uint8)
    half = Finish(replace(PLAIN, exposure=0.5), 64, 48)(picture)
    assert np.abs(half - picture / 2.0).max() <= 0.5
    bright = Finish(replace(PLAIN, exposure=2.0), 64, 48)(picture)
    np.testing.assert_array_equal(bright, np.minimum(2 * picture.astype(int), 255))
    edge = Finish(replace(PLAIN, edge=0.4), 64, 48)(np.full((48, 64, 3), 200, np.uint8))
    assert (edge[[0, 0, -1, -1], [0, -1, 0, -1]] == 120).all() and (edge[24, 32] >= 199).all()
    np.testing.assert_array_equal(Finish(PLAIN, 64, 48)(picture), picture)


def test_blur_spreads_a_point_by_its_standard_deviation() -> None:
    point = np.zeros((240, 320, 3), np.uint8)
    point[115:126, 155:166] = 255
    blurred = Finish(replace(PLAIN, blur_px=8.0), 320, 240)(point).astype(float)[..., 0]
    y, x = np.mgrid[:240, :320]
    for at, middle in ((y, 120.0), (x, 160.0)):
        variance = (blurred * (at - middle) ** 2).sum() / blurred.sum()
        expected = (11**2 - 1) / 12 + 4.0**2  # of the square, and half of 8 px of 480
        assert variance == pytest.approx(expected, rel=0.05)


# --- recorded -----------------------------------------------------------------------------------


def test_a_recording_states_the_look_and_has_the_same_states(tmp_path: Path) -> None:
    recorded = pytest.importorskip("surg_sim.envs.recorded_episode")
    from surg_sim.physics import cell_files
    from surg_sim.tasks import load

    manifests = []
    for looks in (None, WIDE):
        session = recorded.RecordedSession(
            cell_files.find("sim_ur5e"), "pick_and_place", seed=3, cameras=("left",), size=(64, 48),
            randomization=looks,
        )  # fmt: skip
        session.task.time_limit = 0.4
        session.reset(3)
        folder = tmp_path / ("plain" if looks is None else "worn")
        session.record(folder, 3)
        session.close()
        manifests.append(json.loads((folder / "manifest.json").read_text("utf-8")))
    plain, worn = manifests
    assert load("pick_and_place").name == worn["run"]["task"]
    assert "look" not in plain["run"]
    assert worn["run"]["look"] == json.loads(json.dumps(WIDE.draw(3).described()))
    assert plain["sim"]["state_hash"] == worn["sim"]["state_hash"]
    assert plain["camera_info"] == worn["camera_info"], "what a robot believes"


def test_the_ranges_of_a_plan_are_those_of_its_recordings() -> None:
    """A plan is a key of sessions, so ranges are values that can be hashed and compared."""
    assert hash(WIDE) == hash(DomainRandomization(**asdict(WIDE)))
