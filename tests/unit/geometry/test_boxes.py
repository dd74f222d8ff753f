import numpy as np
import pytest

from roadblock.geometry.boxes import footprint, polygon_overlap, shared_px2, visible_face


def test_a_footprint_goes_round_from_the_front_left():
    np.testing.assert_allclose(footprint(np.array([10.0, 1.0, 9.9]), 0.0, 4.0, 2.0), [[12, 2], [8, 2], [8, 0], [12, 0]])
    turned = footprint(np.array([10.0, 1.0]), np.pi / 2, 4.0, 2.0)  # its front points to the left
    np.testing.assert_allclose(turned, [[9, 3], [9, -1], [11, -1], [11, 3]], atol=1e-12)


def test_overlaps_by_hand():
    a = footprint(np.array([10.0, 0.0]), 0.0, 4.0, 2.0)
    assert polygon_overlap(a, a) == pytest.approx(1)
    assert polygon_overlap(a, footprint(np.array([11.0, 0.0]), 0.0, 4.0, 2.0)) == pytest.approx(6 / 10)
    assert polygon_overlap(a, footprint(np.array([10.0, 0.0]), np.pi / 2, 4.0, 2.0)) == pytest.approx(4 / 12)
    assert polygon_overlap(a, footprint(np.array([20.0, 0.0]), 0.3, 4.0, 2.0)) == 0
    # a square of 2 turned by 45 degrees over itself: an octagon of 8 (sqrt 2 - 1)
    square = footprint(np.array([30.0, 5.0]), 0.0, 2.0, 2.0)
    octagon = 8 * (np.sqrt(2) - 1)
    turned = footprint(np.array([30.0, 5.0]), np.pi / 4, 2.0, 2.0)
    assert polygon_overlap(square, turned) == pytest.approx(octagon / (8 - octagon), rel=1e-5)


def test_a_face_seen_square_on_is_as_far_as_it_is():
    assert visible_face(footprint(np.array([12.0, 0.5]), 0.0, 4.0, 2.0), 10) == pytest.approx((10, 0.5), abs=0.02)


def test_a_slanted_wall_by_hand():
    """Seen from its end, y = 2 and x from 5 to 15: columns share slopes 2/15 .. 2/5 alike, each 1/x high.

    With k = y / x the surface counts k dk: half of k^2 / 2 from 0.4 down; 10 % of it ends at
    k^2 = 0.16 - 0.1 (0.16 - (2/15)^2).
    """
    wall = footprint(np.array([10.0, 2.0]), 0.0, 10.0, 1e-6)
    k = np.sqrt(0.16 - 0.1 * (0.16 - (2 / 15) ** 2))
    assert visible_face(wall, 10)[0] == pytest.approx(2 / k, abs=0.02)


def test_what_reaches_beside_the_eyes_has_no_face():
    assert np.isnan(visible_face(footprint(np.array([1.0, 3.0]), 0.0, 4.0, 2.0), 10)).all()


def test_boxes_of_an_image_share_pixels() -> None:
    boxes = np.array([[0.0, 0.0, 10.0, 4.0], [20.0, 0.0, 30.0, 4.0]])
    others = np.array([[8.0, 1.0, 12.0, 9.0], [10.0, 0.0, 20.0, 4.0], [0.0, 0.0, 40.0, 40.0]])
    assert shared_px2(boxes, others).tolist() == [[6.0, 0.0, 40.0], [0.0, 0.0, 40.0]]
