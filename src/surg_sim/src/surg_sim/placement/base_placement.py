"""Places two robots beside a patient and writes the cell.

::

    python3 -m surg_sim.placement.base_placement OUT --psm ROBOT.yaml GRASPER.yaml --ecm ROBOT.yaml
    SCOPE.yaml

``placement_search`` describes the search.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import surg_core
from surg_sim.arrays import Array
from surg_sim.physics.sim_arm import tip_in_flange
from surg_sim.physics.trocar import shaft_in_flange
from surg_sim.placement.arm_reserve import ENDOSCOPE, INSTRUMENT, Reserve, inverse, reserve
from surg_sim.placement.placement_search import (
    Placement,
    place_endoscope,
    place_instrument,
    scope_direction,
    scope_pose,
    upright,
)

_OWN_HOME = "its own holds the shaft across the scope's view; this one has as much reserve"
_SCOPE_HOME = "the lenses 100 mm before the instrument's home tip, the picture upright"
_LIMITS = {
    "tip_velocity": (0.05, "m/s; the flange moves six times as fast as the lens"),
    "tip_jerk": (5.0, "m/s^3; a picture must not shake"),
    "roll_velocity": (0.6, "rad/s; the horizon turns with it"),
    "depth_max": (0.16, "m; 310 mm of shaft less the way to the camera head"),
}


@dataclass(frozen=True)
class ArmFiles:
    """The files that describe one arm."""

    robot: Path  # its robot's YAML
    instrument: Path  # its instrument's YAML

    def load(self, name: str, depth: float) -> surg_core.Arm:
        """Load the arm as the only one of a temporary cell."""
        from surg_description.make_cell import make_cell

        with tempfile.TemporaryDirectory() as folder:
            make_cell(self.robot, Path(folder) / "cell", self.instrument, depth, name)
            return surg_core.load_cell(Path(folder) / "cell").arms[name]


def make_two_arm_cell(out: Path, instrument: ArmFiles, scope: ArmFiles) -> str:
    """Place PSM1 with an instrument and ECM with an endoscope, and write the cell.

    The name of the folder is the cell's. Returns a description of the result for people.

    Raises:
        RuntimeError: There is no placement for one of them.
        ValueError: A file cannot be used.
    """
    from surg_description.make_cell import ArmPlan, make_cell_of

    rng = np.random.default_rng(0)
    psm, ecm = instrument.load("PSM1", INSTRUMENT.depth), scope.load("ECM", ENDOSCOPE.depth)
    first = place_instrument(psm, rng)
    second, near = place_endoscope(ecm, psm, first, rng)
    base, yaw, q = _in_first_base(ecm, first, second)
    remaining = reserve(ecm, q, ENDOSCOPE)
    assert remaining is not None  # rounding moved the base by half a millimetre at most
    _, s_F = shaft_in_flange(psm)
    outwards = -(first.X_PB @ np.asarray(psm.chain.forward(first.q)))[:3, :3] @ s_F
    angle = float(np.degrees(np.arccos(outwards @ scope_direction())))
    geometry = (
        f"The shafts meet at {angle:.0f} degrees; a robot comes no nearer to the other arm than "
        f"{1000 * near.home:.0f} mm at home and {1000 * near.corner:.0f} mm in a corner of its box."
    )
    own = bool(np.abs(first.q - np.asarray(psm.robot.home)).max() < 1e-9)
    share = min(1.0, 1.0 / remaining.acceleration)
    acceleration = float(np.floor(100 * ENDOSCOPE.acceleration * share) / 100)
    plans = {
        "PSM1": ArmPlan(
            instrument.robot,
            instrument.instrument,
            INSTRUMENT.depth,
            home=None if own else first.q.tolist(),
            home_reason=_OWN_HOME,
        ),
        "ECM": ArmPlan(
            scope.robot,
            scope.instrument,
            ENDOSCOPE.depth,
            base_xyz=base.tolist(),
            base_rpy=(0.0, 0.0, yaw),
            home=q.tolist(),
            home_reason=_SCOPE_HOME,
            limits={**_LIMITS, "tip_acceleration": (acceleration, "m/s^2; for the same reason")},
        ),
    }
    note = (
        "PSM1 holds the instrument, ECM the endoscope; placed by "
        f"surg_sim.placement.base_placement. {geometry}"
    )
    make_cell_of(out, plans, "\n".join(textwrap.wrap(note, 98)))
    return f"{geometry} Reserve: PSM1 {_describe(first.reserve)}; ECM {_describe(remaining)}."


def _in_first_base(
    ecm: surg_core.Arm, first: Placement, second: Placement
) -> tuple[Array, float, Array]:
    """Base (3,) [m] and yaw [rad] of the second arm in that of the first, rounded as in the file.

    And its joint positions (n,) [rad] for the rounded base.
    """
    X_WP = np.linalg.inv(first.X_PB)
    base = np.round((X_WP @ np.append(second.base, 1.0))[:3], 3)
    yaw = round(second.yaw - first.yaw, 3)
    X_WTip = X_WP @ scope_pose(np.zeros(3), scope_direction())
    X_BF = np.linalg.inv(upright(base, yaw)) @ X_WTip @ np.linalg.inv(tip_in_flange(ecm))
    q = inverse(ecm.chain, second.q, X_BF)
    assert q is not None  # rounding moved the base by half a millimetre at most
    return base, yaw, q


def _describe(remaining: Reserve) -> str:
    return (
        f"{remaining.margin:.2f} rad to a joint's limit, at most {100 * remaining.speed:.0f} % of a"
        f" joint's speed and {100 * remaining.acceleration:.0f} % of its acceleration"
    )


def main(words: Sequence[str] | None = None) -> int:
    """Place two robots beside a patient and write the cell."""
    parser = argparse.ArgumentParser(
        prog="surg_sim.placement.base_placement", description=main.__doc__
    )
    parser.add_argument("out", type=Path, help="folder of the cell to write")
    for option, what in (("--psm", "the instrument"), ("--ecm", "the endoscope")):
        parser.add_argument(
            option,
            nargs=2,
            type=Path,
            required=True,
            metavar=("ROBOT.yaml", "INSTRUMENT.yaml"),
            help=f"robot that holds {what}",
        )
    options = parser.parse_args(words)
    try:
        print(make_two_arm_cell(options.out, ArmFiles(*options.psm), ArmFiles(*options.ecm)))
    except (ValueError, OSError, RuntimeError) as error:
        print(f"surg_sim.placement.base_placement: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
