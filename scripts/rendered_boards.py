"""Rendered chessboard photos with known truth: how many sigmas is each parameter off?

    python scripts/rendered_boards.py DATA

Corners come from jaxmocap.vision.detect_boards. z = (found - true) / sigma, for the plain sigma (residuals taken as
independent) and for the stated one.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.calibration.boards import TargetViews, chessboard_points, free_parameters, refine_targets
from jaxmocap.calibration.start import start_rig
from jaxmocap.observations import PixelObservations
from jaxmocap.vision import detect_boards


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    folder = parser.parse_args().data / "rendered_puppet"
    jax.config.update("jax_enable_x64", True)
    truth = json.loads((folder / "ground_truth.json").read_text())
    boards = detect_boards([str(folder / "chess_*.jpg")], tuple(truth["chessboard"]["inner_corners"]))
    uv = boards.uv[boards.found]
    points = chessboard_points(*boards.columns_rows, truth["chessboard"]["square_mm"])
    views = TargetViews(jnp.asarray(np.tile(points, (len(uv), 1, 1))), PixelObservations.of(jnp.asarray(uv[:, None])))
    start, _ = start_rig(views, [boards.image_size], ["camera"])
    estimate = refine_targets(start, views, free_parameters(1, "k1k2", False)).check()
    lens, cov = estimate.value.shared.lenses[0], estimate.covariance
    print(
        f"{len(uv)} photos, RMS {float(estimate.stats['rms_px']):.4f} px, "
        f"design effect {float(cov.design_effect):.2f}\n"
    )
    print("| parameter | true | found | stated sigma | z stated | z plain |\n|---|---|---|---|---|---|")
    plain, stated = (np.sqrt(np.diag(C)) for C in (cov.shared_plain(), cov.shared()))
    for k, name in enumerate(("fx", "fy", "cx", "cy", "k1", "k2")):
        found = float(getattr(lens.intrinsics if k < 4 else lens.distortion, name))
        error = found - truth["camera"][name]
        print(
            f"| {name} | {truth['camera'][name]:g} | {found:.4f} | {stated[k]:.4f} "
            f"| {error / stated[k]:+.2f} | {error / plain[k]:+.2f} |"
        )


if __name__ == "__main__":
    main()
