"""Names of simulated recordings."""

from __future__ import annotations

import pytest

from panobench.capture.parts import Parts, split_name
from panobench.errors import UnknownNameError, UsageError
from panobench.rooms.options import VARIANTS


def test_parts_are_taken_out_of_a_name_and_the_rooms_own_variants_stay() -> None:
    name, parts = split_name("room1@7+blur2+operator-15+walkers-3+rolling-15ms+rolling+levelled", VARIANTS)
    assert name == "room1@7+blur2+rolling"
    assert parts == Parts(operator=0.15, walkers=3, rolling=0.015, levelled=1.0)
    assert split_name("room1+blur-10ms+h264-0.2+stitch", VARIANTS) == (
        "room1",
        Parts(blur=0.01, h264=0.2, stitch=0.041),
    )
    assert split_name("city+day+2", ()) == ("city+day+2", Parts())
    assert not split_name("room1+seed-3")[1]


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("room1+opperator-5", UnknownNameError, "did you mean 'operator'"),
        ("room1+operator-95", UsageError, "must be between 1 and 35"),
        ("room1+rolling-15mm", UsageError, "its unit is 'ms'"),
        ("room1+walkers-2.5", UsageError, "whole number"),
        ("room1+operator-1.2.3", UsageError, "is not a number"),
        ("room1+operator+car", UsageError, "one of them"),
        ("room1+h264+h265", UsageError, "one codec"),
    ],
)
def test_mistakes_are_said(name: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        split_name(name, VARIANTS)
