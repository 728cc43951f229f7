"""Rigs: several cameras as one `Camera` with a leading camera axis."""

import jax
import jax.numpy as jnp

from jaxmocap._errors import InputError
from jaxmocap.cameras.camera import Camera


def stack_cameras(cameras: list[Camera]) -> Camera:
    """One module with a leading camera axis on every array; image sizes must agree (files keep each one's own).

    Raises:
        InputError: if the list is empty or the image sizes differ.
    """
    if not cameras:
        raise InputError("cameras: expected at least one, got an empty list")
    sizes = {c.image_size for c in cameras}
    if len(sizes) > 1:
        raise InputError(f"cameras: expected one image size, got {sorted(sizes)}")
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *cameras)


def camera_of(rig: Camera, index: int) -> Camera:
    """One camera of a rig."""
    return jax.tree.map(lambda leaf: leaf[index], rig)
