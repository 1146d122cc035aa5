"""Specs of the built-in studies."""

from panobench.specs import StudySpec

STUDIES: tuple[StudySpec, ...] = ()
