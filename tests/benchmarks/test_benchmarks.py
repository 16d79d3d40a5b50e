"""The benchmarks measure what they say; the reference implementation is the algorithm it says it is."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import learning, one_process, physics, reference, service
from benchmarks.processes import bare_environment, run_module
from common.errors import ProcessError, SettingsError
from common.maths import objectives, returns

pytestmark = pytest.mark.usefixtures("in_a_hurry")

TINY = ["--task", "inverted_pendulum", "--physics", "native", "--num-envs", "16", "--learner", "dpo"]
"""Updates of 160 steps: 32 minibatches of 5."""


# -- the reference -----------------------------------------------------------------------------------------


def test_the_references_dpo_is_that_of_lu_et_al() -> None:
    """r A less alpha's drift where A >= 0, beta's where A < 0, no drift below zero."""
    log_ratio = jnp.log(jnp.array([2.0, 0.5, 2.0, 0.5]))
    advantage = jnp.array([1.0, 1.0, -1.0, -1.0])
    # r = 2, A = 1: drift 1 - 2 tanh(1/2) = 0.075766, so 2 - 0.075766
    # r = 1/2, A = 1: -1/2 + 2 tanh(1/4) < 0, no drift
    # r = 2, A = -1: -log 2 + 0.6 tanh(log 2 / 0.6) < 0, no drift
    # r = 1/2, A = -1: drift log 2 - 0.6 tanh(log 2 / 0.6) = 0.693147 - 0.6 * 0.819485 = 0.201456
    expected = [1.924234, 0.5, -2.0, -0.701456]
    np.testing.assert_allclose(reference.dpo_gain(log_ratio, advantage, 2.0, 0.6), expected, rtol=1e-5)


def test_the_references_ppo_is_clipped_on_the_side_that_gains() -> None:
    """Clip 0.2: a gain is held at 1.2 A or 0.8 A, a loss is not."""
    log_ratio = jnp.log(jnp.array([2.0, 0.5, 2.0, 0.5]))
    advantage = jnp.array([1.0, 1.0, -1.0, -1.0])
    np.testing.assert_allclose(reference.ppo_gain(log_ratio, advantage, 0.2), [1.2, 0.5, -2.0, -0.8], rtol=1e-6)


def test_the_references_advantages_end_with_the_episode() -> None:
    """gamma = lambda = 1/2; the episode ends at the second of three steps."""
    column = lambda *values: jnp.array(values)[:, None]  # noqa: E731
    found = reference.advantages(
        column(1.0, 2.0, 3.0), column(0.5, 1.0, 2.0), column(False, True, False), jnp.array([4.0]), 0.5, 0.5
    )
    # last: 3 + 4/2 - 2 = 3; second: 2 - 1 = 1, nothing follows; first: 1 + 1/2 - 0.5 = 1, plus 1/4 of the second's 1
    np.testing.assert_allclose(found[:, 0], [1.25, 1.0, 3.0], rtol=1e-6)


def test_the_reference_normalises_observations_by_the_moments_just_updated() -> None:
    """After 1, 3 and 5, 7 the mean is 4 and the variance 5, and 5, 7 are already seen through these."""
    moments, first = reference.observe(reference.no_moments((1,)), jnp.array([[1.0], [3.0]]))
    np.testing.assert_allclose(first[:, 0], [-1.0, 1.0], atol=1e-3)  # mean 2, variance 1; the start counts 1e-4
    moments, second = reference.observe(moments, jnp.array([[5.0], [7.0]]))
    np.testing.assert_allclose([moments.mean[0], moments.variance[0]], [4.0, 5.0], rtol=1e-3)
    np.testing.assert_allclose(second[:, 0], [1 / math.sqrt(5.0), 3 / math.sqrt(5.0)], rtol=2e-3)


def test_the_reference_scales_rewards_by_the_deviation_of_discounted_returns() -> None:
    """gamma = 1/2, returns of 2 so far, the second episode ends: 2/2 + 1 = 2 and 0 + 3 = 3, deviation 1/2."""
    _, carried, scaled = reference.scale_reward(
        reference.no_moments(()), jnp.array([2.0, 2.0]), jnp.array([1.0, 3.0]), jnp.array([False, True]), 0.5
    )
    np.testing.assert_allclose(carried, [2.0, 3.0])
    np.testing.assert_allclose(scaled, [2.0, 6.0], rtol=2e-3)  # the start counts 1e-4


def test_reference_and_learner_agree_where_their_methods_do() -> None:
    """Two implementations written apart give the same objectives and advantages for random transitions."""
    random = np.random.default_rng(7)
    log_ratio, advantage = jnp.asarray(random.normal(size=(2, 1000)), jnp.float32)
    pairs = [
        (
            reference.ppo_gain(log_ratio, advantage, 0.2),
            objectives.clipped(jnp.exp(log_ratio), advantage, clip=0.2),
        ),
        (
            reference.dpo_gain(log_ratio, advantage, 2.0, 0.6),
            objectives.drifted(log_ratio, advantage, alpha=2.0, beta=0.6),
        ),
    ]
    reward, value = jnp.asarray(random.normal(size=(2, 10, 100)), jnp.float32)
    last = jnp.asarray(random.normal(size=100), jnp.float32)
    terminated, truncated = jnp.asarray(random.random((2, 10, 100)) < 0.1)
    next_value = jnp.concatenate([value[1:], last[None]])
    pairs.append(
        (
            reference.advantages(reward, value, terminated | truncated, last, 0.99, 0.95),
            # no bootstrap at the time limit: the value there is zero
            returns.generalised_advantage(
                reward,
                value,
                jnp.where(truncated, 0.0, next_value),
                terminated & ~truncated,
                truncated,
                gamma=0.99,
                lambda_=0.95,
            ),
        )
    )
    for theirs, ours in pairs:
        np.testing.assert_allclose(theirs, ours, rtol=1e-4, atol=1e-5)


def test_the_reference_trains(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Two updates of the smallest kind, as the comparison asks for them: one line with every update's episodes."""
    monkeypatch.setattr(reference, "prepare", lambda: None)  # the tests have prepared JAX
    assert reference.main([*TINY, "--steps", "320", "--hidden", "8"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["updates"] == len(result["episodes"]) == len(result["return_sum"]) == 2
    # a pole gets 1 for every step, so the returns are lengths: 1 step at least, and 2 x 160 together at most
    assert 0 < sum(result["episodes"]) <= sum(result["return_sum"]) <= 320
    assert 0.0 < result["env_steps_per_s"] < math.inf


# -- one process and service -------------------------------------------------------------------------------


def test_one_process_reports_its_speed_by_phase(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Speed and seconds are of the same updates, and the phases fill the update."""
    monkeypatch.setattr(one_process, "prepare", lambda: None)
    options = ["--num-steps", "10", "--algorithm.hidden", "8,8", "--updates", "3", "--warm-up", "1", "--returns"]
    assert one_process.main([*TINY, *options]) == 0
    result = json.loads(capsys.readouterr().out)
    seconds = dict(result["seconds"])
    update_s = seconds.pop("update")
    assert set(seconds) == {"physics", "policy", "learner", "hand_over"}
    assert all(0.0 < value < math.inf for value in seconds.values())
    assert 0.5 * update_s < sum(seconds.values()) <= update_s
    assert result["env_steps_per_s"] == pytest.approx(160 / update_s)  # 16 environments x 10 steps
    assert result["updates"] == len(result["episodes"]) == 3
    assert len(result["state_digest"]) == 32


def test_what_cannot_be_measured_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A warm-up that leaves nothing, in one process as through the service, before anything is started."""
    monkeypatch.setattr(one_process, "prepare", lambda: None)
    assert one_process.main([*TINY, "--updates", "3", "--warm-up", "3"]) == SettingsError.exit_code
    assert "--warm-up 3 leaves nothing of 3 updates" in capsys.readouterr().err
    assert service.main([*TINY, "--updates", "3", "--warm-up", "0"]) == SettingsError.exit_code
    assert "--warm-up is 0; it must be at least 1" in capsys.readouterr().err


def test_the_reference_gets_the_same_work_and_refuses_settings_that_it_has_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its command parses as the reference's own does, and asks for as many updates of the same batch."""
    asked: list[str] = []

    def run_json(module: str, arguments: list[str]) -> dict[str, float]:
        asked.extend([module, *arguments])
        return {"env_steps_per_s": 7.0}

    monkeypatch.setattr(service, "run_json", run_json)
    names = ("task", "learner", "physics", "num-envs", "num-steps", "seed")
    values = ("hopper", "dpo", "auto", "64", "10", "3")
    settings = [word for name, value in zip(names, values, strict=True) for word in (f"--{name}", value)]
    plan = service.Plan([*settings, "--total-steps", "3200"], 640, 5, 2)
    assert service.reference(plan).env_steps_per_s == 7.0
    assert asked[0] == "benchmarks.reference"
    assert asked[1:] == [
        *("--task", "hopper", "--learner", "dpo", "--physics", "auto", "--num-envs", "64", "--seed", "3"),
        *("--steps", "3200"),
    ]
    for wrong in (["--learner", "reskpn"], ["--num-steps", "5"], ["--algorithm.hidden", "8,8"]):
        with pytest.raises(SystemExit):
            service.main([*TINY, "--reference", *wrong])
        assert wrong[1] in capsys.readouterr().err


def test_a_failed_process_says_why() -> None:
    """The last words of the process are in the error, not only its exit code."""
    with pytest.raises(ProcessError, match=r"-m json\.tool /nowhere ended with exit code (.|\n)*No such file"):
        run_module("json.tool", ["/nowhere"])


def test_processes_get_no_settings_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both sides of a comparison are what its command line says; only the place of the cache is passed on."""
    monkeypatch.setenv("RESKPN_NUM_STEPS", "3")
    monkeypatch.setenv("RESKPN_CACHE_DIR", "kept")
    assert {"RESKPN_NUM_STEPS", "RESKPN_CACHE_DIR"} & set(bare_environment()) == {"RESKPN_CACHE_DIR"}


def test_transport_is_what_physics_policy_learner_and_publishing_leave_of_an_update() -> None:
    """Two updates of 1 s each; the learner waits less than the actors work, for they begin while it records."""
    first = {"wait": 0.5, "learner": 0.2, "publish": 0.01, "record": 0.15, "log": 0.02}
    first |= {"actor/physics": 0.4, "actor/collect": 0.1, "actor/push": 0.05}
    second = first | {"actor/physics": 0.2, "learner": 0.4}
    found = service.phases([first, second], 1.0)
    # means: physics 0.3, policy 0.1, learner 0.3, publish 0.01; 1 - 0.71
    assert found["transport"] == pytest.approx(0.29)
    assert sum(found[name] for name in service.PHASES if name in found) == pytest.approx(found["update"])
    assert {name: found[name] for name in service.BESIDE} == pytest.approx(
        {"wait": 0.5, "record": 0.15, "log": 0.02, "push": 0.05}
    )


def test_speeds_are_compared_pair_by_pair() -> None:
    """Each service run is held against the one process of its own turn; a wrong state is said aloud."""

    def samples(*speeds: float, digest: str = "aa") -> list[service.Sample]:
        return [service.Sample(speed, {}, digest) for speed in speeds]

    taken = {"one process": samples(100.0, 50.0, 80.0), "1 actor": samples(90.0, 40.0, 80.0, digest="bb")}
    assert service.ratios(taken, "1 actor") == pytest.approx([0.9, 0.8, 1.0])
    text = "\n".join(service.speed_table(taken))
    assert "0.900  0.900 0.800 1.000" in text  # the median, then the pairs
    assert "met" in text
    assert "did NOT end in the same state" in text


# -- learning ----------------------------------------------------------------------------------------------

TRIAL = learning.Trial("own", "hopper", "ppo", "native", 2048, 1_500_000, 0)


def test_a_curve_is_drawn_through_updates_without_episodes() -> None:
    """Straight between the updates around, level before the first; the figures are means over its updates."""
    found = learning.curve({"return_sum": [0.0, 10.0, 0.0, 30.0], "episodes": [0, 2, 0, 3]})
    np.testing.assert_allclose(found, [5.0, 5.0, 7.5, 10.0])
    # the last tenth of 4 updates is the last one; (5 + 5 + 7.5 + 10) / 4
    assert learning.measures(found) == {"last tenth": 10.0, "area": 6.875}


def test_a_run_too_short_for_an_episode_is_refused() -> None:
    """There is nothing to compare, and the sentence says what to change."""
    result = {"return_sum": [0.0], "episodes": [0], "trial": asdict(TRIAL)}
    with pytest.raises(SettingsError, match=r"no episode of hopper .* more --steps"):
        learning.curve(result)


def test_the_interval_holds_the_difference_of_the_means() -> None:
    """Without spread it is a point; with it, seeds are drawn on each side by itself; of one seed there is none."""
    assert learning.difference_interval([3.0, 3.0], [1.0, 1.0]) == (2.0, 2.0)
    # own mean is 0, 1 or 2 with probability 1/4, 1/2, 1/4, the other's likewise: 2 and -2 come in 1/16 of the draws
    assert learning.difference_interval([0.0, 2.0], [0.0, 2.0]) == (-2.0, 2.0)
    assert learning.difference_interval([3.0], [1.0]) is None


def test_results_that_are_there_are_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A comparison goes on where it was stopped, but never with a result of other options."""
    made: list[str] = []

    def run_json(module: str, arguments: list[str]) -> dict[str, Any]:
        made.append(module)
        return {"return_sum": [1.0], "episodes": [1]}

    monkeypatch.setattr(learning, "run_json", run_json)
    first = learning.result_of(TRIAL, tmp_path)
    assert learning.result_of(TRIAL, tmp_path) == first == json.loads((tmp_path / TRIAL.file_name).read_text())
    assert made == ["benchmarks.one_process"]
    with pytest.raises(SettingsError, match="is of another trial"):
        learning.result_of(learning.Trial("own", "hopper", "ppo", "native", 2048, 3_000_000, 0), tmp_path)


def test_the_native_engine_beside_mujocos_batch_alone() -> None:
    """Both make the same steps in turn; the ratio is theirs, round by round."""
    options = argparse.Namespace(num_envs=8, threads=1, steps=3, repeats=3, tasks=["inverted_pendulum"])
    head, _, row = physics.bare_table(options)
    assert head == "| task | envs | native, env steps/s | mujoco.batch alone | ratio, median of rounds |"
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[:2] == ["inverted_pendulum", "8"]
    assert all(float(cell.replace(",", "")) > 0 for cell in cells[2:4])
    assert 0.0 <= float(cells[4]) < 5.0
