"""PPO and DPO for continuous actions in one file and one process: the reference for the project's own learner.

    python -m benchmarks.reference --task hopper --learner ppo --steps 1.5e6 --seed 0

Written from the algorithms as PureJaxRL (Lu et al. 2022) runs them, and independent of this project's mathematics and
services: only the environments are shared. Normalisation is part of the environment: at every step the running moments
take in the new observations (and discounted returns), and these are normalised by the moments just updated.

Axis letters: T steps, N environments, B = T * N transitions or a minibatch of them, O observation, A action.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from common.errors import ReskpnError
from common.physics import engines
from common.physics.environments import BatchedEnvironment, EnvState, make_environment
from common.runtime import enable_compilation_cache
from common.tasks import EPISODE_LENGTH

Parameters = dict[str, Any]
Learned = tuple[Parameters, optax.OptState]

LEARNERS = ("ppo", "dpo")


@dataclass(frozen=True)
class Recipe:
    """Settings of a training run."""

    task: str
    learner: str  # of LEARNERS
    physics: str = "native"
    num_envs: int = 2048
    num_steps: int = 10
    hidden: int = 256
    gamma: float = 0.99
    gae_lambda: float = 0.95
    epochs: int = 4
    minibatches: int = 32
    learning_rate: float = 3e-4
    adam_eps: float = 1e-5
    max_grad_norm: float = 0.5
    clip: float = 0.2
    value_coefficient: float = 0.5
    dpo_alpha: float = 2.0
    dpo_beta: float = 0.6
    episode_length: int = EPISODE_LENGTH
    new_states: bool = False  # each episode starts in a state drawn anew

    @property
    def optimiser(self) -> optax.GradientTransformation:
        return optax.chain(
            optax.clip_by_global_norm(self.max_grad_norm), optax.adam(self.learning_rate, eps=self.adam_eps)
        )


class Moments(NamedTuple):
    """Mean, variance and number of values."""

    mean: Array
    variance: Array
    number: Array


def no_moments(shape: tuple[int, ...]) -> Moments:
    """Initial moments: mean 0, variance 1, number 1e-4."""
    return Moments(jnp.zeros(shape), jnp.ones(shape), jnp.float32(1e-4))


def include(moments: Moments, values: Array) -> Moments:
    """The moments updated with `values` [N, ...]."""
    n = values.shape[0]
    total = moments.number + n
    shift = values.mean(axis=0) - moments.mean
    within = moments.variance * moments.number + values.var(axis=0) * n
    between = shift**2 * moments.number * n / total
    return Moments(moments.mean + shift * n / total, (within + between) / total, total)


def observe(moments: Moments, observation: Array) -> tuple[Moments, Array]:
    """Update the moments with the observations, then normalise these."""
    moments = include(moments, observation)
    return moments, (observation - moments.mean) / jnp.sqrt(moments.variance + 1e-8)


def scale_reward(
    moments: Moments, running_return: Array, reward: Array, done: Array, gamma: float
) -> tuple[Moments, Array, Array]:
    """The moments, running discounted returns and scaled rewards after a step with these rewards."""
    running_return = running_return * gamma * jnp.where(done, 0.0, 1.0) + reward
    moments = include(moments, running_return)
    return moments, running_return, reward / jnp.sqrt(moments.variance + 1e-8)


def first_parameters(key: Array, observation_size: int, action_size: int, hidden: int) -> Parameters:
    """Two separate towers with two layers each; orthogonal weights, biases and log_std zero."""

    def layer(key: Array, inputs: int, outputs: int, gain: float) -> tuple[Array, Array]:
        return jax.nn.initializers.orthogonal(gain)(key, (inputs, outputs)), jnp.zeros(outputs)

    def tower(key: Array, outputs: int, last_gain: float) -> list[tuple[Array, Array]]:
        sizes = [(observation_size, hidden, 2**0.5), (hidden, hidden, 2**0.5), (hidden, outputs, last_gain)]
        return [layer(k, *size) for k, size in zip(jax.random.split(key, 3), sizes, strict=True)]

    actor, critic = jax.random.split(key)
    return {
        "actor": tower(actor, action_size, 0.01),
        "critic": tower(critic, 1, 1.0),
        "log_std": jnp.zeros(action_size),
    }


def run_tower(layers: list[tuple[Array, Array]], x: Array) -> Array:
    for weight, bias in layers[:-1]:
        x = jnp.tanh(x @ weight + bias)
    weight, bias = layers[-1]
    return x @ weight + bias


def value_of(parameters: Parameters, observation: Array) -> Array:
    return run_tower(parameters["critic"], observation)[..., 0]


def log_density(parameters: Parameters, observation: Array, action: Array) -> Array:
    """Log-probability of unclipped actions [..., A] under the diagonal Gaussian."""
    log_std = parameters["log_std"]
    distance = (action - run_tower(parameters["actor"], observation)) / jnp.exp(log_std)
    return -0.5 * jnp.sum(distance**2 + 2.0 * log_std + jnp.log(2.0 * jnp.pi), axis=-1)


class World(NamedTuple):
    """The environments, the normalisation statistics and the normalised observations [N, O]."""

    envs: EnvState
    observations: Moments
    returns: Moments
    running_return: Array
    observation: Array


class Step(NamedTuple):
    """One step of the environments as the policy is trained on it; every field [N, ...]."""

    observation: Array
    action: Array
    log_prob: Array
    value: Array
    reward: Array
    done: Array


def open_world(environment: BatchedEnvironment, key: Array) -> World:
    envs = environment.reset(key)
    moments, observation = observe(no_moments(envs.obs.shape[1:]), envs.obs)
    return World(envs, moments, no_moments(()), jnp.zeros(environment.num_envs), observation)


def collect(
    recipe: Recipe, environment: BatchedEnvironment, parameters: Parameters, world: World, key: Array
) -> tuple[World, tuple[Step, tuple[Array, Array]]]:
    """T steps; also returns the sum and number [T] of the unscaled returns of the episodes that ended at each."""

    def one_step(world: World, key: Array) -> tuple[World, tuple[Step, tuple[Array, Array]]]:
        mean = run_tower(parameters["actor"], world.observation)
        action = mean + jnp.exp(parameters["log_std"]) * jax.random.normal(key, mean.shape)
        reset_key = jax.random.fold_in(key, 1) if recipe.new_states else None
        envs, now = environment.step(world.envs, jnp.clip(action, -1.0, 1.0), reset_key)
        done = now.terminated | now.truncated
        observations, observation = observe(world.observations, now.obs)
        returns, running_return, reward = scale_reward(
            world.returns, world.running_return, now.reward, done, recipe.gamma
        )
        step = Step(
            observation=world.observation,
            action=action,
            log_prob=log_density(parameters, world.observation, action),
            value=value_of(parameters, world.observation),
            reward=reward,
            done=done,
        )
        ended = jnp.where(done, now.episode_return, 0.0).sum(), done.sum()
        return World(envs, observations, returns, running_return, observation), (step, ended)

    return jax.lax.scan(one_step, world, jax.random.split(key, recipe.num_steps))


def advantages(reward: Array, value: Array, done: Array, last_value: Array, gamma: float, gae_lambda: float) -> Array:
    """Generalised advantages [T, N]; the value after an episode is 0, whether it was terminated or truncated."""

    def backwards(carry: tuple[Array, Array], now: tuple[Array, Array, Array]) -> tuple[tuple[Array, Array], Array]:
        advantage, next_value = carry
        reward, value, done = now
        goes_on = jnp.where(done, 0.0, 1.0)
        surprise = reward + gamma * next_value * goes_on - value
        advantage = surprise + gamma * gae_lambda * goes_on * advantage
        return (advantage, value), advantage

    start = (jnp.zeros_like(last_value), last_value)
    return jax.lax.scan(backwards, start, (reward, value, done), reverse=True)[1]


def ppo_gain(log_ratio: Array, advantage: Array, clip: float) -> Array:
    """Schulman et al. 2017, equation 7."""
    ratio = jnp.exp(log_ratio)
    return jnp.minimum(ratio * advantage, ratio.clip(1.0 - clip, 1.0 + clip) * advantage)


def dpo_gain(log_ratio: Array, advantage: Array, alpha: float, beta: float) -> Array:
    """Lu et al. 2022: r A minus a drift that depends on the sign of A."""
    ratio = jnp.exp(log_ratio)
    up, down = (ratio - 1.0) * advantage, log_ratio * advantage
    drift = jnp.where(advantage >= 0.0, up - alpha * jnp.tanh(up / alpha), down - beta * jnp.tanh(down / beta))
    return ratio * advantage - jax.nn.relu(drift)


def loss(recipe: Recipe, parameters: Parameters, samples: Step, advantage: Array, target: Array) -> Array:
    """The loss on a minibatch; all arguments are [B, ...]."""
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    log_ratio = log_density(parameters, samples.observation, samples.action) - samples.log_prob
    if recipe.learner == "ppo":
        gain = ppo_gain(log_ratio, advantage, recipe.clip)
    else:
        gain = dpo_gain(log_ratio, advantage, recipe.dpo_alpha, recipe.dpo_beta)
    value = value_of(parameters, samples.observation)
    near = samples.value + (value - samples.value).clip(-recipe.clip, recipe.clip)
    errors = jnp.maximum((value - target) ** 2, (near - target) ** 2)
    return -gain.mean() + recipe.value_coefficient * 0.5 * errors.mean()


def update(recipe: Recipe, learned: Learned, rollout: Step, last_observation: Array, key: Array) -> Learned:
    """Epochs of minibatches on one rollout."""
    last_value = value_of(learned[0], last_observation)
    advantage = advantages(rollout.reward, rollout.value, rollout.done, last_value, recipe.gamma, recipe.gae_lambda)
    shaped = (rollout, advantage, advantage + rollout.value)
    flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), shaped)

    def minibatch(learned: Learned, rows: Array) -> tuple[Learned, None]:
        parameters, optimiser = learned
        chosen = jax.tree.map(lambda x: x[rows], flat)
        gradient = jax.grad(partial(loss, recipe))(parameters, *chosen)
        step, optimiser = recipe.optimiser.update(gradient, optimiser)
        return (optax.apply_updates(parameters, step), optimiser), None

    count = rollout.value.size
    orders = jax.vmap(lambda k: jax.random.permutation(k, count))(jax.random.split(key, recipe.epochs))
    rows = orders.reshape(recipe.epochs * recipe.minibatches, -1)
    return jax.lax.scan(minibatch, learned, rows)[0]


def training(recipe: Recipe, updates: int, seed: int) -> Iterator[tuple[float, int]]:
    """Train; yields the sum of returns and the number of the episodes that ended in each update's rollout."""
    environment = make_environment(
        recipe.task, recipe.physics, num_envs=recipe.num_envs, episode_length=recipe.episode_length
    )

    @jax.jit
    def begin() -> tuple[Learned, World, Array]:
        parameter_key, reset_key, key = jax.random.split(jax.random.key(seed), 3)
        sizes = environment.observation_size, environment.action_size
        parameters = first_parameters(parameter_key, *sizes, recipe.hidden)
        learned = parameters, recipe.optimiser.init(parameters)
        return learned, open_world(environment, reset_key), jax.random.split(key, (updates, 2))

    run_collect = jax.jit(partial(collect, recipe, environment))
    run_update = jax.jit(partial(update, recipe))
    learned, world, keys = begin()
    for collect_key, update_key in keys:
        world, (rollout, ended) = run_collect(learned[0], world, collect_key)
        learned = jax.block_until_ready(run_update(learned, rollout, world.observation, update_key))
        yield float(np.sum(ended[0])), int(np.sum(ended[1]))


def train(recipe: Recipe, updates: int, seed: int) -> dict[str, Any]:
    """Train; returns the sum of returns and number of episodes that ended in each update's rollout, and the speed."""
    return_sum, episodes, times = [], [], []
    for total, count in training(recipe, updates, seed):
        return_sum.append(total)
        episodes.append(count)
        times.append(time.perf_counter())
    steps = (updates - 1) * recipe.num_envs * recipe.num_steps  # the first update compiles
    speed = steps / (times[-1] - times[0]) if steps else None
    return {"return_sum": return_sum, "episodes": episodes, "env_steps_per_s": speed}


def prepare() -> None:
    """Configure JAX as in the services. Call this before any computation."""
    enable_compilation_cache()
    engines.require_synchronous_dispatch()


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.reference",
        description="A separate PPO and DPO in one file. Prints one JSON object on one line.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--task", default="hopper", help="environment")
    parser.add_argument("--learner", default="ppo", choices=LEARNERS, help="algorithm")
    parser.add_argument("--physics", default="native", help="engine")
    parser.add_argument("--steps", type=float, default=1.5e6, help="environment steps, rounded down to whole updates")
    parser.add_argument("--num-envs", type=int, default=2048, metavar="N", help="environments")
    parser.add_argument("--hidden", type=int, default=256, metavar="N", help="width of both layers of both networks")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of everything")
    given = parser.parse_args(arguments)
    recipe = Recipe(given.task, given.learner, given.physics, given.num_envs, hidden=given.hidden)
    batch = recipe.num_envs * recipe.num_steps
    updates = int(given.steps) // batch
    if updates < 1 or batch % recipe.minibatches:
        parser.error(f"--steps must be at least {batch}, one update, and that a multiple of {recipe.minibatches}")
    prepare()
    try:
        result = train(recipe, updates, given.seed)
    except ReskpnError as error:
        print(f"reference: {error}", file=sys.stderr)
        return error.exit_code
    print(json.dumps({"task": recipe.task, "learner": recipe.learner, "seed": given.seed, "updates": updates} | result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
