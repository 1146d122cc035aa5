"""Errors of the GPU."""

from __future__ import annotations

from panobench.errors import UnavailableError


class DeviceError(UnavailableError):
    """The GPU cannot be used, or did not do what it was told; the message says what is missing or failed."""
