"""The bundled emulated cells at another address, and what an emulated UR5e did by its record."""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import surg_core
from surg_cli.host import paths
from surg_emulators.ur.dh_kinematics import TABLES, Table, frames

BUNDLED = paths.CELLS / "emulated_ur5e"
SERIAL = "20225500001"
TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""From ROS's base to UR's own."""
HOME = surg_core.load_cell(BUNDLED).arms["PSM1"].robot.home


def emulated_cell(
    folder: Path,
    address: str = "127.0.0.1",
    name: str = "ur5e",
    edit: Callable[[dict[str, Any]], object] = lambda arm: None,
    **hardware: object,
) -> Path:
    """A copy of a bundled cell at another address; returns its folder.

    Args:
        folder: Where `cell` is made.
        address: Of the emulated arm.
        name: Of the cell `emulated_<name>`.
        edit: Changes what the cell says of its arm, at last.
        hardware: Other keys of `hardware:`.
    """
    bundled = paths.CELLS / f"emulated_{name}"
    cell = folder / "cell"
    shutil.copytree(bundled, cell)
    document = yaml.safe_load((cell / "cell.yaml").read_text("utf-8"))
    arm = document["arms"]["PSM1"]
    arm["hardware"].update(hardware, address=address)
    for key in ("robot", "instrument"):
        arm[key] = os.path.normpath(bundled / arm[key])
    edit(arm)
    (cell / "cell.yaml").write_text(yaml.safe_dump(document), "utf-8")
    return cell


def ur_flange(q: Sequence[float], table: Table = TABLES["UR5e"]) -> np.ndarray:
    """Pose of a UR's flange in our base (4, 4), by its joints [rad] and its maker's table."""
    return np.array(TURN @ frames(q, table)[-1])


def tip_of(arm: surg_core.Arm, X_BF: np.ndarray) -> np.ndarray:
    """Positions of the tip in the base [m], (..., 3), by poses of the flange (..., 4, 4)."""
    return np.array(X_BF[..., :3, :3] @ arm.tool.p_FTip + X_BF[..., :3, 3])


def deviation(arm: surg_core.Arm, X_BF: np.ndarray) -> np.ndarray:
    """Of the shaft from the trocar [m], (...), by poses of the flange (..., 4, 4)."""
    away = arm.trocar.p_BRcm - tip_of(arm, X_BF)
    s = X_BF[..., :3, :3] @ arm.tool.s_F
    along = np.sum(away * s, axis=-1, keepdims=True)
    return np.asarray(np.linalg.norm(away - along * s, axis=-1))


@dataclass(frozen=True)
class Recorded:
    """What an emulated arm did, one row per cycle: steady clock [s], true joints and velocities."""

    monotonic: np.ndarray
    q: np.ndarray
    target_qd: np.ndarray

    @staticmethod
    def of(file: Path) -> Recorded:
        """Read the emulator's record; an unfinished last row is left out."""
        with file.open(encoding="utf-8") as stream:
            rows = list(csv.reader(stream))
        names, rows = rows[0], [row for row in rows[1:] if len(row) == len(rows[0])][:-1]
        values = np.array(rows, dtype=np.float64)
        at = [names.index(f"q{n}") for n in range(1, 7)]
        speeds = [names.index(f"target_qd{n}") for n in range(1, 7)]
        return Recorded(values[:, names.index("monotonic")], values[:, at], values[:, speeds])

    def deviations(self) -> np.ndarray:
        """Of the shaft from the trocar [m] in every fifth cycle, by the maker's table."""
        arm = surg_core.load_cell(BUNDLED).arms["PSM1"]
        return deviation(arm, np.array([ur_flange(q) for q in self.q[::5]]))

    def rest_after(self, moment: float, least: float = 1e-3) -> float:
        """Time from a moment of the steady clock until no joint moves any more [s]."""
        speed = np.abs(np.diff(self.q, axis=0)).max(axis=1) / 0.002
        moving = self.monotonic[1:][(speed > least) & (self.monotonic[1:] > moment)]
        return float(moving[-1] - moment) if len(moving) else 0.0
