"""The argument EPISODE: an episode's folder, or that of a run with one episode."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from surg_cli.host import option_types


def read(folder: Path) -> Path:
    parser = argparse.ArgumentParser(exit_on_error=False)
    option_types.add_episode(parser)
    return Path(parser.parse_args([str(folder)]).episode)


def record(folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "manifest.json").write_text('{"format": "surg_episode/1"}')
    return folder


def test_a_run_stands_for_its_only_episode(tmp_path: Path) -> None:
    episode = record(tmp_path / "run" / "episodes" / "000" / "episode")
    assert read(episode) == read(tmp_path / "run") == read(episode.parent) == episode


def test_of_several_episodes_one_must_be_named(tmp_path: Path) -> None:
    both = [record(tmp_path / "run" / name) for name in ("episode", "episode_1")]
    with pytest.raises(argparse.ArgumentError, match="2 episodes; name one") as refused:
        read(tmp_path / "run")
    assert all(str(folder) in str(refused.value) for folder in both)
    assert read(both[1]) == both[1]


def test_a_folder_without_an_episode_stays_as_it_was_named(tmp_path: Path) -> None:
    """The command says what is missing there."""
    assert read(tmp_path) == tmp_path and read(tmp_path / "nowhere") == tmp_path / "nowhere"
