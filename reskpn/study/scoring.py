"""Which number of a result stands for it."""

from __future__ import annotations

from reskpn.study.results import NO_EPISODE_ENDS, Result


def final_of(result: Result) -> float:
    """The score of the last tenth of a run: mean return of its training episodes.

    On tasks where no episode terminates (`NO_EPISODE_ENDS`), the mean reward of a step times the episode's length: the
    returns of the few episodes that end in a short run say little about its end.
    """
    scores = result.scores
    if result.task in NO_EPISODE_ENDS or scores.last_tenth is None:
        return scores.reward_last_tenth
    return scores.last_tenth


def area_of(result: Result) -> float:
    """The height of a run's learning curve, its mean over all updates; measured as `final_of`."""
    scores = result.scores
    if result.task in NO_EPISODE_ENDS or scores.area is None:
        return scores.reward_area
    return scores.area
