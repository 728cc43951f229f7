"""Pixels of drawn puppet photos: solids by ray casting, light near the lens, and what a cheap camera adds.

Everything is linear light until `develop`. Supersampled only inside the boxes that the solids can cover.
"""

import io
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter1d, zoom

from jaxmocap.synthetic.puppet_camera import PuppetCamera, pixels, ray_grid
from jaxmocap.synthetic.puppet_figure import Solids

Array = np.ndarray

_AMBIENT = 0.03
_LAMP_DISTANCE = 400.0  # where a white surface that faces the lamp gives 1 [mm]
_WALL, _WALL_DISTANCE = 0.0235, 640.0
_FLOOR, _FLOOR_BELOW = 0.0225, 80.0
_SHOT, _READ = 0.00030, 0.0004  # sigma^2 = shot * light + read^2, as measured in rendered_puppet (light 0..1)


@dataclass(frozen=True)
class Look:
    """How a photo is lit, taken and stored."""

    lamp: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Place of the lamp in the camera frame [mm]; at the lens by default."""
    light: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Gain of red, green, blue; warm light is (1.15, 1.0, 0.75)."""
    exposure: float = 1.0
    """Gain of all light."""
    highlight: float = 0.06
    """Strength of the beads' mirror image of the lamp; 0 for matt beads."""
    specks: int = 0
    """Small bright coloured spots behind the figure that are no beads."""
    speck_radius: tuple[float, float] = (0.5, 4.0)
    """Their radii are drawn uniformly between these [px]."""
    blur: float = 0.45
    """Standard deviation of a Gaussian blur [px]."""
    noise: float = 1.0
    """Standard deviation of the noise relative to rendered_puppet's."""
    vignetting: float = 0.15
    """Part of the light lost in the corners of the picture."""
    jpeg_quality: int = 90
    """0: not compressed."""
    supersampling: int = 2
    """Sub-pixels per pixel and direction; 2 moves a bead of 6.5 px by 0.002 px (RMS)."""


WARM_LIGHT = (1.15, 1.0, 0.75)


def linear_from_srgb(value: Array) -> Array:
    """Linear light 0..1 of sRGB values 0..1."""
    value = np.asarray(value, dtype=float)
    return np.where(value <= 0.04045, value / 12.92, ((np.maximum(value, 0.0) + 0.055) / 1.055) ** 2.4)


@lru_cache(maxsize=1)
def _srgb_table() -> Array:
    """uint8 sRGB of the square of 0..1 in 4096 steps."""
    x = np.linspace(0.0, 1.0, 4096) ** 2
    s = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)
    return np.rint(255.0 * s).astype(np.uint8)


@lru_cache(maxsize=8)
def stage(camera: PuppetCamera, lamp: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
    """Light (height, width) float32 of the empty stage: mottled black wall and floor."""
    x, y = ray_grid(camera, 1)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    wall = _lit_plane(rays, np.array([0.0, 0.0, 1.0]), _WALL_DISTANCE, _WALL, lamp)
    floor = _lit_plane(rays, np.array([0.0, 1.0, 0.0]), _FLOOR_BELOW, _FLOOR, lamp)
    light = np.where(y * _WALL_DISTANCE > _FLOOR_BELOW, floor, wall)
    rough = np.random.default_rng(0).normal(1.0, 0.05, (camera.height // 16 + 2, camera.width // 16 + 2))
    light = light * zoom(rough, 16, order=1)[: camera.height, : camera.width]
    light = light.astype(np.float32)
    light.setflags(write=False)
    return light


def _lit_plane(rays: Array, normal: Array, distance: float, colour: float, lamp: tuple) -> Array:
    facing = rays @ normal
    p = rays * (distance / np.where(facing > 1e-6, facing, 1e-6))[..., None]
    to_lamp = np.asarray(lamp) - p
    far = np.linalg.norm(to_lamp, axis=-1)
    cosine = np.maximum(-(to_lamp @ normal) / far, 0.0)
    return colour * (_AMBIENT + cosine * (_LAMP_DISTANCE / far) ** 2)


def draw_solids(light: Array, camera: PuppetCamera, solids: Solids, gloss: Array, look: Look) -> None:
    """Draw solids (camera frame) over a picture of light (height, width, 3), in place.

    Args:
        light: linear picture.
        camera: lens.
        solids: in the camera frame.
        gloss: (n,) 1 where the solid mirrors the lamp, 0 where it is matt.
        look: lamp, highlight, supersampling.
    """
    n = look.supersampling
    boxes = _boxes(camera, solids)
    filled = boxes[(boxes[:, 0] < boxes[:, 2]) & (boxes[:, 1] < boxes[:, 3])]
    if not len(filled):
        return
    u0, v0, u1, v1 = *filled[:, :2].min(axis=0), *filled[:, 2:].max(axis=0)
    shape = ((v1 - v0) * n, (u1 - u0) * n)
    depth = np.full(shape, np.inf, dtype=np.float32)
    fine = np.zeros((*shape, 4), dtype=np.float32)  # red, green, blue, covered
    grid = ray_grid(camera, n)
    for i, (a0, b0, a1, b1) in enumerate(boxes):
        if a0 < a1 and b0 < b1:
            here = np.s_[(b0 - v0) * n : (b1 - v0) * n, (a0 - u0) * n : (a1 - u0) * n]
            x, y = (g[b0 * n : b1 * n, a0 * n : a1 * n] for g in grid)
            _draw_one(depth[here], fine[here], x, y, solids, i, float(gloss[i]), look)
    rows = sum(fine[k::n] for k in range(n))
    coarse = sum(rows[:, k::n] for k in range(n)) / np.float32(n * n)  # pyright: ignore[reportIndexIssue]
    box = light[v0:v1, u0:u1]
    box *= 1.0 - coarse[..., 3:]  # pyright: ignore[reportIndexIssue]
    box += coarse[..., :3]  # pyright: ignore[reportIndexIssue]


def _boxes(camera: PuppetCamera, solids: Solids) -> Array:
    """(n, 4) pixels u0, v0, u1, v1 (end not included) that each solid can touch; empty if u0 >= u1 or v0 >= v1."""
    near = np.maximum(solids.ends[..., 2] - solids.reach[:, None], 1.0)
    uv = pixels(camera, np.concatenate([solids.ends[..., :2], near[..., None]], axis=-1))
    # 1.1: a sphere off the middle shows an ellipse longer than its radius; the lens stretches by less.
    reach = 1.1 * max(camera.fx, camera.fy) * solids.reach[:, None, None] / near[..., None] + 2.0
    low = np.floor((uv - reach).min(axis=1)).clip(0, [camera.width, camera.height]).astype(int)
    high = np.ceil((uv + reach).max(axis=1) + 1).clip(0, [camera.width, camera.height]).astype(int)
    return np.concatenate([low, high], axis=1)


def _draw_one(depth: Array, fine: Array, x: Array, y: Array, solids: Solids, i: int, gloss: float, look: Look) -> None:
    """One solid over the sub-pixels of its box; x, y are their ideal coordinates.

    |t Md - Mc|^2 = 1 with d = (x, y, 1): the discriminant is a quadratic form of d, put together in double
    precision, so that single precision suffices for the pixels.
    """
    M, centre = solids.shape[i], solids.centre[i]
    Q, b = M.T @ M, M.T @ (M @ centre)
    D = np.outer(b, b) - Q * ((M @ centre) @ (M @ centre) - 1.0)
    under = _quadratic(D, x, y)
    at = np.flatnonzero(under > 0)
    if not len(at):
        return
    rays = np.stack([x.ravel()[at], y.ravel()[at], np.ones(len(at), np.float32)])
    a = _quadratic(Q, rays[0], rays[1])
    t = (b.astype(np.float32) @ rays - np.sqrt(under.ravel()[at])) / a
    p = t * rays
    offset = p - centre.astype(np.float32)[:, None]
    along = solids.cut[i, :3].astype(np.float32) @ offset
    ahead = (along >= 0) & (along <= solids.cut[i, 3]) & (t > 0)
    rows, columns = np.divmod(at, x.shape[1])
    ahead &= t < depth[rows, columns]
    rows, columns = rows[ahead], columns[ahead]
    depth[rows, columns] = t[ahead]
    diffuse, mirrored = _shade(p[:, ahead], Q.astype(np.float32) @ offset[:, ahead], look, gloss)
    colour = solids.colour[i].astype(np.float32)
    fine[rows, columns] = np.concatenate([colour[:, None] * diffuse + mirrored, np.ones((1, len(rows)), np.float32)]).T


def _quadratic(A: Array, x: Array, y: Array) -> Array:
    """(x, y, 1) A (x, y, 1)^T."""
    a = A.astype(np.float32)
    return x * (a[0, 0] * x + 2 * a[0, 1] * y + 2 * a[0, 2]) + y * (a[1, 1] * y + 2 * a[1, 2]) + a[2, 2]


def _shade(p: Array, normal: Array, look: Look, gloss: float) -> tuple[Array, Array | float]:
    """Diffuse and mirrored light of surface points (3, n) with outward normals of any length."""
    normal = normal / np.sqrt((normal * normal).sum(axis=0))
    to_lamp = np.asarray(look.lamp, dtype=np.float32)[:, None] - p
    far2 = (to_lamp * to_lamp).sum(axis=0)
    to_lamp = to_lamp / np.sqrt(far2)
    cosine = np.maximum((normal * to_lamp).sum(axis=0), 0.0)
    strength = np.float32(_LAMP_DISTANCE**2) / far2
    diffuse = np.float32(_AMBIENT) + cosine * strength
    if not gloss or not look.highlight:
        return diffuse, 0.0
    half = to_lamp - p / np.sqrt((p * p).sum(axis=0))
    shine = np.maximum((normal * half).sum(axis=0), 0.0) / np.sqrt((half * half).sum(axis=0))
    return diffuse, np.float32(look.highlight * gloss) * shine ** np.float32(20.0) * strength


def add_specks(light: Array, look: Look, rng: np.random.Generator) -> list[dict]:
    """Put foreign spots of any bright colour into the picture, in place; their places for the truth."""
    found = []
    height, width = light.shape[:2]
    for _ in range(look.specks):
        u, v = rng.uniform(0, width - 1), rng.uniform(0, height - 1)
        radius = rng.uniform(*look.speck_radius)
        colour = linear_from_srgb(
            np.array(_rgb_from_hsb([rng.uniform(), rng.uniform(0.1, 0.8), rng.uniform(0.4, 0.9)]))
        )
        u0, v0 = max(int(u - radius - 2), 0), max(int(v - radius - 2), 0)
        box = light[v0 : int(v + radius + 3), u0 : int(u + radius + 3)]
        rows, columns = np.mgrid[v0 : v0 + box.shape[0], u0 : u0 + box.shape[1]]
        cover = np.clip(radius + 0.5 - np.hypot(columns - u, rows - v), 0.0, 1.0)[..., None]
        box += (cover * (colour - box)).astype(np.float32)
        found.append({"centre_px": [round(u, 4), round(v, 4)], "radius_px": round(radius, 4)})
    return found


def _rgb_from_hsb(hsb: object) -> Array:
    h, s, b = np.asarray(hsb, dtype=float)
    ramp = np.clip(np.abs((h * 6.0 - np.array([3.0, 2.0, 4.0]) + 3.0) % 6.0 - 3.0) * [1, -1, -1] + [-1, 2, 2], 0, 1)
    return b * (1.0 - s * (1.0 - ramp))


def colour_of_bead(hsb: object) -> Array:
    """Linear reflectance of a bead whose middle shows this colour (hue, saturation, brightness 0..1) in white light."""
    return linear_from_srgb(_rgb_from_hsb(hsb))


def develop(light: Array, look: Look, rng: np.random.Generator) -> Array:
    """The camera: vignetting, colour of the light, blur, noise, sRGB; (height, width, 3) uint8, not yet JPEG."""
    height, width = light.shape[:2]
    v = (np.arange(height, dtype=np.float32) - height / 2) ** 2
    u = (np.arange(width, dtype=np.float32) - width / 2) ** 2
    fall = 1.0 - np.float32(4.0 * look.vignetting / (height**2 + width**2)) * (v[:, None] + u)
    light = light * (fall[..., None] * np.asarray(look.light, dtype=np.float32) * np.float32(look.exposure))
    if look.blur:
        for axis in (0, 1):
            light = gaussian_filter1d(light, look.blur, axis=axis, truncate=3.5)
    if look.noise:
        sigma = np.sqrt(np.float32(_SHOT) * np.maximum(light, 0.0) + np.float32(_READ**2))
        sigma *= np.float32(look.noise)
        sigma *= rng.standard_normal(light.shape, dtype=np.float32)
        light = light + sigma
    return _srgb_table()[(np.sqrt(np.clip(light, 0.0, 1.0)) * 4095.0 + 0.5).astype(np.uint16)]


def jpeg_bytes(rgb: Array, quality: int) -> bytes:
    """The photo as a JPEG file; quality 0 gives PNG, without loss."""
    out = io.BytesIO()
    if quality:
        Image.fromarray(rgb).save(out, "JPEG", quality=quality)
    else:
        Image.fromarray(rgb).save(out, "PNG", compress_level=1)
    return out.getvalue()


def decoded(file: bytes) -> Array:
    """(height, width, 3) uint8 of a file that `jpeg_bytes` made."""
    return np.asarray(Image.open(io.BytesIO(file)).convert("RGB"))
