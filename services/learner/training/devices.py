"""The devices of a learner: the batch lies on all of them, and each computes its share of every minibatch."""

from __future__ import annotations

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from common.errors import SettingsError

_AXIS = "minibatch"


def device_mesh(count: int) -> Mesh:
    """The first `count` devices.

    Raises:
        SettingsError: there are fewer.
    """
    devices = jax.devices()
    if count > len(devices):
        raise SettingsError(
            f"algorithm.devices is {count}, and JAX finds {len(devices)} here ({devices[0].device_kind}); on a CPU, "
            f"XLA_FLAGS=--xla_force_host_platform_device_count={count} makes that many of its cores"
        )
    return Mesh(np.array(devices[:count]), (_AXIS,))


def everywhere(mesh: Mesh) -> NamedSharding:
    """The same array on every device."""
    return NamedSharding(mesh, PartitionSpec())


def by_row(mesh: Mesh) -> NamedSharding:
    """Rows of minibatches, [minibatches, rows], the rows divided among the devices."""
    return NamedSharding(mesh, PartitionSpec(None, _AXIS))
