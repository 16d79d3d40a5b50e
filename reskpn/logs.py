"""Recorded runs in Python: every update with what was measured and the rollouts it was made from.

    from reskpn.logs import open_run

    run = open_run("runs/x")
    print(run.run, run.settings.task)
    for update in run.updates():
        rewards = [rollout.reward.mean() for rollout in update.rollouts]
        print(update.version, update.metrics["train/kl"], rewards)

The log is read as the loop goes on and needs no JAX. Arrays are NumPy's and read-only: `obs` [T, N, O], `action`
[T, N, A], `log_prob`, `reward`, `terminated` and `truncated` [T, N], `last_obs` [N, O], for T steps of N environments.
"""

from common.log.records import LogMessage
from common.runs.recorded_run import RecordedRun, open_run
from common.runs.recorded_updates import RecordedUpdate
from common.wire.rollout import Rollout

__all__ = ["LogMessage", "RecordedRun", "RecordedUpdate", "Rollout", "open_run"]
