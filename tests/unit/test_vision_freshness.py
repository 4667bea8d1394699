"""One picture shown for ever is not a live picture, however fresh its stamp."""

import numpy as np
import pytest

from gateway.vision.freshness import ROWS, Look, Stillness

S = 1_000_000_000


def picture(n: int) -> np.ndarray[tuple[int, int, int], np.dtype[np.uint8]]:
    return np.full((4 * ROWS, 8, 3), n, np.uint8)


def test_a_picture_that_changes_is_live_from_its_second_frame_on() -> None:
    still = Stillness(2.0)
    looks = [still.look(picture(n % 2), n * S // 25) for n in range(100)]
    assert looks == [Look.UNPROVEN] + [Look.LIVE] * 99


def test_one_picture_is_frozen_after_its_time_and_not_before() -> None:
    still = Stillness(2.0)
    assert still.look(picture(0), 0) is Look.UNPROVEN
    assert still.look(picture(1), S) is Look.LIVE
    assert still.look(picture(1), 3 * S) is Look.LIVE
    assert still.look(picture(1), 3 * S + 1) is Look.FROZEN


def test_a_source_that_never_changed_is_never_live() -> None:
    still = Stillness(2.0)
    assert [still.look(picture(0), t * S) for t in (0, 1, 2)] == [Look.UNPROVEN] * 3
    assert still.look(picture(0), 2 * S + 1) is Look.FROZEN


def test_a_change_begins_the_time_anew() -> None:
    still = Stillness(2.0)
    for t_s, n in ((0, 0), (1, 1), (2, 1), (3, 2), (4, 2)):
        still.look(picture(n), t_s * S)
    assert still.look(picture(2), 5 * S) is Look.LIVE
    assert still.look(picture(2), 5 * S + 1) is Look.FROZEN


def test_one_grey_level_in_one_pixel_of_a_watched_row_is_a_change() -> None:
    still = Stillness(1.0)
    still.look(picture(7), 0)
    other = picture(7)
    other[2 * ROWS, 5, 1] += 1
    assert still.look(other, 5 * S) is Look.LIVE


@pytest.mark.parametrize("t_s", [0, 1, 1000])
def test_0_switches_it_off(t_s: int) -> None:
    still = Stillness(0.0)
    still.look(picture(0), 0)
    assert still.look(picture(0), t_s * S) is Look.LIVE
