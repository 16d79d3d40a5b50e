"""Python functions that compiled programs call, without keeping these programs out of JAX's compilation cache.

A program with `jax.pure_callback` holds Python objects of the process that compiled it, so JAX never caches it. A call
made here is one to a foreign function by its name, as to functions of C libraries (`jax.ffi`), with the number of a
Python function. The program holds the number alone: read from the cache by another process, it calls the function that
has this number there. Numbers are given in order, so that a program that is made in the same way has the same ones.

The C structures are those of XLA's foreign function interface, xla/ffi/api/c_api.h in jaxlib's include folder. They
begin with their size, and grow at their end alone while the major version stays; JAX refuses a function whose version
it does not know. Then, and on devices other than CPUs, `jax.pure_callback` is used as before.
"""

from __future__ import annotations

import ctypes
import functools
import itertools
import logging
from collections.abc import Callable, Sequence
from ctypes import POINTER, c_char, c_char_p, c_int, c_int64, c_size_t, c_uint32, c_void_p
from typing import Any
from weakref import WeakValueDictionary

import jax
import numpy as np

TARGET = "reskpn_host_function"

Shapes = Sequence[tuple[int, ...]]

Run = Callable[[Sequence[np.ndarray], Sequence[np.ndarray]], None]
"""Computes from arguments, which are read-only, into results; all are float32 and only valid during the call."""


class HostFunction:
    """A Python function for compiled programs, which can call it as long as this object exists."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.number = next(_numbers)
        _functions[self.number] = self

    def __call__(self, inputs: Sequence[jax.Array], shapes: Shapes) -> Sequence[jax.Array]:
        """The results, float32 of these shapes. Mapped by `jax.vmap` it is called once, with the axis in front."""
        results = tuple(jax.ShapeDtypeStruct(shape, np.float32) for shape in shapes)
        if jax.default_backend() == "cpu" and _registered():
            call = jax.ffi.ffi_call(TARGET, results, vmap_method="broadcast_all")
            return call(*inputs, number=np.int64(self.number))

        def on_host(*arrays: Any) -> tuple[np.ndarray, ...]:
            given = [np.asarray(array) for array in arrays]
            batch = given[0].shape[: given[0].ndim - ndim]
            made = tuple(np.empty((*batch, *shape), np.float32) for shape in shapes)
            self.run(given, made)
            return made

        ndim = inputs[0].ndim
        return jax.pure_callback(on_host, results, *inputs, vmap_method="broadcast_all")


_numbers = itertools.count()
_functions: WeakValueDictionary[int, HostFunction] = WeakValueDictionary()


# -- the C interface -------------------------------------------------------------------------------------------

_MAJOR = 0
_METADATA, _EXECUTE, _FLOAT32, _INTERNAL = 1, 3, 11, 13
"""XLA_FFI_Extension_Metadata, XLA_FFI_ExecutionStage_EXECUTE, XLA_FFI_DataType_F32, XLA_FFI_Error_Code_INTERNAL."""


class _Version(ctypes.Structure):
    _fields_ = [("struct_size", c_size_t), ("extension", c_void_p), ("major", c_int), ("minor", c_int)]


class _ErrorArguments(ctypes.Structure):
    _fields_ = [("struct_size", c_size_t), ("extension", c_void_p), ("message", c_char_p), ("code", c_int)]


class _Api(ctypes.Structure):
    """The beginning of XLA_FFI_Api."""

    _fields_ = [
        ("struct_size", c_size_t),
        ("extension", c_void_p),
        ("version", _Version),
        ("internal", c_void_p),
        ("create_error", ctypes.CFUNCTYPE(c_void_p, POINTER(_ErrorArguments))),
    ]


class _Metadata(ctypes.Structure):
    _fields_ = [("struct_size", c_size_t), ("version", _Version), ("traits", c_uint32), ("state_type", c_int64)]


class _Extension(ctypes.Structure):
    """XLA_FFI_Metadata_Extension."""

    _fields_ = [("struct_size", c_size_t), ("kind", c_int), ("next", c_void_p), ("metadata", POINTER(_Metadata))]


class _Buffer(ctypes.Structure):
    _fields_ = [
        ("struct_size", c_size_t),
        ("extension", c_void_p),
        ("dtype", c_int),
        ("data", c_void_p),
        ("rank", c_int64),
        ("dims", POINTER(c_int64)),
    ]


class _Buffers(ctypes.Structure):
    """XLA_FFI_Args and XLA_FFI_Rets."""

    _fields_ = [
        ("struct_size", c_size_t),
        ("extension", c_void_p),
        ("size", c_int64),
        ("types", c_void_p),
        ("buffers", POINTER(POINTER(_Buffer))),
    ]


class _Scalar(ctypes.Structure):
    _fields_ = [("dtype", c_int), ("value", POINTER(c_int64))]


class _Attributes(ctypes.Structure):
    _fields_ = [
        ("struct_size", c_size_t),
        ("extension", c_void_p),
        ("size", c_int64),
        ("types", c_void_p),
        ("names", c_void_p),
        ("scalars", POINTER(POINTER(_Scalar))),
    ]


class _Frame(ctypes.Structure):
    """XLA_FFI_CallFrame."""

    _fields_ = [
        ("struct_size", c_size_t),
        ("extension", POINTER(_Extension)),
        ("api", POINTER(_Api)),
        ("context", c_void_p),
        ("stage", c_int),
        ("arguments", _Buffers),
        ("results", _Buffers),
        ("attributes", _Attributes),
    ]


@functools.cache
def _registered() -> bool:
    """True once XLA knows the function by name; False where it has another version of the interface."""
    try:
        jax.ffi.register_ffi_target(TARGET, jax.ffi.pycapsule(_handler), platform="cpu")
    except Exception as error:
        logging.getLogger(__name__).warning(
            "programs with native physics are compiled anew at each start: this jaxlib has another interface to "
            "foreign functions (%s)",
            error,
        )
        return False
    return True


@ctypes.CFUNCTYPE(c_void_p, POINTER(_Frame))
def _handler(pointer: Any) -> int | None:
    """The entry point for XLA. Returns no error, or XLA's object of one."""
    frame = pointer.contents
    try:
        if frame.extension and frame.extension.contents.kind == _METADATA:
            _describe(frame.extension.contents.metadata.contents, frame.api.contents.version)
        elif frame.stage == _EXECUTE:
            _execute(frame)
    except BaseException as error:  # nothing may be raised into XLA
        text = f"{type(error).__name__}: {error}"
        logging.getLogger(__name__).debug("a host function failed", exc_info=error)
        arguments = _ErrorArguments(ctypes.sizeof(_ErrorArguments), None, text.encode(), _INTERNAL)
        made: int | None = frame.api.contents.create_error(ctypes.byref(arguments))
        return made
    return None


def _describe(metadata: _Metadata, version: _Version) -> None:
    """Tell XLA the version of the interface that this module was written for: any minor one."""
    metadata.version.major, metadata.version.minor = _MAJOR, version.minor
    metadata.traits, metadata.state_type = 0, 0


def _execute(frame: _Frame) -> None:
    number = frame.attributes.scalars[0].contents.value[0]
    function = _functions.get(number)
    if function is None:
        raise LookupError(f"the environment of this program is gone (host function {number})")
    inputs = _arrays(frame.arguments)
    for array in inputs:
        array.flags.writeable = False
    function.run(inputs, _arrays(frame.results))


def _arrays(given: _Buffers) -> list[np.ndarray]:
    """The buffers as arrays, without copying them."""
    arrays = []
    for place in range(given.size):
        buffer = given.buffers[place].contents
        if buffer.dtype != _FLOAT32:
            raise TypeError(f"host functions take and return float32, not XLA's type {buffer.dtype}")
        shape = tuple(buffer.dims[: buffer.rank])
        size = 4 * int(np.prod(shape))
        memory = (c_char * size).from_address(buffer.data) if size else b""
        arrays.append(np.ndarray(shape, np.float32, memory))
    return arrays
