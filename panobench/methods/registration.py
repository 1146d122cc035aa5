"""Specs of the built-in methods."""

from panobench.specs import MethodSpec

METHODS: tuple[MethodSpec, ...] = ()
