"""`./surg dev bench eye`: what it measures, and what it says of what is missing."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from helpers.policy import bgr_pictures as made
from surg_cli.host import paths

sys.path.insert(0, str(paths.ROOT / "benchmarks"))

import bench_eye


def test_times_are_of_one_and_of_two_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_eye, "TIMES", 3)
    found = bench_eye.timed(made.eye(), "numpy", np.__version__)
    assert [each["pictures"] for each in found] == [1, 2]
    assert all(0.0 < each["p50_ms"] <= each["p99_ms"] <= each["most_ms"] for each in found)
    shown = bench_eye.views(2)
    assert shown.shape == (2, made.SIDE, made.SIDE, 3) and shown.std() > 20.0


def test_what_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["bench", "--weights", str(tmp_path / "w.npz")])
    with pytest.raises(SystemExit, match=r"w\.npz"):
        bench_eye.main()
    with pytest.raises(SystemExit, match="no_python"):
        bench_eye.asked(tmp_path / "no_python", tmp_path / "w.npz")
    with pytest.raises(SystemExit, match="it needs torch, onnx, onnxruntime"):
        bench_eye.asked(Path(sys.executable), tmp_path / "w.npz")
