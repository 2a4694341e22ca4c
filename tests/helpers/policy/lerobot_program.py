"""Runs a module in an environment of `lerobot_venv` as a command line does.

Usage: ``python lerobot_program.py MODULE ARGUMENTS``.
"""

from __future__ import annotations

import runpy
import sys

import torch

# The compiled part of torchvision is of another build than a CPU-only torch. lerobot needs its
# transforms and networks only, but torchvision does not import unless these operators are known.
_OPERATORS = torch.library.Library("torchvision", "DEF")
for _name in ("nms", "qnms"):
    _OPERATORS.define(f"{_name}(Tensor a, Tensor b, float c) -> Tensor")

if __name__ == "__main__":
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
