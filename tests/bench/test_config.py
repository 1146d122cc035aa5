"""Options of a method: defaults, preset, --set; types and suggestions."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Literal

import pytest

from panobench.bench.run.config import config_values, method_config, option_names, override, parse_settings
from panobench.errors import UnknownNameError, UsageError
from panobench.specs import MethodSpec


class Mode(enum.Enum):
    FAST = "fast"
    SLOW = "slow"


@dataclass(frozen=True)
class Inner:
    gain: float = 0.5
    steps: tuple[int, ...] = (1, 2)


@dataclass(frozen=True)
class Options:
    count: int = 3
    rate: float = 1.0
    on: bool = False
    name: str | None = None
    limit: float | None = 2.0
    size: tuple[int, float] = (1, 2.0)
    mode: Mode = Mode.FAST
    solver: Literal["adam", "gauss-newton"] = "adam"
    text: str = "x"
    inner: Inner = field(default_factory=Inner)


@pytest.mark.parametrize(
    ("key", "text", "expected"),
    [
        ("count", "7", 7),
        ("count", "1e3", 1000),
        ("rate", "2", 2.0),
        ("rate", 3, 3.0),
        ("on", "yes", True),
        ("on", "0", False),
        ("on", True, True),
        ("name", "none", None),
        ("name", "abc", "abc"),
        ("limit", "null", None),
        ("limit", "0.25", 0.25),
        ("size", "4,5", (4, 5.0)),
        ("size", [4, 5], (4, 5.0)),
        ("mode", "slow", Mode.SLOW),
        ("solver", "gauss-newton", "gauss-newton"),
        ("text", "12", "12"),
    ],
)
def test_values_take_the_type_of_the_option(key: str, text: object, expected: object) -> None:
    value = getattr(override(Options(), {key: text}, "option"), key)
    assert value == expected
    assert type(value) is type(expected)


def test_nested_options_are_dotted_or_nested() -> None:
    dotted = override(Options(), {"inner.gain": "0.1", "inner.steps": "3,4,5"}, "option")
    nested = override(Options(), {"inner": {"gain": 0.1, "steps": [3, 4, 5]}}, "option")
    assert dotted == nested
    assert dotted.inner == Inner(0.1, (3, 4, 5))
    assert "inner.gain" in option_names(Options())


@pytest.mark.parametrize(
    ("key", "text", "says"),
    [
        ("count", "3.5", "a whole number"),
        ("count", "inf", "a whole number"),
        ("count", "true", "a whole number"),
        ("rate", "fast", "a number"),
        ("on", "2", "true or false"),
        ("size", "1,2,3", "2 values"),
        ("mode", "medium", "one of fast, slow"),
        ("solver", "sgd", "one of adam, gauss-newton"),
        ("inner.steps", "1,x", "inner.steps"),
    ],
)
def test_a_value_of_the_wrong_type_says_what_is_expected(key: str, text: str, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        override(Options(), {key: text}, "option")


@pytest.mark.parametrize(("key", "hint"), [("cuont", "count"), ("inner.gian", "inner.gain"), ("count.x", "count")])
def test_unknown_keys_suggest_the_nearest(key: str, hint: str) -> None:
    with pytest.raises(UnknownNameError, match=f"did you mean '{hint}'"):
        override(Options(), {key: 1}, "option")


@dataclass(frozen=True)
class Checked:
    n: int = 1

    def __post_init__(self) -> None:
        if self.n < 1:
            raise ValueError("n must be positive")


def _spec() -> MethodSpec:
    return MethodSpec("m", "", "x:Y", config=f"{__name__}:Checked", presets={"big": {"n": 100}, "typo": {"nn": 1}})


def test_settings_win_over_the_preset_and_the_preset_over_defaults() -> None:
    assert method_config(_spec()).n == 1
    assert method_config(_spec(), "default").n == 1
    assert method_config(_spec(), "big").n == 100
    assert method_config(_spec(), "big", {"n": "5"}).n == 5


def test_wrong_presets_and_refused_values_are_usage_errors() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'big'"):
        method_config(_spec(), "bigg")
    with pytest.raises(UnknownNameError, match="preset 'typo'"):
        method_config(_spec(), "typo")
    with pytest.raises(UsageError, match="n must be positive"):
        method_config(_spec(), None, {"n": 0})
    with pytest.raises(UnknownNameError, match="known: none"):
        method_config(MethodSpec("m", "", "x:Y"), None, {"n": 0})


def test_parse_settings() -> None:
    assert parse_settings(["a=1", "b.c=x=y", "d="]) == {"a": "1", "b.c": "x=y", "d": ""}
    with pytest.raises(UsageError, match="KEY=VALUE"):
        parse_settings(["oops"])


def test_config_values_are_plain() -> None:
    values = config_values(Options())
    assert values["mode"] == "fast"
    assert values["size"] == [1, 2.0]
    assert values["inner"] == {"gain": 0.5, "steps": [1, 2]}
    assert config_values(None) == {}
