"""JAX as the package needs it: versions that compute right, and what importing the package leaves alone."""

import time

import jax
import jax.numpy as jnp
import numpy as np

import timesim.runtime  # noqa: F401  (double precision)


def test_this_jax_multiplies_many_vectors_right():
    """0.10.2 gives some rows of a batch, from 16,385 on, the values of others (jax-ml/jax#39103)."""
    x = np.random.default_rng(0).normal(size=(16_385, 3))
    matrix = np.array([[2.0, -1.0, 0.5], [0.0, 3.0, 1.0], [1.0, 0.0, -2.0]])

    def largest(x):
        return jax.vmap(lambda row: jnp.max(matrix @ row))(x)

    np.testing.assert_allclose(jax.jit(largest)(x), (x @ matrix.T).max(axis=1), rtol=1e-12, atol=1e-12)


def test_this_jax_writes_into_a_record_at_the_cost_of_what_it_writes():
    """0.11.1 copies the whole record at each write inside a loop (jax-ml/jax#40101)."""
    num_writes = 20_000

    @jax.jit
    def write(record):
        return jax.lax.fori_loop(0, num_writes, lambda i, r: r.at[i % r.size].set(r[i % r.size] + i), record)

    def seconds(size):
        record, taken = jnp.zeros(size), []
        write(record).block_until_ready()
        for _ in range(5):
            start = time.perf_counter()
            write(record).block_until_ready()
            taken.append(time.perf_counter() - start)
        return min(taken)

    assert seconds(num_writes) < 20 * seconds(64)
