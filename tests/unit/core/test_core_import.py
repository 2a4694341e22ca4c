"""The library is found from wherever it is looked for."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

import surg_core


def where() -> str:
    """File of the compiled half."""
    return str(surg_core._core.__file__)


def test_a_child_with_its_parents_path_finds_the_compiled_half() -> None:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(where).result(60) == where()


@pytest.mark.skipif(np.__version__ >= "2", reason="this pybind11 knows numpy 2")
def test_numpy_2_under_an_old_pybind11_is_refused() -> None:
    stub = "import numpy; numpy.__version__ = '2.1.3'; import surg_core"
    result = subprocess.run([sys.executable, "-c", stub], capture_output=True, text=True)
    assert result.returncode != 0
    assert "ImportError" in result.stderr and "2.1.3" in result.stderr, result.stderr
