"""stable-baselines3 checks the environments and learns in one: `./surg test --tier oracle`.

Its environment is made on first use (needs the internet; torch for the processor, 1 GB).
"""

from __future__ import annotations

import os
import subprocess

import pytest

from helpers.tree import oracle_venv
from surg_cli.host import paths

pytestmark = pytest.mark.oracle

PACKAGES = (
    "stable-baselines3==2.7.0",
    "torch==2.13.0",
    "gymnasium==1.2.3",
    "mujoco==4.0.0",
    "mujoco-core==4.0.0",
    "numpy==1.26.4",  # the workspace's binding of surg_core is built for numpy 1
    "pandas==2.2.3",
    "matplotlib==3.8.4",
    "pyyaml",
)
SCRIPT = """
import gymnasium, numpy as np, warnings
import surg_sim.envs.flat_env
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
with warnings.catch_warnings():
    warnings.simplefilter("error")
    tasks = ("bgr-dense", "bgr-flat", "pick_and_place-flat", "endoscope_guidance-flat",
             "needle_driving-flat", "needle_driving-dense", "thread_in_hole-dense")
    for name in tasks:
        check_env(gymnasium.make(f"surg_sim/{name}-v0").unwrapped, skip_render_check=True)
model = PPO("MlpPolicy", gymnasium.make("surg_sim/bgr-dense-v0"), seed=1, n_steps=1000)
model.learn(%d)
lengths = [episode["l"] for episode in model.ep_info_buffer]
rewards = [episode["r"] for episode in model.ep_info_buffer]
assert np.isfinite(rewards).all()
print(f"{model.num_timesteps} steps, {len(lengths)} episodes, mean reward {np.mean(rewards):.3f}")
"""


def test_stable_baselines3_accepts_the_environments_and_learns(full: bool) -> None:
    python = oracle_venv.python("sb3", (PACKAGES,), ("stable_baselines3", "torch"))
    parts = ("surg_sim/src", "surg_core/python")
    path = ":".join(str(paths.ROOT / "src" / part) for part in parts)
    done = subprocess.run(
        [str(python), "-c", SCRIPT % (10_000 if full else 1_000)],
        env={**os.environ, "PYTHONPATH": f"{path}:{os.environ.get('PYTHONPATH', '')}"},
        capture_output=True,
        text=True,
        timeout=3000,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    print(done.stdout.strip().splitlines()[-1])
