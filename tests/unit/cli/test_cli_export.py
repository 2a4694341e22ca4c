"""`./surg episode export`: what a person types and reads."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import pytest

from helpers.graph.surg import called
from helpers.recording import datasets_synthetic
from surg_cli.host.terminal import CliError

surg_export = functools.partial(called, "episode export")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a good recording and one of another robot."""
    root = tmp_path_factory.mktemp("runs")
    datasets_synthetic.record(root / "a", 1, 0.4, ("endoscope_left",))
    other = {"arms": {"PSM1": {"robot": {"name": "panda"}, "instrument": {"name": "grasper"}}}}
    datasets_synthetic.copy(root / "a", root / "b", cell=other)
    return root


def test_export_check_and_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "set"
    words = ("--format", "act", "--out", out, "--workers", "1")
    assert surg_export(folder / "a", *words) == 0
    said = capsys.readouterr().out
    assert "1 recordings, " in said
    assert f"report: {out}.report.json" in said
    assert json.loads((tmp_path / "set.report.json").read_text())["ok"]
    assert surg_export(folder / "a", *words) == 0
    assert "up to date" in capsys.readouterr().out
    assert surg_export("--check", "--format", "act", "--out", out) == 0
    (out / "episode_0.hdf5").write_bytes(b"")
    assert surg_export("--check", "--format", "act", "--out", out) == 1
    assert "wrong: episode_0.hdf5: changed since it was written" in capsys.readouterr().err


def test_without_a_folder_it_names_features_and_writes_nothing(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(folder.rglob("*"))
    assert surg_export(folder) == 1
    said = capsys.readouterr()
    assert "nothing is written: no --out" in said.out
    assert "observation.images.endoscope.left" in said.out
    assert "1 recordings, " in said.out
    assert "refused: " in said.err
    assert "robots: panda, but this export has ur5e" in said.err
    assert sorted(folder.rglob("*")) == before


def test_shards_and_merge(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "set"
    words = (folder / "a", "--format", "act", "--out", out, "--workers", "1")
    with pytest.raises(CliError, match=r"set\.parts"):
        surg_export(*words, "--shard", "merge")
    assert surg_export(*words, "--shard", "0/1") == 0
    assert not out.exists()
    assert surg_export(*words, "--shard", "merge") == 0
    assert out.is_dir()


def test_what_only_people_know(folder: Path, tmp_path: Path) -> None:
    about = tmp_path / "about.yaml"
    about.write_text("license: CC0\ncontact: us@example.org\n")
    words = (folder / "a", "--out", tmp_path / "set", "--workers", "1", "--about", about)
    assert surg_export(*words) == 0
    assert "CC0" in (tmp_path / "set/meta/README.md").read_text()
    about.write_text("licence: CC0\n")
    with pytest.raises(CliError, match="holds licence; known keys: name, summary, license"):
        surg_export(*words)
    with pytest.raises(CliError, match=r"none\.yaml"):
        surg_export(*words[:-1], tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "x"], "name recordings"),
        (["--check"], "--out DIR is missing"),
        (["a", "--shard", "merge"], "--out DIR is missing"),
        (["a", "--replace"], "--out DIR is missing"),
        (["a", "--out", "x", "--format", "cd"], "there are lerobot"),
        (["a", "--out", "x", "--fps", "0"], "--fps: 0 is not allowed; allowed: 1 to 1000"),
        (["a", "--out", "x", "--size", "641x480"], "even numbers of pixels"),
        (["a", "--out", "x", "--splits", "train=0.5"], "that add up to 1"),
        (["nowhere", "--out", "x"], "nowhere: no such folder"),
        (["--check", "--out", "x"], "no export of this program"),
    ],
)
def test_wrong_input_is_named(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CliError, match=said) as caught:
        surg_export(*words)
    assert caught.value.code == 2


@pytest.mark.parametrize(
    "word",
    [
        *("--size=big", "--shard=4/4", "--shard=x", "--splits=train", "--splits=sorted:train=1"),
        *("--workers=0", "--workers=many"),
    ],
)
def test_an_unreadable_value_names_its_option(
    word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        surg_export("a", "--out", "x", word)
    assert word.partition("=")[0] in capsys.readouterr().err
