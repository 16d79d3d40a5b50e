"""`--config fast`: small batches, DPO's drift and the kernel critic; the defaults stay Table 1's."""

from __future__ import annotations

from common.config.settings import RunSettings
from common.config.sources import load


def test_fast_is_what_its_file_says() -> None:
    """Batches of 64 x 128 = 8,192 in 32 minibatches of 256, networks of 128, time limits bootstrapped, rff critic."""
    settings = load(config="fast", environment={})
    assert (settings.learner, settings.batch_size, settings.envs_per_actor) == ("dpo", 8192, 32)
    assert (settings.algorithm.minibatches, settings.algorithm.hidden) == (32, (128, 128))
    assert settings.algorithm.bootstrap_at_truncation
    assert settings.critic.representation == "rff"


def test_the_environment_takes_precedence_over_it() -> None:
    """A preset is a file of settings like any other."""
    settings = load(config="fast", environment={"RESKPN_LEARNER": "ppo", "RESKPN_CRITIC__REPRESENTATION": "none"})
    assert (settings.learner, settings.critic.representation, settings.num_envs) == ("ppo", "none", 64)


def test_no_default_has_a_kernel_critic() -> None:
    """Without the preset a run is the paper's."""
    settings = RunSettings()
    assert (settings.critic.representation, settings.algorithm.objective) == ("none", "auto")
