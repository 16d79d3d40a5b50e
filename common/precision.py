"""The choice of `algorithm.precision auto`: bfloat16 where the device multiplies it faster than float32."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import jax

CPU_FLAGS = ("avx512_bf16", "amx_bf16")
"""Instructions of x86 processors for products in bfloat16; without them XLA rounds and multiplies in float32."""

GPU_CAPABILITY = 8.0
"""Compute capability of NVIDIA GPUs from which on their tensor cores take bfloat16 (Ampere)."""


def chosen_precision(given: Literal["float32", "bfloat16", "auto"]) -> Literal["float32", "bfloat16"]:
    """The precision that a setting means on this machine."""
    return choose_precision()[0] if given == "auto" else given


def choose_precision() -> tuple[Literal["float32", "bfloat16"], str]:
    """The precision for this machine's first device, and the reason, as a clause."""
    device = jax.devices()[0]
    if device.platform == "cpu":
        return choose_for_cpu(_cpu_flags())
    if device.platform == "tpu":
        return "bfloat16", f"{device.device_kind} multiplies it natively"
    return choose_for_gpu(device.device_kind, str(getattr(device, "compute_capability", "")))


def choose_for_cpu(flags: frozenset[str]) -> tuple[Literal["float32", "bfloat16"], str]:
    """The precision for a processor with these flags."""
    if found := [flag for flag in CPU_FLAGS if flag in flags]:
        return "bfloat16", f"this processor has {' and '.join(found)}"
    return "float32", f"this processor has neither {' nor '.join(CPU_FLAGS)}"


def choose_for_gpu(kind: str, capability: str) -> tuple[Literal["float32", "bfloat16"], str]:
    """The precision for a GPU with this compute capability, as in "9.0"; "" where it is not known."""
    try:
        enough = float(capability) >= GPU_CAPABILITY
    except ValueError:
        return "float32", f"the compute capability of {kind} is not known"
    if enough:
        return "bfloat16", f"{kind} has compute capability {capability}, and tensor cores from {GPU_CAPABILITY} on"
    return "float32", f"{kind} has compute capability {capability}, and bfloat16 needs {GPU_CAPABILITY}"


def _cpu_flags() -> frozenset[str]:
    """Features of the processor as Linux reports them; none elsewhere."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return frozenset()
    flags = next((line.partition(":")[2] for line in lines if line.startswith("flags")), "")
    return frozenset(flags.split())
