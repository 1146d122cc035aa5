"""Options with documentation: bounds, stages, names that --set does not know."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import pytest

from panobench.bench.run.config import method_config, override
from panobench.errors import UnknownNameError, UsageError
from panobench.options import OptionError, Options, describe_options, nearest_options, option, option_names
from panobench.specs import MethodSpec


@dataclass(frozen=True)
class Tracking(Options):
    """Tracking of a frame.

    More about it.
    """

    iterations: int = option(15, "steps of the solver", above=0)
    huber: float = option(1.0, "where the loss turns linear", unit="px", above=0)


@dataclass(frozen=True)
class Mapping(Options):
    """Mapping."""

    iterations: int = option(30, "steps per keyframe")
    beta: float = option(0.9, "mean of the gradients", below=1)
    offset: float = option(-1.0, "may be negative", minimum=None)
    sizes: tuple[float, ...] = option((1.0, 2.0), "of the pyramid", maximum=8)


@dataclass(frozen=True)
class Config(Options):
    """General."""

    solver: Literal["adam", "newton"] = option("adam", "of tracking")
    plain: int = 3
    tracking: Tracking = field(default_factory=Tracking)
    mapping: Mapping = field(default_factory=Mapping)


SPEC = MethodSpec("staged", "", "x:Y", config=f"{__name__}:Config", presets={"odd": {"tracking": {"huber": 2}}})


@pytest.mark.parametrize(
    ("cls", "values", "says"),
    [
        (Tracking, {"iterations": 0}, "iterations must be a number above 0, not 0"),
        (Tracking, {"huber": float("nan")}, "huber must be a number above 0, not nan"),
        (Mapping, {"iterations": -1}, "iterations must be a number from 0, not -1"),
        (Mapping, {"beta": 1.0}, "beta must be a number from 0 and below 1, not 1.0"),
        (Mapping, {"offset": float("inf")}, "offset must be a number, not inf"),
        (Mapping, {"sizes": (1.0, 9.0)}, "sizes must be a number from 0 and up to 8, not 9.0"),
    ],
)
def test_values_out_of_their_bounds_are_refused(cls: Any, values: dict[str, Any], says: str) -> None:
    with pytest.raises(OptionError, match=f"^{says}$"):
        cls(**values)


def test_bounds_allow_what_is_within() -> None:
    assert Mapping(offset=-5.0, beta=0.999, sizes=()).offset == -5.0
    with pytest.raises(OptionError):
        replace(Tracking(), huber=0.0)


def test_options_are_described_stage_by_stage() -> None:
    found = describe_options(Config())
    assert [o.name for o in found] == option_names(Config())
    about = {o.name: o for o in found}
    assert about["tracking.huber"].unit == "px"
    assert about["tracking.huber"].help == "where the loss turns linear"
    assert about["tracking.huber"].bounds == "above 0"
    assert [about[n].stage for n in ("solver", "tracking.huber", "mapping.beta")] == [
        "General", "Tracking of a frame", "Mapping",
    ]  # fmt: skip
    assert (about["plain"].help, about["plain"].default, about["plain"].type) == ("", 3, "a whole number")


@dataclass(frozen=True)
class Own(Tracking):
    """Of one method."""

    more: bool = option(True, "something else")


def test_options_of_a_base_class_come_last_under_its_heading() -> None:
    assert [(o.name, o.stage) for o in describe_options(Own())] == [
        ("more", "Of one method"),
        ("iterations", "Tracking of a frame"),
        ("huber", "Tracking of a frame"),
    ]


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("huber", ["tracking.huber"]),
        ("iterations", ["tracking.iterations", "mapping.iterations"]),
        ("traking.iterations", ["tracking.iterations"]),
        ("tracking_iterations", ["tracking.iterations"]),
        ("xyz", []),
    ],
)
def test_the_nearest_option_is_found(name: str, nearest: list[str]) -> None:
    assert nearest_options(name, option_names(Config())) == nearest


def test_an_unknown_option_names_the_nearest_and_the_command_that_lists_them() -> None:
    with pytest.raises(UnknownNameError) as caught:
        method_config(SPEC, None, {"iterations": 3})
    assert str(caught.value) == (
        "unknown option of method 'staged' 'iterations': did you mean 'tracking.iterations' or 'mapping.iterations'? "
        "`panobench list methods staged` lists them all"
    )


def test_a_value_that_a_stage_refuses_has_its_dotted_name() -> None:
    with pytest.raises(UsageError, match=r"^method 'staged': tracking\.huber must be a number above 0, not -1\.0$"):
        method_config(SPEC, "odd", {"tracking.huber": "-1"})
    assert method_config(SPEC, "odd").tracking == Tracking(huber=2.0)
    assert override(Config(), {"mapping.offset": "-3"}, "option").mapping.offset == -3.0
