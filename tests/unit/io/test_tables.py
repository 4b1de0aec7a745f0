"""Numbers in text."""

import numpy as np
import pytest

from gridslam.io.tables import parse_stamp_ns, symmetric_of_upper, upper_of_symmetric


@pytest.mark.parametrize(
    ("text", "stamp"), [("-1.5", -1_500_000_000), ("12", 12 * 10**9), ("1e3", 10**12), ("4." + "9" * 40, 5 * 10**9 - 1)]
)
def test_rare_forms_of_stamps(text, stamp):
    assert parse_stamp_ns(text) == stamp


@pytest.mark.parametrize("text", ["", "x", "nan", "inf", "1.2.3", "99999999999.0", "1e999999999"])
def test_what_is_no_stamp(text):
    with pytest.raises(ValueError, match="expected a stamp"):
        parse_stamp_ns(text)


@pytest.mark.parametrize("size", [2, 3])
def test_a_symmetric_matrix_comes_back_from_its_upper_triangle(size):
    roots = np.random.default_rng(size).normal(size=(5, size, size))
    matrices = roots @ roots.transpose(0, 2, 1)
    upper = upper_of_symmetric(matrices)
    assert upper[0].tolist() == [matrices[0, i, j] for i in range(size) for j in range(i, size)]
    back = symmetric_of_upper(upper)
    np.testing.assert_array_equal(back, back.transpose(0, 2, 1))
    np.testing.assert_array_equal(upper_of_symmetric(back), upper)
