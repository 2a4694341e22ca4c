"""A policy for real-time chunking, without a model: a line along x that ends."""

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig


def _identity() -> dict[str, NormalizationMode]:
    return dict.fromkeys(("STATE", "ACTION", "VISUAL"), NormalizationMode.IDENTITY)


@PreTrainedConfig.register_subclass("sweep")
@dataclass
class SweepConfig(PreTrainedConfig):
    """Rows of a chunk, way of a row [m] and of all [m]."""

    rows: int = 30
    step: float = 0.0004
    length: float = 0.012
    slow_s: float = 0.12
    """How long a chunk takes: two to three periods."""
    normalization_mapping: dict[str, NormalizationMode] = field(default_factory=_identity)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.input_features = {"observation.state": PolicyFeature(FeatureType.STATE, (9,))}
        self.output_features = {"action": PolicyFeature(FeatureType.ACTION, (5,))}

    observation_delta_indices = action_delta_indices = reward_delta_indices = None

    def get_optimizer_preset(self) -> Any:
        """Never trained."""
        raise NotImplementedError

    def get_scheduler_preset(self) -> None:
        """None."""

    def validate_features(self) -> None:
        """Nothing."""
