"""A photo full of bright spots is as good as any other."""

import numpy as np

from jaxmocap.vision.beads import find_beads


def test_a_photo_may_hold_more_spots_than_one_call_of_remap_takes():
    rows, columns = np.mgrid[:576, :704]
    middle = np.stack(np.meshgrid(np.arange(11, 700, 22), np.arange(11, 570, 22)), axis=-1).reshape(-1, 2)
    distance = np.hypot(columns % 22 - 11, rows % 22 - 11)
    cover = np.clip(4.5 - distance, 0.0, 1.0)[..., None]
    rgb = (20 + cover * np.array([220.0, 120.0, 60.0])).astype(np.uint8)
    found = find_beads(rgb)
    inside = [uv for uv in middle if uv[0] < 695 and uv[1] < 567]
    nearest = np.array([np.linalg.norm(found.uv - uv, axis=1).min() for uv in inside])
    assert len(inside) > 700 and (nearest < 0.2).all()
