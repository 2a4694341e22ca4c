"""Which topics of a bag hold the motion of which arm: a map from YAML, or dVRK's names."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping
from typing import Any

from surg_recording.recording_errors import EpisodeError

ARM_TOPICS = {
    "measured_cp": "{arm}/measured_cp",
    "measured_js": "{arm}/measured_js",
    "jaw": "{arm}/jaw/measured_js",
    "goal_cp": "{arm}/setpoint_cp",
    "goal_jaw": "{arm}/jaw/setpoint_js",
}
"""Keys of an arm in a map, with the topics of CRTK (dVRK 2). Only ``measured_cp`` is required."""
FACTS = ("task", "operator", "setting", "instruction")
DVRK_ARMS = ("PSM1", "PSM2", "PSM3")
ARM_FACTS = ("rcm", "rcm_rpy", "robot", "instrument")
OUT_OF_THE_PATIENT = (math.pi, 0.0, 0.0)
"""Default of ``rcm_rpy``: the base's z points out of the patient, as that of dVRK's PSM does."""


@dataclasses.dataclass(frozen=True)
class ArmTopics:
    """Topics and facts of one arm."""

    name: str
    topics: Mapping[str, str]
    """Key of ``ARM_TOPICS`` → topic."""
    rcm: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Trocar in the frame of ``measured_cp`` [m]; dVRK's PSM measures from it."""
    rcm_rpy: tuple[float, ...] = OUT_OF_THE_PATIENT
    robot: str = "dvrk_psm"
    instrument: str = "unknown"


@dataclasses.dataclass(frozen=True)
class BagMap:
    """What of a bag becomes an episode."""

    arms: tuple[ArmTopics, ...]
    cameras: Mapping[str, str]
    """Name of the camera → image topic."""
    facts: Mapping[str, Any]


def of_yaml(stated: Any) -> BagMap:
    """A map from the content of its YAML file; an EpisodeError names key and value."""
    keys = {"arms", "cameras", *FACTS}
    if not isinstance(stated, Mapping) or set(stated) - keys or not stated.get("arms"):
        raise EpisodeError(f"--map: keys are {', '.join(sorted(keys))}; 'arms' is needed")
    arms = []
    for name, entry in stated["arms"].items():
        allowed = {*ARM_TOPICS, *ARM_FACTS}
        if not isinstance(entry, Mapping) or set(entry) - allowed or "measured_cp" not in entry:
            raise EpisodeError(
                f"--map, arms.{name}: keys are {', '.join(sorted(allowed))};"
                " 'measured_cp' is needed"
            )
        topics = {key: str(entry[key]) for key in ARM_TOPICS if entry.get(key)}
        about: dict[str, Any] = {k: str(entry[k]) for k in ("robot", "instrument") if k in entry}
        for key in ("rcm", "rcm_rpy"):
            if key in entry:
                about[key] = three(entry[key], f"--map, arms.{name}.{key}")
        arms.append(ArmTopics(str(name), topics, **about))
    cameras = stated.get("cameras") or {}
    if not isinstance(cameras, Mapping):
        raise EpisodeError("--map, cameras: names with image topics are needed")
    named = {str(camera): str(topic) for camera, topic in cameras.items()}
    return BagMap(tuple(arms), named, {key: stated[key] for key in FACTS if stated.get(key)})


def of_dvrk(topics: Mapping[str, str]) -> BagMap:
    """A map for the arms of dVRK in a bag, whose topics and types these are.

    Raises:
        EpisodeError: There is none.
    """
    arms = []
    for name in DVRK_ARMS:
        named = {key: "/" + topic.format(arm=name) for key, topic in ARM_TOPICS.items()}
        if named["measured_cp"] in topics:
            found = {key: topic for key, topic in named.items() if topic in topics}
            arms.append(ArmTopics(name, found))
    if not arms:
        raise EpisodeError(
            f"no topic /PSM1/measured_cp; there are {', '.join(sorted(topics)) or 'none'};"
            " --map FILE names the topics"
        )
    return BagMap(tuple(arms), _cameras(topics), {})


def _cameras(topics: Mapping[str, str]) -> dict[str, str]:
    """The image topics, named as the recorder names them; one per camera."""
    images = {"sensor_msgs/Image", "sensor_msgs/CompressedImage"}
    found: dict[str, str] = {}
    for topic, kind in sorted(topics.items()):
        if kind in images:
            stem = topic.removesuffix("/compressed").removesuffix("/image_raw")
            found.setdefault(stem.strip("/").replace("/", "_"), topic)
    return found


def three(value: Any, where: str) -> tuple[float, ...]:
    """Three numbers of a map; an EpisodeError names the key."""
    good = isinstance(value, Collection) and len(value) == 3
    if not good or not all(isinstance(v, (int, float)) and math.isfinite(v) for v in value):
        raise EpisodeError(f"{where}: {value!r}; three numbers are needed")
    return tuple(float(v) for v in value)
