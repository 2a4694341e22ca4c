"""What earlier versions of the command line called otherwise."""

from __future__ import annotations

COMMANDS = {
    "view": "episode view",
    "film": "episode film",
    "label": "episode label",
    "depth": "episode depth",
    "recover": "episode recover",
    "export": "episode export",
    "import": "episode import",
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

_CAMERAS = {
    "--stereo": "--cameras stereo",
    "--depth": "--cameras depth",
    "--marks": "--cameras marks",
}
_LOSSLESS = {"--video-lossless": "--video-crf lossless"}
_OPTIONS = {
    "demo": {
        "--feedback-gain": "--law open-loop",
        "--task": "./surg run TASK",
        "--full": "./surg learn TASK",
        "--cell": "--robot CELL",
        "--port": "none: it takes a free one",
        "--view": "./surg up CELL --view",
    },
    "run": {
        **_LOSSLESS,
        "--privileged": "--observe privileged",
        "--forces": "--observe forces",
        "--no-film": "none: with a camera a film is made",
    },
    "teleop": {
        **_CAMERAS,
        **_LOSSLESS,
        "--second-leader": "--leader twice",
        "--web-port": "--bind ADDRESS:PORT",
        "--cert": "--tls CERT KEY",
        "--key": "--tls CERT KEY",
    },
    "up": {
        **_CAMERAS,
        **_LOSSLESS,
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
    "episode label": {
        "--no-open": "BROWSER=true before ./surg",
        "--port": "none: it takes a free one",
    },
    "episode depth": {"--near": "--range NEAR FAR", "--far": "--range NEAR FAR"},
    "episode evaluate": {
        "--paper-values": "--reference paper",
        "--incomplete": "--allow incomplete",
    },
    "episode export": {
        "--allow-incomplete": "--allow incomplete",
        "--allow-unsynchronised": "--allow unsynchronised",
        "--executor": "--workers 1, --workers N or --workers dask",
        "--scheduler": "--workers ADDRESS",
        "--merge": "--shard merge",
        "--split-by": "--splits hash",
        "--dry-run": "no --out: then nothing is written",
        **dict.fromkeys(
            ("--max-image-age", "--max-gap", "--crf", "--gop", "--preset", "--keep-parts"),
            "surg_recording.datasets.ExportOptions in Python",
        ),
    },
    "learn": {"--looks": "--domain-randomization"},
    "policy keys": {"--policy": "./surg policy keys NAME"},
    "calibrate": {
        "--motion": "./surg calibrate CELL collect MOTION",
        "--other": "--arm",
        "--other-from": "--from FILE FILE",
        "--squares": "--board CxRxMM",
        "--square": "--board CxRxMM",
        "--out": "--to",
        "--keep": "cp -r FOLDER CELL/calibration/views",
        "--timeout": "none: it waits for 10 minutes",
        "--seconds": "none: it measures for 20 seconds",
        "--date": "none: it is today's",
    },
    "check-frames": {"--port": "none: it finds the running system of the cell"},
    "robot": {"--timeout": "none: it waits for one minute"},
    "robot home": {"--seed": "none: the search is repeatable"},
    "emulate": {
        "--cell": "./surg emulate CELL",
        "--model": "./surg emulate ur3e, ur5e or ur10e",
        "--seconds": "timeout S before ./surg",
        **dict.fromkeys(
            ("--ports", "--record", "--serial", "--q", "--off"),
            "that of python3 -m surg_emulators.ur.ur_emulator or …franka.franka_emulator",
        ),
        "--lock-step": "none: its cycles follow the clock",
    },
    "ptp": {
        "--interface": "./surg ptp master|slave INTERFACE",
        "--folder": "none: it is /run/surg_ptp",
    },
    "dev build": {
        "--all": "./surg dev setup --all",
        "--force": "rm -r build, then ./surg dev build",
    },
    "test": {"--coverage": "python3 -m pytest --cov, in ./surg dev shell"},
    "dev topics": {"--write": "none: it writes the page"},
    "dev shell": {"--port": "export ROS_MASTER_URI in the shell"},
    "dev doctor": {
        "--robot": "./surg robot CELL doctor",
        "--arm": "./surg robot CELL doctor --arm",
        "--seconds": "./surg robot CELL doctor",
    },
}
OPTIONS = {(name, option): now for name, of in _OPTIONS.items() for option, now in of.items()}
"""(command, option) -> what does the same now."""
ARGUMENTS = {
    ("emulate", "ur"): "ur5e, ur3e, ur10e, or a cell",
    ("emulate", "fer"): "panda, or a cell",
}
"""(command, argument) -> what it is now."""
