"""Differentiable calibration of cameras and capture of motion, from first principles, in JAX."""

_PUBLIC = {
    "calibrate_chessboard": "jaxmocap.workflows.calibrate",
    "calibrate_stereo": "jaxmocap.workflows.calibrate",
    "calibrate_points": "jaxmocap.workflows.calibrate",
    "read_rig": "jaxmocap.io",
    "write_rig": "jaxmocap.io",
    "InputError": "jaxmocap._errors",
    "JaxMocapError": "jaxmocap._errors",
    "SolveError": "jaxmocap._errors",
}
_PACKAGES = ("geometry", "optim", "cameras", "vision", "calibration", "closed_forms", "synthetic", "io", "report")


def __getattr__(name: str) -> object:
    """Resolve public names when they are asked for: importing jaxmocap alone does not import JAX."""
    import importlib

    if name in _PUBLIC:
        return getattr(importlib.import_module(_PUBLIC[name]), name)
    if name in _PACKAGES:
        return importlib.import_module(f"jaxmocap.{name}")
    raise AttributeError(f"module 'jaxmocap' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*_PUBLIC, *_PACKAGES])
