"""The messages: round trips, and the refusal of everything that is not the message it should be."""

import contextlib
import dataclasses
import hashlib
import tracemalloc

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps

from common.errors import CodecError
from common.wire import codec
from common.wire.codec import SCHEMA_VERSION, Limits
from common.wire.messages import (
    Environment,
    Evaluation,
    Heartbeat,
    Join,
    JoinReply,
    Orders,
    PushReply,
    Snapshot,
    digest_arrays,
)
from common.wire.rollout import Rollout, RolloutShape

SHAPE = RolloutShape(num_steps=3, num_envs=4, observation_size=5, action_size=2, branches=4)

count = st.integers(0, 2**63 - 1)
slot = st.integers(0, 2**31 - 1)
name = st.text(max_size=20)
slug = st.sampled_from(["", "stale", "bad_value"])
run = st.sampled_from(["a", "hopper-1", "0.b_c"])
amount = st.floats(0, 1e12)
texts = st.dictionaries(name, name, max_size=3)
per_slot = st.dictionaries(slot, count, max_size=3)
finite = st.floats(-1e6, 1e6, width=32)


def make_rollout(**changes):
    """A rollout of `SHAPE` with one episode that fell, one that the time limit cut, and both returns."""
    rng = np.random.default_rng(7)
    steps, envs, obs, act, branches, _ = dataclasses.astuple(SHAPE)
    terminated, truncated = np.zeros((steps, envs), bool), np.zeros((steps, envs), bool)
    terminated[0, 1] = truncated[2, 3] = True

    def draw(*shape):
        return rng.standard_normal(shape).astype(np.float32)

    rollout = Rollout(
        run="r",
        slot=1,
        incarnation="i",
        seq=5,
        policy_version=9,
        t_ns=123,
        obs=draw(steps, envs, obs),
        action=draw(steps, envs, act),
        log_prob=draw(steps, envs),
        reward=draw(steps, envs),
        terminated=terminated,
        truncated=truncated,
        last_obs=draw(envs, obs),
        truncated_obs=draw(1, obs),
        episode_return=draw(2),
        episode_length=np.array([17, 1000], np.int32),
        timing={"physics": 0.5, "push": 0.0},
        mirror_action=draw(branches, act),
        mirror_reward=draw(branches),
        mirror_terminated=np.array([False, True, False, False]),
        mirror_truncated=np.array([False, False, False, True]),
        mirror_obs=draw(branches, obs),
    )
    return dataclasses.replace(rollout, **changes)


@st.composite
def rollouts(draw):
    """Rollouts of every small size, with any flags that a rollout may have."""
    steps, envs, obs, act = (draw(st.integers(1, 3)) for _ in range(4))
    ends = draw(nps.arrays(np.uint8, (steps, envs), elements=st.integers(0, 2)))
    episodes = draw(st.integers(0, int((ends > 0).sum())))
    branches = draw(st.sampled_from([0, envs]))
    mirrored = draw(nps.arrays(np.uint8, branches, elements=st.integers(0, 2)))

    def f32(*shape):
        return draw(nps.arrays(np.float32, shape, elements=finite))

    rollout = Rollout(
        *(draw(run), draw(slot), draw(name), draw(count), draw(count), draw(count)),
        *(f32(steps, envs, obs), f32(steps, envs, act), f32(steps, envs), f32(steps, envs)),
        *(ends == 1, ends == 2, f32(envs, obs), f32(int((ends == 2).sum()), obs), f32(episodes)),
        draw(nps.arrays(np.int32, episodes, elements=st.integers(1, 1000))),
        draw(st.dictionaries(name, amount, max_size=3)),
        *(f32(branches, act), f32(branches), mirrored == 1, mirrored == 2, f32(branches, obs)),
    )
    return rollout, RolloutShape(steps, envs, obs, act, branches)


@st.composite
def snapshots(draw):
    array = nps.arrays(np.float32, nps.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3))
    arrays = draw(st.dictionaries(name, array, max_size=3))
    return Snapshot(draw(run), draw(count), digest_arrays(arrays), arrays)


@st.composite
def environments(draw):
    arrays = draw(snapshots()).arrays
    place = (draw(run), draw(slot), draw(name), draw(count), draw(count), draw(count))
    return Environment(*place, digest_arrays(arrays), arrays)


@st.composite
def evaluations(draw):
    episodes = draw(st.integers(1, 4))
    returns = draw(nps.arrays(np.float32, episodes, elements=finite))
    lengths = draw(nps.arrays(np.int32, episodes, elements=st.integers(1, 1000)))
    return Evaluation(draw(run), draw(slot), draw(name), draw(count), returns, lengths)


states = st.sampled_from(["compiling", "waiting", "collecting", "pushing", "evaluating"])
any_message = st.one_of(
    st.builds(Join, st.just("") | run, st.sampled_from(["actor", "evaluator"]), name, texts, texts, name),
    st.builds(JoinReply, st.booleans(), slug, name, st.booleans(), st.just("") | run, slot, count, name),
    rollouts().map(lambda pair: pair[0]),
    st.builds(PushReply, st.sampled_from(["accepted", "busy", "refused"]), slug, name),
    st.builds(Orders, run, count, name, count, per_slot, per_slot, st.booleans(), count),
    snapshots(),
    environments(),
    st.builds(Heartbeat, run, slot, name, states, count, count, amount, amount, count),
    evaluations(),
)

ARRAYS = {"b/w": np.ones((2, 3), np.float32), "a": np.arange(3, dtype=np.int32)}
EXAMPLES = [
    Join("", "actor", "i", {"jax": "0.10.2"}, {"cpu": "2"}, "native"),
    JoinReply(True, "", "", False, "r", 0, 2, "{}", True),
    make_rollout(),
    PushReply("busy", "queue_full", "queue full"),
    Orders("r", 3, "d", 99, {0: 2, 7: 1}, {1: 16}, False, 5, True),
    Snapshot("r", 3, digest_arrays(ARRAYS), ARRAYS),
    Heartbeat("r", 0, "i", "collecting", 3, 4096, 1000.0, 0.25, 5),
    Evaluation("r", 0, "i", 3, np.float32([1.5]), np.int32([1000])),
    Environment("r", 0, "i", 2, 5, 3, digest_arrays(ARRAYS), ARRAYS),
]
FIELDS = [
    pytest.param(message, field.name, id=f"{type(message).__name__}.{field.name}")
    for message in EXAMPLES
    for field in dataclasses.fields(message)
]
by_type = pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)


def values(message):
    """The fields with arrays as (dtype, shape, bytes), to compare."""

    def plain(value):
        if isinstance(value, np.ndarray):
            return value.dtype.name, value.shape, value.tobytes()
        return {key: plain(item) for key, item in value.items()} if isinstance(value, dict) else value

    return {field.name: plain(getattr(message, field.name)) for field in dataclasses.fields(message)}


def with_raw(message, **changes):
    """The message's bytes with some raw fields changed."""
    return codec.encode({**codec.decode(message.encode()), **changes})


def refusal(kind, data):
    """The `CodecError` that decoding `data` as `kind` must raise."""
    with pytest.raises(CodecError) as caught:
        kind.decode(data)
    return caught.value


def check_refusal(reason, **changes):
    """The sentence of the refusal that `check` must raise for a rollout with these changes."""
    with pytest.raises(CodecError) as caught:
        make_rollout(**changes).check(SHAPE)
    assert caught.value.reason == reason
    return str(caught.value)


@given(any_message)
@settings(max_examples=120)
def test_round_trip(message):
    """Every message comes back with the same values and types, arrays bit for bit."""
    assert values(type(message).decode(message.encode())) == values(message)


@given(any_message, st.data())
@settings(max_examples=120)
def test_damaged_messages(message, data):
    """A truncated message is refused; one with flipped bits is read or refused, and nothing else happens."""
    whole = message.encode()
    refusal(type(message), whole[: data.draw(st.integers(0, len(whole) - 1))])
    damaged = bytearray(whole)
    for bit in data.draw(st.lists(st.integers(0, 8 * len(whole) - 1), min_size=1, max_size=3)):
        damaged[bit // 8] ^= 1 << bit % 8
    with contextlib.suppress(CodecError):
        read = type(message).decode(bytes(damaged))
        assert isinstance(read, type(message))
        if isinstance(read, Rollout):
            read.check(RolloutShape(*read.obs.shape, read.action.shape[2], len(read.mirror_reward)))


@pytest.mark.parametrize(("message", "field"), FIELDS)
def test_each_field_is_needed_and_typed(message, field):
    """Without one field, or with one of a wrong type, a message is refused and the sentence names the field."""
    raw = codec.decode(message.encode())
    del raw[field]
    missing = refusal(type(message), codec.encode(raw))
    assert (missing.reason, field in str(missing)) == ("missing_field", True)
    for wrong in (None, [1], b"x"):
        error = refusal(type(message), with_raw(message, **{field: wrong}))
        assert (error.reason, str(error).startswith(field)) == ("bad_type", True)


@by_type
def test_unknown_fields(message):
    """A field that the message does not have is refused by name."""
    error = refusal(type(message), with_raw(message, surprise=1))
    assert error.reason == "unknown_field"
    assert "'surprise'" in str(error)


@by_type
@pytest.mark.parametrize("schema", [SCHEMA_VERSION + 1, 0, -1, True, float(SCHEMA_VERSION), "1", None, np.ones(2)])
def test_another_schema(message, schema):
    """A message of another schema says so, whatever else it holds, so that a refusal can name both versions."""
    error = refusal(type(message), codec.encode({"schema": schema, "fields": "of the future"}))
    assert error.reason == "schema"
    assert type(message).__name__ in str(error)
    assert f"this side speaks schema {SCHEMA_VERSION}" in str(error)


def test_schema_is_named():
    """The sentence has the version that was given and what to do."""
    error = refusal(Join, codec.encode({"schema": 5}))
    assert str(error) == (
        "Join of schema 5, but this side speaks schema 4: run the same release on the learner and on the actors"
    )
    assert refusal(Join, codec.encode({"run": ""})).reason == "missing_field"


def test_messages_are_not_mistaken():
    """One message is not read as another."""
    for message in EXAMPLES:
        for other in EXAMPLES:
            if type(other) is not type(message):
                # An environment has all that a snapshot has, and more.
                known = (type(other), type(message)) == (Snapshot, Environment)
                reason = "unknown_field" if known else "missing_field"
                assert refusal(type(other), message.encode()).reason == reason


@pytest.mark.parametrize(
    ("message", "field", "value", "reason"),
    [
        (EXAMPLES[0], "role", "learner", "bad_value"),
        (EXAMPLES[0], "versions", {"jax": 3}, "bad_type"),
        (EXAMPLES[0], "versions", {"jax": "x" * 1025}, "bad_value"),
        (EXAMPLES[1], "slot", 2**31, "bad_value"),
        (EXAMPLES[1], "slot", True, "bad_type"),
        (EXAMPLES[1], "accepted", 1, "bad_type"),
        (EXAMPLES[2], "run", "a/b", "bad_value"),
        (EXAMPLES[2], "run", "**", "bad_value"),
        (EXAMPLES[2], "seq", -1, "bad_value"),
        (EXAMPLES[2], "seq", 1.0, "bad_type"),
        (EXAMPLES[2], "seq", 2**63, "bad_value"),
        (EXAMPLES[2], "obs", np.zeros((3, 4, 5)), "bad_dtype"),
        (EXAMPLES[2], "obs", np.zeros((3, 20), np.float32), "bad_shape"),
        (EXAMPLES[2], "terminated", np.zeros((3, 4), np.uint8), "bad_dtype"),
        (EXAMPLES[2], "timing", {"physics": float("nan")}, "not_finite"),
        (EXAMPLES[2], "timing", {"physics": -1.0}, "bad_value"),
        (EXAMPLES[2], "timing", {"physics": "1"}, "bad_type"),
        (EXAMPLES[3], "status", "maybe", "bad_value"),
        (EXAMPLES[4], "collect", {"x": 1}, "bad_value"),
        (EXAMPLES[4], "collect", {"-1": 1}, "bad_value"),
        (EXAMPLES[4], "collect", {"²": 1}, "bad_value"),
        (EXAMPLES[4], "collect", {"9999999999": 1}, "bad_value"),
        (EXAMPLES[4], "collect", {"0": -1}, "bad_value"),
        (EXAMPLES[5], "arrays", {"a": 1}, "bad_type"),
        (EXAMPLES[5], "arrays", {}, "bad_digest"),
        (EXAMPLES[5], "digest", "0" * 32, "bad_digest"),
        (EXAMPLES[6], "state", "asleep", "bad_value"),
        (EXAMPLES[6], "steps_per_s", float("inf"), "not_finite"),
        (EXAMPLES[6], "state_s", -0.5, "bad_value"),
        (EXAMPLES[7], "episode_return", np.float32([np.nan]), "not_finite"),
        (EXAMPLES[7], "episode_return", np.float32([1, 2]), "bad_shape"),
        (EXAMPLES[7], "episode_length", np.int32([0]), "bad_value"),
        (EXAMPLES[7], "episode_length", np.int64([10]), "bad_dtype"),
    ],
)
def test_values_out_of_range(message, field, value, reason):
    """A value that a field may not have is refused under its reason."""
    assert refusal(type(message), with_raw(message, **{field: value})).reason == reason


def test_an_evaluation_has_an_episode():
    """An evaluation without episodes is none."""
    empty = Evaluation("r", 0, "i", 3, np.zeros(0, np.float32), np.zeros(0, np.int32))
    assert refusal(Evaluation, empty.encode()).reason == "bad_shape"


def test_limits_are_the_callers():
    """A receiver that allows less gets less."""
    with pytest.raises(CodecError, match="10 are allowed"):
        PushReply.decode(PushReply("accepted").encode(), Limits(max_message=10))


@given(rollouts())
@settings(max_examples=60)
def test_rollouts_of_the_right_shape_pass(pair):
    """Whatever the sizes and flags, a rollout that fits its run passes the check."""
    rollout, shape = pair
    Rollout.decode(rollout.encode()).check(shape)


def test_rollout_key_and_size():
    """The key finds duplicates; nbytes counts the arrays."""
    rollout = make_rollout()
    assert rollout.key == (1, "i", 5)
    # float32: obs 3*4*5, action 3*4*2, log_prob and reward 3*4, last_obs 4*5, truncated_obs 5, returns 2 -> 135, of the
    # mirrored step action 4*2, reward 4, observation 4*5 -> 32;
    # int32: lengths 2; bool: 2 * 3*4 and 2 * 4.
    assert rollout.nbytes == 4 * (135 + 32) + 4 * 2 + 32


@pytest.mark.parametrize(
    "field", ["obs", "action", "log_prob", "reward", "terminated", "truncated", "last_obs", "truncated_obs"]
)
def test_each_array_must_have_the_runs_shape(field):
    """An array with one row more is refused; the sentence has the field, the shape given and the one expected."""
    array = getattr(make_rollout(), field)
    longer = np.concatenate([array, array[:1]])
    sentence = check_refusal("bad_shape", **{field: longer})
    assert sentence == f"{field} has shape {longer.shape}; expected {array.shape}"


@pytest.mark.parametrize(
    "field", ["obs", "action", "log_prob", "reward", "last_obs", "truncated_obs", "episode_return"]
)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_each_array_must_be_finite(field, value):
    """One element that is not finite is found, and the sentence says where it is."""
    array = getattr(make_rollout(), field).copy()
    array[(-1,) * array.ndim] = value
    last = tuple(size - 1 for size in array.shape)
    sentence = check_refusal("not_finite", **{field: array})
    assert sentence == f"{field} has 1 of {array.size} elements that are not finite, the first at {last}"


def test_observations_of_truncated_episodes_are_counted():
    """There are as many final observations as truncated episodes."""
    none_cut = np.zeros((3, 4), bool)
    assert "expected (0, 5)" in check_refusal("bad_shape", truncated=none_cut)
    make_rollout(truncated=none_cut, truncated_obs=np.zeros((0, 5), np.float32), **episodes(1)).check(SHAPE)


def episodes(number):
    """The fields of `number` episodes that ended."""
    return {"episode_return": np.ones(number, np.float32), "episode_length": np.full(number, 3, np.int32)}


def test_no_more_episodes_than_ends():
    """Two episodes ended in this rollout: none to two may be told of, three are refused."""
    for number in range(3):
        make_rollout(**episodes(number)).check(SHAPE)
    assert "only 2 ended" in check_refusal("bad_shape", **episodes(3))


def test_returns_and_lengths_belong_together():
    """Each episode has a return and a length of at least one step."""
    one, two = episodes(1), episodes(2)
    check_refusal("bad_shape", episode_return=one["episode_return"], episode_length=two["episode_length"])
    assert "has 0;" in check_refusal("bad_value", episode_length=np.array([5, 0], np.int32))


def test_a_step_ends_in_one_way():
    """A step that is both terminated and truncated is refused: bootstrapping from it has no meaning."""
    both = np.zeros((3, 4), bool)
    both[2, 3] = True
    assert "1 steps that are both" in check_refusal("bad_value", terminated=both)


def test_digest_is_blake2b_of_the_documented_bytes():
    """The digest can be computed by anyone from path, dtype, shape and elements."""
    # ascii of (path, dtype, shape) behind its length in 4 bytes, then 3 little-endian int32.
    header = b"('a', 'int32', (3,))"
    expected = hashlib.blake2b(b"\x14\0\0\0" + header + b"\1\0\0\0\2\0\0\0\3\0\0\0", digest_size=16).hexdigest()
    assert digest_arrays({"a": np.array([1, 2, 3], np.int32)}) == expected


def test_digest_knows_only_the_contents():
    """Order of the map, memory layout and byte order do not matter."""
    a, b = np.arange(6, dtype=np.float32).reshape(2, 3), np.arange(2, dtype=np.int64)
    expected = digest_arrays({"a": a, "b": b})
    assert digest_arrays({"b": b, "a": a}) == expected
    assert digest_arrays({"a": np.asfortranarray(a), "b": b.astype(">i8")}) == expected


def test_digest_differs():
    """Another path, dtype, shape or element gives another digest, and arrays do not run into each other."""
    zeros = np.zeros(4, np.float32)
    given = [
        {"a": zeros},
        {"b": zeros},
        {"a": zeros.astype(np.int32)},
        {"a": zeros.reshape(2, 2)},
        {"a": np.float32([0, 0, 0, 1])},
        {"a": np.float32([0, 0, 0, -0.0])},
        {"a": zeros, "b": zeros[:0]},
        {"a": zeros[:2], "b": zeros[:2]},
        {},
    ]
    assert len({digest_arrays(arrays) for arrays in given}) == len(given)


def test_digest_copies_nothing():
    """8 MB of contiguous arrays are hashed where they are."""
    arrays = {"a": np.zeros((1000, 1000), np.float32), "b": np.zeros(1_000_000, np.float32)}
    tracemalloc.start()
    try:
        digest_arrays(arrays)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 100_000


def test_environments_whose_arrays_were_changed_are_refused():
    """The digest covers them, so that nobody goes on from another state."""
    changed = {**ARRAYS, "a": np.arange(1, 4, dtype=np.int32)}
    whole = Environment("r", 4, "i", 2, 5, 3, digest_arrays(ARRAYS), ARRAYS)
    error = refusal(Environment, with_raw(whole, arrays=changed))
    assert error.reason == "bad_digest"
    assert str(error).startswith("environment of slot 4 says digest")


def test_the_id_of_a_rollout():
    """Slot, generation and number: the same for whoever makes it."""
    assert make_rollout(slot=3, generation=2, seq=9, incarnation="x").id == (3, 2, 9)


@pytest.mark.parametrize("kind", [Rollout, Snapshot, Environment])
def test_what_is_in_logs_of_the_previous_schema_is_read(kind):
    """Rollouts, policies, checkpoints and environments have the same fields in schema 2; all else is refused."""
    for message in EXAMPLES:
        old = codec.encode(codec.decode(message.encode()) | {"schema": 2})
        if type(message) is kind:
            assert codec.decode(kind.decode(old).encode()).keys() == codec.decode(old).keys()
        elif type(message) not in (Rollout, Snapshot, Environment):
            assert refusal(type(message), old).reason == "schema"
    error = refusal(kind, codec.encode({"schema": 1}))
    assert f"of schema 1, but this side speaks schema {SCHEMA_VERSION} and reads those from 2 on" in str(error)


@pytest.mark.parametrize("name", ["obs", "action", "log_prob", "reward", "last_obs", "mirror_reward"])
def test_magnitudes_that_no_update_could_be_made_of(name):
    """A finite 3e38 overflows when it is squared: refused at admission, and read from a log all the same."""
    array = np.array(getattr(make_rollout(), name))
    array.flat[-1] = -3e38
    forged = make_rollout(**{name: array})
    forged.check(SHAPE)
    with pytest.raises(
        CodecError, match=f"{name} has an element of magnitude 3e\\+38; allowed: up to 1e\\+10"
    ) as caught:
        forged.check_magnitudes()
    assert caught.value.reason == "too_big"


def test_returns_and_timings_have_bounds():
    """Four returns of 3e38 would add up to infinity; a timing of 1e308 would be shown and added."""
    forged = make_rollout(episode_return=np.full(2, 3e38, np.float32))
    with pytest.raises(CodecError, match="episode_return"):
        forged.check_magnitudes()
    error = refusal(Rollout, with_raw(make_rollout(), timing={"collect": 1e308}))
    assert (error.reason, str(error)) == ("bad_value", "timing['collect'] is 1e+308; allowed: 0 to 1e+12")


def test_an_episode_is_no_longer_than_the_runs():
    """With an episode length of 1,000 steps none of 1,001."""
    shape = dataclasses.replace(SHAPE, episode_length=1000)
    make_rollout().check(shape)
    with pytest.raises(CodecError, match="episode_length has 1001; allowed: 1 to 1,000 steps"):
        make_rollout(episode_length=np.array([17, 1001], np.int32)).check(shape)


@pytest.mark.parametrize("what", ["dtype", "shape", "key", "name", "schema"])
def test_no_error_repeats_what_came(what):
    """A part of 32 MB: the text stays below 500 characters, and at most 4 MB are allocated beside the part itself."""
    giant = b"\x00" * (32 << 20)
    raw = codec.decode(Join("", "actor", "i", {}, {}, "native").encode())
    message = {
        "dtype": raw | {"run": {"dtype": giant, "shape": [1], "bytes": b"1"}},
        "shape": raw | {"run": {"dtype": "uint8", "shape": giant, "bytes": b"1"}},
        "key": raw | {giant: 1},
        "name": raw | {"role": giant},
        "schema": raw | {"schema": giant},
    }[what]
    data = msgpack.packb(message)
    tracemalloc.start()
    with pytest.raises(CodecError) as caught:
        Join.decode(data, Limits())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(str(caught.value)) < 500
    assert peak < len(giant) + (4 << 20)


def test_small_messages_have_small_limits():
    """A request to join of more than 256 KiB is refused by its size alone."""
    assert refusal(Join, b"\xc1" * (300 << 10)).reason == "too_large"
    assert refusal(Heartbeat, b"\xc1" * (5 << 10)).reason == "too_large"


def test_no_more_simulations_diverged_than_episodes_were_terminated() -> None:
    """A diverged simulation ends its episode; the example has one that was terminated."""
    make_rollout(diverged=1).check(SHAPE)
    with pytest.raises(CodecError, match="diverged is 2; only 1 episodes were terminated"):
        make_rollout(diverged=2).check(SHAPE)


def test_fields_that_came_later_have_their_defaults_in_older_logs():
    """A rollout of schema 2 says nothing of divergence: none, and the rest as it is. One of this schema must say it."""
    raw = codec.decode(make_rollout(seq=3).encode())
    del raw["diverged"]
    old = Rollout.decode(codec.encode(raw | {"schema": 2}))
    assert (old.diverged, old.seq) == (0, 3)
    assert refusal(Rollout, codec.encode(raw)).reason == "missing_field"
    del raw["obs"]
    assert refusal(Rollout, codec.encode(raw | {"schema": 2})).reason == "missing_field"
