"""ground_truth.json of puppet photos, of rendered_puppet or of `scripts/render_puppet_set.py`, as arrays."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class TakeTruth:
    """One pose on the turntable; `beads` in the order of `names`."""

    names: tuple[str, ...]
    files: list[str]
    nominal: np.ndarray
    """(views,) stated angles [rad]."""
    actual: np.ndarray
    """(views,) real angles [rad]."""
    T_camera_world: np.ndarray
    """(views, 4, 4)."""
    beads_world: np.ndarray
    """(beads, 3)."""
    uv: np.ndarray
    """(views, beads, 2) projected centres [px]."""
    radius: np.ndarray
    """(views, beads) [px]."""
    visible_fraction: np.ndarray
    """(views, beads)."""
    in_image: np.ndarray
    """(views, beads)."""
    directions: dict[str, np.ndarray]
    """Unit direction of every bone."""


def read_truth(folder: Path) -> dict:
    """The record of a folder."""
    return json.loads((folder / "ground_truth.json").read_text())


def take_truth(truth: dict, pose: str) -> TakeTruth:
    """One take of a record; where a view states its own angle and pose those count, else the turntable's."""
    names, take, turntable = tuple(truth["beads"]["names"]), truth["poses"][pose], truth["turntable"]
    views = take["views"]

    def of_beads(key: str) -> np.ndarray:
        return np.array([[view["beads"][name][key] for name in names] for view in views])

    def of_views(key: str) -> np.ndarray:
        return np.array([view.get(key, turntable[key][i]) for i, view in enumerate(views)])

    return TakeTruth(
        names=names,
        files=[view["file"] for view in views],
        nominal=np.deg2rad(np.array([view["nominal_deg"] for view in views], dtype=float)),
        actual=np.deg2rad(of_views("actual_deg")),
        T_camera_world=of_views("world_to_camera"),
        beads_world=np.array([take["beads_world"][name] for name in names]),
        uv=of_beads("centre_px"),
        radius=of_beads("radius_px"),
        visible_fraction=of_beads("visible_fraction"),
        in_image=of_beads("in_image"),
        directions={bone: np.array(row["direction"]) for bone, row in take["bones"].items()},
    )
