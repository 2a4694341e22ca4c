"""`./surg teleop` in a calibrated cell whose endoscope somebody has turned in its clamp since."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.async_tests import within
from helpers.endoscope_files import copied_cell
from helpers.graph.surg import start
from helpers.sim.unknown_scene import UnknownScene
from helpers.teleop.console_page import when
from surg_cli.graph import master
from surg_recording.episode import episode_reader
from surg_sim.physics.patient_settings import find_setting

pytestmark = [pytest.mark.ros, pytest.mark.full]

CALIBRATED = "phantom+unregistered+lens"
RECLAMPED = "phantom+unregistered+reclamped+lens"
LEADER = '''
import numpy as np
import rospy
from surg_core.hand.leader_sample import HandlePose, LeaderSample
from surg_msgs.msg import DriftStatus

STEADY_S = 25.0

class Leader:
    """Moves the tip slowly before the eyes, and clutches when the watch has refused something.

    Its time begins with the first pictures. It records until 6 s after the clutch.
    """

    name = "slow_hand"

    def open(self):
        self.heard, self.clutched = [], None
        rospy.Subscriber("/endoscope/drift", DriftStatus, self.heard.append)
        self.begun = None

    def read(self, now):
        if self.heard and self.begun is None:
            self.begun = now
        t = 0.0 if self.begun is None else now - self.begun
        p = 0.008 * np.sin(2 * np.pi * np.array([0.13, 0.09, 0.07]) * t)
        if self.clutched is None and t > 6.0:
            state = self.heard[-1]
            if state.refusal or (t > STEADY_S and state.state == DriftStatus.STATE_STEADY):
                self.clutched = t + 2.0
        at = {"enable": [2.0], "record": [3.0]}
        if self.clutched is not None:
            at["clutch"] = [self.clutched]
            at["record"].append(self.clutched + 6.0)
        down = {name for name, times in at.items() if any(x <= t < x + 0.4 for x in times)}
        pose, buttons = HandlePose(p, np.eye(4)[3]), frozenset(down | {"present"})
        return LeaderSample(stamp=now, pose=pose, buttons=buttons)

    def close(self):
        pass
'''


@pytest.mark.parametrize("setting", [CALIBRATED, RECLAMPED])
@within(240.0)
async def test_what_an_operator_meets(setting: str, tmp_path: Path) -> None:
    cell = copied_cell(tmp_path, "sim_two_arms")
    scene = UnknownScene(surg_core.load_cell(cell), find_setting(CALIBRATED))
    scene.renderer.close()
    scene.chain.write(cell / "calibration")
    leader, log, out = tmp_path / "slow_hand.py", tmp_path / "log", tmp_path / "out"
    leader.write_text(LEADER)
    done = out / "episode" / "manifest.json"
    words = ["teleop", cell, "--cameras", "stereo", "--setting", setting, "--scale", 1.0]
    words += ["--leader", leader, "--port", master.free_port(), "--out", out]
    words += ["--bind", f"127.0.0.1:{master.free_port()}"]
    with start(log, *words) as process:
        try:
            await when(lambda: process.poll() is not None or done.is_file(), "a recording", 200.0)
            assert process.poll() is None, log.read_text()
            await asyncio.sleep(1.0)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)
    episode = episode_reader.read(out / "episode")
    events = episode.table("events")
    rows = zip(events["topic"], events["text"], strict=True)
    said = [text for topic, text in rows if topic == "/endoscope/drift"]
    tips = np.stack([episode.cycle("PSM1")[f"p_tip_{axis}"] for axis in "xyz"], axis=1)
    print(setting, said, episode.manifest.get("drift"), np.ptp(tips, axis=0))
    logs = Path(log.read_text().partition("Logs: ")[2].partition(". Ctrl-C")[0])
    refused = "on PSM1: the picture is not what was" in (logs / "teleop.log").read_text()
    if setting == RECLAMPED:
        assert any(text.startswith("moved") for text in said)
        assert episode.manifest["drift"]["since_ns"] > 0 and refused
    else:
        assert said[-1].startswith("steady") and "drift" not in episode.manifest and not refused
