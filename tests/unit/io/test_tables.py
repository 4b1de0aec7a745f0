"""Numbers in text."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.io.tables import format_stamp_ns, parse_stamp_ns, symmetric_of_upper, upper_of_symmetric


@given(st.integers(0, 4 * 10**9), st.integers(0, 10**9 - 1))
def test_stamps_are_exact(seconds, nanoseconds):
    assert parse_stamp_ns(f"{seconds}.{nanoseconds:09d}") == seconds * 10**9 + nanoseconds
    assert parse_stamp_ns(f"{seconds}.{nanoseconds // 1000:06d}") == seconds * 10**9 + nanoseconds // 1000 * 1000


@pytest.mark.parametrize(
    ("text", "stamp"), [("-1.5", -1_500_000_000), ("12", 12 * 10**9), ("1e3", 10**12), ("4." + "9" * 40, 5 * 10**9 - 1)]
)
def test_rare_forms_of_stamps(text, stamp):
    assert parse_stamp_ns(text) == stamp


@pytest.mark.parametrize("text", ["", "x", "nan", "inf", "1.2.3", "99999999999.0", "1e999999999"])
def test_what_is_no_stamp(text):
    with pytest.raises(ValueError, match="expected a stamp"):
        parse_stamp_ns(text)


@given(st.integers(-(2**63), 2**63 - 1), st.sampled_from([6, 9]))
def test_stamps_come_back(stamp, decimals):
    text = format_stamp_ns(stamp, decimals)
    assert parse_stamp_ns(text) == stamp
    assert len(text.partition(".")[2]) in (decimals, 9)


@pytest.mark.parametrize("size", [2, 3])
def test_a_symmetric_matrix_comes_back_from_its_upper_triangle(size):
    roots = np.random.default_rng(size).normal(size=(5, size, size))
    matrices = roots @ roots.transpose(0, 2, 1)
    upper = upper_of_symmetric(matrices)
    assert upper[0].tolist() == [matrices[0, i, j] for i in range(size) for j in range(i, size)]
    back = symmetric_of_upper(upper)
    np.testing.assert_array_equal(back, back.transpose(0, 2, 1))
    np.testing.assert_array_equal(upper_of_symmetric(back), upper)
