"""Environments with the real lerobot, one per version, beside the checkout and never in git.

Each has the real robomimic too, which needs the same torch.
"""

from __future__ import annotations

from pathlib import Path

from helpers.tree import oracle_venv

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


def python(version: str) -> Path:
    """The interpreter of the environment for a version; made when it is missing.

    A torch for the processor alone is needed: its wheel (``torch==2.13.0+cpu``) must be in reach of
    pip, by its settings or ``PIP_FIND_LINKS``. Skips the test where the environment cannot be made.
    """
    installs = (
        (*PLAIN, DATASETS[version]),
        ("--no-deps", *TORCH, "accelerate", f"lerobot=={version}", ROBOMIMIC),
    )
    return oracle_venv.python(f"lerobot-{version}", installs, ("torch", "torchcodec"))
