"""The mathematics once more: in NumPy, in float64, one transition at a time, straight from the equations.

Nothing here shares code with `common.maths`. Arrays are named as `trees.to_arrays` names them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

Arrays = Mapping[str, np.ndarray]


def tower(arrays: Arrays, name: str, x: np.ndarray) -> np.ndarray:
    """tanh layers, one after the other."""
    layer = 0
    while f"{name}/layers/{layer}/kernel" in arrays:
        x = np.tanh(x @ arrays[f"{name}/layers/{layer}/kernel"] + arrays[f"{name}/layers/{layer}/bias"])
        layer += 1
    return x


def value(arrays: Arrays, observation: np.ndarray) -> float:
    """V(o)."""
    z = tower(arrays, "critic/features", observation)
    return float(z @ arrays["critic/value/kernel"][:, 0] + arrays["critic/value/bias"][0])


def features(arrays: Arrays, observation: np.ndarray) -> np.ndarray:
    """psi(o) / sqrt(d), what the kernel sees."""
    z = tower(arrays, "policy/features", observation)
    return z / np.sqrt(z.size)


def residual(arrays: Arrays, observation: np.ndarray) -> np.ndarray:
    """mu(psi(o))."""
    z = tower(arrays, "policy/features", observation)
    return z @ arrays["policy/residual/kernel"] + arrays["policy/residual/bias"]


def gaussian(x: np.ndarray, y: np.ndarray, bandwidth: float) -> float:
    """K(x, y)."""
    return float(np.exp(-np.sum((x - y) ** 2) / bandwidth))


def expansion(centres: np.ndarray, weights: np.ndarray, x: np.ndarray, bandwidth: float) -> np.ndarray:
    """h(x) = sum_i w_i K(c_i, x)."""
    h = np.zeros(weights.shape[1])
    for centre, weight in zip(centres, weights, strict=True):
        h = h + weight * gaussian(centre, x, bandwidth)
    return h


def log_prob(mean: np.ndarray, log_std: np.ndarray, action: np.ndarray) -> float:
    """log N(a; m, diag(std^2)) by the density of each component."""
    std = np.exp(log_std)
    density = np.exp(-((action - mean) ** 2) / (2 * std**2)) / np.sqrt(2 * np.pi * std**2)
    return float(np.sum(np.log(density)))


def drift(ratio: float, advantage: float, alpha: float, beta: float) -> float:
    """DPO's drift at one transition (Lu et al. 2022)."""
    if advantage >= 0:
        x = (ratio - 1) * advantage
        return max(0.0, x - alpha * np.tanh(x / alpha))
    x = np.log(ratio) * advantage
    return max(0.0, x - beta * np.tanh(x / beta))


def generalised_advantage(
    reward: np.ndarray,
    value: np.ndarray,
    next_value: np.ndarray,
    terminated: np.ndarray,
    truncated: np.ndarray,
    gamma: float,
    lambda_: float,
) -> np.ndarray:
    """For every step the sum of the discounted deltas that follow it, up to the end of its episode."""
    steps, envs = reward.shape
    advantage = np.zeros((steps, envs))
    for e in range(envs):
        for start in range(steps):
            for t in range(start, steps):
                bootstrap = 0.0 if terminated[t, e] else next_value[t, e]
                delta = reward[t, e] + gamma * bootstrap - value[t, e]
                advantage[start, e] += (gamma * lambda_) ** (t - start) * delta
                if terminated[t, e] or truncated[t, e]:
                    break
    return advantage


def discounted_returns(
    carried: np.ndarray, slot: np.ndarray, fresh: np.ndarray, reward: np.ndarray, done: np.ndarray, gamma: float
) -> tuple[np.ndarray, np.ndarray]:
    """R = gamma (1 - done) R + r, carried from one rollout of a slot to its next; arrays as [K, T, N]."""
    carried = np.array(carried, np.float64)
    every = np.zeros(reward.shape)
    rollouts, steps, envs = reward.shape
    for k in range(rollouts):
        for e in range(envs):
            running = 0.0 if fresh[k] else carried[slot[k], e]
            for t in range(steps):
                running = reward[k, t, e] + (0.0 if done[k, t, e] else gamma * running)
                every[k, t, e] = running
            carried[slot[k], e] = running
    return carried, every


def moments(
    mean: np.ndarray, variance: np.ndarray, count: float, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean, population variance and count after more values, from the first two power sums."""
    total = count + len(values)
    first = (count * mean + values.sum(axis=0)) / total
    second = (count * (variance + mean**2) + (values**2).sum(axis=0)) / total
    return first, second - first**2, total


def normalised(x: np.ndarray) -> np.ndarray:
    """Mean 0, standard deviation 1."""
    return (x - x.mean()) / x.std()


@dataclass(frozen=True)
class Transition:
    """One transition as the loss sees it: advantage normalised, target the lambda-return."""

    observation: np.ndarray
    action: np.ndarray
    log_prob: float
    value: float
    advantage: float
    target: float


def policy_mean(
    arrays: Arrays, h: tuple[np.ndarray, np.ndarray], observation: np.ndarray, bandwidth: float
) -> np.ndarray:
    """m(o) = h(psi(o)) + mu(psi(o)), h given as (centres, weights)."""
    return expansion(*h, features(arrays, observation), bandwidth) + residual(arrays, observation)


def ppo_gain(ratio: float, advantage: float, clip: float) -> float:
    """min(r A, clip(r) A)."""
    return min(ratio * advantage, min(max(ratio, 1 - clip), 1 + clip) * advantage)


def value_loss(new: float, old: float, target: float, clip: float) -> float:
    """Half the larger of the squared errors of the value and of the value held near the old one."""
    held = old + min(max(new - old, -clip), clip)
    return 0.5 * max((new - target) ** 2, (held - target) ** 2)


def numeric_gradient(function: Callable[[Arrays], float], arrays: Arrays, step: float = 1e-5) -> dict[str, np.ndarray]:
    """Central differences of the function in every number of every array."""
    gradient = {name: np.zeros(array.shape) for name, array in arrays.items()}
    for name, array in arrays.items():
        for index in np.ndindex(array.shape):
            up, down = array.copy(), array.copy()
            up[index] += step
            down[index] -= step
            difference = function({**arrays, name: up}) - function({**arrays, name: down})
            gradient[name][index] = difference / (2 * step)
    return gradient
