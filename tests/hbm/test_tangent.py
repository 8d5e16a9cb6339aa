"""Derivatives of a balance: chained through a period, and by few of its unknowns."""

import numpy as np
import pytest

from timesim.hbm.condensation import Condensation
from timesim.hbm.continuation.bordered import Bordered
from timesim.hbm.tangent.chain import LINKS, chained


@pytest.mark.parametrize("count", [0, 1, LINKS - 1, LINKS, LINKS + 1, 3 * LINKS + 2])
def test_derivatives_are_chained_as_one_step_after_the_other(count):
    step, rows = (np.random.default_rng(count).normal(size=(count + i, 2, 2 + 5 * i)) for i in (0, 1))
    expected = rows.copy()
    for k in range(count):
        expected[k + 1] += step[k] @ expected[k]
    chained(step, rows)
    np.testing.assert_allclose(rows, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("works", [(), (0,), (1,), (0, 2)])
def test_derivatives_by_few_unknowns_give_the_steps_and_the_sign_of_those_by_all(works):
    """Three contacts, of which some depend on all coefficients of their motion, one sticks in part, the others all."""
    harmonics, contacts, random = 4, 3, np.random.default_rng(len(works))
    size, parts = 2 * harmonics + 1, 3 * contacts
    flexibility = random.normal(size=(2, harmonics + 1, parts, parts)).T @ [1, 1j]
    flexibility = 0.1 * np.moveaxis(flexibility, -1, 0)
    flexibility[0] = flexibility[0].real
    stiffness = np.zeros((contacts, 3, size, 3, size))
    for contact in range(contacts):
        stiffness[contact] += random.normal(size=(3, 1, 3, 1)) * np.eye(size)[:, None, :]
        if contact in works:
            stiffness[contact, :, :, : 2 + contact % 2] += random.normal(size=(3, size, 2 + contact % 2, size))
    whole = np.zeros((parts, size, parts, size))
    for contact in range(contacts):
        own = slice(3 * contact, 3 * contact + 3)
        whole[own, :, own] = stiffness[contact]
    a, b = flexibility.real, flexibility.imag
    given = np.zeros_like(whole)
    given[:, 0] = np.einsum("ij,jkl->ikl", a[0], whole[:, 0])
    cos, sin = whole[:, 1::2], whole[:, 2::2]
    given[:, 1::2] = np.einsum("hij,jhkl->ihkl", a[1:], cos) + np.einsum("hij,jhkl->ihkl", b[1:], sin)
    given[:, 2::2] = np.einsum("hij,jhkl->ihkl", a[1:], sin) - np.einsum("hij,jhkl->ihkl", b[1:], cos)
    dense = np.eye(parts * size) - given.reshape(parts * size, -1)
    few = Condensation(flexibility, stiffness)
    assert few.inner.size == size * sum(2 + contact % 2 for contact in works)
    r, by_p, row = random.normal(size=parts * size), random.normal(size=parts * size), np.ones(parts * size + 1)
    found, expected = (Bordered(by_x, by_p, row) for by_x in (few, dense))
    np.testing.assert_allclose(found.solve(r, 0.3), expected.solve(r, 0.3), rtol=1e-9, atol=1e-9)
    (tangent, sign), (known, known_sign) = found.tangent(), expected.tangent()
    np.testing.assert_allclose(tangent, known, atol=1e-9)
    assert sign == known_sign == np.sign(np.linalg.det(dense))
