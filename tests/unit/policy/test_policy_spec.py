"""The specification: read strictly, compared in words that name both sides."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from helpers.policy.policy_server import spec
from surg_policy_client import Feature, Spec, SpecError


def test_a_spec_survives_the_way_through_a_map() -> None:
    for each in (spec(), spec(pictures=True), Spec(), Spec.of_keys(["observation.state"])):
        assert Spec.from_map(each.to_map()) == each


def test_keys_alone_match_whatever_they_are_like() -> None:
    served = spec(pictures=True)
    assert Spec().mismatches(served) == []
    assert Spec.of_keys(["observation.state"]).mismatches(served) == []
    assert served.mismatches(served) == []


def other(**changes: Any) -> Spec:
    """The spec with another feature."""
    key = "observation.state"
    feature = dataclasses.replace(spec().observation[key], **changes)
    return dataclasses.replace(spec(), observation={key: feature})


def acting(**changes: Any) -> Spec:
    action = spec().action
    assert action is not None
    return Spec(action=dataclasses.replace(action, **changes))


@pytest.mark.parametrize(
    ("wants", "words"),
    [
        (Spec(task="pick_and_place"), ("task", "'pick_and_place'", "'bgr'")),
        (Spec(period_s=0.1), ("period_s", "0.1", "0.05")),
        (Spec.of_keys(["observation.images.side"]), ("images.side", "observation.state")),
        (other(shape=(14,)), ("observation.state, shape", "(14,)", "(9,)")),
        (other(dtype="f8"), ("observation.state, dtype", "'f8'", "'f4'")),
        (other(unit="mm"), ("observation.state, unit", "'mm'", "'m,m,m")),
        (other(frame="world"), ("observation.state, frame", "'world'", "'rcm'")),
        (acting(frame="base"), ("action, frame", "'base'", "'rcm'")),
        (acting(units=("mm",) * 5), ("action, units", "'mm'", "'rad'")),
        (acting(names=tuple("abcde")), ("action, names", "'a'", "'PSM1/x'")),
    ],
)
def test_a_mismatch_names_both_sides(wants: Spec, words: tuple[str, ...]) -> None:
    (found,) = wants.mismatches(spec())
    assert all(word in found for word in words), found


def test_limits_are_the_servers_to_say() -> None:
    assert acting(low=(0.0,) * 5, high=None).mismatches(spec()) == []


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("period_s",), 0, "more than 0"),
        (("period_s",), float("inf"), "finite"),
        (("period_s",), True, "finite"),
        (("task",), "", "1 to 256"),
        (("task",), 5, "1 to 256"),
        (("observation",), [], "a map"),
        (("observation",), {str(i): {} for i in range(65)}, "at most 64"),
        (("observation", "observation.state", "dtype"), "f2", "one of u1"),
        (("observation", "observation.state", "dtype"), [], "one of u1"),
        (("observation", "observation.state", "shape"), [0], "sides"),
        (("observation", "observation.state", "shape"), [1] * 5, "sides"),
        (("observation", "observation.state", "shape"), "9", "a list"),
        (("observation", "observation.state", "names"), [1], "1 to 256"),
        (("observation", "observation.state", "privileged"), 0, "true or false"),
        (("observation", "observation.state", "more"), 0, "exactly the keys"),
        (("action", "names"), [], "at least one"),
        (("action", "names"), ["x"] * 5, "each once"),
        (("action", "units"), ["m"], "1 for 5"),
        (("action", "low"), [0.0], "1 for 5"),
        (("action", "high"), [float("nan")] * 5, "finite"),
        (("action",), 3, "a map"),
    ],
)
def test_a_spec_that_is_wrong_is_refused_with_its_place(path: Any, value: Any, said: str) -> None:
    top = spec().to_map()
    inside = top
    for key in path[:-1]:
        inside = inside[key]
    inside[path[-1]] = value
    with pytest.raises(SpecError, match=said) as caught:
        Spec.from_map(top)
    assert "spec." + ".".join(path[:2]) in str(caught.value) or path[0] in str(caught.value)


def test_a_server_has_to_say_everything() -> None:
    assert spec().served() == spec()
    with pytest.raises(SpecError, match=r"task, period_s, action, observation\.x\.dtype"):
        Spec(observation={"x": Feature()}).served()
    with pytest.raises(SpecError, match="observation"):
        dataclasses.replace(spec(), observation={}).served()


def test_observations_and_chunks_are_held_against_it() -> None:
    good = {k: np.zeros(f.shape or (), f.dtype) for k, f in spec().observation.items()}
    assert spec().check_observation(good) == []
    state = "observation.state"
    assert "missing" in spec().check_observation({})[0]
    assert "(8,)" in spec().check_observation({**good, state: np.zeros(8, "f4")})[0]
    assert "f8" in spec().check_observation({**good, state: np.zeros(9)})[0]
    assert "not in the spec" in spec().check_observation({**good, "x": np.zeros(1)})[0]
    assert spec().check_chunk(np.zeros((3, 5))) == []
    assert spec().check_chunk(np.zeros((0, 5))) == []
    for shape in ((5,), (3, 4), (1, 1, 5)):
        assert "a chunk is [K, 5] (PSM1/x" in spec().check_chunk(np.zeros(shape))[0]
    chunk = np.zeros((3, 5))
    chunk[1, 3] = np.nan
    assert spec().check_chunk(chunk) == ["row 1, PSM1/roll is nan; allowed: finite numbers"]
