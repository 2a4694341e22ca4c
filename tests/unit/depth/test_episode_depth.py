"""`./surg episode depth EPISODE`: depth of a recording, and the recordings that are refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest

from helpers.perception.plane_pair import PlanePair
from helpers.recording.stereo_recording import EYES, FRAME_NS, camera_info, record_pairs
from surg_cli.host.terminal import CliError
from surg_recording.episode import episode_reader, table_file
from surg_recording.video import exact_values

COUNT = 4


@pytest.fixture(scope="module")
def pair() -> PlanePair:
    return PlanePair(distance=0.06)


@pytest.fixture(scope="module")
def models(pair: PlanePair) -> dict:
    return {eye: camera_info(lens) for eye, lens in zip(EYES, pair.lenses(), strict=True)}


@pytest.fixture(scope="module")
def recorded(pair: PlanePair, models: dict, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("depth") / "run" / "episode"
    seen = pair.pictures()
    return record_pairs(folder, [seen] * COUNT, models)


def refused(surg: Callable[..., int], *words: object) -> str:
    """What the command says when it refuses."""
    with pytest.raises(CliError) as problem:
        surg("episode", "depth", *words)
    assert problem.value.code == 2
    return str(problem.value)


def copied(recorded: Path, tmp_path: Path, **changes: object) -> Path:
    """The episode with another ``camera_info``, as an editor of the manifest leaves it."""
    folder = tmp_path / "episode"
    shutil.copytree(recorded, folder)
    file = folder / "manifest.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **changes}))
    return folder


def test_depth_of_a_recording(
    surg: Callable[..., int],
    recorded: Path,
    pair: PlanePair,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert surg("episode", "depth", recorded.parent, "--out", tmp_path / "d") == 0
    said = capsys.readouterr().out
    assert "4 pairs of 320 x 240" in said and str(tmp_path / "d") in said.splitlines()[-1]
    values = list(exact_values.read(tmp_path / "d" / "endoscope_depth.mp4"))
    assert len(values) == 4 and values[0].dtype == np.uint16
    depth = np.where(values[0] > 0, 1e-4 * values[0], np.nan)
    away = np.abs(depth - pair.depth())[20:-20, 60:-20]
    assert np.nanpercentile(away, 90) < 0.0035
    table = table_file.read_table(tmp_path / "d" / "endoscope_depth.csv")
    assert table["stamp_ns"].tolist() == [FRAME_NS * k for k in range(1, 5)]
    figures = json.loads((tmp_path / "d" / "depth.json").read_text())
    assert figures["format"] == "surg_depth/1" and figures["pairs"] == 4
    assert figures["baseline_m"] == pytest.approx(pair.baseline)
    assert figures["video_quality"] == "18"
    assert figures["median_depth_m"][0] == pytest.approx(0.06, abs=0.003)
    assert (tmp_path / "d" / "depth.png").stat().st_size > 5000
    with av.open(str(tmp_path / "d" / "depth.mp4")) as film:
        assert sum(1 for _ in film.decode(video=0)) == 4


def test_the_folder_stands_beside_the_episode_and_is_not_overwritten(
    surg: Callable[..., int], recorded: Path
) -> None:
    out = recorded.with_name("episode_depth")
    assert surg("episode", "depth", recorded, "--size", "160x120") == 0
    before = (out / "depth.json").read_bytes()
    assert json.loads(before)["size"] == [160, 120]
    assert "is there already; remove it, or choose another --out" in refused(surg, recorded)
    assert (out / "depth.json").read_bytes() == before
    assert episode_reader.read(recorded).complete


def changed(models: dict, eye: int, **values: object) -> dict:
    """The camera models with other values of one eye."""
    return {**models, EYES[eye]: {**models[EYES[eye]], **values}}


BAD_MODELS: dict[str, tuple[Callable[[dict], dict], str]] = {
    "no lens": (lambda m: {}, "camera_info.endoscope_left is missing"),
    "no right lens": (
        lambda m: {EYES[0]: m[EYES[0]]},
        "camera_info.endoscope_right is missing",
    ),
    "not measured": (
        lambda m: changed(m, 0, K=[0.0] * 9),
        "has no focal length: nothing says through which lens the pictures look",
    ),
    "not a number": (
        lambda m: changed(m, 0, D=[float("nan"), 0.0, 0.0, 0.0, 0.0]),
        "distortion_coefficients.data",
    ),
    "unknown model": (lambda m: changed(m, 1, distortion_model="thin_prism"), "distortion_model"),
    "text for a number": (lambda m: changed(m, 1, P="12 numbers"), "is no camera model"),
    "eyes swapped": (lambda m: {EYES[0]: m[EYES[1]], EYES[1]: m[EYES[0]]}, "swapped"),
    "another size": (lambda m: changed(m, 0, width=320, height=320), "the same aspect"),
    "not measured together": (
        lambda m: changed(m, 1, P=[v * (1.05 if i in (0, 5) else 1) for i, v in
                                   enumerate(m[EYES[1]]["P"])]),
        "were not measured together",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD_MODELS)
def test_a_recording_without_good_lenses_is_refused(
    what: str,
    surg: Callable[..., int],
    recorded: Path,
    models: dict,
    tmp_path: Path,
) -> None:
    change, said = BAD_MODELS[what]
    episode = copied(recorded, tmp_path, camera_info=change(models))
    error = refused(surg, episode)
    assert said in error and "endoscope_" in error, error
    assert not episode.with_name("episode_depth").exists()


@pytest.mark.parametrize("there", [EYES[:1], EYES[1:], ()])
def test_a_recording_of_one_eye_is_refused(
    there: tuple[str, ...], surg: Callable[..., int], recorded: Path, tmp_path: Path
) -> None:
    videos = json.loads((recorded / "manifest.json").read_text())["videos"]
    kept = {eye: videos[eye] for eye in there}
    error = refused(surg, copied(recorded, tmp_path, videos=kept))
    for eye in EYES:
        assert (f"no video {eye}" in error or f"no {eye}" in error) == (eye not in there), error
    assert "--cameras stereo" in error


def test_eyes_without_a_stamp_in_common_are_refused(
    surg: Callable[..., int], recorded: Path, tmp_path: Path
) -> None:
    episode = copied(recorded, tmp_path)
    sidecar = episode / "endoscope_right.csv"
    head, *lines = sidecar.read_text().splitlines()
    later = [",".join([n, str(int(t) + 1000), *rest]) for n, t, *rest in
             (line.split(",") for line in lines)]  # fmt: skip
    sidecar.write_text("\n".join([head, *later]) + "\n")
    assert "have no stamp in common; allowed: pairs of one stamp" in refused(surg, episode)


def test_a_broken_video_is_refused(
    surg: Callable[..., int], recorded: Path, tmp_path: Path
) -> None:
    episode = copied(recorded, tmp_path)
    for eye in EYES:
        with (episode / f"{eye}.csv").open("a") as sidecar:
            sidecar.write(f"{COUNT},{10 * FRAME_NS},{10 * FRAME_NS},450000,0\n")
    error = refused(surg, episode)
    assert "1 pictures fewer than its sidecar states; run ./surg episode recover" in error, error
    video = episode / "endoscope_right.mp4"
    video.write_bytes(video.read_bytes()[:-12000])
    error = refused(surg, episode)
    assert str(video) in error and "no readable video" in error, error
    assert not episode.with_name("episode_depth").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--method", "census"), "there is no such stereo method"),
        (("--method", "none.py"), "none.py"),
        (("--range", "0.2", "0.1"), "0.005 <= near < far <= 10"),
        (("--size", "640"), "allowed: such as 640x480"),
        (("--range", "nan", "0.1"), "a positive number"),
    ],
)
def test_an_option_that_is_none_is_refused(
    words: tuple[str, ...],
    said: str,
    surg: Callable[..., int],
    recorded: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises((CliError, SystemExit)) as problem:
        surg("episode", "depth", recorded, "--out", tmp_path / "d", *words)
    assert said in str(problem.value) + capsys.readouterr().err
    assert not (tmp_path / "d").exists()


def test_coarse_video_is_said(
    surg: Callable[..., int], recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    streams = {eye: {"quality": "28"} for eye in EYES}
    episode = copied(recorded, tmp_path, camera_streams=streams)
    assert surg("episode", "depth", episode) == 0
    told = capsys.readouterr()
    assert "recorded with crf 28" in told.out + told.err and "--video-crf 18" in told.out + told.err
