"""The choice of `algorithm.precision auto`."""

import pytest

from common.precision import choose_for_cpu, choose_for_gpu, chosen_precision


@pytest.mark.parametrize(
    ("flags", "precision", "words"),
    [
        ({"avx2"}, "float32", "neither avx512_bf16 nor amx_bf16"),
        ({"avx2", "avx512_bf16"}, "bfloat16", "has avx512_bf16"),
        ({"amx_bf16", "avx512_bf16"}, "bfloat16", "avx512_bf16 and amx_bf16"),
    ],
)
def test_processors(flags, precision, words):
    """bfloat16 needs an instruction for it, which is named."""
    chosen, reason = choose_for_cpu(frozenset(flags))
    assert chosen == precision
    assert words in reason


@pytest.mark.parametrize(
    ("capability", "precision"), [("9.0", "bfloat16"), ("8.0", "bfloat16"), ("7.5", "float32"), ("", "float32")]
)
def test_gpus(capability, precision):
    """Tensor cores take bfloat16 from compute capability 8.0 on; an unknown one is not trusted."""
    chosen, reason = choose_for_gpu("some GPU", capability)
    assert chosen == precision
    assert "some GPU" in reason


def test_what_is_given_is_taken():
    """Only auto looks at the machine."""
    assert chosen_precision("bfloat16") == "bfloat16"
    assert chosen_precision("float32") == "float32"
