"""Films of episodes: the right picture at the right time, small, and part of the report."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from conftest import FULL
from helpers.recording import datasets_synthetic, picture_identity
from helpers.recording.datasets_synthetic import FRAME_NS
from surg_cli.graph import episode_film
from surg_cli.host import cells
from surg_recording.episode import episode_reader
from surg_recording.recording_errors import EpisodeError
from surg_recording.reports.html_page import film_section
from surg_recording.video import film


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> episode_reader.Episode:
    folder = tmp_path_factory.mktemp("film") / "e"
    return episode_reader.read(datasets_synthetic.record(folder, 3, 0.7))


def test_every_picture_is_the_newest_of_its_time(recorded: episode_reader.Episode) -> None:
    video = recorded.video("endoscope_left")
    stamps = video.frames["stamp_ns"]
    times = film.times(int(stamps[0]) - 10, int(stamps[-1]) + 10, 100.0)
    assert len(times) == round((stamps[-1] - stamps[0]) * 1e-9 * film.FPS)
    size = (picture_identity.WIDTH, picture_identity.HEIGHT)
    shown = [picture_identity.read(p).frame for p in film.frames_at(video, times, size)]
    assert shown == [max(t // FRAME_NS, stamps[0] // FRAME_NS) for t in times]
    assert len(set(shown)) == len(times) and film.times(0, 10**11, 4.0)[-1] == 10**11
    assert len(film.times(0, 10**11, 4.0)) == 4 * film.FPS


def test_a_film_of_noise_stays_below_its_size(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    noise = [rng.integers(0, 256, (120, 160, 3), dtype=np.uint8) for _ in range(60)]
    path = film.write(iter(noise), len(noise), tmp_path / "x.mp4", max_bytes=150_000)
    assert path.stat().st_size < 150_000
    with av.open(str(path)) as container:
        assert container.streams.video[0].codec_context.name == "h264"
        assert sum(1 for _ in container.decode(video=0)) == len(noise)
    free = film.write(iter(noise), len(noise), tmp_path / "free.mp4")
    assert 150_000 < free.stat().st_size < film.MAX_BYTES, "the limit was at work"


def test_a_gif_repeats_and_another_ending_is_refused(tmp_path: Path) -> None:
    pictures = [np.full((20, 30, 3), 4 * n, np.uint8) for n in range(30)]
    joined = list(film.beside(pictures, pictures))
    assert joined[0].shape == (20, 68, 3)
    with Image.open(film.write(joined, 30, tmp_path / "x.gif")) as gif:
        assert gif.n_frames == 15 and gif.info["loop"] == 0
    with pytest.raises(EpisodeError, match=r"\.mp4 or \.gif"):
        film.write(joined, 30, tmp_path / "x.avi")


def test_a_report_shows_the_film_of_its_folder(tmp_path: Path) -> None:
    assert film_section(tmp_path, "both") == ""
    (tmp_path / episode_film.FILM).write_bytes(b"film")
    assert "data:video/mp4;base64,ZmlsbQ==" in film_section(tmp_path, "both")


def test_an_episode_that_cannot_be_filmed_costs_only_its_film(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "e").mkdir()
    (tmp_path / "e/manifest.json").write_text("{")
    episode_film.for_report([tmp_path / "e"], tmp_path, tmp_path)
    assert "no film" in capsys.readouterr().err
    assert not (tmp_path / episode_film.FILM).exists()


@pytest.mark.parametrize("outcomes", ["sfsf", "ss", "ff", ""])
def test_a_report_films_the_first_failure_and_the_first_success(
    outcomes: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("film_failed.mp4", "film_succeeded.mp4"):
        (tmp_path / name).write_text("of a former run")
    filmed = {}
    monkeypatch.setattr(episode_reader, "read", lambda folder: folder)
    monkeypatch.setattr(
        episode_film, "make", lambda folder, cell, out, **_: filmed.update({out.name: folder.name})
    )
    played = [(kind == "s", tmp_path / str(n)) for n, kind in enumerate(outcomes)]
    episode_film.of_outcomes(iter(played), tmp_path, tmp_path)
    expected = {}
    for kind, name in (("f", "film_failed.mp4"), ("s", "film_succeeded.mp4")):
        assert not (tmp_path / name).exists(), "films of a former run do not stay"
        if kind in outcomes:
            expected[name] = str(outcomes.index(kind))
    assert filmed == expected


@pytest.mark.skipif(not FULL, reason="./surg test --full")
def test_the_room_moves_with_the_recorded_joints(
    recorded: episode_reader.Episode, tmp_path: Path
) -> None:
    out = episode_film.make(recorded, cells.find("sim_ur5e"), tmp_path / "x.mp4")
    with av.open(str(out)) as container:
        first, *_, last = (f.to_ndarray(format="rgb24") for f in container.decode(video=0))
    assert first.shape == (360, 540 + 8 + 540, 3) and out.stat().st_size < film.MAX_BYTES
    room = slice(540 + 8, None)
    assert np.abs(first[:, room].astype(int) - last[:, room]).max() > 60
