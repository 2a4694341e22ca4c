"""What version 0.1.0 of the command line called otherwise."""

from __future__ import annotations

COMMANDS = {
    "view": "episode view",
    "recover": "episode recover",
    "export": "episode export",
    "evaluate": "episode evaluate",
    "keys": "policy keys",
    "setup": "dev setup",
    "build": "dev build",
    "bench": "dev bench",
    "shell": "dev shell",
    "doctor": "dev doctor",
    "topics": "dev topics",
}
"""Old name -> new name."""

_OPTIONS = {
    "demo": {
        "--feedback-gain": "--law open-loop",
        "--task": "./surg run TASK",
        "--full": "./surg learn TASK",
        "--port": "none: it takes a free one",
        "--view": "./surg up CELL --view",
    },
    "run": {"--privileged": "--observe privileged"},
    "teleop": {
        "--stereo": "--cameras stereo",
        "--second-leader": "--leader twice",
        "--web-port": "--bind ADDRESS:PORT",
        "--cert": "--tls CERT KEY",
        "--key": "--tls CERT KEY",
    },
    "up": {
        "--stereo": "--cameras stereo",
        "--no-video": "--cameras none",
        "--participant": "--lock-step NODE",
        "--link": "the robot's YAML, or ./surg demo --link",
        "--seed": "./surg demo --seed or ./surg teleop --seed",
    },
    "record": {
        "--operator": "--info operator=NAME",
        "--task": "--info task=NAME",
        "--setting": "--info setting=NAME",
        "--seed": "--info seed=N",
        "--success": "--outcome success",
        "--failure": "--outcome WHY",
    },
    "episode view": {"--no-open": "BROWSER=true before ./surg"},
    "episode evaluate": {"--incomplete": "--allow incomplete"},
    "episode export": {
        "--allow-incomplete": "--allow incomplete",
        "--allow-unsynchronised": "--allow unsynchronised",
        "--executor": "--workers 1, --workers N or --workers dask",
        "--scheduler": "--workers ADDRESS",
        "--merge": "--shard merge",
        "--dry-run": "no --out: then nothing is written",
        **dict.fromkeys(
            ("--max-image-age", "--max-gap", "--crf", "--gop", "--preset", "--keep-parts"),
            "surg_recording.datasets.ExportOptions in Python",
        ),
    },
    "policy keys": {"--policy": "./surg policy keys NAME"},
    "calibrate": {
        "--motion": "./surg calibrate CELL collect MOTION",
        "--timeout": "none: it waits for 10 minutes",
        "--date": "none: it is today's",
    },
    "check-frames": {"--port": "none: it finds the running system of the cell"},
    "ptp": {
        "--interface": "./surg ptp master|slave INTERFACE",
        "--folder": "none: it is /run/surg_ptp",
    },
    "dev build": {"--force": "rm -r build, then ./surg dev build"},
    "test": {"--coverage": "python3 -m pytest --cov, in ./surg dev shell"},
    "dev topics": {"--write": "none: it writes the page"},
    "dev shell": {"--port": "export ROS_MASTER_URI in the shell"},
}
OPTIONS = {(name, option): now for name, of in _OPTIONS.items() for option, now in of.items()}
"""(command, option) -> what does the same now."""
