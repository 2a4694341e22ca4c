"""Environments with the real lerobot, one per version, beside the checkout and never in git.

Each has the real robomimic too, which needs the same torch.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from helpers.policy import pythons
from helpers.tree import oracle_venv
from surg_cli.host import paths

# lerobot's own pins ask for CUDA and much that reading needs not: it comes without dependencies.
TORCH = ("torch==2.13.0", "torchvision==0.28.0", "torchcodec==0.13.0")
PLAIN = (
    *("numpy==2.2.6", "pandas<3", "pyarrow>=21", "huggingface_hub", "av==15.1.0", "pillow"),
    *("packaging", "einops", "jsonlines", "imageio", "draccus", "filelock", "fsspec", "sympy"),
    *("networkx", "jinja2", "typing_extensions", "mpmath", "termcolor", "deepdiff", "psutil"),
    *("opencv-python-headless", "safetensors", "h5py", "tqdm"),
)
ROBOMIMIC = "robomimic==0.3.0"
DATASETS = {"0.3.3": "datasets==3.6.0", "0.4.4": "datasets>=4,<5"}
NEWER = {
    "0.6.1": (
        "lerobot[core_scripts,training,evaluation]==0.6.1",
        *("mujoco>=4.0,<4.1", "matplotlib", "pyyaml", "pyzmq", "msgpack"),
    )
}
"""Versions that need a newer Python, with all that they ask for and our plug-ins need."""
# What lerobot's policies and its training import and reading its datasets does not need.
POLICIES = (
    *("pyzmq", "msgpack", "diffusers", "importlib_metadata", "zipp", "regex", "pyserial"),
    *("gymnasium<2", "farama-notifications", "cloudpickle", "grpcio>=1.73.1", "protobuf>=6.31"),
    *("draccus==0.10.0", "mergedeep", "pyyaml", "pyyaml-include<2", "toml", "typing-inspect"),
)
CLIENT = paths.ROOT / "src" / "surg_policy_bridge" / "client" / "src"
PROGRAM = Path(__file__).with_name("lerobot_program.py")


def python(version: str) -> Path:
    """The interpreter of the environment for a version; made when it is missing.

    A torch for the processor alone is needed: its wheel (``torch==2.13.0+cpu``) must be in reach of
    pip, by its settings or ``PIP_FIND_LINKS``. Skips the test where the environment cannot be made.
    """
    if version in NEWER:
        newer = pythons.find("3.13")
        if newer is None:
            pytest.skip("missing: Python 3.13; `uv python install 3.13` or pyenv get it")
        return oracle_venv.python(f"lerobot-{version}", (NEWER[version],), ("torch",), newer)
    installs = (
        (*PLAIN, DATASETS[version]),
        ("--no-deps", *TORCH, "accelerate", f"lerobot=={version}", ROBOMIMIC),
    )
    return oracle_venv.python(f"lerobot-{version}", installs, ("torch", "torchcodec"))


def with_policies(version: str, home: Path) -> tuple[Path, dict[str, str]]:
    """Its interpreter, and an environment with our client, in which policies load and train.

    Args:
        version: As for `python`.
        home: A folder for what the libraries keep. Nothing is fetched from a hub.
    """
    interpreter = python(version)
    beside = paths.ROOT / ".venv-oracle-lerobot-policies"
    stamp = beside / ".complete"
    if not stamp.exists() or stamp.read_text("utf-8") != repr(POLICIES):
        pip = [str(interpreter), "-m", "pip", "install", "-q", "--no-deps", "--upgrade"]
        pip += ["--target", str(beside)]
        done = subprocess.run([*pip, *POLICIES], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            pytest.skip(f"missing: {', '.join(POLICIES)}: {done.stderr.strip()[-300:]}")
        stamp.write_text(repr(POLICIES), "utf-8")
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    env.update(PYTHONPATH=f"{CLIENT}:{beside}", HF_HUB_OFFLINE="1", HF_HOME=str(home / "hf"))
    env.update(TORCH_HOME=str(home / "torch"))
    return interpreter, env
