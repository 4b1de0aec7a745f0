"""Numbers in text are what Python reads and writes, to the last bit, in the kernel and in its twin."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.kernels import backend, reference

BOTH = pytest.mark.parametrize("parse", [backend.parse_numbers, reference.parse_numbers], ids=["backend", "twin"])
NUMBERS = st.one_of(
    st.decimals(allow_nan=False, allow_infinity=False, places=2, min_value=-1000, max_value=1000).map(str),
    st.floats(allow_nan=False, allow_infinity=False, min_value=-1e90, max_value=1e90)
    .filter(lambda x: x == 0 or abs(x) > 1e-90)
    .map(repr),
    st.integers(-(10**20), 10**20).map(str),
    st.sampled_from(["5.", ".5", "-.5e-7", "1E5", "1e+05", "-0", "0.1", "9007199254740993", "2.5e-23", "1e22", "1e23"]),
)


@BOTH
@given(st.integers(1, 4).flatmap(lambda n: st.lists(st.lists(NUMBERS, min_size=n, max_size=n), min_size=1, max_size=5)))
def test_numbers_are_those_that_python_reads(parse, lines):
    text = "\n".join("  ".join(line) for line in lines).encode()
    assert parse(text, len(lines)).tobytes() == np.array([[float(word) for word in line] for line in lines]).tobytes()


@BOTH
@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ("1 2 x", 1),
        ("1 nan", 1),
        ("inf", 1),
        ("0x10", 1),
        ("+1", 1),
        ("1_0", 1),
        ("1e", 1),
        ("1e100", 1),
        ("1e-", 1),
        (".", 1),
        ("-", 1),
        ("1-2", 1),
        ("1\t2", 1),
        ("1 2\r", 1),
        ("1 \xa0", 1),
        ("0" * 33, 1),
        ("1 2\n3", 2),
        ("1 2\n3 4 5", 2),
        ("1\n\n2", 3),
        ("1\n2", 1),
        ("1\n2", 3),
        ("1\n", 1),
        ("", 1),
        ("", 0),
        ("1.2.3", 1),
    ],
)
def test_what_is_no_table_of_plain_numbers_is_left_to_who_can_tell_why(parse, text, rows):
    assert parse(text.encode("latin-1"), rows).shape == (0, 0)


@given(st.text(alphabet="0159.-+eE \nx", max_size=40), st.integers(0, 4))
def test_kernel_and_twin_agree_on_anything(text, rows):
    one, other = (module.parse_numbers(text.encode(), rows) for module in (backend, reference))
    assert one.shape == other.shape
    assert one.tobytes() == other.tobytes()


@given(
    st.lists(st.tuples(st.integers(-(2**63), 2**63 - 1), st.floats(), st.floats()), max_size=5),
    st.tuples(st.booleans(), st.booleans()),
    st.sampled_from(" ,"),
)
def test_rows_are_what_python_writes(rows, is_fixed, separator):
    stamps_ns = np.array([row[0] for row in rows], np.int64)
    values = np.array([row[1:] for row in rows], np.float64).reshape(-1, 2)
    kernel, twin = (
        module.format_rows(stamps_ns, values, np.array(is_fixed), separator) for module in (backend, reference)
    )
    assert kernel == twin
    for line, (stamp_ns, *numbers) in zip(kernel.decode().splitlines(), rows, strict=True):
        stamp, *words = line.split(separator)
        assert int(stamp.replace(".", "")) == stamp_ns
        assert words == [f"{x:.9f}" if fixed else f"{x:.9g}" for x, fixed in zip(numbers, is_fixed, strict=True)]
