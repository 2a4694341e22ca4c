"""Fixtures of the faults' tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from helpers.results.reactions import Reactions


@pytest.fixture(scope="session")
def reactions() -> Iterator[Reactions]:
    """The table of reaction times."""
    table = Reactions()
    yield table
    table.write()
