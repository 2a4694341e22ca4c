"""Messages of a console page: read exactly, or refused."""

from __future__ import annotations

import json
import random

import numpy as np
import pytest

from surg_console.web import page_protocol

INPUT = {
    "say": "input",
    "seq": 7,
    "at": 12.5,
    "picture_us": 1_795_262_692_265_404,
    "hand": "rate",
    "p": [0.1, -0.2, 0.3],
    "q": [0.0, 0.0, 0.6, 0.8],
    "v": [0.01, 0, -0.02],
    "roll_rate": 1,
    "tilt_x": -0.5,
    "grip": 0.25,
    "clutch": True,
    "camera": False,
}


def test_an_input_is_read_as_it_was_written() -> None:
    said = page_protocol.parse(json.dumps(INPUT))
    assert isinstance(said, page_protocol.Input)
    assert said.seq == 7 and said.picture_us == 1_795_262_692_265_404
    assert said.p == (0.1, -0.2, 0.3) and said.v == (0.01, 0.0, -0.02)
    assert said.q == (0.0, 0.0, 0.6, 0.8)
    assert said.tilt == (-0.5, 0.0)
    assert said.grip == 0.25 and said.clutch and not said.camera


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "invalid JSON"),
        ("[]", "JSON object"),
        ("{}", "say: None"),
        ('{"say": ["input"]}', "say:"),
        ('{"say": "press", "button": "format", "at": 1}', "button: 'format'; allowed: take"),
        ('{"say": "press", "button": "stop"}', "at: None; allowed: a number"),
        ('{"say": "scale", "value": 7}', "value: 7; allowed: 0.05 to 1"),
        ('{"say": "scale", "value": true}', "value: True; allowed: a number"),
        ('{"say": "scale", "value": NaN}', "NaN is not allowed"),
        ('{"say": "scale", "value": 1e999}', "value: inf"),
        pytest.param('{"say": "scale", "value": 1' + "0" * 400 + "}", "value: 1000", id="no float"),
        ('{"say": "watch", "layout": "left", "codec": "vp8"}', "codec: 'vp8'"),
        *(
            (
                f'{{"say": "watch", "layout": "left", "codec": "jpeg", "spacing": {n}}}',
                f"spacing: {n}",
            )
            for n in ("-1", "201", "1.5")
        ),
        ('{"say": "hello", "token": "' + "x" * 300 + '"}', "token"),
        ('{"say": "hello", "tokens": ""}', "unknown key 'tokens'"),
        (json.dumps({**INPUT, "q": [0, 0, 0, 1.01]}), "q: a quaternion of length 1.01; allowed: 1"),
        (json.dumps({**INPUT, "q": [0, 0, 0, 0]}), "q: a quaternion of length 0"),
        (json.dumps({**INPUT, "q": [0, 0, 1]}), "allowed: four numbers"),
        (json.dumps({**INPUT, "squeeze": True}), "squeeze: allowed with hand position and q only"),
        (
            '{"say": "input", "seq": 1, "at": 1, "hand": "position", "squeeze": true}',
            "and q only",
        ),
        (json.dumps({**INPUT, "squeeze": 1, "q": [0, 0, 0, 1]}), "squeeze: 1; allowed: true or"),
        ("[" * 3000, "invalid JSON"),
        ("x" * 5000, "a message of 5000 characters"),
    ],
)
def test_nonsense_is_refused_with_what_is_allowed(text: str, said: str) -> None:
    with pytest.raises(page_protocol.ProtocolError) as caught:
        page_protocol.parse(text)
    assert said in str(caught.value)


def test_broken_inputs_never_get_through() -> None:
    """Every key of an input, replaced by what it must not be."""
    bad = [None, "x", [], {}, True, -1, 1e9, [1, 2], [1, 2, "3"], [1, 2, None], [0, 0, 1e3], 0.5]
    allowed = {
        "grip": [None, 0.5],
        "roll_rate": [-1, 0.5],
        "tilt_x": [-1, 0.5],
        "at": [1e9, 0.5],
    }
    allowed |= {"clutch": [True], "camera": [True], "seq": [], "picture_us": []}
    refused = 0
    for key in set(INPUT) - {"say"}:
        for value in bad:
            if any(
                value is good or (value == good and value is not True)
                for good in allowed.get(key, [])
            ):
                continue
            with pytest.raises(page_protocol.ProtocolError):
                page_protocol.parse(json.dumps({**INPUT, key: value}))
            refused += 1
    print(f"{refused} broken inputs refused")
    assert refused > 100


def test_random_bytes_are_refused() -> None:
    rng = random.Random(1)
    text = json.dumps(INPUT)
    for _ in range(5000):
        at = rng.randrange(len(text))
        broken = text[:at] + chr(rng.randrange(32, 127)) + text[at + rng.randrange(3) :]
        try:
            said = page_protocol.parse(broken)
        except page_protocol.ProtocolError:
            continue
        assert isinstance(said, page_protocol.Input)
        assert np.isfinite([*said.p, *said.v, *said.q, said.roll_rate, said.at]).all()
