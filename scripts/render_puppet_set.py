"""Draw a set of puppet photos with known truth, imperfect if asked.

    python scripts/render_puppet_set.py --out DIR --seed 1 --tilt 1 --step-error 0.5 --turned 1 --warm --specks 20

Writes tpose_*.jpg, wave_*.jpg, stride_*.jpg (with --random-poses N: pose0_*.jpg, ...), chess_*.jpg, turntable_*.jpg and
ground_truth.json, laid out as that of the rendered_puppet set.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxmocap.synthetic.puppet import DOCUMENT_HSB, Studio, random_hsb
from jaxmocap.synthetic.puppet_camera import Build, PuppetCamera
from jaxmocap.synthetic.puppet_figure import POSES, ROOT_HEIGHT, Proportions, random_pose, random_proportions
from jaxmocap.synthetic.puppet_render import WARM_LIGHT, Look
from jaxmocap.synthetic.puppet_set import Session, puppet_set


def session_of(a: argparse.Namespace) -> Session:
    """The session that the options describe."""
    rng = np.random.default_rng([a.seed, 1])
    build = Build(
        a.distance, a.height, np.deg2rad(a.tilt), rng.uniform(0, 2 * np.pi), np.deg2rad(a.turned) * rng.choice([-1, 1])
    )
    look = Look(
        lamp=(a.lamp[0], a.lamp[1], 0.0),
        light=WARM_LIGHT if a.warm else (1.0, 1.0, 1.0),
        specks=a.specks,
        blur=a.blur,
        noise=a.noise,
        highlight=a.highlight,
        vignetting=a.vignetting,
        jpeg_quality=a.quality,
    )
    body = random_proportions(rng, a.bead_radius) if a.other_figure else Proportions(bead_radius=a.bead_radius)
    poses = {"tpose": POSES["tpose"]} | {f"pose{k}": random_pose(rng, body) for k in range(a.random_poses)}
    off = rng.uniform(-a.misplaced, a.misplaced, 2)
    return Session(
        studio=Studio(
            replace(PuppetCamera(), **dict(a.lens)), build, look, random_hsb(rng) if a.colours else DOCUMENT_HSB
        ),
        poses=poses if a.random_poses else POSES,
        proportions=body,
        root=(off[0], ROOT_HEIGHT, off[1]),
        step_error=np.deg2rad(a.step_error),
        chessboards=a.chessboards,
    )


def lens_option(text: str) -> tuple[str, float]:
    """k1=-0.2 as a pair."""
    name, value = text.split("=")
    return name, float(value)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--tilt", type=float, default=0.0, help="axis from the camera's vertical, in some direction [deg]"
    )
    parser.add_argument("--step-error", type=float, default=0.0, help="largest error of a photo's angle [deg]")
    parser.add_argument("--turned", type=float, default=0.0, help="camera turned about its vertical [deg]")
    parser.add_argument("--distance", type=float, default=400.0, help="camera centre to axis [mm]")
    parser.add_argument("--height", type=float, default=80.0, help="camera centre above the platform [mm]")
    parser.add_argument(
        "--misplaced", type=float, default=0.0, help="figure off the axis by up to this in x and z [mm]"
    )
    parser.add_argument("--warm", action="store_true", help="warm light")
    parser.add_argument("--lamp", type=float, nargs=2, default=(0.0, 0.0), help="lamp right of and below the lens [mm]")
    parser.add_argument("--specks", type=int, default=0, help="foreign spots per photo")
    parser.add_argument("--noise", type=float, default=1.0, help="times that of rendered_puppet")
    parser.add_argument("--blur", type=float, default=Look().blur, help="standard deviation [px]")
    parser.add_argument("--highlight", type=float, default=Look().highlight, help="gloss of the beads")
    parser.add_argument("--vignetting", type=float, default=Look().vignetting)
    parser.add_argument("--quality", type=int, default=90, help="of JPEG")
    parser.add_argument("--bead-radius", type=float, default=3.0, help="[mm]; 1 mm is about 2.15 px")
    parser.add_argument("--colours", action="store_true", help="sixteen other colours than the document's")
    parser.add_argument("--other-figure", action="store_true", help="other proportions")
    parser.add_argument("--random-poses", type=int, default=0, help="this many instead of wave and stride")
    parser.add_argument("--chessboards", type=int, default=20)
    parser.add_argument("--lens", type=lens_option, nargs="*", default=[], help="k1=-0.2 fx=900 ...")
    a = parser.parse_args()
    drawn = puppet_set(session_of(a), a.seed)
    a.out.mkdir(parents=True, exist_ok=True)
    for name, data in drawn.files.items():
        (a.out / name).write_bytes(data)
    (a.out / "ground_truth.json").write_text(json.dumps(drawn.truth, indent=1))
    print(f"{len(drawn.files)} photos and ground_truth.json in {a.out}")


if __name__ == "__main__":
    main()
