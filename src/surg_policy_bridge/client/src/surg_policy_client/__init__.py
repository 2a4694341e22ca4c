"""Connects a policy to the platform's model server; no ROS, Python 3.8 to 3.13.

`serve` answers observations with a policy's actions. `RemoteEnv` offers the same as reset and step.
Guide: docs/guide/policy_client.md. Protocol: docs/reference/protocol.md.
"""

# First, because modules below use it.
__version__ = "0.1.0"

from surg_policy_client.chunks import ChunkBlender, RecedingHorizon
from surg_policy_client.env import RemoteEnv
from surg_policy_client.errors import (
    BadAction,
    BadKeys,
    NoServer,
    PolicyClientError,
    Refused,
    SpecMismatch,
    VersionMismatch,
)
from surg_policy_client.observation import Chunk, Observation
from surg_policy_client.seen import Keypoint, Seen, SeenError
from surg_policy_client.serving import Served, serve
from surg_policy_client.spec import ActionSpec, Feature, Spec, SpecError

__all__ = [
    "ActionSpec",
    "BadAction",
    "BadKeys",
    "Chunk",
    "ChunkBlender",
    "Feature",
    "Keypoint",
    "NoServer",
    "Observation",
    "PolicyClientError",
    "RecedingHorizon",
    "Refused",
    "RemoteEnv",
    "Seen",
    "SeenError",
    "Served",
    "Spec",
    "SpecError",
    "SpecMismatch",
    "VersionMismatch",
    "serve",
]
