"""The settings that RL Baselines3 Zoo recommends for PPO, read from the installed package `rl_zoo3`."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import yaml

from common.errors import SettingsError

CONSTRUCTOR = {
    "batch_size", "n_steps", "gamma", "learning_rate", "ent_coef", "clip_range", "n_epochs", "gae_lambda",
    "max_grad_norm", "vf_coef",
}  # fmt: skip
"""Settings that are arguments of PPO's constructor."""

ELSEWHERE = {"normalize", "n_envs", "policy", "n_timesteps", "policy_kwargs"}

_LINEAR = re.compile(r"lin_(\S+)")


def recommended(environment: str) -> dict[str, Any]:
    """The settings for an environment of Gymnasium, such as "Hopper-v5": those of the zoo's newest version of it."""
    # Not imported: of the package, the environment has this file alone and none of its dependencies.
    file = Path(str(metadata.distribution("rl_zoo3").locate_file("rl_zoo3/hyperparams/ppo.yml")))
    return newest(yaml.safe_load(file.read_text(encoding="utf-8")), environment)


def newest(zoo: Mapping[str, Any], environment: str) -> dict[str, Any]:
    """The entry for an environment with the highest version; `policy_kwargs` as a dictionary.

    Raises:
        SettingsError: there is none, or it has a setting that is not known here.
    """
    name = environment.rpartition("-v")[0]
    versions = {int(found[1]): key for key in zoo if (found := re.fullmatch(rf"{re.escape(name)}-v(\d+)", key))}
    if not versions:
        raise SettingsError(f"the zoo recommends no settings of PPO for {name}; leave sb3 and sbx out on this task")
    key = versions[max(versions)]
    entry = dict(zoo[key])
    unknown = set(entry) - CONSTRUCTOR - ELSEWHERE
    linear = [setting for setting, value in entry.items() if isinstance(value, str) and _LINEAR.fullmatch(value)]
    if unknown or linear:
        raise SettingsError(
            f"the zoo's settings for {key} have {', '.join(sorted(unknown) + linear)}, which this benchmark does not "
            "apply; leave sb3 and sbx out on this task"
        )
    return entry | {"entry": key, "policy_kwargs": call_arguments(entry.get("policy_kwargs", "dict()"))}


def call_arguments(text: str) -> dict[str, Any]:
    """The arguments of a `dict(...)` that is written as text, without running it; `nn.ReLU` is given as "ReLU"."""
    call = ast.parse(text.strip(), mode="eval").body
    if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name) or call.func.id != "dict":
        raise SettingsError(f"policy_kwargs must be a dict(...); given: {text}")
    return {str(keyword.arg): _value(keyword.value) for keyword in call.keywords}


def _value(node: ast.expr) -> Any:
    if isinstance(node, ast.Attribute):
        return node.attr
    if isinstance(node, ast.Call):
        return {str(keyword.arg): _value(keyword.value) for keyword in node.keywords}
    return ast.literal_eval(node)
