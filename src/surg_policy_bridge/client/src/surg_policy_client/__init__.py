"""Connects a policy to the platform's model server; no ROS, Python 3.8 to 3.13.

`serve` answers observations with a policy's actions. `RemoteEnv` offers the same as reset and step.
Guide: docs/guide/policy_client.md. Protocol: docs/reference/protocol.md.
"""

from surg_policy_client.action_spec import ActionSpec
from surg_policy_client.attention import Attention, AttentionError, Keypoint
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
from surg_policy_client.serving import Served, serve
from surg_policy_client.spec import Feature, Spec, SpecError
from surg_policy_client.version import __version__

__all__ = [
    "ActionSpec",
    "Attention",
    "AttentionError",
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
    "Served",
    "Spec",
    "SpecError",
    "SpecMismatch",
    "VersionMismatch",
    "__version__",
    "serve",
]
