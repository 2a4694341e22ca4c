"""Does the eye of the image policy of bgr answer faster by numpy or by onnxruntime?

One core, one and two pictures at a time. numpy is measured by the Python of the platform;
`--onnx PYTHON` names one of an environment with torch, onnx and onnxruntime, which exports the eye
and measures there. `--json FILE` writes

    format    "surg_bench_eye/1"
    weights   SHA-256 of the weights
    runs      [{by, version, pictures, p50_ms, p99_ms, most_ms}] wall clock of an answer of the
              whole eye, without scaling the picture down
    worst     largest difference of the network's outputs between the two
    onnx_kib  size of the exported network
    machine   {processor, cores, load_before, load_after, date}
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")

import numpy as np  # noqa: E402  reads them

ROOT = Path(__file__).parents[1]

from surg_learn.bgr.image_policy import ImagePolicy  # noqa: E402
from surg_learn.bgr.keypoint_network import CONVOLUTIONS, MAPS, SIDE, Eye, grid, scaled  # noqa: E402

TIMES = 1000


def views(count: int) -> np.ndarray:
    """Smooth pictures, (count, SIDE, SIDE, 3)."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(40, 220, (count, 8, 8, 3))
    block = SIDE // 8
    return np.kron(coarse, np.ones((1, block, block, 1), int)).astype(np.uint8)


def timed(eye: Eye, by: str, version: str) -> list[dict[str, Any]]:
    """Times of answers to one and to two pictures."""
    found = []
    for count in (1, 2):
        shown, spent = views(count), []
        for n in range(TIMES + 50):
            before = time.perf_counter()
            eye(shown)
            if n >= 50:
                spent.append(1e3 * (time.perf_counter() - before))
        p50, p99 = np.percentile(spent, (50, 99))
        entry = {"p50_ms": round(p50, 2), "p99_ms": round(p99, 2), "most_ms": round(max(spent), 2)}
        found.append({"by": by, "version": version, "pictures": count, **entry})
    return found


def exported(eye: Eye, file: Path) -> None:
    """Write the network of an eye, from pictures (B, 3, SIDE, SIDE) to what `network` returns."""
    import torch

    n, k, F = len(CONVOLUTIONS), len(MAPS), torch.nn.functional
    layers = [tuple(torch.from_numpy(part.copy()) for part in layer) for layer in eye.layers]
    cells = torch.from_numpy(grid(SIDE // 4))

    class Network(torch.nn.Module):
        """The same sums in PyTorch's words."""

        def forward(self, x: Any) -> tuple[Any, Any, Any]:
            for (weight, bias), (size, stride, dilation) in zip(layers, CONVOLUTIONS, strict=False):
                w = weight.permute(3, 2, 0, 1)
                x = F.relu(F.conv2d(x, w, bias, stride, dilation * (size // 2), dilation))
            weight, bias = layers[n]
            maps = F.conv2d(x, weight.T[:, :, None, None], bias)
            share = F.softmax(maps[:, :k].flatten(2), dim=2)
            flat = x.flatten(2)
            where, there = share @ cells, share @ flat.transpose(1, 2)
            y = torch.cat([where.flatten(1), flat.mean(dim=2), there.flatten(1)], dim=1)
            for weight, bias in layers[-3:-1]:
                y = F.relu(y @ weight + bias)
            return y @ layers[-1][0] + layers[-1][1], where, maps[:, k]

    example = torch.zeros(2, 3, SIDE, SIDE)
    names = {"input_names": ["x"], "output_names": ["raw", "where", "tube"]}
    sizes = {"x": {0: "pictures"}}
    torch.onnx.export(Network(), (example,), str(file), **names, dynamic_axes=sizes, dynamo=False)


class OnnxEye(Eye):
    """An eye whose network onnxruntime runs, on one core."""

    def __init__(self, eye: Eye, file: Path) -> None:
        import onnxruntime

        super().__init__(eye.layers, eye.plane, eye.pointed)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(
            str(file), options, providers=["CPUExecutionProvider"]
        )

    def network(self, views: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Eye.network`."""
        x = np.ascontiguousarray(scaled(views).transpose(0, 3, 1, 2))
        raw, where, tube = self._session.run(None, {"x": x})
        return raw, where, tube


def by_onnx(eye: Eye) -> dict[str, Any]:
    """In the environment that has onnxruntime."""
    import onnxruntime

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "eye.onnx"
        exported(eye, file)
        other = OnnxEye(eye, file)
        pairs = zip(eye.network(views(2)), other.network(views(2)), strict=True)
        worst = max(float(np.abs(a - b).max()) for a, b in pairs)
        runs = timed(other, "onnxruntime", onnxruntime.__version__)
        return {"runs": runs, "worst": worst, "onnx_kib": file.stat().st_size // 1024}


def asked(python: Path, weights: Path) -> dict[str, Any]:
    """`by_onnx` in another environment."""
    argv = [str(python), __file__, "--weights", str(weights), "--there"]
    env = {**os.environ, "PYTHONPATH": str(ROOT / "src/surg_policy_bridge/client/src")}
    try:
        done = subprocess.run(argv, env=env, capture_output=True, text=True, check=False)
    except OSError as error:
        raise SystemExit(f"bench eye: --onnx {error}") from None
    if done.returncode != 0:
        last = done.stderr.strip().splitlines()[-1]
        raise SystemExit(f"bench eye: --onnx {python}: {last}; it needs torch, onnx, onnxruntime")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="bench eye", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--weights", type=Path, required=True, help="of learn bgr --cameras")
    parser.add_argument("--onnx", type=Path, metavar="PYTHON", help="with torch, onnx, onnxruntime")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--there", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    try:
        policy = ImagePolicy.load(options.weights)
    except (OSError, ValueError) as error:
        raise SystemExit(f"bench eye: {error}") from None
    eye = policy.network.eye
    if options.there:
        print(json.dumps(by_onnx(eye)))
        return 0
    from machine import this_machine

    before = os.getloadavg()[0]
    result: dict[str, Any] = {"format": "surg_bench_eye/1", "weights": policy.hash}
    result["runs"] = timed(eye, "numpy", np.__version__)
    if options.onnx is not None:
        there = asked(options.onnx, options.weights)
        result["runs"] += there.pop("runs")
        result |= there
    result["machine"] = this_machine(before)
    print(json.dumps(result, indent=1))
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
