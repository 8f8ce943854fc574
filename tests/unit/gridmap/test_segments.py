"""Lines across a grid are drawn as far as it reaches."""

import numpy as np

from trolley.gridmap.segments import clip_segments, draw_segments


def test_a_mirror_that_reaches_beyond_the_world_is_drawn_as_far_as_the_map() -> None:
    grid, whole = np.zeros((2, 40, 60), np.uint8)
    # Lines through the whole map, from near its edge: the rest costs neither time nor memory.
    draw_segments(whole, np.array([[-0.1, -0.1, 5.0, 5.0]]), 0.05, 1)
    for far in (1e3, 1e9, 1e15):
        draw_segments(grid, np.array([[-0.1, -0.1, far, far]]), 0.05, 1)
        np.testing.assert_array_equal(grid, whole)
    for nowhere in ([1e9, 0.0, 1e9, 1.0], [-1e300, 1e300, 1e300, 1e300], [-1.7e308, 0, 1.7e308, 0]):
        draw_segments(grid, np.array([nowhere]), 0.05, 1)
    np.testing.assert_array_equal(grid, whole)


def test_clipped_segments_are_what_lies_inside() -> None:
    rng = np.random.default_rng(5)
    segments = np.round(rng.uniform(-6.0, 12.0, (400, 4)), rng.integers(0, 3))
    along = np.linspace(0.0, 1.0, 401)[:, None]
    for segment in segments:
        points = segment[:2] + along * (segment[2:] - segment[:2])
        inside = points[((points >= 0.0) & (points <= (7.0, 4.0))).all(axis=1)]
        parts = clip_segments(segment[None], (7.0, 4.0))
        if not len(parts):
            assert len(inside) <= 1  # it touches a corner at most
            continue
        ends = parts.reshape(2, 2)
        assert ((ends >= -1e-9) & (ends <= (7.0 + 1e-9, 4.0 + 1e-9))).all()
        length = np.hypot(*(ends[1] - ends[0]))
        step = np.hypot(*(segment[2:] - segment[:2])) / 400
        assert abs(length - max(0, len(inside) - 1) * step) <= 2.0 * step + 1e-9
