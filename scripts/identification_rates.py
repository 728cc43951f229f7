"""How often is a bead named right? Each way of naming, on rendered photographs and on simulated candidates.

    python scripts/identification_rates.py --turns 20 --seed 0
    python scripts/identification_rates.py --sweep     (the document's largest colour distance)
    python scripts/identification_rates.py --scatter   (scatter of a bead's colour between photographs)

Counted are beads in photographs. "right": named, within 1 px of its place. "missed": seen clearly (more than 95 % of
its disc; simulated ones: not drawn half hidden) and not named. "wrong": the name is at another thing. "beside": the
bead itself, but more than 1 px off, because most of it is hidden. Rates of right and missed are of the clear beads,
those of wrong are of all names given. Rendered photographs: JAXMOCAP_DATA/rendered_puppet, colours learnt from its
T-pose and tested on all poses; simulated: colours learnt from one turn, another pose named, both through a build whose
camera is turned and whose steps are uneven, from the nominal start.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.bodies.puppet import DOCUMENT_COLOURS, MARKERS
from jaxmocap.calibration.boards import Lens
from jaxmocap.calibration.turntable import bead_prior, solve_beads
from jaxmocap.calibration.turntable_start import start_beads
from jaxmocap.cameras import Turntable
from jaxmocap.observations import PixelObservations
from jaxmocap.synthetic.bead_candidates import Build, posed, tpose_scene, turn_of_photos, turntable_cameras
from jaxmocap.tracking import BeadColours, colours_from_tpose, identify_beads, learn_colours
from jaxmocap.tracking.colour_space import cone_from_hsb

ANGLES_DEG = np.arange(0, 360, 30)
PERFECT = np.array([np.pi, 0.0, 0.0])
MODES = ("literal", "repaired", "best")
BUILDS = {
    "simulated, exact build, no specks": Build(turn_deg=0.0, step_deg=0.0, specks=0),
    "simulated, imperfect build, 3 specks a photo": Build(),
    "simulated, the same, warm light, 8 specks, noise 0.4 px": Build(specks=8, sigma=0.4, light=(1.12, 1.0, 0.85)),
    "simulated, the same and 2 foreign things on the table": Build(
        specks=8, sigma=0.4, light=(1.12, 1.0, 0.85), things=2
    ),
}


class Refinement:
    """The package's own solve, as `tracking.rounds.Refine`."""

    def __init__(self, angles):
        self.angles = jnp.asarray(angles)
        start = turntable_cameras(PERFECT, np.zeros(1))
        self.lens = jax.tree.map(lambda leaf: leaf[0], Lens(start.intrinsics, start.distortion))
        self.seconds = 0.0

    def __call__(self, uv, visible, sigma):
        """Cameras, points and gate from tracks."""
        begin = time.perf_counter()
        seen = PixelObservations(*(jnp.asarray(np.swapaxes(a, 0, 1)) for a in (uv, visible, sigma)))
        nominal = Turntable.nominal()
        prior = bead_prior(nominal, self.angles, np.arange(len(self.angles)) == 0, sigma_angle=np.radians(1.0))
        found = solve_beads(start_beads(nominal, self.angles, self.lens, seen), seen, prior, jnp.zeros((10, 10)))
        length = np.linalg.norm(np.asarray(found.residual), axis=-1)[np.asarray(seen.visible)]
        cameras = turntable_cameras(np.array(found.turntable.rotvec), np.array(found.angles))
        self.seconds += time.perf_counter() - begin
        return cameras, np.asarray(found.points), max(1.0, 6.0 * float(np.median(length)))


def name_all(photos, colours: dict[str, BeadColours], angles) -> dict[str, tuple[np.ndarray, float]]:
    """Indices and seconds by mode."""
    found = {}
    for mode in MODES:
        refine = Refinement(angles) if mode == "best" else None
        begin = time.perf_counter()
        result = identify_beads(photos, turntable_cameras(PERFECT, angles), colours[mode], mode=mode, refine=refine)
        found[mode] = (result.index, time.perf_counter() - begin - (refine.seconds if refine else 0.0))
    return found


def reference_colours(photos, angles) -> dict[str, BeadColours]:
    """Colours of a T-pose turn: the document's arithmetic mean for its own mode, ours for the others."""
    learnt = colours_from_tpose(photos, turntable_cameras(PERFECT, angles), refine=Refinement(angles))
    if not learnt.complete:
        raise SystemExit(f"The T-pose was not understood: {learnt.problems}")
    plain = []
    for row in learnt.index.T:
        k = np.flatnonzero(row >= 0)
        plain.append(np.mean([getattr(photos[i], "hsb_square", photos[i].hsb)[row[i]] for i in k], axis=0))
    literal = BeadColours.of(dict(zip(MARKERS, np.array(plain))))
    return {"literal": literal, "repaired": learnt.colours, "best": learnt.colours}


def count_simulated(index, photos, places) -> np.ndarray:
    """(clear, right, missed, wrong, beside, named)."""
    out = np.zeros(6, int)
    for row, photo, place in zip(index, photos, places):
        for m, i in enumerate(row):
            j = np.flatnonzero(photo.truth == m)
            clear = len(j) > 0 and np.linalg.norm(photo.uv[j[0]] - place[m]) < 1.0
            true = i >= 0 and photo.truth[i] == m
            near = true and np.linalg.norm(photo.uv[i] - place[m]) < 1.0
            out += [clear, clear and near, clear and i < 0, i >= 0 and not true, true and not near, i >= 0]
    return out


def count_rendered(index, photos, views) -> np.ndarray:
    """The same from the truth of rendered photographs; a bead's radius is 6 to 7 px."""
    out = np.zeros(6, int)
    for row, photo, view in zip(index, photos, views):
        for name, i in zip(MARKERS, row):
            bead = view["beads"][name]
            clear = bead["visible_fraction"] > 0.95
            off = np.linalg.norm(photo.uv[i] - bead["outline_centroid_px"]) if i >= 0 else np.inf
            true = off < 4.0 and bead["visible_fraction"] > 0
            out += [clear, clear and off < 1, clear and i < 0, i >= 0 and not true, true and off >= 1, i >= 0]
    return out


def rendered(folder: Path) -> dict[str, tuple[np.ndarray, list[float]]]:
    """Counts and seconds by mode over the three poses."""
    photos, truth = rendered_candidates(folder)
    angles = np.radians(ANGLES_DEG)
    colours = reference_colours(photos["tpose"], angles)
    total = {mode: (np.zeros(6, int), []) for mode in MODES}
    for pose, found in photos.items():
        for mode, (index, seconds) in name_all(found, colours, angles).items():
            total[mode][0][:] += count_rendered(index, found, truth["poses"][pose]["views"])
            total[mode][1].append(seconds)
    return total


def rendered_candidates(folder: Path):
    from jaxmocap.vision.beads import find_beads
    from jaxmocap.vision.photos import read_colour_photo

    truth = json.loads((folder / "ground_truth.json").read_text())
    photos = {
        pose: [find_beads(read_colour_photo(folder / view["file"]).rgb) for view in content["views"]]
        for pose, content in truth["poses"].items()
    }
    return photos, truth


def simulated(build: Build, turns: int, seed: int) -> dict[str, tuple[np.ndarray, list[float]]]:
    """Counts and seconds by mode over some turns, each of a new build and pose."""
    total = {mode: (np.zeros(6, int), []) for mode in MODES}
    for turn in range(turns):
        rng = np.random.default_rng([seed, turn])
        scene = tpose_scene(DOCUMENT_COLOURS)
        teach = turn_of_photos(scene, ANGLES_DEG, build, rng)
        seen = turn_of_photos(posed(scene, rng), ANGLES_DEG, build, rng)
        samples = [
            np.concatenate([p.hsb[p.truth == m] for p in teach.photos]) for m in range(len(MARKERS))
        ]  # by truth: this script counts naming, not learning
        learnt = learn_colours(MARKERS, samples)
        plain = BeadColours.of(dict(zip(MARKERS, [s.mean(axis=0) for s in samples])))
        colours = {"literal": plain, "repaired": learnt, "best": learnt}
        for mode, (index, seconds) in name_all(seen.photos, colours, seen.angles).items():
            total[mode][0][:] += count_simulated(index, seen.photos, seen.places)
            total[mode][1].append(seconds)
    return total


def print_rates(title: str, total: dict[str, tuple[np.ndarray, list[float]]]) -> None:
    print(f"\n{title}")
    print("| mode | clear beads | right | missed | wrong names | beside | ms per turn of 12 (median) |")
    print("|---|---|---|---|---|---|---|")
    for mode, ((clear, right, missed, wrong, beside, named), seconds) in total.items():
        print(
            f"| {mode} | {clear} | {100 * right / clear:.1f} % | {100 * missed / clear:.1f} % "
            f"| {wrong} ({100 * wrong / max(named, 1):.1f} %) | {beside} | {1000 * np.median(seconds):.0f} |",
            flush=True,
        )


def sweep(folder: Path) -> None:
    photos, truth = rendered_candidates(folder)
    angles = np.radians(ANGLES_DEG)
    colours = reference_colours(photos["tpose"], angles)
    print("| largest distance | literal right / wrong | repaired right / wrong |\n|---|---|---|")
    for limit in (0.05, 0.1, 0.15, 0.2, 0.3, 0.5):
        cells = []
        for mode in ("literal", "repaired"):
            total = np.zeros(6, int)
            for pose, found in photos.items():
                index = identify_beads(found, None, colours[mode], mode=mode, max_distance=limit).index
                total += count_rendered(index, found, truth["poses"][pose]["views"])
            cells.append(f"{100 * total[1] / total[0]:.1f} % / {total[3]}")
        print(f"| {limit} | {cells[0]} | {cells[1]} |")


def scatter(folder: Path) -> None:
    photos, truth = rendered_candidates(folder)
    rows = []
    for pose, found in photos.items():
        for name in MARKERS:
            cones = []
            for photo, view in zip(found, truth["poses"][pose]["views"]):
                off = np.linalg.norm(photo.uv - view["beads"][name]["outline_centroid_px"], axis=1)
                if view["beads"][name]["visible"] and off.min() < 1:
                    cones.append(cone_from_hsb(photo.hsb[off.argmin()]))
            rows.append(np.std(cones, axis=0, ddof=1))
    low, middle, high = np.percentile(rows, [0, 50, 100], axis=0)
    print("Standard deviation of the colour of a bead between photographs of a turn: saturation plane, brightness")
    print(f"least {low.round(3)}, median {middle.round(3)}, most {high.round(3)} over {len(rows)} beads and poses")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sweep", action="store_true")
    parser.add_argument("--scatter", action="store_true")
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    data = os.environ.get("JAXMOCAP_DATA")
    folder = Path(data or ".") / "rendered_puppet"
    if args.sweep or args.scatter:
        (sweep if args.sweep else scatter)(folder)
        return
    if data:
        print_rates("rendered_puppet, 36 photographs, colours from its T-pose", rendered(folder))
    for title, build in BUILDS.items():
        print_rates(f"{title}; {args.turns} turns of 12", simulated(build, args.turns, args.seed))


if __name__ == "__main__":
    main()
