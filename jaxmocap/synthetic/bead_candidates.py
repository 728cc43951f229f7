"""Bead candidates without pictures: a figure with beads on a turntable that is not built exactly, seen and named."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from jaxmocap.cameras.camera import Camera
from jaxmocap.cameras.distortion import BrownDistortion
from jaxmocap.cameras.intrinsics import Intrinsics
from jaxmocap.geometry import Pose
from jaxmocap.tracking.colour_space import cone_from_hsb, hsb_from_cone, hsb_from_rgb, rgb_from_hsb

_CAMERA = (859.0, 860.2, 337.3, 288.2, -0.12, 0.03)  # fx fy cx cy k1 k2, near the document's calibrated webcam
_DISTANCE, _HEIGHT = 400.0, 80.0
_PERFECT = Rotation.from_rotvec([np.pi, 0.0, 0.0])

# T-pose of the document's figure [mm], x = the figure's left, y up, z front; and the way out of the body at the bead.
_FRONT, _LEFT, _RIGHT = (0.0, 0.0, 1.0), (0.97, 0.0, 0.26), (-0.97, 0.0, 0.26)
_TPOSE: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "head.1": ((0.0, 195.0, 14.0), _FRONT),
    "head.2": ((0.0, 178.0, 14.0), _FRONT),
    "torso.1": ((0.0, 153.0, 15.0), _FRONT),
    "torso.2": ((0.0, 130.0, 15.0), _FRONT),
    **{f"arm.L{i}": ((x, 161.0, 7.0), _FRONT) for i, x in ((1, 28.0), (2, 56.0), (3, 86.0))},
    **{f"arm.R{i}": ((-x, 161.0, 7.0), _FRONT) for i, x in ((1, 28.0), (2, 56.0), (3, 86.0))},
    **{f"leg.L{i}": ((x, y, 2.0), _LEFT) for i, x, y in ((1, 20.0, 91.0), (2, 21.0, 53.0), (3, 23.0, 13.0))},
    **{f"leg.R{i}": ((-x, y, 2.0), _RIGHT) for i, x, y in ((1, 20.0, 91.0), (2, 21.0, 53.0), (3, 23.0, 13.0))},
}


@dataclass(frozen=True)
class BeadScene:
    """What stands on the table and how it is seen. Lengths in mm."""

    names: tuple[str, ...]
    p_world: Float[np.ndarray, "markers 3"]
    out_world: Float[np.ndarray, "markers 3"]
    """Unit directions in which a bead is best seen."""
    hsb: Float[np.ndarray, "markers 3"]
    """Colours of the beads in 0..1."""


@dataclass(frozen=True)
class Build:
    """How far the build is from the document's, and how well photographs are measured."""

    turn_deg: float = 1.0
    """Largest error of each component of the camera's rotation (its own turn and the lean of the axis)."""
    step_deg: float = 0.5
    """Largest error of the angle of each photograph."""
    sigma: float = 0.15
    """Noise of a centre [px]."""
    colour_sd: tuple[float, float, float] = (0.015, 0.015, 0.06)
    """Scatter of a colour in the cone from photograph to photograph."""
    light: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Factors of red, green and blue."""
    hidden: float = 0.1
    """Share of beads that should be seen but are not found."""
    half_hidden: float = 0.1
    """Share of beads whose centre is beside its place by up to half a radius and whose colour is mixed."""
    specks: int = 3
    """Foreign candidates in each photograph, of any colour, anywhere."""
    things: int = 0
    """Foreign things that turn with the figure, of any colour."""


@dataclass(frozen=True)
class SeenBeads:
    """Candidates of one photograph as `jaxmocap.vision.beads` returns them, and which is which."""

    uv: Float[np.ndarray, "n 2"]
    radius: Float[np.ndarray, "n"]
    sigma: Float[np.ndarray, "n"]
    hsb: Float[np.ndarray, "n 3"]
    score: Float[np.ndarray, "n"]
    truth: Int[np.ndarray, "n"]
    """Marker of each candidate, -1 for foreign ones."""


@dataclass(frozen=True)
class SeenTurn:
    """A turn of photographs."""

    photos: tuple[SeenBeads, ...]
    start: Camera
    """Cameras as the nominal build has them, stacked over the photographs."""
    true: Camera
    """The real ones."""
    angles: Float[np.ndarray, "photos"]
    """Stated angles [rad]."""
    places: Float[np.ndarray, "photos markers 2"]
    """Where the centre of every bead is, seen or not [px]."""
    scene: BeadScene = field(repr=False)


def tpose_scene(
    hsb: Mapping[str, tuple[float, float, float]], stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> BeadScene:
    """The figure in its T-pose; `stretch` makes arms, trunk and legs longer or shorter."""
    names = tuple(hsb)
    p = np.array([_TPOSE[name][0] for name in names])
    arm = np.array([name.startswith("arm") for name in names])
    leg = np.array([name.startswith("leg") for name in names])
    hip, leg_top = 110.0, 110.0 * stretch[2]
    p[arm, 0] *= stretch[0]
    p[leg, 1] *= stretch[2]
    p[~leg, 1] = leg_top + (p[~leg, 1] - hip) * stretch[1]
    out = np.array([_TPOSE[name][1] for name in names])
    return BeadScene(names, p, out / np.linalg.norm(out, axis=1, keepdims=True), np.array(list(hsb.values()), float))


def posed(scene: BeadScene, rng: np.random.Generator, bend: float = 1.0) -> BeadScene:
    """Another pose: every limb segment turned at random by up to some `bend` rad, lengths kept."""
    p, row = scene.p_world.copy(), {name: i for i, name in enumerate(scene.names)}
    out = scene.out_world.copy()
    for limb in ("arm.L", "arm.R", "leg.L", "leg.R"):
        turn = np.eye(3)
        for i in (2, 3):
            if f"{limb}{i}" in row and f"{limb}{i - 1}" in row:
                last, this = row[f"{limb}{i - 1}"], row[f"{limb}{i}"]
                step = scene.p_world[this] - scene.p_world[last]
                turn = Rotation.from_rotvec(rng.uniform(-bend, bend, 3) / 2).as_matrix() @ turn
                p[this] = p[last] + turn @ step
                out[this] = turn @ scene.out_world[this]
    return BeadScene(scene.names, p, out, scene.hsb)


def turn_of_photos(scene: BeadScene, angles_deg: ArrayLike, build: Build, rng: np.random.Generator) -> SeenTurn:
    """Photographs of a scene at the stated angles through a build with errors."""
    angles = np.radians(np.asarray(angles_deg, float))
    off = Rotation.from_rotvec(np.radians(rng.uniform(-1, 1, 3) * build.turn_deg))
    steps = np.radians(rng.uniform(-1, 1, len(angles)) * build.step_deg) * (np.arange(len(angles)) > 0)
    start = turntable_cameras(_PERFECT.as_rotvec(), angles)
    true = turntable_cameras((off * _PERFECT).as_rotvec(), angles + steps)
    box = scene.p_world.min(axis=0) - 10, scene.p_world.max(axis=0) + 10
    things = rng.uniform(*box, (build.things, 3))
    things_hsb = rng.uniform(0, 1, (build.things, 3))
    uv = _pixels(true, np.concatenate([scene.p_world, things]))
    facing = np.stack([-np.sin(angles), 0 * angles, np.cos(angles)], axis=-1)  # from the axis to the camera
    shown = np.concatenate([facing @ scene.out_world.T > -0.1, rng.uniform(size=(len(angles), len(things))) < 0.5], 1)
    hsb = np.concatenate([scene.hsb, things_hsb])
    truth = np.concatenate([np.arange(len(scene.names)), np.full(build.things, -1)])
    photos = [_photo(uv[k][s], hsb[s], truth[s], build, rng) for k, s in enumerate(shown)]
    return SeenTurn(tuple(photos), start, true, angles, uv[:, : len(scene.names)], scene)


def turntable_cameras(rotvec: Float[np.ndarray, "3"], angles: Float[np.ndarray, "photos"]) -> Camera:
    """The document's camera before a turntable at some angles [rad], stacked.

    Args:
        rotvec: rotation world -> camera at angle 0; (pi, 0, 0) for a perfect build.
        angles: of the photographs.

    Source: stop-motion document, 4.1 and eq. 4.14-4.17.
    """
    R0 = Rotation.from_rotvec(rotvec)
    R = R0 * Rotation.from_rotvec(np.outer(angles, [0.0, 1.0, 0.0]))
    t = np.tile(-R0.apply([0.0, _HEIGHT, _DISTANCE]), (len(angles), 1))
    fx, fy, cx, cy, k1, k2, zero = (jnp.full(len(angles), v) for v in (*_CAMERA, 0.0))
    pose = Pose(jnp.asarray(R.as_rotvec()), jnp.asarray(t))
    return Camera(Intrinsics(fx, fy, cx, cy, zero), BrownDistortion(k1, k2, zero, zero, zero), pose, (704, 576))


def _pixels(cameras: Camera, p_world: np.ndarray) -> np.ndarray:
    """Pixels (photos, points, 2), written out for this one lens."""
    fx, fy, cx, cy, k1, k2 = _CAMERA
    R = Rotation.from_rotvec(np.array(cameras.T_camera_world.rotvec)).as_matrix()
    p = np.einsum("kij,pj->kpi", R, p_world) + np.asarray(cameras.T_camera_world.translation)[:, None]
    xy = p[..., :2] / p[..., 2:]
    r2 = (xy**2).sum(axis=-1, keepdims=True)
    return xy * (1.0 + k1 * r2 + k2 * r2**2) * [fx, fy] + [cx, cy]


def _photo(uv: np.ndarray, hsb: np.ndarray, truth: np.ndarray, build: Build, rng: np.random.Generator) -> SeenBeads:
    keep = rng.uniform(size=len(uv)) > build.hidden
    uv, hsb, truth = uv[keep], hsb[keep], truth[keep]
    cone = cone_from_hsb(hsb) + rng.normal(size=(len(uv), 3)) * build.colour_sd
    half = rng.uniform(size=len(uv)) < build.half_hidden
    shift = rng.uniform(-1, 1, (len(uv), 2)) * 3.0
    uv = uv + rng.normal(size=uv.shape) * build.sigma + shift * half[:, None]
    cone = np.where(half[:, None], cone * rng.uniform(0.5, 1.0, (len(uv), 1)), cone)  # mixed with the black figure
    hsb = _lit(hsb_from_cone(cone), np.asarray(build.light))
    lo, hi = uv.min(axis=0, initial=100) - 20, uv.max(axis=0, initial=500) + 20
    uv = np.concatenate([uv, rng.uniform(lo, hi, (build.specks, 2))])
    hsb = np.concatenate([hsb, rng.uniform(0.0, 1.0, (build.specks, 3))])
    truth = np.concatenate([truth, np.full(build.specks, -1)])
    order = rng.permutation(len(uv))
    n = len(uv)
    return SeenBeads(
        uv[order], np.full(n, 6.5), np.full(n, max(build.sigma, 0.05)), hsb[order], np.ones(n), truth[order]
    )


def _lit(hsb: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """The colours under a light of another tint."""
    return hsb_from_rgb(np.clip(rgb_from_hsb(hsb) * gains, 0.0, 1.0))
