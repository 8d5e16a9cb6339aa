"""The contact law on its own: its rates, its directions, and what follows a transition."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from timesim.engine.law.cone import ConeLaw, incipient_direction, slip_direction, slip_speed
from timesim.engine.law.contact_law import Motion, dot, length, product
from timesim.model.model import GROUND, SEPARATION, SLIP, STICK, Contact

RNG = np.random.default_rng(20)


def law(stiffness: np.ndarray, *, friction: float = 0.4, normal: float = 1.3, preload: float = 0.7) -> ConeLaw:
    """One contact with a full or isotropic K_u."""
    one = lambda value: jnp.asarray([value], dtype=float)  # noqa: E731
    inverse = np.linalg.inv(stiffness)
    return ConeLaw(
        friction=one(friction),
        stiffness=tuple(one(stiffness[i, j]) for i, j in ((0, 0), (0, 1), (1, 1))),
        compliance=tuple(one(inverse[i, j]) for i, j in ((0, 0), (0, 1), (1, 1))),
        normal_stiffness=one(normal),
        preload=one(preload),
    )


def both_forms(full: ConeLaw) -> tuple[ConeLaw, ConeLaw]:
    """A law, and the same by the one number of an isotropic K_u."""
    one = (full.stiffness[:1], full.compliance[:1])
    return full, ConeLaw(full.friction, *one, full.normal_stiffness, full.preload)


def plane(values: np.ndarray) -> tuple[jax.Array, jax.Array]:
    return jnp.asarray(values[:1]), jnp.asarray(values[1:])


def moving(u: np.ndarray, v: float, du: np.ndarray, dv: float) -> Motion:
    return Motion(plane(u), jnp.asarray([v]), plane(du), jnp.asarray([dv]))


def random_stiffness() -> np.ndarray:
    a = RNG.normal(size=(2, 2))
    return a @ a.T + 0.2 * np.eye(2)


@pytest.mark.parametrize("case", range(20))
def test_a_sliding_contact_stays_on_its_cone(case: int):
    """d|f|^2/dt = 2 mu^2 n n' by (9), with the force K_u (u - w) and the slip rate of the law."""
    stiffness, contact = random_stiffness(), None
    contact = law(stiffness)
    v, du, dv = RNG.uniform(0, 1), RNG.normal(size=2), RNG.normal()
    n = 0.7 + 1.3 * v
    e = np.array([np.cos(case), np.sin(case)])
    w = RNG.normal(size=2)
    u = w + np.linalg.solve(stiffness, 0.4 * n * e)
    moves = moving(u, v, du, dv)
    acts = contact.reaction(jnp.asarray([SLIP]), moves, plane(w))
    f = np.concatenate(acts.f)
    np.testing.assert_allclose(f, 0.4 * n * e, atol=1e-13)
    df = stiffness @ (du - np.concatenate(acts.dw))
    assert 2 * f @ df == pytest.approx(2 * 0.4**2 * n * 1.3 * dv, abs=1e-11)
    # (9) as printed, times mu n.
    c = (f @ stiffness @ du - 0.4**2 * n * 1.3 * dv) / (f @ stiffness @ f)
    assert float(slip_speed(contact, plane(e), moves)[0]) == pytest.approx(c * 0.4 * n, rel=1e-11)


@pytest.mark.parametrize("case", range(30))
def test_the_incipient_direction_solves_its_equation(case: int):
    stiffness = random_stiffness()
    contact = law(stiffness)
    du = RNG.normal(size=2)
    # Below the rate at which it would stick, above and below zero.
    dv = RNG.uniform(-2.0, 0.98) * np.linalg.norm(stiffness @ du) / (0.4 * 1.3)
    moves = moving(np.zeros(2), 0.0, du, dv)
    e = np.concatenate(incipient_direction(contact, moves))
    assert np.linalg.norm(e) == pytest.approx(1, abs=1e-12)
    s = float(slip_speed(contact, plane(e), moves)[0])
    assert s >= 0
    np.testing.assert_allclose((0.4 * 1.3 * dv) * e + s * stiffness @ e, stiffness @ du, atol=1e-9)
    angle = float(contact.inner(jnp.asarray([SLIP]), moves, plane(np.zeros(2)))[0])
    np.testing.assert_allclose((np.cos(angle), np.sin(angle)), e, atol=1e-12)  # with which a collocated step begins


def test_the_incipient_direction_of_isotropic_stiffness_is_that_of_the_velocity():
    moves = moving(np.zeros(2), 0.0, np.array([3.0, -4.0]), 0.1)
    for each in both_forms(law(2 * np.eye(2))):
        np.testing.assert_allclose(np.concatenate(incipient_direction(each, moves)), [0.6, -0.8], atol=1e-13)


def test_the_direction_goes_smoothly_through_separation():
    """Beyond n = 0 the stretch points backwards; the direction of slip does not."""
    e = np.array([0.8, 0.6])
    for contact in both_forms(law(np.eye(2), normal=1.0, preload=0.0)):
        for v in (0.1, -0.1):
            moves = moving(0.4 * v * e, v, np.array([1.0, 0.0]), -1.0)
            found = np.concatenate(slip_direction(contact, moves, plane(np.zeros(2)), True))
            np.testing.assert_allclose(found, e, atol=1e-13)


@pytest.mark.parametrize("state", [SLIP, STICK, SEPARATION])
def test_a_contact_acts_as_if_it_were_alone(state: int):
    """The incipient direction is computed only where one slips near n = 0: for all, or for none of them."""
    u, du, w = RNG.normal(size=(3, 4, 2))
    u[:2] = w[:2]  # the first slips without a direction, the second is next to n = 0 in any state
    laws = [law(random_stiffness(), preload=preload) for preload in (0.0, 0.0, 0.7, 1.1)]
    moves = [moving(u[i], 0.0, du[i], 0.3 * i) for i in range(4)]
    states = [jnp.asarray([each]) for each in (SLIP, state, SLIP, STICK)]

    def acts(own: slice) -> list[np.ndarray]:
        contact, motion, slip, now = jax.tree.map(
            lambda *parts: jnp.concatenate(parts),
            *zip(laws[own], moves[own], map(plane, w[own]), states[own], strict=True),
        )
        return [np.asarray(x) for x in jax.tree.leaves(contact.reaction(now, motion, slip))]

    each = [acts(slice(i, i + 1)) for i in range(4)]
    for chosen in (slice(0, 4), slice(1, 4), slice(2, 4)):
        for together, apart in zip(acts(chosen), map(np.concatenate, zip(*each[chosen], strict=True)), strict=True):
            np.testing.assert_allclose(together, apart, rtol=1e-14, atol=1e-14)


# State, n, u', n' and the state that follows.
FOLLOWS = [
    (STICK, 1.0, (1.0, 0.0), 0.0, SLIP),
    (STICK, 0.0, (1.0, 0.0), -1.0, SEPARATION),
    (SLIP, 1.0, (0.0, 0.0), 1.0, STICK),
    (SLIP, 0.0, (1.0, 0.0), -1.0, SEPARATION),
    (SEPARATION, 0.0, (0.1, 0.0), 1.0, STICK),
    (SEPARATION, 0.0, (1.0, 0.0), 1.0, SLIP),
]


@pytest.mark.parametrize(("state", "n", "du", "dn", "after"), FOLLOWS)
def test_what_follows_a_transition(state: int, n: float, du: tuple[float, float], dn: float, after: int):
    contact = law(np.eye(2), normal=1.0, preload=0.0)
    moves = moving(np.zeros(2), n, np.array(du), dn)
    assert int(contact.successor(jnp.asarray([state]), moves)[0]) == after


def test_slip_after_a_transition_lies_on_the_cone_or_under_the_contact():
    contact = law(np.diag([2.0, 3.0]))
    moves = moving(np.array([0.5, -0.2]), 0.3, np.array([1.0, 1.0]), 0.0)
    w = plane(np.array([0.1, 0.1]))
    stuck = contact.slip_at_transition(jnp.asarray([SLIP]), jnp.asarray([STICK]), moves, w)
    f = product(contact.stiffness, (moves.u[0] - stuck[0], moves.u[1] - stuck[1]))
    assert float(length(f)[0]) == pytest.approx(0.4 * (0.7 + 1.3 * 0.3))
    for before, after in ((SEPARATION, STICK), (SEPARATION, SLIP), (SLIP, SEPARATION), (STICK, SEPARATION)):
        apart = contact.slip_at_transition(jnp.asarray([before]), jnp.asarray([after]), moves, w)
        np.testing.assert_array_equal(np.concatenate(apart), np.concatenate(moves.u))


def test_margins_are_those_of_the_state():
    contact = law(np.eye(2))
    moves = moving(np.array([0.1, 0.0]), 0.2, np.array([1.0, 0.0]), 0.0)
    w = plane(np.zeros(2))
    n = 0.7 + 1.3 * 0.2
    first = {state: float(contact.margins(jnp.asarray([state]), moves, w)[0][0]) for state in (STICK, SLIP, SEPARATION)}
    assert first == {STICK: pytest.approx(0.4 * n - 0.1), SLIP: pytest.approx(n), SEPARATION: pytest.approx(-n)}
    ends = {state: float(contact.margins(jnp.asarray([state]), moves, w)[1][0]) for state in (STICK, SLIP, SEPARATION)}
    assert ends == {STICK: pytest.approx(n / (0.7 + 1.3)), SLIP: pytest.approx(1.0), SEPARATION: 1.0}


def test_a_contact_at_rest_has_finite_derivatives():
    """The length of a vector is not smooth at zero; its derivative must be zero there, and not a NaN."""
    contact = law(np.eye(2))

    def total(x: jax.Array) -> jax.Array:
        moves = Motion((x, x), x, (x, x), x)
        acts = contact.reaction(jnp.asarray([SLIP]), moves, (0 * x, 0 * x))
        return dot(acts.f, acts.f)[0] + acts.dw[0][0]

    _, slope = jax.jvp(total, (jnp.zeros(1),), (jnp.ones(1),))
    assert np.isfinite(slope)


@pytest.mark.parametrize("speed", [1e-2, 1e-5, 1e-9, 0.0])
def test_a_stop_that_turns_back_has_finite_derivatives(speed: float):
    """A stop without K_u, in the form of a K_u that is not isotropic, as it has beside a contact with one."""
    zero = np.zeros(1)
    stop = ConeLaw(zero, (zero, zero), (zero, zero), np.ones(1), np.ones(1))

    def acts(du: jax.Array) -> jax.Array:
        moves = Motion((jnp.ones(1), jnp.zeros(1)), jnp.zeros(1), (du, -du), du)
        reaction = stop.reaction(jnp.asarray([SLIP]), moves, moves.u)
        return jnp.stack([*reaction.f, reaction.n, *reaction.dw])

    _, slopes = jax.jvp(acts, (jnp.array([speed]),), (jnp.ones(1),))
    assert np.all(np.isfinite(slopes))


@pytest.mark.parametrize("v", [1e-6, -1e-9, 1e-30])
def test_the_stored_energy_of_a_motion_far_below_the_preload(v: float):
    stop = Contact("pad", "tip", GROUND, np.eye(3), 0.0, np.zeros((2, 2)), 20.0, 3.0)
    motion, slip = np.array([[0.0, 0.0, v]]), np.zeros((1, 2))
    energy = sum(ConeLaw.stored_energy(stop, motion, slip, np.array([SLIP])))[0]
    assert energy == pytest.approx(10 * v**2, rel=1e-12, abs=0)


@pytest.mark.parametrize(("preload", "v"), [(3.0, 0.2), (3.0, -0.4), (-1.0, 0.2), (-1.0, 0.01), (0.0, -1.0)])
def test_the_stored_energy_is_the_work_of_the_normal_load(preload: float, v: float):
    stop = Contact("pad", "tip", GROUND, np.eye(3), 0.0, np.zeros((2, 2)), 20.0, preload)
    path = np.linspace(0.0, v, 100_001)
    work = np.trapezoid(np.maximum(preload + 20 * path, 0.0) - max(preload, 0.0), path)
    motion, slip = np.array([[0.0, 0.0, v]]), np.zeros((1, 2))
    assert sum(ConeLaw.stored_energy(stop, motion, slip, np.array([SLIP])))[0] == pytest.approx(work, abs=1e-8)


@pytest.mark.parametrize("stiffness", [np.eye(2), np.array([[2.0, 0.5], [0.5, 1.0]])], ids=["isotropic", "full"])
@pytest.mark.parametrize("du", [0.0, 0.3])
def test_the_angle_of_a_contact_without_a_force_has_a_derivative(stiffness: np.ndarray, du: float):
    """Apart, or never moved along its plane: what its direction is does not matter, but that it is a number does."""
    own = both_forms(law(stiffness))[int(stiffness[0, 0] == stiffness[1, 1])]

    def angles(values: jax.Array) -> jax.Array:
        u, w, du = (tuple(values[i : i + 2].reshape(2, 1)) for i in (0, 2, 4))
        return own.inner(jnp.asarray([STICK, SLIP, SEPARATION]), Motion(u, values[6:7], du, values[7:8]), w)

    at = jnp.asarray([0.1, 0.2, 0.1, 0.2, du, 0.0, -1.0, 0.1])
    assert np.isfinite(jax.jit(jax.jacfwd(angles))(at)).all()
