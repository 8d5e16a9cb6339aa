"""Functions that XLA compiles apart.

XLA on a CPU fuses elementwise operations into the kernels of everything that uses them, and computes them again in
each: left alone, every stage of a Runge-Kutta step is evaluated anew for every later one. `optimization_barrier` is
removed before fusion; a call that may not be inlined is not. Measured on the oscillator of two modes, 256 at a time:
see benchmarks/README.md.
"""

import timesim.runtime  # noqa: F401  isort: skip

import functools
from collections.abc import Callable, Sequence
from typing import ParamSpec, TypeVar

import jax
import jax.numpy as jnp
from jax import Array
from jax.experimental.xla_metadata import set_xla_metadata

P = ParamSpec("P")
T = TypeVar("T")


def apart(function: Callable[P, T], static: Sequence[int] = ()) -> Callable[P, T]:
    """The function of arrays as a call of its own, whose operations are not fused with those around it.

    ``static``: places of arguments that are no arrays.
    """

    def inside(*args: P.args, **kwargs: P.kwargs) -> T:
        # Calls inside, such as every `jnp.where`, are functions too: they are to be inlined.
        with set_xla_metadata(inlineable="true"):
            return function(*args, **kwargs)

    compiled = jax.jit(functools.wraps(function)(inside), static_argnums=static)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        with set_xla_metadata(inlineable="false"):
            return compiled(*args, **kwargs)

    return call


SMALL = 1024
"""Products of numbers up to which one loop over all of them is quickest."""


def matmul(a: Array, b: Array) -> Array:
    """The product of two matrices, the first of few rows.

    A product of matrices by a library is no part of the function that a loop is compiled to: the whole loop is then a
    sequence of kernels. One with a vector is.
    """
    if a.shape[0] * b.shape[0] * b.shape[1] > SMALL:
        return jnp.stack([jnp.dot(row, b) for row in a])
    return (a[:, :, None] * b[None]).sum(axis=1)
