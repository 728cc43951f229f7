"""Small sets of drawn puppet photographs with their camera, for the end-to-end tests."""

import shutil
from functools import cache
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics
from jaxmocap.geometry import Pose
from jaxmocap.io import NamedCamera, RigFile, write_rig
from jaxmocap.synthetic.puppet import PuppetPhoto, Studio, puppet_take
from jaxmocap.synthetic.puppet_camera import PuppetCamera
from jaxmocap.synthetic.puppet_figure import POSES, Figure, pose_figure
from jaxmocap.workflows.stopmotion import add_to_puppet, new_puppet

STEP = 45
"""Between photographs [degrees]: eight of them, so that all beads have their views."""


@cache
def figure(pose: str) -> Figure:
    """One of the poses of the rendered set."""
    return pose_figure(POSES[pose])


@cache
def take(pose: str) -> dict[int, PuppetPhoto]:
    """A turn of a pose, by stated angle in degrees."""
    angles = range(0, 360, STEP)
    return dict(zip(angles, puppet_take(Studio(), figure(pose), list(np.deg2rad(angles)), rng=STEP)))


def write_take(folder: Path, pose: str, name: str = "{pose}_{angle:03d}.jpg") -> list[Path]:
    """The files of a turn in a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for angle, photo in take(pose).items():
        files.append(folder / name.format(pose=pose, angle=angle))
        files[-1].write_bytes(photo.file)
    return files


def write_camera(path: Path, cameras: int = 1, unit: str = "mm", size: tuple[int, int] | None = None) -> Path:
    """A rig file of the camera that drew them."""
    true = PuppetCamera()
    lens = BrownDistortion.from_vector(jnp.asarray(true.distortions()))
    camera = Camera(
        Intrinsics.from_matrix(jnp.asarray(true.matrix())), lens, Pose.identity(), size or (true.width, true.height)
    )
    names = [f"cam{k + 1}" for k in range(cameras)]
    sigmas = {name: {"fx": 0.4, "fy": 0.4, "cx": 0.4, "cy": 0.4} for name in names}
    write_rig(path, RigFile(tuple(NamedCamera(name, camera) for name in names), unit=unit, sigmas=sigmas))
    return path


def folder_of(path: Path, drawn: Path, photos: dict[int, Path]) -> Path:
    """A pose whose photographs stand at the angles given, whatever their names say."""
    new_puppet(path, drawn / "camera.toml", colours=drawn / "colours.toml")
    renamed = path.parent / f"{path.name} photos"
    renamed.mkdir()
    for angle, file in photos.items():
        shutil.copy(file, renamed / f"p_{angle:03d}{file.suffix}")
    add_to_puppet(path, renamed)
    return path
