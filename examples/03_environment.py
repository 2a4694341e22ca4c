#!/usr/bin/env python3
"""Step 3: an episode of a surgical task in a Gymnasium environment, without ROS.

You learn: what an observation and an action hold, and how to play an episode of bowel grasping and
retraction by the scripted expert. Replace ``env.unwrapped.expert_action()`` by a policy of yours.

    ./surg dev shell -c "python3 examples/03_environment.py"
"""

from __future__ import annotations

import gymnasium

import surg_sim.envs.surg_env  # registers surg_sim/<task>-v0

SEED = 10_000  # 10,000 to 10,699 are for training, 20,000 to 20,999 for figures


def main() -> None:
    """Play one episode."""
    env = gymnasium.make("surg_sim/bgr-v0", setting="phantom")
    task = env.unwrapped
    assert isinstance(task, surg_sim.envs.surg_env.SurgEnv)
    observation, info = env.reset(seed=SEED)
    print("action:", ", ".join(task.action_names))
    print("state:", ", ".join(task.state_names))
    print("privileged (no robot can measure it):", ", ".join(observation["privileged"]))

    phase, steps, rcm_error, done = "", 0, 0.0, False
    while not done:
        observation, _, terminated, truncated, info = env.step(task.expert_action())
        steps, done = steps + 1, terminated or truncated
        rcm_error = max(rcm_error, info["rcm_error"]["PSM1"])
        if info["phase"] != phase:
            phase = info["phase"]
            print(f"{steps / 20:5.2f} s  {phase}")
    print(f"success: {info['success']} {info['reason']}")
    print(f"refused commands: {info['refused']}; RCM deviation at most {1e3 * rcm_error:.3f} mm")
    env.close()


if __name__ == "__main__":
    main()
