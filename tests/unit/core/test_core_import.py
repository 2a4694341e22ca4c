"""The library is found from wherever it is looked for."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import surg_core


def where() -> str:
    """File of the compiled half."""
    return str(surg_core._core.__file__)


def test_a_child_with_its_parents_path_finds_the_compiled_half() -> None:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(where).result(60) == where()
