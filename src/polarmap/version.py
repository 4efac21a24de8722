"""The version of the package."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str | None:
    """The installed version; None where the package is run from its source without being installed."""
    try:
        return version("polarmap")
    except PackageNotFoundError:
        return None
