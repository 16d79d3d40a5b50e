"""Advantages, and the discounted returns by which rewards are scaled."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int


def generalised_advantage(
    reward: Float[Array, "T N"],
    value: Float[Array, "T N"],
    next_value: Float[Array, "T N"],
    terminated: Bool[Array, "T N"],
    truncated: Bool[Array, "T N"],
    *,
    gamma: float,
    lambda_: float,
) -> Float[Array, "T N"]:
    """Generalised advantage estimation (Schulman et al. 2016, equation 16).

    delta_t = r_t + gamma (1 - terminated_t) V(s_t+1) - V(s_t), summed with (gamma lambda)^l up to the end of the
    episode. `next_value` is the value of the state that a step led to, before any reset; pass zero there to
    leave out the bootstrap at the time limit.
    """
    delta = reward + gamma * jnp.where(terminated, 0.0, next_value) - value
    carries_on = jnp.where(terminated | truncated, 0.0, gamma * lambda_)

    def backwards(
        advantage: Float[Array, "N"], at_t: tuple[Float[Array, "N"], Float[Array, "N"]]
    ) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
        delta_t, decay_t = at_t
        advantage = delta_t + decay_t * advantage
        return advantage, advantage

    _, advantages = jax.lax.scan(backwards, jnp.zeros_like(delta[0]), (delta, carries_on), reverse=True)
    return advantages


def discounted_returns(
    carried: Float[Array, "S N"],
    slot: Int[Array, "K"],
    fresh: Bool[Array, "K"],
    reward: Float[Array, "K T N"],
    done: Bool[Array, "K T N"],
    *,
    gamma: float,
) -> tuple[Float[Array, "S N"], Float[Array, "K T N"]]:
    """The forward-discounted return R_t = gamma (1 - done_t) R_t-1 + r_t of every environment at every step.

    Its variance scales the rewards (PureJaxRL, Engstrom et al. 2020). Rollouts are taken in the order given; two
    of the same slot follow one another in time.

    Args:
        carried: R at the end of each slot's last rollout, S slots.
        slot: the slot of each of the K rollouts.
        fresh: whether a rollout is the first of new environments, whose returns start at zero.
    """

    def one_rollout(
        carried: Float[Array, "S N"], rollout: tuple[Array, Array, Array, Array]
    ) -> tuple[Float[Array, "S N"], Float[Array, "T N"]]:
        slot_k, fresh_k, reward_k, done_k = rollout
        before = jnp.where(fresh_k, 0.0, carried[slot_k])

        def one_step(
            returns: Float[Array, "N"], at_t: tuple[Array, Array]
        ) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
            reward_t, done_t = at_t
            returns = jnp.where(done_t, 0.0, gamma * returns) + reward_t
            return returns, returns

        after, returns = jax.lax.scan(one_step, before, (reward_k, done_k))
        return carried.at[slot_k].set(after), returns

    return jax.lax.scan(one_rollout, carried, (slot, fresh, reward, done))
