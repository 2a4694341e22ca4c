"""Long work in stages: each is done once, timed, and said; what was cut off goes on where it ended.

A ledger is one JSON file in the folder of the work. A stage that ended well has a result there, and
the key of what it was made from: the same key, and the stage is not done again. A stage whose key
has changed, and every stage behind it, is done anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from surg_cli.host import paths
from surg_cli.host.terminal import Problem, say

FORMAT = "surg_stages/1"


class Ledger:
    """What has been done, and how long it took.

    Args:
        file: Where it is kept; made when a first stage ends.
        again: How a person goes on after a stage has failed, for the message.

    Raises:
        Problem: The file is there and is no ledger.
    """

    def __init__(self, file: Path, again: str) -> None:
        self._file, self._again = file, again
        self._stages: dict[str, dict[str, Any]] = {}
        self._before = ""
        if file.exists():
            try:
                content = json.loads(file.read_text("utf-8"))
                if content["format"] != FORMAT:
                    raise ValueError(f"its format is {content['format']!r}, not {FORMAT}")
                self._stages = dict(content["stages"])
            except (ValueError, KeyError, TypeError) as error:
                raise Problem(
                    f"{file}: not a list of stages ({error}); remove the folder or name another", 2
                ) from error

    @property
    def seconds(self) -> dict[str, float]:
        """Wall time of each stage, attempts that were cut off included [s]."""
        return {name: round(entry["s"], 2) for name, entry in self._stages.items()}

    def stage(
        self,
        name: str,
        made_of: Any,
        work: Callable[[], Any],
        whole: Callable[[Any], bool] = lambda _: True,
    ) -> Any:
        """Do a stage, unless it is done.

        Args:
            name: Of the stage.
            made_of: What its result depends on beside the stages before it; anything JSON.
            work: Does it; returns what JSON can hold. Must be able to go on after it was cut off.
            whole: Whether a result is all that was wanted; else the stage goes on next time.

        Returns:
            The result, of now or of then.

        Raises:
            Problem: It failed; the text names the stage, and what to do.
        """
        words = json.dumps([self._before, name, made_of], sort_keys=True, default=str)
        key = self._before = hashlib.sha256(words.encode()).hexdigest()
        entry = self._stages.get(name)
        if entry is not None and entry["key"] == key and entry["done"]:
            say(f"{name}: done before, in {entry['s']:.0f} s")
            return entry["result"]
        spent = entry["s"] if entry is not None and entry["key"] == key else 0.0
        started, result, done = time.monotonic(), None, False
        try:
            result = work()
            done = whole(result)
        except Problem as problem:
            raise Problem(
                f"stage '{name}': {problem}\nWhat is done is kept. Go on with: {self._again}",
                problem.code,
            ) from problem
        finally:
            spent += time.monotonic() - started
            self._stages[name] = {"key": key, "s": spent, "done": done, "result": result}
            content = {"format": FORMAT, "stages": self._stages}
            # A full disk must not hide what went wrong before.
            with contextlib.nullcontext() if done else contextlib.suppress(OSError):
                paths.write_text(self._file, json.dumps(content, indent=1, default=str) + "\n")
        return result
