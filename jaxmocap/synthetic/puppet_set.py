"""A whole session of drawn photos: chessboards, chessboard on the turntable, takes; with one record of the truth."""

import colorsys
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from jaxmocap.bodies.puppet import BONES, MARKERS, PARENTS
from jaxmocap.synthetic.puppet import (
    DOCUMENT_HSB,
    TWELVE,
    PuppetPhoto,
    Studio,
    puppet_photo,
)
from jaxmocap.synthetic.puppet_boards import Board, board_truth, draw_board, random_board_pose, standing_board
from jaxmocap.synthetic.puppet_figure import (
    BONE_TABLE,
    POSES,
    Figure,
    Proportions,
    pose_figure,
)
from jaxmocap.synthetic.puppet_render import develop, jpeg_bytes, stage

Array = np.ndarray

BONE_BEADS = {bone.name: (bone.m1, bone.m2) for bone in BONES}


@dataclass(frozen=True)
class Session:
    """What is photographed."""

    studio: Studio = field(default_factory=Studio)
    poses: Mapping[str, Mapping[str, Array]] = field(default_factory=lambda: POSES)
    """Takes: rotation vectors by bone, see `puppet_figure.pose_figure`."""
    proportions: Proportions = field(default_factory=Proportions)
    root: tuple[float, float, float] | None = None
    """Place of the root joint, if not on the axis [mm]."""
    angles: tuple[float, ...] = TWELVE
    """Stated turntable angles [rad]."""
    step_error: float = 0.0
    """Every photo's angle is off by a uniform error up to this [rad]; photos at 0 are not, they define the zero."""
    chessboards: int = 20
    board: Board = field(default_factory=Board)


@dataclass(frozen=True)
class PuppetSet:
    """The files of a session."""

    files: dict[str, bytes]
    """JPEG by file name."""
    truth: dict
    """As ground_truth.json of rendered_puppet; `world_to_camera` and `actual_deg` are also given per view and per
    board photo, and those hold: each take has angle errors of its own, the lists under `turntable` are the board's."""


def puppet_set(session: Session, seed: int = 0) -> PuppetSet:
    """Draw a session.

    Args:
        session: what is photographed and how.
        seed: of angle errors, boards, specks and noise.

    Returns:
        Files and truth.
    """
    rng = np.random.default_rng(seed)
    files: dict[str, bytes] = {}
    truth = _common_truth(session)
    truth["chessboard"] = _board_facts(session.board) | {"photos": _chessboards(session, files, rng)}
    truth["turntable_chessboard"] = _board_facts(session.board) | _board_on_turntable(session, files, rng)
    turn = truth["turntable_chessboard"]["photos"]
    truth["turntable"] |= {key: [photo[key] for photo in turn] for key in ("actual_deg", "world_to_camera")}
    truth["poses"] = {name: _take(name, session, files, rng) for name in session.poses}
    if "tpose" in session.poses:
        truth["beads"]["tpose_measured_hsb"] = truth["poses"]["tpose"]["measured_hsb"]
    return PuppetSet(files, truth)


def _angles(session: Session, rng: np.random.Generator) -> Array:
    stated = np.asarray(session.angles)
    error = rng.uniform(-1.0, 1.0, len(stated)) * session.step_error
    return stated + np.where(stated == 0.0, 0.0, error)


def _degrees(angle: float) -> float:
    return round(float(np.rad2deg(angle)), 9)


def _name(take: str, angle: float) -> str:
    return f"{take}_{round(float(np.rad2deg(angle))):03d}.jpg"


def _common_truth(session: Session) -> dict:
    camera, build, look = session.studio.camera, session.studio.build, session.studio.look
    point, direction = build.axis()
    return {
        "set": "puppet drawn by jaxmocap",
        "units": "mm, degrees, px",
        "camera": {key: getattr(camera, key) for key in camera.__dataclass_fields__},
        "white_balance_gain_rgb": list(look.light),
        "jpeg_quality": look.jpeg_quality,
        "beads": {
            "names": list(MARKERS),
            "diameter": 2.0 * session.proportions.bead_radius,
            "hsb_table": dict(zip(MARKERS, DOCUMENT_HSB.tolist())),
            "hsb_in_white_light": dict(zip(MARKERS, np.asarray(session.studio.hsb).tolist())),
        },
        "bone_markers": {bone: dict(zip(("m1", "m2"), pair)) for bone, pair in BONE_BEADS.items()},
        "bone_parent": dict(PARENTS),
        "turntable": {
            "nominal_deg": [_degrees(a) for a in session.angles],
            "axis_point_camera": point.tolist(),
            "axis_direction_camera": direction.tolist(),
            "distance": build.distance,
            "height": build.height,
            "tilt_deg": _degrees(build.tilt),
            "turned_deg": _degrees(build.turned),
        },
    }


def _board_facts(board: Board) -> dict:
    return {"inner_corners": [board.columns, board.rows], "square_mm": board.square, "border_mm": board.border}


def _board_photo(session: Session, T_camera_board: Array, rng: np.random.Generator) -> bytes:
    camera, look = session.studio.camera, session.studio.look
    light = np.repeat(stage(camera, look.lamp)[..., None], 3, axis=2)
    draw_board(light, camera, T_camera_board, session.board, look)
    return jpeg_bytes(develop(light, look, rng), look.jpeg_quality)


def _chessboards(session: Session, files: dict[str, bytes], rng: np.random.Generator) -> list[dict]:
    photos = []
    for k in range(session.chessboards):
        T = random_board_pose(rng, session.studio.camera, session.board)
        name = f"chess_{k:02d}.jpg"
        files[name] = _board_photo(session, T, rng)
        photos.append({"file": name} | board_truth(session.studio.camera, T, session.board))
    return photos


def _board_on_turntable(session: Session, files: dict[str, bytes], rng: np.random.Generator) -> dict:
    T_world_board = standing_board(session.board, yaw=rng.uniform(-0.1, 0.1), shift=rng.uniform(-5.0, 5.0))
    photos = []
    for stated, actual in zip(session.angles, _angles(session, rng)):
        T_camera_world = session.studio.build.world_to_camera(actual)
        T = T_camera_world @ T_world_board
        name = _name("turntable", stated)
        files[name] = _board_photo(session, T, rng)
        view = {"file": name, "nominal_deg": _degrees(stated), "actual_deg": _degrees(actual)}
        view["world_to_camera"] = T_camera_world.tolist()
        photos.append(view | board_truth(session.studio.camera, T, session.board))
    return {"board_to_world": T_world_board.tolist(), "photos": photos}


def _take(name: str, session: Session, files: dict[str, bytes], rng: np.random.Generator) -> dict:
    root = None if session.root is None else np.asarray(session.root)
    figure = pose_figure(session.poses[name], session.proportions, root)
    views, photos = [], []
    for stated, actual in zip(session.angles, _angles(session, rng)):
        photo = puppet_photo(session.studio, figure, float(actual), rng)
        photos.append(photo)
        view = {"file": _name(name, stated), "nominal_deg": _degrees(stated), "actual_deg": _degrees(actual)}
        files[view["file"]] = photo.file
        view["world_to_camera"] = photo.T_camera_world.tolist()
        views.append(view | {"beads": photo.beads, "specks": photo.specks})
    return figure_truth(figure) | {"measured_hsb": measured_hsb(photos), "views": views}


def figure_truth(figure: Figure) -> dict:
    """Joints, bones and beads of a figure in the world."""
    bones = {}
    for bone, (parent, _) in BONE_TABLE.items():
        bones[bone] = {"parent": parent, "length": figure.lengths[bone], "direction": figure.directions[bone].tolist()}
        if bone in BONE_BEADS:
            bones[bone] |= dict(zip(("m1", "m2"), BONE_BEADS[bone]))
    return {
        "joints": {name: p.tolist() for name, p in figure.joints.items()},
        "bones": bones,
        "beads_world": dict(zip(MARKERS, figure.beads.tolist())),
    }


def measured_hsb(photos: list[PuppetPhoto]) -> dict[str, list[float]]:
    """Mean hue (circular), saturation and brightness of 5x5 pixels over the photos that show a bead whole."""
    found = {}
    for name in MARKERS:
        seen = []
        for photo in photos:
            bead = photo.beads[name]
            if bead["visible_fraction"] == 1.0 and bead["in_image"]:
                u, v = (round(x) for x in bead["centre_px"])
                seen.append(colorsys.rgb_to_hsv(*photo.rgb[v - 2 : v + 3, u - 2 : u + 3].mean(axis=(0, 1)) / 255.0))
        if seen:
            hsb = np.array(seen)
            hue = np.angle(np.exp(2j * np.pi * hsb[:, 0]).mean()) / (2.0 * np.pi) % 1.0
            found[name] = [round(float(x), 4) for x in (hue, *hsb[:, 1:].mean(axis=0))]
    return found
