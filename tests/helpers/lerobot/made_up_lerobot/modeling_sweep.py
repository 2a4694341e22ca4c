"""The policy; as a program it writes a checkpoint: ``python -m … FOLDER``."""

import sys
import time
from pathlib import Path
from typing import Any

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from made_up_lerobot.configuration_sweep import SweepConfig
from made_up_lerobot.processor_sweep import make_sweep_pre_post_processors

HELD = (5, 6, 7, 8, 4)
"""Columns of `observation.state` with set-point, roll and jaw."""


class SweepPolicy(PreTrainedPolicy):
    """Rows that are sure to be played, as the prefix says, stay; the line goes on behind them."""

    config_class, name = SweepConfig, "sweep"

    def __init__(self, config: SweepConfig, **_: Any) -> None:
        super().__init__(config)
        self.nothing = torch.nn.Parameter(torch.zeros(1))
        self._end: torch.Tensor | None = None

    def supports_rtc(self) -> bool:
        """It does."""
        return True

    def reset(self) -> None:
        """A new line."""
        self._end = None

    def predict_action_chunk(
        self,
        batch: dict[str, torch.Tensor],
        inference_delay: int = 0,
        prev_chunk_left_over: torch.Tensor | None = None,
        **_: Any,
    ) -> torch.Tensor:
        """(1, rows, 5)."""
        time.sleep(self.config.slow_s)
        held = batch["observation.state"][0, list(HELD)].clone()
        if self._end is None:
            self._end = held[0] + self.config.length
        kept = [] if prev_chunk_left_over is None else list(prev_chunk_left_over[:inference_delay])
        rows = [row for row in kept if row.abs().sum() > 0]  # it is filled up with zeros
        last = rows[-1] if rows else held
        while len(rows) < self.config.rows:
            last = last.clone()
            last[0] = torch.minimum(last[0] + self.config.step, self._end)
            rows.append(last)
        return torch.stack(rows)[None]

    def select_action(self, batch: dict[str, torch.Tensor], **_: Any) -> torch.Tensor:
        """The first row."""
        return self.predict_action_chunk(batch)[:, 0]

    def forward(self, batch: dict[str, torch.Tensor]) -> Any:
        """Never trained."""
        raise NotImplementedError

    def get_optim_params(self) -> dict[str, Any]:
        """None."""
        return {}


if __name__ == "__main__":
    folder, made = Path(sys.argv[1]), SweepConfig(device="cpu", push_to_hub=False)
    SweepPolicy(made).save_pretrained(folder)
    for processor in make_sweep_pre_post_processors(made):
        processor.save_pretrained(folder)
