"""Operations of a compiled program are sorted by what they contain."""

from __future__ import annotations

import pytest

from benchmarks.profile import OTHER, by_kind, kinds_of_operations, network_flop
from common.config.settings import RunSettings

HLO = """\
HloModule jit_update

%fused_computation (p: f32[4]) -> f32[4] {
  %p = f32[4]{0} parameter(0)
  ROOT %tanh.1 = f32[4]{0} tanh(%p)
}

ENTRY %main (x: f32[4,4]) -> f32[4,4] {
  %x = f32[4,4]{1,0} parameter(0)
  %dot.3 = f32[4,4]{1,0} dot(%x, %x), lhs_contracting_dims={1}
  %add_tanh_fusion = f32[4]{0} fusion(%dot.3), kind=kLoop, calls=%fused_computation
  %pair = (f32[4]{0}, s32[4]{0}) sort(%add_tanh_fusion, %x), dimensions={0}
  ROOT %add.2 = f32[4,4]{1,0} add(%dot.3, %dot.3)
}
"""


def test_kinds_of_operations() -> None:
    """A fusion is what it contains; what only passes values on is left out."""
    kinds = kinds_of_operations(HLO)
    assert kinds["dot.3"] == "matrix products"
    assert kinds["add_tanh_fusion"] == "tanh, exp"
    assert kinds["pair"] == "sorts"
    assert kinds["add.2"] == OTHER
    assert "x" not in kinds


def test_times_by_kind() -> None:
    """Two products and a sort; the profiler's own entries do not count."""
    ms = {"dot.3": 2.0, "dot.4": 1.0, "sort": 5.0, "block_until_ready": 100.0}
    kinds = {"dot.3": "matrix products", "dot.4": "matrix products", "sort": "sorts"}
    assert by_kind(ms, kinds) == {"matrix products": 3.0, "sorts": 5.0}


def test_operations_of_the_networks() -> None:
    """One epoch on hopper (11 numbers, 3 actions) with layers of 8 and 4, 10 x 2 transitions.

    Forward, over two networks: 2 x 11 x 8 + 2 x 8 x 4 + 4 x (3 + 1) = 256 products; three times that with the backward
    pass, less the gradient by observations, 176: 592. Two operations each, 20 transitions: 23,680.
    """
    settings = RunSettings.model_validate(
        {
            "task": "hopper",
            "num_envs": 2,
            "actors": 1,
            "num_steps": 10,
            "algorithm": {"epochs": 1, "minibatches": 1, "hidden": (8, 4)},
        }
    )
    assert network_flop(settings) == pytest.approx(23_680)
