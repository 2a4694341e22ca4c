"""One recorded episode of a wristed arm for all tests of this folder."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from helpers.recording import wristed_episode
from helpers.recording.wristed_episode import OPTIONS, Truth
from surg_core.contract import ACTION_SPACES
from surg_recording import datasets


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Truth]:
    """The episode, and the simulator's truth."""
    folder = tmp_path_factory.mktemp("wristed") / "episode"
    return folder, wristed_episode.record(folder)


@pytest.fixture(scope="session")
def exported(
    recorded: tuple[Path, Truth], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    """The episode in every action space."""
    root = tmp_path_factory.mktemp("spaces")
    for space in ACTION_SPACES:
        chosen = dataclasses.replace(OPTIONS, action_space=space)
        report = datasets.load("lerobot").write([recorded[0]], root / space, chosen)
        assert report.ok, report.errors
    return {space: root / space for space in ACTION_SPACES}
