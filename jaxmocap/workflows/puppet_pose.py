"""From named beads to a pose: axis, angles and beads in one problem, wrong names out, bones, skeleton. No formula."""

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap._arrays import require_x64
from jaxmocap._errors import SolveError
from jaxmocap._programs import program
from jaxmocap.bodies.motion import SkeletonMotion
from jaxmocap.bodies.puppet import BONES, MARKERS
from jaxmocap.calibration.turntable import TurntableEstimate
from jaxmocap.cameras import Camera
from jaxmocap.observations import PixelObservations
from jaxmocap.reconstruction import ViewVerdict, name_wrong_views
from jaxmocap.reconstruction.skeleton import BONE_NAMES, SkeletonPose, motion_from_poses, skeleton_from_markers
from jaxmocap.workflows.puppet_beads import NamedBeads
from jaxmocap.workflows.puppet_scene import Angles, PuppetScene, cameras_at, improve

_PHOTOS = 12  # the judging of names is compiled for a multiple of so many photos
_ROUNDS = 3  # of leaving out wrong names and solving again


@program
def _judge_names(cameras: Camera, seen: PixelObservations) -> ViewVerdict:
    return jax.vmap(name_wrong_views, in_axes=(None, 0))(cameras, seen)


@program
def _skeleton(points: jax.Array, seen: jax.Array, lengths: jax.Array) -> SkeletonPose:
    return skeleton_from_markers(points, seen, lengths)


@dataclass(frozen=True)
class PuppetPose:
    """A pose of the puppet with what is known of it."""

    beads: NamedBeads
    """Those that were used."""
    solved: TurntableEstimate
    seen: np.ndarray
    """(markers,) True where a bead stands in two photographs or more."""
    wrong: tuple[tuple[str, str], ...]
    """(photograph, bead) of names that the other photographs contradict."""
    skeleton: SkeletonPose
    lengths: np.ndarray
    """Of all bones, in the order of `skeleton.BONE_NAMES`."""
    lengths_known: bool
    """False: default lengths."""
    scene: PuppetScene
    notes: tuple[str, ...]

    @property
    def points(self) -> np.ndarray:
        """(markers, 3) in the world [unit]; meaningless where not `seen`."""
        return np.asarray(self.solved.points)

    @property
    def sigma(self) -> np.ndarray:
        """(markers, 3) standard deviations [unit], those of axis, angles and lens included."""
        return np.sqrt(np.diagonal(np.asarray(self.solved.covariance_points), axis1=1, axis2=2))

    @property
    def views(self) -> np.ndarray:
        """(markers,) number of photographs."""
        return self.beads.visible.sum(axis=0)

    @property
    def rms_px(self) -> np.ndarray:
        """(markers,) RMS of the residual length [px]."""
        r2 = np.sum(np.asarray(self.solved.residual) ** 2, axis=-1)
        use = self.beads.visible.T
        return np.sqrt(np.where(use, r2, 0.0).sum(axis=1) / np.maximum(use.sum(axis=1), 1))

    @property
    def angles_deg(self) -> np.ndarray:
        """(photos,) as measured."""
        return np.degrees(np.asarray(self.solved.angles))

    @property
    def sigma_angles_deg(self) -> np.ndarray:
        """(photos,) standard deviations; zero for the one that holds the zero."""
        sigma = np.degrees(np.sqrt(np.maximum(np.diag(np.asarray(self.solved.covariance))[4:], 0.0)))
        return np.where(Angles.of(self.beads.stated_deg).held, 0.0, sigma)

    def directions(self) -> dict[str, np.ndarray]:
        """Unit direction of every bone that has one: between its beads where it has two, else the document's."""
        out = {}
        for bone in BONES:
            a, b = MARKERS.index(bone.m1), MARKERS.index(bone.m2)
            if self.seen[a] and self.seen[b]:
                d = self.points[b] - self.points[a]
                out[bone.name] = d / np.linalg.norm(d)
        others = zip(BONE_NAMES, np.asarray(self.skeleton.directions), np.asarray(self.skeleton.valid))
        return {**{name: d for name, d, ok in others if ok and name not in out}, **out}

    def bones(self) -> dict[str, dict[str, Any]]:
        """Direction, distance of the two beads, length: as `--json` has them."""
        beads = {bone.name: (MARKERS.index(bone.m1), MARKERS.index(bone.m2)) for bone in BONES}
        out = {}
        for name, direction in self.directions().items():
            apart = None
            if name in beads and self.seen[list(beads[name])].all():
                apart = float(np.linalg.norm(self.points[beads[name][1]] - self.points[beads[name][0]]))
            length = float(self.lengths[BONE_NAMES.index(name)]) if self.lengths_known else None
            out[name] = {"direction": [float(x) for x in direction], "marker_distance": apart, "length": length}
        return out

    def markers(self) -> dict[str, dict[str, Any]]:
        """Place, sigma, views and RMS by bead."""
        return {
            name: {
                "xyz": [float(x) for x in self.points[i]],
                "sigma": [float(x) for x in self.sigma[i]],
                "views": int(self.views[i]),
                "rms_px": float(self.rms_px[i]),
            }
            for i, name in enumerate(MARKERS)
            if self.seen[i]
        }

    def motion(self) -> SkeletonMotion:
        """The skeleton as exporters take it."""
        stacked = jax.tree.map(lambda x: x[None], self.skeleton)
        return motion_from_poses(stacked, self.lengths, self.scene.unit)


def reconstruct_pose(beads: NamedBeads, scene: PuppetScene, lengths: np.ndarray, lengths_known: bool) -> PuppetPose:
    """Axis, angles and beads of the smallest reprojection error, and the skeleton they make.

    Args:
        beads: where they were seen.
        scene: camera and turntable.
        lengths: of the bones, in the order of `skeleton.BONE_NAMES` [unit of the scene].
        lengths_known: whether they were measured.

    Returns:
        PuppetPose.

    Raises:
        SolveError: fewer than two photographs with beads, no bead in two of them, or no solution.
    Source: stop-motion document, sections 5 and 6.
    """
    require_x64("A reconstruction")
    _check_enough(beads)
    angles = Angles.of(beads.stated_deg)
    at, wrong = (scene.turntable, angles.stated), []
    for _ in range(_ROUNDS):
        solved = improve(scene, angles, at, beads.uv, beads.visible, beads.sigma)
        if not solved.estimate.success:
            raise SolveError(f"The pose could not be solved. {solved.estimate.sentence}")
        at = (solved.turntable, np.asarray(solved.angles))
        bad = _contradicted(beads, scene, solved)
        if not bad.any():
            break
        wrong += [(beads.names[k], MARKERS[i]) for k, i in np.argwhere(bad)]
        beads = replace(beads, visible=beads.visible & ~bad)
    seen = (beads.visible.sum(axis=0) >= 2) & np.isfinite(np.asarray(solved.points)).all(axis=1)
    points = jnp.asarray(np.where(seen[:, None], np.asarray(solved.points), 0.0))
    skeleton = _skeleton(points, jnp.asarray(seen), jnp.asarray(lengths))
    return PuppetPose(
        beads, solved, seen, tuple(wrong), skeleton, lengths, lengths_known, scene, tuple(_notes(beads, wrong, seen))
    )


def _check_enough(beads: NamedBeads) -> None:
    photos = int(beads.visible.any(axis=1).sum())
    if photos < 2:
        raise SolveError(
            f"Beads were named in {photos} of {len(beads.names)} photographs: a place in space needs two. Add "
            "photographs at other angles (`jaxmocap puppet add`)."
        )
    if not (beads.visible.sum(axis=0) >= 2).any():
        raise SolveError(
            "No bead was named in two photographs. Look at the contact sheet (`jaxmocap puppet check`): are colours "
            "and angles those of this puppet?"
        )


def _contradicted(beads: NamedBeads, scene: PuppetScene, solved: TurntableEstimate) -> np.ndarray:
    """(photos, markers) True for names that the other photographs of the bead contradict."""
    more = -len(beads.names) % _PHOTOS
    cameras = cameras_at(scene, solved.turntable, np.concatenate([np.asarray(solved.angles), np.zeros(more)]))
    # Residuals are measured by the errors that the pixels turned out to have, if these are the larger ones.
    scale = max(float(solved.estimate.stats["sigma_scale"]), 1.0)

    def by_bead(x: np.ndarray, value: float = 0.0) -> jax.Array:
        wide = np.concatenate([x, np.full((more, *x.shape[1:]), value, x.dtype)])
        return jnp.asarray(np.swapaxes(wide, 0, 1))

    seen = PixelObservations(by_bead(beads.uv), by_bead(beads.visible), by_bead(scale * beads.sigma, 1.0))
    verdict = _judge_names(cameras, seen)
    return np.asarray(verdict.wrong)[:, : len(beads.names)].T


def _notes(beads: NamedBeads, wrong: list[tuple[str, str]], seen: np.ndarray) -> list[str]:
    said = [
        f"{photo}: {bead} lies where the other photographs do not see it; its name there was dropped."
        for photo, bead in wrong
    ]
    missing = [name for name, ok in zip(MARKERS, seen) if not ok]
    if missing:
        views = beads.visible.sum(axis=0)
        counted = ", ".join(f"{name} (in {views[MARKERS.index(name)]})" for name in missing)
        said.append(f"Beads without a place, since two photographs are needed: {counted}. Add photographs.")
    return said
