"""The tree of settings: what is possible, and what is said of what is not."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from common.config.rkhs import PAPER_CENTRES
from common.config.settings import RunSettings
from common.config.sources import parse_json
from common.errors import SettingsError


def make(**values: Any) -> RunSettings:
    return RunSettings.model_validate(values)


def refusal(**values: Any) -> str:
    """The one sentence that these settings are refused with."""
    with pytest.raises(ValidationError) as refused:
        make(**values)
    (fault,) = refused.value.errors()
    return fault["msg"].removeprefix("Value error, ")


# -- what follows from the settings ------------------------------------------------------------------------


def test_batch_updates_and_environments() -> None:
    """B = N T, updates are whole ones, and every actor runs the same share."""
    settings = make(num_envs=64, num_steps=8, actors=4, total_steps=5000, algorithm={"minibatches": 16})
    # B = 64 * 8 = 512; 5000 / 512 = 9.77; 64 / 4 = 16
    assert (settings.batch_size, settings.updates, settings.envs_per_actor) == (512, 9, 16)


def test_defaults_are_possible() -> None:
    """Nothing has to be set; the paper's sizes, for 2.2e6 steps."""
    settings = RunSettings()
    # 2048 * 10 = 20,480 transitions; 2,200,000 / 20,480 = 107.4
    assert (settings.batch_size, settings.updates, settings.envs_per_actor) == (20_480, 107, 1024)
    assert (settings.task, settings.learner, settings.mode) == ("inverted_pendulum", "reskpn", "sync")


@pytest.mark.parametrize(
    ("changes", "capacity"),
    [
        ({}, 107),  # one centre an update, 107 updates
        ({"rkhs": {"samples": 4}}, 428),  # 4 * 107
        ({"total_steps": 5e7}, 2441),  # 5e7 / 20480 = 2441.4
        ({"total_steps": 1e9}, PAPER_CENTRES),  # 48,828 updates, and no more centres than in the paper
        ({"total_steps": 1e9, "rkhs": {"samples": 3000}}, 3000),  # room for one step's samples at least
        ({"rkhs": {"capacity": 77}}, 77),
        ({"learner": "ppo", "rkhs": {"capacity": 77}}, 0),  # no expansion
    ],
)
def test_capacity(changes: dict[str, Any], capacity: int) -> None:
    """Room for every centre of the run up to the paper's number, unless it is given."""
    assert make(**changes).capacity == capacity


def test_settings_are_frozen() -> None:
    """They are read in many places and changed in none."""
    settings = RunSettings()
    with pytest.raises(ValidationError, match="frozen"):
        settings.seed = 1
    with pytest.raises(ValidationError, match="frozen"):
        settings.algorithm.gamma = 0.5


# -- numbers -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [3_000_000, 3e6, "3e6", "3000000", "3_000_000", "3e+6", " 3000000.0 "])
def test_whole_numbers_in_every_form(value: Any) -> None:
    """As YAML, JSON, shells and people write them."""
    settings = make(total_steps=value)
    assert settings.total_steps == 3_000_000
    assert type(settings.total_steps) is int


def test_whole_numbers_everywhere() -> None:
    """Counts of every section take the short form, also in lists and where None is allowed."""
    settings = make(
        actors="1e0",
        num_envs="4e2",
        num_steps="1e1",
        seed="1e3",
        episode_length="2e3",
        algorithm={"minibatches": "1e1", "hidden": ["1.6e1", 8.0]},
        rkhs={"capacity": "1e2", "samples": "2e0"},
        transport={"queue_bytes": "1e6"},
        log={"checkpoint_every": "5e0"},
        evaluation={"episodes": "0e0"},
    )
    assert (settings.actors, settings.num_envs, settings.num_steps) == (1, 400, 10)
    assert (settings.seed, settings.episode_length) == (1000, 2000)
    assert settings.algorithm.hidden == (16, 8)
    assert (settings.rkhs.capacity, settings.rkhs.samples) == (100, 2)
    assert (settings.transport.queue_bytes, settings.log.checkpoint_every) == (1_000_000, 5)
    assert settings.evaluation.episodes == 0


@given(st.integers(0, 2**32 - 1))
def test_digits_are_exact(seed: int) -> None:
    """A seed written out is that seed."""
    assert make(seed=str(seed)).seed == seed


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"seed": "1.5"}, "got a number with a fractional part"),
        ({"seed": 1.5}, "got a number with a fractional part"),
        ({"seed": "many"}, "unable to parse string as an integer"),
        ({"seed": -1}, "greater than or equal to 0"),
        # JAX uses 32 bits: 2**32 would be seed 0 again.
        ({"seed": 2**32}, "less than 4294967296"),
        ({"total_steps": "inf"}, "finite number"),
        ({"actors": 0}, "greater than or equal to 1"),
        ({"algorithm": {"gamma": 1.01}}, "less than or equal to 1"),
        ({"algorithm": {"learning_rate": 0}}, "greater than 0"),
        ({"algorithm": {"learning_rate": float("nan")}}, "finite number"),
        ({"algorithm": {"hidden": []}}, "needs at least one layer, for example 256,256"),
        ({"algorithm": {"hidden": [8, 0]}}, "greater than or equal to 1"),
        ({"rkhs": {"momentum": 1.0}}, "less than 1"),
        ({"rkhs": {"bandwidth": 0}}, "greater than 0"),
        ({"log": {"compression": "zstd"}}, "'none' or 'lz4'"),
        ({"mode": "fast"}, "'sync' or 'async'"),
        ({"mode": "async", "max_staleness": 5}, "less than or equal to 4"),
        ({"max_staleness": -1}, "greater than or equal to 0"),
        ({"evaluation": {"episodes": -1}}, "greater than or equal to 0"),
    ],
)
def test_numbers_that_are_not_possible(values: dict[str, Any], said: str) -> None:
    """Each setting has its range."""
    assert said in refusal(**values)


# -- names -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"task": "hoper"}, "'hoper' is not a task; did you mean 'hopper'? allowed: inverted_pendulum, hopper, "),
        (
            {"learner": "reskp"},
            "'reskp' is not a learner; did you mean 'reskpn'? allowed: origin-kernel, kpn, advkpn, reskpn, ",
        ),
        (
            {"physics": "mjxx"},
            "'mjxx' is not a physics engine; did you mean 'mjx'? allowed: auto, mjx, native",
        ),
        (
            {"rkhs": {"kernel": "gausian"}},
            "'gausian' is not a kernel; did you mean 'gaussian'? allowed: gaussian",
        ),
    ],
)
def test_unknown_names(values: dict[str, Any], said: str) -> None:
    """The nearest name, and all that are allowed."""
    assert refusal(**values).startswith(said)


def test_unknown_settings() -> None:
    """A name that is no setting is an error, at the top and in every section."""
    for values in ({"gama": 1}, {"algorithm": {"gama": 1}}, {"log": {"gama": 1}}):
        assert refusal(**values) == "Extra inputs are not permitted"


# -- combinations ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (
            {"num_envs": 7, "actors": 2},
            "num_envs (7) must be a multiple of actors (2): each actor runs num_envs / actors environments; "
            "try num_envs 8",
        ),
        (
            {"num_envs": 2, "actors": 5},
            "num_envs (2) must be a multiple of actors (5): each actor runs num_envs / actors environments; "
            "try num_envs 5",
        ),
        (
            # 64 * 10 = 640 = 2^7 * 5; the divisors nearest to 30 are 32 and 20
            {"num_envs": 64, "algorithm": {"minibatches": 30}},
            "a batch of 640 transitions (num_envs 64 x num_steps 10) cannot be divided into 30 minibatches; "
            "try algorithm.minibatches 32",
        ),
        (
            # 2 * 7 = 14: the divisors are 1, 2, 7 and 14, and 14 would leave single transitions
            {"num_envs": 2, "num_steps": 7, "algorithm": {"minibatches": 32}},
            "a batch of 14 transitions (num_envs 2 x num_steps 7) cannot be divided into 32 minibatches; "
            "try algorithm.minibatches 7",
        ),
        (
            # 4 * 8 = 32: the divisors that leave two or more are 1, 2, 4, 8 and 16
            {"num_envs": 4, "num_steps": 8, "algorithm": {"minibatches": 32}},
            "algorithm.minibatches (32) leaves one transition in each minibatch of a batch of 32 (num_envs 4 x "
            "num_steps 8), whose normalised advantage is always 0; try algorithm.minibatches 16",
        ),
        (
            {"total_steps": 20_479},
            "total_steps (20479) is less than one update of 20480 transitions (num_envs 2048 x num_steps 10); "
            "ask for more steps or fewer environments",
        ),
        (
            {"num_steps": 10, "episode_length": 9},
            "num_steps (10) must not be longer than an episode (9 steps)",
        ),
        (
            {"rkhs": {"samples": 20_481}},
            "rkhs.samples (20481) must be at most the batch of 20480 transitions; 'batch' takes all of them",
        ),
        (
            {"rkhs": {"samples": 5, "capacity": 4}},
            "rkhs.capacity (4) must hold at least one step's rkhs.samples (5): each is a new centre; "
            "rkhs.representation nystrom or rff takes any number of samples at a fixed size",
        ),
    ],
)
def test_impossible_combinations(values: dict[str, Any], said: str) -> None:
    """Refused at start, with the numbers and a way out."""
    assert refusal(**values) == said


@given(st.integers(1, 3000), st.integers(1, 3000))
def test_the_suggested_number_of_minibatches_is_the_nearest(num_envs: int, minibatches: int) -> None:
    """Of all divisors of the batch, here simply all envs of one step, that leave two transitions or more."""
    if num_envs % minibatches == 0:
        return
    said = refusal(num_envs=num_envs, actors=1, num_steps=1, algorithm={"minibatches": minibatches})
    suggested = int(said.rsplit(" ", 1)[1])
    divisors = [m for m in range(1, num_envs // 2 + 1) if num_envs % m == 0] or [1]
    assert suggested in divisors
    assert abs(suggested - minibatches) == min(abs(m - minibatches) for m in divisors)


def test_a_huge_batch_is_refused_at_once() -> None:
    """The search for a number that would do does not grow with the batch."""
    said = refusal(num_envs=10**15 + 2, num_steps=1, total_steps=10**16)
    # 10^15 + 2 is 2 times an odd number: 32 does not divide it
    assert said.startswith("a batch of 1000000000000002 transitions")


# -- from one process to another ---------------------------------------------------------------------------

whole = st.integers(1, 50)
real = st.floats(1e-9, 1.0, allow_nan=False)


@st.composite
def possible(draw: st.DrawFn) -> RunSettings:
    actors, each, steps, minibatches = draw(whole), draw(whole), draw(st.integers(2, 50)), draw(whole)
    num_envs = actors * each * minibatches
    return make(
        task=draw(st.sampled_from(["hopper", "reacher"])),
        learner=draw(st.sampled_from(["reskpn", "ppo", "dpo"])),
        actors=actors,
        num_envs=num_envs,
        num_steps=steps,
        total_steps=num_envs * steps * draw(whole),
        seed=draw(st.integers(0, 2**32 - 1)),
        run_dir=draw(st.sampled_from([None, "runs/a", "/somewhere/ä b"])),
        algorithm={
            "minibatches": minibatches,
            "gamma": draw(real),
            "adam_eps": draw(real),
            "hidden": draw(st.lists(whole, min_size=1, max_size=3)),
            "normalise_rewards": draw(st.booleans()),
        },
        rkhs={"eta": draw(real), "capacity": draw(st.none() | st.integers(1, 99))},
    )


@given(possible())
def test_settings_survive_the_way_to_an_actor(settings: RunSettings) -> None:
    """As JSON, every field to the last bit."""
    assert parse_json(settings.model_dump_json()) == settings


@pytest.mark.parametrize("text", ["", "{", "[]", '{"gama": 1}', '{"seed": -1}'])
def test_settings_that_are_none(text: str) -> None:
    """Whatever another release of the learner sends, there is a sentence."""
    with pytest.raises(SettingsError):
        parse_json(text)


def test_staleness_is_a_matter_of_async_mode() -> None:
    """In sync mode no rollout is ever stale, whatever bound is given."""
    assert RunSettings.model_validate({"max_staleness": 3}).staleness == 0
    assert RunSettings.model_validate({"mode": "async"}).staleness == 1
    assert RunSettings.model_validate({"mode": "async", "max_staleness": 3}).staleness == 3
