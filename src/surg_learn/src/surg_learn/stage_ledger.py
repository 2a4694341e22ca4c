"""Long work in stages: each is done once and timed; interrupted work resumes where it stopped.

A ledger is one JSON file in the folder of the work. It stores the result of each completed stage
and a key of the stage's inputs. A stage with the same key is not repeated. A stage whose key has
changed is repeated, with every stage behind it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from surg_learn.learn_terminal import LearnError

FORMAT = "surg_stages/1"


class Ledger:
    """Results and durations of the stages, in a JSON file that is written when a first stage ends.

    ``resume`` is the command line that resumes the work, for the error message. ``say`` prints.

    Raises:
        LearnError: The file is there and is no ledger.
    """

    def __init__(self, file: Path, resume: str, say: Callable[[str], None] = print) -> None:
        self._file, self._resume, self._say = file, resume, say
        self._stages: dict[str, dict[str, Any]] = {}
        self._before = ""
        if file.exists():
            try:
                content = json.loads(file.read_text("utf-8"))
                if content["format"] != FORMAT:
                    raise ValueError(f"its format is {content['format']!r}, not {FORMAT}")
                self._stages = dict(content["stages"])
            except (ValueError, KeyError, TypeError) as error:
                raise LearnError(
                    f"{file}: not a list of stages ({error}); remove the folder or name another", 2
                ) from error

    @property
    def seconds(self) -> dict[str, float]:
        """Wall time of each stage [s], interrupted attempts included."""
        return {name: round(entry["s"], 2) for name, entry in self._stages.items()}

    def stage(
        self,
        name: str,
        inputs: Any,
        work: Callable[[], Any],
        complete: Callable[[Any], bool] = lambda _: True,
    ) -> Any:
        """Do a stage, unless it is done; returns the result, new or stored.

        Args:
            name: Of the stage.
            inputs: What its result depends on, beside the stages before it; any JSON value.
            work: Does it and returns a JSON value. Must be able to resume.
            complete: Whether a result is complete; otherwise the stage resumes next time.

        Raises:
            LearnError: The stage failed; the text names it, and how to resume.
        """
        words = json.dumps([self._before, name, inputs], sort_keys=True, default=str)
        key = self._before = hashlib.sha256(words.encode()).hexdigest()
        entry = self._stages.get(name)
        if entry is not None and entry["key"] == key and entry["done"]:
            self._say(f"{name}: already done, in {entry['s']:.0f} s")
            return entry["result"]
        spent = entry["s"] if entry is not None and entry["key"] == key else 0.0
        started, result, done = time.monotonic(), None, False
        try:
            result = work()
            done = complete(result)
        except LearnError as problem:
            raise LearnError(
                f"stage '{name}': {problem}\nFinished work is kept. Resume with: {self._resume}",
                problem.code,
            ) from problem
        finally:
            spent += time.monotonic() - started
            self._stages[name] = {"key": key, "s": spent, "done": done, "result": result}
            # A full disk must not hide the error that ended the stage.
            with contextlib.nullcontext() if done else contextlib.suppress(OSError):
                self._write()
        return result

    def _write(self) -> None:
        """Replace the file in one step, so that a reader sees the old or the new text whole."""
        self._file.parent.mkdir(parents=True, exist_ok=True)
        content = {"format": FORMAT, "stages": self._stages}
        whole = self._file.with_name(f".{self._file.name}.partial")
        whole.write_text(json.dumps(content, indent=1, default=str) + "\n", "utf-8")
        whole.replace(self._file)
