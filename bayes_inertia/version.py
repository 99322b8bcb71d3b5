"""The version of the package, stated once, and those of the libraries that it computes with."""

from importlib import metadata

__version__ = "0.4.0"

_LIBRARIES = ("numpy", "scipy", "jax", "emcee", "arviz", "xarray", "matplotlib")


def versions() -> dict[str, str]:
    """Versions of the package, also where it is not installed, and of its libraries."""
    return {"bayes-inertia": __version__} | {name: metadata.version(name) for name in _LIBRARIES}
