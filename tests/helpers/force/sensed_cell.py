"""The cell sim_ur5e with a simulated force sensor at the flange, calibrated on the bench."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import surg_core
from helpers.force.force_bench import ForceBench
from helpers.force.loaded_arm import SENSOR
from surg_cli.host import paths
from surg_cli.robots import force_steps


def write(folder: Path) -> Path:
    """Write the cell into an empty folder; returns it."""
    source = paths.ROOT / "cells" / "sim_ur5e"
    shutil.copytree(source / "calibration", folder / "calibration")
    text = (source / "cell.yaml").read_text("utf-8")
    text = text.replace("../../", f"{paths.ROOT}/")
    (folder / "cell.yaml").write_text(text, encoding="utf-8")
    shutil.copy(SENSOR, folder / "force_sensor_PSM1.yaml")
    cell = surg_core.load_cell(folder)
    file = folder / "postures.csv"
    ForceBench(cell, "PSM1", 1).record(file, 16)
    options = argparse.Namespace(what="force", source=file, dry_run=False)
    force_steps.run(folder, cell.arms["PSM1"], options, "simulated", "2026-11-23")
    return folder
