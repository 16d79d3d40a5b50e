"""Keys: one root, one run, one chunk for each part."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.errors import CodecError, SettingsError
from common.wire.keys import JOIN, STATUS, Keys, parse_alive

LETTERS = "abcdefghijklmnopqrstuvwxyz0123456789"
run_ids = st.builds(str.__add__, st.sampled_from(LETTERS), st.text(LETTERS + "_.-", max_size=79))


def test_join_needs_no_run():
    """A process that knows only an address can ask to join, and how the run is."""
    assert JOIN == "reskpn/v1/join"
    assert STATUS == "reskpn/v1/status"


def test_keys_as_documented():
    """Keys are what dashboards and access rules written by hand expect."""
    keys = Keys("hopper-1")
    assert keys.rollout(3) == "reskpn/v1/hopper-1/rollout/3"
    assert keys.evaluation(0) == "reskpn/v1/hopper-1/evaluation/0"
    assert keys.environment(4) == "reskpn/v1/hopper-1/environment/4"
    assert keys.environments == "reskpn/v1/hopper-1/environment/*"
    assert keys.assessment("5f") == "reskpn/v1/hopper-1/assessment/5f"
    assert keys.assessments == "reskpn/v1/hopper-1/assessment/*"
    assert keys.heartbeat(12) == "reskpn/v1/hopper-1/heartbeat/12"
    assert keys.alive("actor", "5f") == "reskpn/v1/hopper-1/alive/actor/5f"
    assert keys.rollouts == "reskpn/v1/hopper-1/rollout/*"
    assert keys.evaluations == "reskpn/v1/hopper-1/evaluation/*"
    assert keys.heartbeats == "reskpn/v1/hopper-1/heartbeat/*"
    assert keys.all_alive == "reskpn/v1/hopper-1/alive/*/*"
    assert keys.policy_notify == "reskpn/v1/hopper-1/policy/notify"
    assert keys.policy_latest == "reskpn/v1/hopper-1/policy/latest"
    assert keys.status == "reskpn/v1/hopper-1/status"
    assert keys.metrics == "reskpn/v1/hopper-1/metrics"


@given(run_ids, run_ids, run_ids)
@settings(max_examples=50)
def test_alive_keys_come_apart_again(run, role, identity):
    """Who a liveliness token belongs to can be read from its key, for every run, role and id."""
    assert parse_alive(Keys(run).alive(role, identity)) == (role, identity)


@pytest.mark.parametrize(
    "key",
    [
        "",
        "reskpn/v1/r/alive/actor",
        "reskpn/v1/r/alive/actor/1/2",
        "reskpn/v1/r/alive/*/*",
        "reskpn/v2/r/alive/actor/1",
        "reskpn/v1/r/status",
    ],
)
def test_other_keys_are_not_liveliness_keys(key):
    """A key of another form is refused, never half read."""
    with pytest.raises(CodecError, match="expected reskpn/v1/<run>/alive/<role>/<id>") as caught:
        parse_alive(key)
    assert caught.value.reason == "bad_key"


@pytest.mark.parametrize("run", ["a", "0", "hopper_2.b-c", "a" * 80])
def test_possible_run_ids(run):
    """Lower-case letters, digits, '_', '.' and '-' make a run id, up to 80 of them."""
    assert Keys(run).status == f"reskpn/v1/{run}/status"


@pytest.mark.parametrize(
    "run", ["", "a" * 81, "A", "-a", ".a", "a/b", "a*", "**", "$a", "a?b", "a#b", "@a", "a b", "é", "a\n"]
)
def test_impossible_run_ids(run):
    """What would reach beyond the run, or is no key at all, is refused with the rule."""
    with pytest.raises(SettingsError, match="cannot be a run id: use 1 to 80 of a-z, 0-9"):
        Keys(run)


@pytest.mark.parametrize(("role", "identity"), [("*", "1"), ("actor", "**"), ("actor", "1/2"), ("", "1")])
def test_a_token_is_no_wildcard(role, identity):
    """A token cannot speak for others: roles and ids are single chunks without wildcards."""
    with pytest.raises(SettingsError):
        Keys("r").alive(role, identity)
    with pytest.raises(SettingsError):
        Keys("r").assessment("a/*")


def test_slots_count_from_zero():
    """A negative slot is refused."""
    with pytest.raises(SettingsError, match="-1 cannot be a slot"):
        Keys("r").rollout(-1)
