"""The file of a score card: what follows from what, its hash, its page."""

from __future__ import annotations

import copy
import hashlib
import json
import math
from pathlib import Path
from typing import Any

import pytest

from surg_recording.cards import score_card, score_card_page
from surg_recording.recording_errors import EpisodeError


def episode(seed: int, success: bool, reason: str = "", **numbers: float) -> dict[str, Any]:
    counts = dict.fromkeys(score_card.COUNTS, 1)
    measured = {**dict.fromkeys(score_card.MEASURES), **numbers}
    rejected = {} if success else {"workspace": 3}
    told = {"seed": seed, "success": success, "reason": reason, "phase": "", "rejected": rejected}
    return {**told, **measured, **counts, "state_hash": None}


def made() -> dict[str, Any]:
    served = [{"key": "observation.state", "dtype": "f4", "shape": [9], "privileged": False}]
    episodes = [
        episode(20000, True, duration_s=2.0, rcm_max_m=1e-5),
        episode(20001, False, "no answer", duration_s=4.0),
    ]
    cells = [
        score_card.cell("bgr", name, blind, {"served": served, "episodes": episodes})
        for name, blind in (("as served", False), ("zeroed observations", True))
    ]
    policy = {"name": "mine.py", "sha256": "0" * 64, "shut_in": True}
    return score_card.card("quick", policy, {"software": "1"}, [20000, 20001], cells)


def test_a_cell_is_what_its_episodes_are() -> None:
    cell = made()["cells"][0]
    assert (cell["n"], cell["k"], cell["failures"]) == (2, 1, {"no answer": 1})
    # Wilson's interval of 1 of 2 by hand: z = 1.96, centre 0.5, half width z / (2 sqrt(2 + z^2)).
    half = 1.959964 / (2.0 * math.sqrt(2.0 + 1.959964**2))
    assert cell["low"] == pytest.approx(0.5 - half, abs=1e-6)
    assert cell["high"] == pytest.approx(0.5 + half, abs=1e-6)
    assert cell["means"]["duration_s"] == 3.0 and cell["means"]["rcm_max_m"] == 1e-5
    assert cell["means"]["tip_force_max_n"] is None
    assert cell["rejected"] == {"workspace": 3} and cell["counts"]["clipped"] == 2


def test_the_hash_is_of_everything_but_the_machine() -> None:
    card = made()
    kept = {key: card[key] for key in card if key not in ("machine", "sha256")}
    words = json.dumps(kept, sort_keys=True, separators=(",", ":"))
    assert card["sha256"] == hashlib.sha256(words.encode()).hexdigest()
    read = json.loads(json.dumps({**card, "machine": {"cores": 2}}))
    score_card.check("card.json", read)


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("format",), "surg_card/9", "format, kind: 'surg_card/9'"),
        (("cells",), {}, "cells: {}; allowed: list"),
        (("cells", 0, "k"), 2, r"cells\[0\].k: 2; its episodes give 1"),
        (("cells", 0, "k"), True, r"cells\[0\].k: True; allowed: int"),
        (("cells", 0, "means", "path_m"), 1.0, r"cells\[0\].means"),
        (("cells", 1, "episodes", 0, "sparc"), "x", r"episodes\[0\].sparc: 'x'; allowed: a finite"),
        (("cells", 1, "episodes", 0, "late"), None, r"episodes\[0\].late: None; allowed: int"),
        (("seeds",), [1, 2], "the card's are"),
        (("policy", "name"), "another.py", "sha256: .*; its content has"),
        (("policy", "name"), ["mine.py"], r"policy.name: \['mine.py'\]; allowed: str"),
        (("policy", "shut_in"), None, "policy.shut_in: None; allowed: bool"),
        (("cells", 0, "served", 0), 5, r"cells\[0\].served\[0\]: int; allowed: an object"),
        (("cells", 0, "served", 0, "privileged"), 0, r"privileged: 0; allowed: bool"),
        (("cells", 0, "task"), "../../bgr", r"cells\[0\].task: '../../bgr'; allowed: letters"),
        (("cells", 1, "episodes", 0, "sparc"), 10**400, "allowed: a finite number"),
    ],
)
def test_a_card_that_was_changed_is_refused(place: tuple[Any, ...], value: Any, said: str) -> None:
    card = copy.deepcopy(made())
    at: Any = card
    for key in place[:-1]:
        at = at[key]
    at[place[-1]] = value
    with pytest.raises(EpisodeError, match=said):
        score_card.check("card.json", card)


def test_a_page_shows_policies_beside_each_other(tmp_path: Path) -> None:
    first, second = made(), made()
    second["policy"]["name"] = "<other>"
    page = score_card_page.write([first, second], tmp_path).read_text("utf-8")
    assert page.count("1 of 2 (95 % interval") == 4
    assert "&lt;other&gt;" in page and "<other>" not in page
    assert "software 1" in page
    assert first["sha256"] in page and "observation.state" in page and "no answer" in page
    assert (tmp_path / "figures/bgr.png").is_file()
