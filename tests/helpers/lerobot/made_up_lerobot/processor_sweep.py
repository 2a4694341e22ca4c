"""Its pre- and post-processor: lerobot's own."""

from typing import Any

from lerobot.processor import make_default_pre_post_processors


def make_sweep_pre_post_processors(config: Any, dataset_stats: Any = None) -> Any:
    """Both."""
    return make_default_pre_post_processors(config, dataset_stats)
