"""The codec: what goes in comes out, and nothing that comes in can hurt."""

import contextlib
import threading
import tracemalloc

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps

from common.errors import CodecError
from common.wire.codec import DTYPES, Limits, decode, encode

arrays = st.sampled_from(sorted(DTYPES)).flatmap(
    lambda name: nps.arrays(name, nps.array_shapes(min_dims=0, max_dims=6, min_side=0, max_side=3))
)
plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False)
    | st.text(max_size=8)
    | st.binary(max_size=8)
    | arrays,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4),
    max_leaves=12,
)
messages = st.dictionaries(st.text(max_size=8), plain, max_size=6)


def same(a, b):
    """Equal, arrays bit for bit and with their dtype and shape."""
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list):
        return isinstance(b, list) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and a == b


def array_message(**changes):
    """Bytes of a message with one array of two float32, some of its parts changed."""
    return msgpack.packb({"x": {"dtype": "float32", "shape": [2], "bytes": bytes(8), **changes}})


def refusal(data, **limits):
    """The `CodecError` that `data` must raise."""
    with pytest.raises(CodecError) as caught:
        decode(data, Limits(**limits))
    return caught.value


@given(messages)
@settings(max_examples=80)
def test_round_trip(message):
    """Every message comes back as it was, arrays bit for bit."""
    assert same(decode(encode(message)), message)


@pytest.mark.parametrize("array", [np.arange(6, dtype=">i4").reshape(2, 3), np.asfortranarray([[1.0, 2], [3, 4]])])
def test_layout_does_not_travel(array):
    """Big-endian and Fortran-ordered arrays arrive with the same elements, little-endian and in C order."""
    arrived = decode(encode({"x": array}))["x"]
    np.testing.assert_array_equal(arrived, array)
    assert arrived.dtype.byteorder in "=<|"
    assert arrived.flags.c_contiguous


def test_a_slice_travels_alone():
    """A view of a larger array sends its own elements only."""
    base = np.arange(20, dtype=np.int32).reshape(4, 5)
    np.testing.assert_array_equal(decode(encode({"x": base[1:3, ::2]}))["x"], [[5, 7, 9], [10, 12, 14]])


def test_decoded_arrays_are_read_only_views():
    """A decoded array owns no memory and cannot be written, so that a logged message stays what it was."""
    array = decode(encode({"x": np.ones((3, 4), np.float32)}))["x"]
    assert not array.flags.owndata
    assert not array.flags.writeable


def test_numpy_scalars_become_plain():
    """A NumPy scalar travels as the number that it is."""
    message = decode(encode({"i": np.int64(3), "f": np.float32(0.5), "b": np.bool_(True)}))
    assert same(message, {"i": 3, "f": 0.5, "b": True})


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (np.array([object()]), "bad_dtype"),
        (np.array(["a"]), "bad_dtype"),
        (np.ones(2, np.float16), "bad_dtype"),
        (np.ones(2, np.complex64), "bad_dtype"),
        (np.float16(1), "bad_type"),
        (object(), "bad_type"),
        ({1, 2}, "bad_type"),
        (2**64, "bad_type"),
    ],
)
def test_what_cannot_be_sent(value, reason):
    """A value without a form on the wire is refused when sent, and the next message is whole."""
    with pytest.raises(CodecError) as caught:
        encode({"before": 1, "x": value})
    assert caught.value.reason == reason
    assert decode(encode({"y": 2})) == {"y": 2}


def test_threads_do_not_mix_their_messages():
    """Threads that encode at the same time each get their own bytes."""
    messages = [{"x": np.full(200_000, i, np.int64)} for i in range(4)]
    expected = [encode(message) for message in messages]
    wrong = []
    start = threading.Barrier(4)

    def work(i):
        start.wait(10)
        wrong.extend(i for _ in range(20) if encode(messages[i]) != expected[i])

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert wrong == []


@given(st.binary(max_size=200))
@settings(max_examples=200)
def test_random_bytes(data):
    """Whatever the bytes are, the answer is a map or a `CodecError`."""
    with contextlib.suppress(CodecError):
        assert isinstance(decode(data), dict)


@given(messages, st.data())
@settings(max_examples=40)
def test_truncated_and_extended_messages(message, data):
    """A message that lacks its end, or has something behind it, is not a message."""
    whole = encode(message)
    cut = data.draw(st.integers(0, len(whole) - 1))
    assert refusal(whole[:cut]).reason == "not_msgpack"
    assert refusal(whole + b"\xc0").reason == "not_msgpack"


@given(messages, st.data())
@settings(max_examples=80)
def test_flipped_bits(message, data):
    """A damaged message decodes to another map or raises `CodecError`, nothing else."""
    damaged = bytearray(encode(message))
    for bit in data.draw(st.lists(st.integers(0, 8 * len(damaged) - 1), min_size=1, max_size=3)):
        damaged[bit // 8] ^= 1 << bit % 8
    with contextlib.suppress(CodecError):
        assert isinstance(decode(bytes(damaged)), dict)


@pytest.mark.parametrize(
    "head",
    [
        pytest.param(b"\xdd\x7f\xff\xff\xff", id="array32"),
        pytest.param(b"\xdc\xff\xff", id="array16"),
        pytest.param(b"\xdf\x7f\xff\xff\xff", id="map32"),
        pytest.param(b"\xc6\x7f\xff\xff\xff", id="bin32"),
        pytest.param(b"\xdb\x7f\xff\xff\xff", id="str32"),
        pytest.param(b"\xc9\x7f\xff\xff\xff\x01", id="ext32"),
    ],
)
def test_a_declared_length_allocates_nothing(head):
    """Fifty bytes that declare two thousand million elements cost no memory before they are refused."""
    for data in (head + bytes(45), b"\x81\xa1x" + head + bytes(42)):
        tracemalloc.start()
        try:
            error = refusal(data)
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert error.reason in {"too_large", "not_msgpack"}
        assert peak < 100_000


@pytest.mark.parametrize("level", [b"\x91", b"\x81\xa1x", b"\x92\xc0", b"\xdc\x00\x40"])
def test_nesting_bombs(level):
    """A hundred thousand levels of nesting end neither the stack nor the memory."""
    tracemalloc.start()
    try:
        error = refusal(b"\x81\xa1x" + level * 100_000)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert error.reason in {"too_large", "not_msgpack"}
    assert peak < 5_000_000


def test_many_small_elements():
    """Elements that cost Python fifty times their bytes are counted, not only their bytes."""
    # 64 lists of 64 lists of 64 empty maps: 266,435 bytes, 262,144 maps of 64 bytes each.
    level = b"\x80"
    for _ in range(3):
        level = b"\xdc\x00\x40" + level * 64
    tracemalloc.start()
    try:
        error = refusal(b"\x81\xa1x" + level)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert error.reason == "too_large"
    assert "16,384" in str(error)
    assert peak < 4_000_000


def test_limits_are_inclusive():
    """What is exactly as large as allowed passes; one more does not, and the sentence says how much is allowed."""
    whole = encode({"x": b"12345"})  # 1 byte of map, 2 of key, 2 + 5 of value
    assert decode(whole, Limits(max_message=len(whole), max_bin=5)) == {"x": b"12345"}
    assert "9 are allowed" in str(refusal(whole, max_message=len(whole) - 1))
    assert refusal(whole, max_bin=4).reason == "too_large"
    assert refusal(encode({"x": "12345"}), max_str=4).reason == "too_large"
    assert refusal(encode({"x": [1, 2, 3]}), max_array=2).reason == "too_large"
    assert refusal(encode({"x": 1, "y": 2}), max_map=1).reason == "too_large"
    assert refusal(encode({"x": [1, 2, 3]}), max_items=3).reason == "too_large"
    assert decode(encode({"x": [1, 2, 3]}), Limits(max_items=4)) == {"x": [1, 2, 3]}


@pytest.mark.parametrize("data", [b"\xc0", b"\x01", b"\x90", msgpack.packb("text"), encode({"a": 1})[1:]])
def test_a_message_is_a_map(data):
    """Other values are not messages."""
    assert refusal(data).reason in {"bad_type", "not_msgpack"}


@pytest.mark.parametrize("data", [msgpack.packb({1: 2}), msgpack.packb({"x": msgpack.ExtType(1, b"abc")})])
def test_foreign_msgpack(data):
    """Maps with numbers for keys and extension types are not part of a message."""
    assert refusal(data).reason in {"not_msgpack", "too_large"}


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"dtype": "object"}, "bad_dtype"),
        ({"dtype": "float16"}, "bad_dtype"),
        ({"dtype": "f4"}, "bad_dtype"),
        ({"dtype": ">f4"}, "bad_dtype"),
        ({"dtype": 3}, "bad_dtype"),
        ({"dtype": ["float32"]}, "bad_dtype"),
        ({"shape": [3]}, "bad_array"),
        ({"shape": [1]}, "bad_array"),
        ({"shape": []}, "bad_array"),
        ({"shape": [-2]}, "bad_array"),
        ({"shape": [-1, -2]}, "bad_array"),
        ({"shape": [2.0]}, "bad_array"),
        ({"shape": [True, 2]}, "bad_array"),
        ({"shape": "2"}, "bad_array"),
        ({"shape": 2}, "bad_array"),
        ({"shape": [2, 1, 1, 1, 1, 1, 1]}, "bad_array"),
        ({"shape": [0, 2**63], "bytes": b""}, "bad_array"),
        ({"shape": [0, 2**31 - 1, 2**31 - 1, 2**31 - 1], "bytes": b""}, "bad_array"),
        ({"bytes": bytes(7)}, "bad_array"),
        ({"bytes": "12345678"}, "bad_array"),
        ({"bytes": None}, "bad_array"),
        ({"dtype": "bool", "bytes": b"\x01\x02"}, "bad_array"),
    ],
)
def test_malformed_arrays(changes, reason):
    """An array whose dtype, shape and bytes do not agree is refused."""
    assert decode(array_message())["x"].tolist() == [0.0, 0.0]
    assert refusal(array_message(**changes)).reason == reason


def test_what_came_is_not_repeated_at_length():
    """A dtype of 8 MB: the sentence that refuses it has less than 300 characters, and no `repr` of it is made, which
    would take four times as much."""
    data = array_message(dtype="\x01" * (8 << 20))
    tracemalloc.start()
    try:
        found = refusal(data, max_message=16 << 20, max_str=16 << 20)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found.reason in ("bad_dtype", "too_large")
    assert len(str(found)) < 300
    assert peak < 3 * (8 << 20)
