"""The benchmark of the policies' wire: what its page says, and that every way answers rightly."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

from surg_cli.host import paths

BENCHMARKS = paths.ROOT / "benchmarks"


def load(monkeypatch: pytest.MonkeyPatch, file: str) -> ModuleType:
    """A file of the benchmarks, whose neighbours it imports by their short names."""
    for folder in (BENCHMARKS, BENCHMARKS / "policy"):
        monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "page", raising=False)
    spec = importlib.util.spec_from_file_location(f"tested_{Path(file).stem}", BENCHMARKS / file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # A dataclass looks for its module there.
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    monkeypatch.delitem(sys.modules, "page", raising=False)
    return module


def test_the_table_compares_with_ours_over_tcp(monkeypatch: pytest.MonkeyPatch) -> None:
    page = load(monkeypatch, "policy/policy_page.py")
    result = {
        "machine": {"openpi_client": "0.1.2"},
        "round_trip_ms": {
            "ours_tcp": {"p50": 1.0, "p99": 2.0},
            "peer_openpi_ws": {"p50": 2.5, "p99": 4.0},
        },
        "cpu_ms": {"ours_tcp": 1.5, "peer_openpi_ws": 6.0},
    }
    ((_, rows),) = page.tables(result)
    assert rows[1] == ["ours, TCP", "1.00", "2.00", "1.00", "1.50"]
    assert rows[2] == ["openpi-client 0.1.2, websocket", "2.50", "4.00", "2.50", "6.00"]


@pytest.mark.full
def test_every_way_brings_both_pictures_over(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    bench = load(monkeypatch, "bench_policy.py")
    for name, way in bench.ways(tmp_path, bench.openpi(offline=True)).items():
        pair = bench.Pair(name, way)
        try:
            assert len(pair.run(3)) == 3
            assert pair.cpu_ns() > 0
        finally:
            pair.close()
