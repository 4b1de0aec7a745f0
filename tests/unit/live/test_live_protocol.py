"""Messages come out as they went in, and levels tell a map as it looks."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from gridslam.kernels import UNKNOWN
from gridslam.live.protocol import STEP_NATS, encode, levels
from support.page_client import decode

KINDS = st.sampled_from([np.float32, np.int32, np.uint8])
ARRAYS = KINDS.flatmap(lambda kind: arrays(kind, array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=5)))


@given(st.dictionaries(st.text(max_size=5), st.integers() | st.text()), st.dictionaries(st.text(max_size=5), ARRAYS))
def test_a_message_comes_out_as_it_went_in(header, data):
    header.pop("arrays", None)
    said, got = decode(encode(header, data))
    assert said == header
    assert list(got) == list(data)
    for name, array in data.items():
        assert got[name].dtype == array.dtype
        assert got[name].shape == array.shape
        assert got[name].tobytes() == array.tobytes()


def test_arrays_begin_where_a_browser_can_read_them():
    """Typed arrays over a buffer need an offset that is a multiple of their item's size."""
    import json
    import struct
    import zlib

    data = zlib.decompress(encode({"x": "ä" * 3}, {"a": np.zeros(3, np.uint8), "b": np.ones(2, np.float32)}))
    (length,) = struct.unpack_from("<I", data)
    assert length % 4 == 0
    assert json.loads(data[4 : 4 + length])["arrays"] == [["a", "u1", [3]], ["b", "f4", [2]]]
    assert np.frombuffer(data, np.float32, 2, 4 + length + 4).tolist() == [1.0, 1.0]


@given(st.integers(UNKNOWN + 1, 2**15 - 1), st.integers(UNKNOWN + 1, 2**15 - 1))
def test_levels_rise_with_the_log_odds_and_are_within_half_a_step(a, b):
    low, high = sorted([a, b])
    one, other = levels(np.array([low, high], np.int16)).tolist()
    assert 1 <= one <= other <= 15
    for log_odds, level in ((low, one), (high, other)):
        if 1 < level < 15:
            assert abs(0.01 * log_odds - STEP_NATS * (level - 8)) <= STEP_NATS / 2 + 1e-9
