"""Runs somebody's script as it is: `python public_script_run.py SCRIPT WORDS…`.

The script does not see a difference. Its last line of output states how often it waited for a
move, how often in vain, and for how long, because such scripts ignore what ``wait()`` returns.
"""

from __future__ import annotations

import atexit
import json
import os
import runpy
import sys
import time
from typing import Any

HEAD = "waits: "
FOUND = {"waits": 0, "in_vain": 0, "longest": 0.0}


def count(plain: Any) -> Any:
    """``wait()`` that counts."""

    def wait(handle: Any, is_busy: bool = False, timeout: float = 30.0) -> bool:
        began = time.monotonic()
        done = bool(plain(handle, is_busy, timeout))
        FOUND["waits"] += 1
        FOUND["in_vain"] += not done
        FOUND["longest"] = max(FOUND["longest"], time.monotonic() - began)
        return done

    return wait


if __name__ == "__main__":
    import crtk

    crtk.wait_move_handle.wait = count(crtk.wait_move_handle.wait)
    atexit.register(lambda: print(f"\n{HEAD}{json.dumps(FOUND)}", flush=True))
    sys.argv = sys.argv[1:]
    sys.path[0] = os.path.dirname(sys.argv[0])
    runpy.run_path(sys.argv[0], run_name="__main__")
