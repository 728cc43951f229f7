"""Bead detectors on pictures with known truth: the document's Hough transform, OpenCV's, and `find_beads`.

    python scripts/bead_detectors.py [DATA] [--photos 12] [--seed 0]

First table: three detectors on the rendered photos in DATA/rendered_puppet (without DATA, on drawn ones). The Hough
transforms get the edge map (OpenCV's: the grey picture) of document 000, section 3.3.1, 16 circles of 5 to 7 px,
or more of them in a wider range. Found: share of clearly visible beads (95 % of the disc or more, all of it in the
picture) with a circle within 1 px of the centre of the outline. Second table: `find_beads` on drawn photos under other
conditions, with z = (found - true) / sigma per coordinate.

The choice. The document's accumulator fills up its circles with wrong ones and knows whole pixels only; its threshold
for the whole picture loses dark beads or lets the figure in, and beads that touch share one outline. OpenCV's, given
enough circles of the right size, finds the clear beads as well as `find_beads` and is by far the fastest, but its
centres too come in whole pixels, more than ten times as far off as the fitted edge, without a measure of how sure they
are, and it has to be told the size. An error of 0.4 px is 0.2 mm on the puppet before anything else has gone wrong. So
`find_beads` is the default, and the accumulator, being the document's, serves the document's own mode.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from jaxmocap.synthetic.puppet import Studio, puppet_photo
from jaxmocap.synthetic.puppet_figure import Proportions, pose_figure, random_pose
from jaxmocap.synthetic.puppet_render import WARM_LIGHT, Look
from jaxmocap.vision import edge_map, find_beads, grey_of, hough_circles, opencv_circles, read_colour_photo

CLEAR, FOUND_WITHIN = 0.95, 1.0


@dataclass
class Tally:
    """What one detector did on many photos."""

    clear: int = 0
    found: int = 0
    false: int = 0
    photos: int = 0
    seconds: float = 0.0
    error: list = None
    z_clear: list = None
    z_hidden: list = None
    rows: list = None

    def __post_init__(self):
        self.error, self.z_clear, self.z_hidden, self.rows = [], [], [], []

    def add(self, uv: np.ndarray, beads: dict, sigma: np.ndarray | None = None) -> None:
        """Count the circles of one photo against its truth."""
        self.photos += 1
        free = np.ones(len(uv), bool)
        for bead in beads.values():
            distance = np.linalg.norm(uv - np.array(bead["outline_centroid_px"]), axis=1)
            k = int(distance.argmin()) if len(uv) else -1
            near = k >= 0 and distance[k] < max(FOUND_WITHIN, 0.4 * bead["radius_px"])
            if near:
                free[k] = False
            clear = bead["visible_fraction"] >= CLEAR and bead["in_image"]
            self.clear += clear
            if clear and k >= 0 and distance[k] < FOUND_WITHIN:
                self.found += 1
                self.error.append(distance[k])
            if sigma is not None and near and bead["visible_fraction"] > 0.15:
                z = (uv[k] - bead["outline_centroid_px"]) / sigma[k]
                (self.z_clear if clear else self.z_hidden).extend(z)
                self.rows.append((distance[k], sigma[k], bead["visible_fraction"], bead["radius_px"]))
        self.false += int(free.sum())


def drawn(look: Look, bead_radius: float, photos: int, seed: int) -> Iterator[tuple[np.ndarray, dict]]:
    """Photos of random poses from random sides."""
    rng = np.random.default_rng(seed)
    for _ in range(photos):
        proportions = Proportions(bead_radius=bead_radius)
        figure = pose_figure(random_pose(rng, proportions), proportions)
        photo = puppet_photo(Studio(look=look), figure, rng.uniform(0, 2 * np.pi), rng)
        yield photo.rgb, photo.beads


def rendered(folder: Path, photos: int) -> Iterator[tuple[np.ndarray, dict]]:
    """Photos of the rendered set."""
    truth = json.loads((folder / "ground_truth.json").read_text())
    views = [view for pose in truth["poses"].values() for view in pose["views"]]
    for view in views[:: max(1, len(views) // photos)]:
        yield read_colour_photo(folder / view["file"]).rgb, view["beads"]


DETECTORS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "document's Hough, 16 circles, 5-7 px": lambda rgb: hough_circles(edge_map(rgb))[:, :2],
    "document's Hough, 24 circles, 5-8 px": lambda rgb: hough_circles(edge_map(rgb), (5, 8), 24)[:, :2],
    "OpenCV's Hough, 16 circles, 5-7 px": lambda rgb: opencv_circles(grey_of(rgb))[:, :2],
    "OpenCV's Hough, 24 circles, 5-8 px": lambda rgb: opencv_circles(grey_of(rgb), (5, 8), 24)[:, :2],
    "find_beads": lambda rgb: find_beads(rgb).uv,
}

USUAL = Look()
CONDITIONS: dict[str, tuple[Look, float]] = {
    "usual": (USUAL, 3.0),
    "warm light": (replace(USUAL, light=WARM_LIGHT), 3.0),
    "30 specks": (replace(USUAL, specks=30), 3.0),
    "noise x 3": (replace(USUAL, noise=3.0), 3.0),
    "lamp 100 mm beside the lens": (replace(USUAL, lamp=(100.0, -50.0, 0.0)), 3.0),
    "glossy, blur 0.8 px": (replace(USUAL, highlight=0.3, blur=0.8), 3.0),
    "half of the light": (replace(USUAL, exposure=0.5), 3.0),
    "radius 1.5 px": (USUAL, 0.7),
    "radius 2.2 px": (USUAL, 1.0),
    "radius 3.3 px": (USUAL, 1.5),
    "radius 9 px": (USUAL, 4.0),
}


def compare(name: str, pictures: list[tuple[np.ndarray, dict]]) -> None:
    print(f"{name}: {len(pictures)} photos\n")
    print("| detector | found | false circles / photo | centre error, median | 95 % | ms / photo |")
    print("|---|---|---|---|---|---|")
    for title, detector in DETECTORS.items():
        tally = Tally()
        for rgb, beads in pictures:
            start = time.process_time()
            uv = detector(rgb)
            tally.seconds += time.process_time() - start
            tally.add(uv, beads)
        median, high = np.percentile(tally.error, [50, 95]) if tally.error else (np.nan, np.nan)
        print(
            f"| {title} | {tally.found} of {tally.clear} = {tally.found / max(tally.clear, 1):.1%} "
            f"| {tally.false / tally.photos:.1f} | {median:.2f} px | {high:.2f} px "
            f"| {1e3 * tally.seconds / tally.photos:.0f} |"
        )


def conditions(photos: int, seed: int) -> None:
    print("\n| condition | found | median error | z^2 clear | above 3 | z^2 partly hidden | above 3 | false / photo |")
    print("|---|---|---|---|---|---|---|---|")
    for title, (look, bead_radius) in CONDITIONS.items():
        tally = Tally()
        for rgb, beads in drawn(look, bead_radius, photos, seed):
            found = find_beads(rgb)
            tally.add(found.uv, beads, found.sigma)
        clear, hidden = np.array(tally.z_clear), np.array(tally.z_hidden)
        print(
            f"| {title} | {tally.found} of {tally.clear} = {tally.found / max(tally.clear, 1):.1%} "
            f"| {np.median(tally.error):.3f} px | {np.mean(clear**2):.2f} | {np.mean(abs(clear) > 3):.1%} "
            f"| {np.mean(hidden**2):.2f} | {np.mean(abs(hidden) > 3):.1%} | {tally.false / tally.photos:.1f} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--photos", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    if options.data:
        compare("rendered_puppet", list(rendered(options.data / "rendered_puppet", 36)))
    else:
        compare("drawn", list(drawn(USUAL, 3.0, options.photos, options.seed)))
    conditions(options.photos, options.seed)


if __name__ == "__main__":
    main()
