"""The contact law through a period, on samples and with located transitions, and its derivatives."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import systems
from located import located_forces
from scipy.optimize import minimize

from timesim.element.motion import CYCLE, SplineMotion
from timesim.element.state_by_state import steady_cycle
from timesim.engine.law.cone import ConeLaw
from timesim.engine.law.contact_law import Motion
from timesim.hbm.interval import Interval, advance
from timesim.hbm.path import Cubic, window_of
from timesim.hbm.period import (
    MAX_PASSES,
    basis_of,
    contact_forces,
    motion_of,
    period_of,
    starts_of,
)
from timesim.hbm.stuck_offset import plainly_sticks, stuck_offset, without_slip
from timesim.hbm.tangent import intervals_of, linearised
from timesim.orbit.fourier import fourier_basis, to_coefficients, to_phasors

pytestmark = pytest.mark.long

# A, B, D and phase of the normal motion in degrees: u = (A cos, B cos(. + 90)), v = D cos(. + phase).
MOTIONS = {
    "ellipse": (1.0, 0.5, 0.0, 0.0),
    "stick and slip": (0.6, 0.1, 0.0, 0.0),
    "variable load": (1.0, 0.5, 0.5, 45.0),
    "separation": (1.0, 0.5, 1.5, 45.0),
    "straight": (1.0, 0.0, 1.5, 45.0),
    "against": (1.0, 0.0, 1.5, -45.0),
}
# Contacts that a test follows at once, and samples of a period: for others more is compiled. 98 times the rounded 1/98
# is less than 1.
SIDE_BY_SIDE, SAMPLES = 6, (64, 98, 256)
COARSE = SAMPLES[0]
STIFFNESS = {"isotropic": np.eye(2), "general": np.array([[1.0, 0.3], [0.3, 0.6]])}


def test_when_a_contact_is_closed_within_an_interval():
    """Loads of one or two roots, and of none: when it closes and opens, and how long it is apart."""
    two = np.array([0.24, -1.0, 1.0])  # (t - 0.4) (t - 0.6)
    loads = np.array([two, -two, [1.0, -2.0, 0.0], [-1.0, 4.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    window = jax.jit(window_of)(Cubic(*loads.T, np.zeros(6)))
    np.testing.assert_allclose(window.separation, [0.2, 0.8, 0.5, 0.25, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(window.start, [0.6, 0.4, 0.0, 0.25, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(window.end, [1.0, 0.6, 0.5, 1.0, 1.0, 1.0], atol=1e-12)
    assert window.closes.tolist() == [True, True, False, True, False, False]
    assert window.opens.tolist() == [True, True, True, False, False, False]


def prescribed(motion, num_harmonics=1):
    A, B, D, phase = motion
    coefficient = np.zeros((3, 2 * num_harmonics + 1))
    turn = np.radians(phase)
    coefficient[:, 1] = A, 0.0, D * np.cos(turn)
    coefficient[:, 2] = 0.0, -B, -D * np.sin(turn)
    return coefficient


def element(matrix, preload=1.0):
    return replace(systems.pad(0.3, 1.0, 1.0, preload), tangential_stiffness=matrix)


def law_of(contacts):
    matrices = np.array([c.tangential_stiffness for c in contacts])
    k11, k12, k22 = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    plain = np.all(k12 == 0) and np.all(k11 == k22)
    stiffness = (k11,) if plain else (k11, k12, k22)
    det = k11 * k22 - k12**2
    compliance = (1 / k11,) if plain else (k22 / det, -k12 / det, k11 / det)
    each = [np.array([getattr(c, name) for c in contacts]) for name in ("friction", "normal_stiffness", "preload")]
    friction, normal, preload = map(jnp.asarray, each)
    return ConeLaw(friction, tuple(map(jnp.asarray, stiffness)), tuple(map(jnp.asarray, compliance)), normal, preload)


def shifted(coefficient):
    """The same cycle begun at other angles within a sample, so that the samples meet transitions in many ways."""
    turn = np.exp(1j * np.outer(0.37 * np.arange(SIDE_BY_SIDE), np.arange(coefficient.shape[-1] // 2 + 1)))
    return to_coefficients(to_phasors(coefficient) * turn[:, None])


@pytest.mark.parametrize("kind", STIFFNESS)
@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("finest", [256, pytest.param(1024, marks=pytest.mark.slow)])
def test_order_of_the_law_through_a_period(name, kind, finest):
    """Third, hardly less where the pull on slip depends on its direction, which turns fast next to n = 0."""
    contact, motion = element(STIFFNESS[kind]), prescribed(MOTIONS[name], 3)
    exact = located_forces(contact, motion)
    assert exact is not None
    numbers = np.array([*SAMPLES, 512, 1024])
    numbers = numbers[numbers <= finest]
    motions, exacts = shifted(motion), shifted(exact)
    errors, law = [], law_of([contact] * SIDE_BY_SIDE)
    for num in numbers:
        done = contact_forces(law, basis_of(3, int(num)), motions)
        assert np.max(done.closure) <= 1
        assert 1 <= done.passes < MAX_PASSES
        errors.append(np.sqrt(np.mean((np.asarray(done.coefficient) - exacts) ** 2)))
    assert -np.polyfit(np.log(numbers), np.log(errors), 1)[0] > (2.85 if kind == "isotropic" else 2.6), errors
    assert errors[-1] < 1e-8 * (1024 / finest) ** 3


def test_slip_under_constant_load_is_of_third_order():
    contact, motion = element(np.eye(2)), prescribed(MOTIONS["ellipse"])
    exact = located_forces(contact, motion)
    numbers = np.array(SAMPLES)
    law, motions = law_of([contact] * SIDE_BY_SIDE), np.stack([motion] * SIDE_BY_SIDE)
    found = (contact_forces(law, basis_of(1, int(n)), motions) for n in numbers)
    errors = [np.abs(np.asarray(done.coefficient) - exact).max() for done in found]
    assert -np.polyfit(np.log(numbers), np.log(errors), 1)[0] > 2.8, errors


def test_full_stick_starts_from_no_slip():
    motion = prescribed((0.1, 0.05, 0.2, 30.0))
    law, motions = law_of([element(np.eye(2))] * SIDE_BY_SIDE), np.stack([motion] * SIDE_BY_SIDE)
    done = contact_forces(law, basis_of(1, 64), motions)
    motions[:, 2, 0] += 1.0
    np.testing.assert_allclose(done.coefficient, motions, atol=1e-14)
    assert not np.any(done.slip)
    assert not np.any(done.separation)


def differences(value, x, step):
    return np.array([(value(x + step * e) - value(x - step * e)) / (2 * step) for e in np.eye(x.size)]).T


@pytest.mark.parametrize("kind", STIFFNESS)
@pytest.mark.parametrize("preload", [1.0, pytest.param(0.3, marks=pytest.mark.slow), -0.3])
def test_force_derivatives_against_differences(kind, preload):
    rng = np.random.default_rng(3)
    law, basis = law_of([element(STIFFNESS[kind], preload)] * SIDE_BY_SIDE), basis_of(2, 98)
    y = rng.normal(size=(SIDE_BY_SIDE, 3, 5)) * np.array([1.0, 1.0, 1.0, 0.2, 0.2])
    acts, slope = linearised(law, basis, y)
    assert np.max(acts.slip) > 0.2

    def value(flat):
        return np.asarray(contact_forces(law, basis, flat.reshape(y.shape)).coefficient).ravel()

    whole = differences(value, y.ravel(), 1e-6).reshape(SIDE_BY_SIDE, 15, SIDE_BY_SIDE, 15)
    own = np.stack([whole[i, :, i] for i in range(SIDE_BY_SIDE)])
    np.testing.assert_allclose(slope, own, atol=2e-8)
    assert np.abs(whole).sum() == pytest.approx(np.abs(own).sum())


@pytest.mark.parametrize("kind", [pytest.param("isotropic", marks=pytest.mark.slow), "general"])
def test_derivatives_where_slip_is_too_short_to_forget_the_start(kind):
    """Across the direction of slip a part of the elastic displacement lasts: the period closes over several passes."""
    law, basis = law_of([element(STIFFNESS[kind], 1.0)] * SIDE_BY_SIDE), basis_of(2, 98)
    y = np.zeros((SIDE_BY_SIDE, 3, 5))
    y[:, 0, 1], y[:, 1, 2], y[:, 2, 3] = np.tile([[0.34, 0.35, 0.36], [0.1, -0.05, 0.02], [0.05, 0.0, -0.05]], 2)
    acts, slope = linearised(law, basis, jnp.asarray(y))
    assert 0.1 < np.max(acts.slip) < 0.5
    assert acts.passes > 3

    def value(flat):
        return np.asarray(contact_forces(law, basis, jnp.asarray(flat.reshape(y.shape))).coefficient).ravel()

    whole = differences(value, y.ravel(), 1e-6).reshape(SIDE_BY_SIDE, 15, SIDE_BY_SIDE, 15)
    np.testing.assert_allclose(slope, np.stack([whole[i, :, i] for i in range(SIDE_BY_SIDE)]), atol=2e-8)


@pytest.mark.parametrize("kind", STIFFNESS)
def test_derivatives_where_no_slip_at_all_would_leave_the_cone(kind):
    """w = 0 lies outside: the contact sticks with an offset, which follows the motion."""
    motion = np.array([[[0.15, 0.2, 0.05], [-0.3, 0.02, -0.1], [0.1, 0.2, -0.1]]] * SIDE_BY_SIDE)
    law, basis = law_of([element(STIFFNESS[kind], 1.0)] * SIDE_BY_SIDE), basis_of(1, 98)
    acts, slope = linearised(law, basis, motion)
    offset = acts.coefficient[0, :2, 0] - STIFFNESS[kind] @ motion[0, :2, 0]
    assert acts.slip[0] == acts.separation[0] == 0
    assert np.linalg.norm(offset) > 0.03

    def value(flat):
        moved = np.stack([flat.reshape(3, 3)] * SIDE_BY_SIDE)
        return np.asarray(contact_forces(law, basis, moved).coefficient[0]).ravel()

    np.testing.assert_allclose(slope[0], differences(value, motion[0].ravel(), 1e-6), atol=1e-7)


def test_offset_where_little_room_is_left():
    """|F cos + g| <= R (1 + cos / 2) leaves F - R/2 <= g <= 3R/2 - F: one offset where F reaches R, none beyond."""
    law, basis = law_of([element(np.eye(2), 1.0)] * SIDE_BY_SIDE), basis_of(1, 256)
    for force, sticks, expected, within in ((0.9, 1, 0.15, 0.04), (0.999, 1, 0.15, 4e-4), (1.001, 0, 0.0, 0.0)):
        motion = np.zeros((SIDE_BY_SIDE, 3, 3))
        motion[:, 0, 1], motion[:, 2, 1] = 0.3 * force, 0.5
        found = stuck_offset(law, motion_of(basis, motion))
        assert found.sticks[0] == sticks
        assert abs(float(found.force[0][0]) - expected) <= within
        assert found.force[1][0] == pytest.approx(0, abs=1e-12)


def test_a_contact_sticks_however_far_a_constant_force_deflects_it():
    """Its offset is then far larger than the cone, and so is its rounding."""
    law, basis = law_of([element(STIFFNESS["general"], 1.0)] * SIDE_BY_SIDE), basis_of(1, 256)
    for mean in 10.0 ** np.arange(7):
        motion = np.tile([[0.0, 0.06, 0.02], [0.0, 0.01, 0.04], [0.0, 0.05, 0.0]], (SIDE_BY_SIDE, 1, 1))
        angle = np.arange(SIDE_BY_SIDE)
        motion[:, 0, 0], motion[:, 1, 0] = mean * np.cos(angle), mean * np.sin(angle)
        moving = motion_of(basis, motion)
        found, (force, limit, _) = stuck_offset(law, moving), without_slip(law, moving)
        assert np.all(found.sticks), mean
        assert np.all(np.hypot(*(f + g for f, g in zip(force, found.force, strict=True))) < limit)


def test_the_search_for_an_offset_ends_where_it_does_not_converge():
    """A motion that is not a number, as an iterate of a solver may be, never comes to rest; its neighbours do."""
    law, basis = law_of([element(np.eye(2), 1.0)] * SIDE_BY_SIDE), basis_of(1, 256)
    motion = np.zeros((SIDE_BY_SIDE, 3, 3))
    motion[:, 0, 1], motion[:, 2, 1], motion[0, 1, 1] = 0.27, 0.5, np.nan
    found = stuck_offset(law, motion_of(basis, motion))
    assert found.sticks.tolist() == [False] + [True] * (SIDE_BY_SIDE - 1)
    assert (found.force[0][0], found.force[1][0]) == (0.0, 0.0)


def test_a_contact_that_opens_for_a_moment_does_not_plainly_stick():
    """Nothing pulls at it, so its force is inside the cone at all times, also where this is turned over."""
    law, none = law_of([element(np.eye(2), 1.0)] * 2), np.zeros((256, 2))
    v = none.copy()
    v[100, 0] = -2.0
    assert plainly_sticks(law, Motion((none, none), v, (), v)).tolist() == [False, True]


def test_a_contact_sticks_wherever_it_can():
    """Against a search for the offset with which the force stays deepest in its cone, under motions in the plane."""
    rng, contact, basis = np.random.default_rng(11), element(STIFFNESS["general"], 1.0), basis_of(3, 256)
    law, one = law_of([contact] * SIDE_BY_SIDE), law_of([contact])
    sticks = []
    for scale in np.linspace(0.05, 0.35, 60):
        y = rng.normal(size=(1, 3, 7)) * scale * np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.2, 0.2])
        motion = motion_of(basis, y)
        force, limit, _ = without_slip(one, motion)
        path, limit = np.stack([np.asarray(f)[:, 0] for f in force]), np.asarray(limit)[:, 0]
        if limit.min() <= 0:
            continue

        def excess(g, path=path, limit=limit):
            return np.max(np.linalg.norm(path + np.reshape(g, (2, 1)), axis=0) - limit)

        starts = (np.zeros(2), -path.mean(axis=1), -(path.max(axis=1) + path.min(axis=1)) / 2)
        fine = {"xatol": 1e-9, "fatol": 1e-9}
        best = min(minimize(excess, start, method="Nelder-Mead", options=fine).fun for start in starts)
        found = stuck_offset(law, motion_of(basis, np.repeat(y, SIDE_BY_SIDE, axis=0)))
        if abs(best) > 1e-4:
            sticks.append(bool(found.sticks[0]))
            assert sticks[-1] == (best < 0), best
        if found.sticks[0]:
            assert excess([float(f[0]) for f in found.force]) < 0
    assert 10 < sum(sticks) < len(sticks) - 10


def turned(coefficient, angle):
    """The same cycle begun later by an angle [rad]."""
    turn = np.exp(1j * angle * np.arange(coefficient.shape[-1] // 2 + 1))
    return to_coefficients(to_phasors(coefficient) * turn)


@pytest.mark.parametrize("kind", STIFFNESS)
@pytest.mark.parametrize(
    ("motion", "changes"),
    [
        ((0.8, 0.1, 1.2, 180.0), {(0, 1), (1, 0), (1, 2), (2, 1)}),
        ((0.6, 0.1, 1.5, 45.0), {(0, 1), (1, 2), (2, 0)}),
    ],
)
def test_a_contact_that_changes_its_state_at_the_start_of_the_period(motion, changes, kind):
    """Each transition in turn lies at the first sample, give or take rounding: forces and shares turn with it."""
    contact, motion = element(STIFFNESS[kind]), prescribed(motion, 3)
    theta = CYCLE * np.arange(768) / 768
    cycle = steady_cycle(contact, SplineMotion(fourier_basis(theta, 7) @ motion.T))
    kinds = {(transition.before, transition.after) for transition in cycle.transitions}
    assert kinds == changes
    exact, num = located_forces(contact, motion), 256
    angles = np.array([item.angle + shift for item in cycle.transitions for shift in (-1e-13, 0.0, 1e-13)])
    shares = [sum(stay.stop - stay.start for stay in cycle.stays if stay.state == state) for state in (1, 2)]
    law = law_of([contact] * SIDE_BY_SIDE)
    for some in np.resize(angles, (-(-angles.size // SIDE_BY_SIDE), SIDE_BY_SIDE)):
        done = contact_forces(law, basis_of(3, num), np.array([turned(motion, angle) for angle in some]))
        assert np.max(done.closure) <= 1
        errors = np.asarray(done.coefficient) - [turned(exact, angle) for angle in some]
        assert np.abs(errors).max() < 5e-5
        # Slip ends at a sample; the other transitions are located.
        np.testing.assert_allclose(done.slip, shares[0] / CYCLE, atol=1 / num)
        np.testing.assert_allclose(done.separation, shares[1] / CYCLE, atol=1e-2 / num)


side_by_side = jax.jit(jax.vmap(advance, (None, 0, 0)))


@pytest.mark.parametrize("kind", ["isotropic", pytest.param("general", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", MOTIONS)
def test_the_path_through_the_period_is_that_of_the_law(name, kind):
    """Each interval starts where the one before ends, the first one where the period does; the period is closed."""
    law, basis = law_of([element(STIFFNESS[kind])] * SIDE_BY_SIDE), basis_of(1, COARSE)
    coefficient = shifted(prescribed(MOTIONS[name]))
    motion = motion_of(basis, coefficient)
    period = period_of(law, basis, coefficient)
    starts = np.array(starts_of(period))
    ends = np.array(side_by_side(law, starts_of(period), intervals_of(motion)).d)
    np.testing.assert_array_equal(starts[:, 0], np.array(period.start))
    np.testing.assert_array_equal(starts[:, 1:], np.array(period.ends.d)[:, :-1])
    np.testing.assert_allclose(ends, np.array(period.ends.d), atol=1e-14)
    np.testing.assert_allclose(ends[:, -1], starts[:, 0], atol=1e-11)
    assert np.abs(starts[:, 0]).max() > 0.1


@pytest.mark.parametrize("kind", STIFFNESS)
@pytest.mark.parametrize("num", [64, 98, pytest.param(1000, marks=pytest.mark.slow)])
def test_shares_are_exact_where_the_state_never_changes(num, kind):
    """Contacts that slip all along, stick all along and stay apart."""
    contacts = [element(STIFFNESS[kind], preload) for preload in (1.0, 1.0, 100.0, 100.0, -10.0, -10.0)]
    motion = np.stack([prescribed((3.0, 2.5, 0.1, 30.0), 3)] * SIDE_BY_SIDE)
    done = contact_forces(law_of(contacts), basis_of(3, num), motion)
    np.testing.assert_array_equal(done.slip, [1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(done.separation, [0.0, 0.0, 0.0, 0.0, 1.0, 1.0])


# --- between two samples ---


def busy(name: str) -> np.ndarray:
    """One of the motions with a second and third harmonic, so that no transition lies where symmetry puts it."""
    motion = prescribed(MOTIONS[name], 3)
    motion[0, 3], motion[1, 4], motion[2, 5] = 0.1, 0.05, 0.01
    return motion


@pytest.mark.parametrize("kind", STIFFNESS)
@pytest.mark.parametrize("name", ["stick and slip", "separation", "straight", "against"])
def test_forces_hardly_depend_on_where_the_samples_lie(name, kind):
    """Followed over more than the distance of two samples they neither jump nor, on 64 samples, vary by 1e-4."""
    law, basis = law_of([element(STIFFNESS[kind])] * SIDE_BY_SIDE), basis_of(3, COARSE)
    angles = np.linspace(0, 2 * np.pi / COARSE * 1.2, 50 * SIDE_BY_SIDE)
    forces = []
    for part in angles.reshape(-1, SIDE_BY_SIDE):
        done = contact_forces(law, basis, np.array([turned(busy(name), angle) for angle in part]))
        forces += [turned(own, -angle) for own, angle in zip(done.coefficient, part, strict=True)]
    assert np.ptp(forces, axis=0).max() < 4e-5
    assert np.abs(np.diff(forces, axis=0)).max() < 1e-5
    assert 0.2 < done.slip[0] < 0.95


@pytest.mark.parametrize("angle", [0.4, 0.43, 0.45, 0.47])
def test_a_stop_that_is_hit_between_two_samples(angle):
    """n = max(0, a cos(theta - angle) - 1): its mean is (a sin b - b) / pi with cos b = 1 / a."""
    none = np.zeros(SIDE_BY_SIDE)
    law, basis = ConeLaw(none, (none,), (none,), none + 1.0, none - 1.0), basis_of(3, COARSE)
    height = np.array([1.00005, 1.0002, 1.0005, 1.001, 1.01, 1.1])
    motion = np.zeros((SIDE_BY_SIDE, 3, 7))
    motion[:, 2, 1], motion[:, 2, 2] = height * np.cos(angle), height * np.sin(angle)
    done, slope = linearised(law, basis, motion)
    assert done.passes == 1  # a stop has no elastic displacement that must close
    half = np.arccos(1 / height)
    np.testing.assert_allclose(done.coefficient[:, 2, 0], (height * np.sin(half) - half) / np.pi, rtol=1e-2, atol=4e-7)
    np.testing.assert_allclose(1 - done.separation, half / np.pi, rtol=2e-2, atol=5e-4)
    way = motion / height[:, None, None]
    along = np.einsum("ckij,cij->ck", slope.reshape(SIDE_BY_SIDE, 21, 3, 7), way).reshape(SIDE_BY_SIDE, 3, 7)
    more, less = (contact_forces(law, basis, motion + step * way).coefficient for step in (1e-8, -1e-8))
    np.testing.assert_allclose(along, (more - less) / 2e-8, atol=1e-6, rtol=1e-3)
    assert np.isfinite(slope).all()


def test_slip_that_begins_within_an_interval_is_short_at_first():
    """The friction force turns on the way and touches its cone late in the interval, not where a straight one would."""
    law, shape = law_of([element(np.eye(2), 1.0)] * SIDE_BY_SIDE), (COARSE, SIDE_BY_SIDE)
    each = [np.full(shape, x) for x in (0.03, 0.02, 0.1, -0.04, -0.08, 0.08, 0.0, -0.02, 0.0, -0.02)]
    interval = Interval(tuple(each[:2]), tuple(each[2:4]), tuple(each[4:6]), *each[6:])

    def slip(size):
        return float(side_by_side(law, (np.full(shape, size), np.full(shape, 0.08)), interval).slip[0, 0])

    low, high = 0.1, 0.28
    assert slip(low) == 0 < slip(high) < 1
    while high - low > 1e-12:
        middle = (low + high) / 2
        low, high = (middle, high) if slip(middle) == 0 else (low, middle)
    assert 0 < slip(high) < 1e-4


@pytest.mark.parametrize("kind", STIFFNESS)
@pytest.mark.parametrize("angle", [0.3, 1.8, 4.0])
def test_slip_with_which_a_contact_opens_may_be_as_short_as_it_likes(kind, angle):
    """The force vanishes where it opens but for a rest: what that puts on the samples goes to nothing with the rest."""
    contact, lanes = element(STIFFNESS[kind], 1.0), 10.0 ** -np.arange(2, 13, 2)
    law, shape = law_of([contact] * SIDE_BY_SIDE), (COARSE, SIDE_BY_SIDE)
    ways = (0.04, 0.03, 0.05, 0.04, 0.03, 0.02, -0.98, -1.03, -0.05, -0.05)  # v + 1 falls from 0.02 through 0 at 0.4
    each = [np.full(shape, x) for x in ways]
    along = [0.4 * rate0 + 0.4**2 * (3 * x - 2 * rate0 - rate1) + 0.4**3 * (rate0 + rate1 - 2 * x)
             for x, rate0, rate1 in zip(ways[:2], ways[2:4], ways[4:6], strict=True)]  # fmt: skip
    rest = np.linalg.solve(contact.tangential_stiffness, [np.cos(angle), np.sin(angle)])
    d = tuple(np.broadcast_to(lanes * x - u, shape) for x, u in zip(rest, along, strict=True))
    end = side_by_side(law, d, Interval(tuple(each[:2]), tuple(each[2:4]), tuple(each[4:6]), *each[6:]))
    slip, put = np.asarray(end.slip[0]), np.array([part[0] for part in (*end.before, *end.after)])
    assert np.all(np.diff(slip) < 0)
    assert slip[-1] < 1e-8
    assert np.all(np.abs(put - put[:, -1:]) < lanes + 1e-15)


@pytest.mark.parametrize(("kind", "phase"), [("isotropic", -64.0), ("general", -52.0)])
@pytest.mark.parametrize("across", [0.0, 1e-9, 1e-3])
def test_slip_against_the_motion_ends_smoothly_where_the_contact_opens(kind, phase, across):
    """A falling load keeps up slip against the motion up to the opening, or next to it: no rounding turns it there."""
    law, basis = law_of([element(STIFFNESS[kind])] * SIDE_BY_SIDE), basis_of(3, SAMPLES[-1])
    motion, turn = prescribed((1.0, across, 1.5, phase), 3), np.exp(0.43j)
    plane = turn * (motion[0] + 1j * motion[1])  # along no axis, where rounding would be nil
    motion[:2] = plane.real, plane.imag
    angles, forces = np.linspace(0, 2 * np.pi / SAMPLES[-1] * 1.2, 10 * SIDE_BY_SIDE), []
    for part in angles.reshape(-1, SIDE_BY_SIDE):
        done = contact_forces(law, basis, np.array([turned(motion, angle) for angle in part]))
        forces += [turned(own, -angle) for own, angle in zip(done.coefficient, part, strict=True)]
    assert np.abs(np.diff(forces, axis=0)).max() < 1e-6


def test_slip_that_is_shorter_than_the_distance_of_samples():
    """u = A cos, A a little above delta = mu n / k: slip at both turns dissipates 4 mu n (A - delta)."""
    contact = replace(element(np.eye(2)), normal_stiffness=0.0)
    law, basis = law_of([contact] * SIDE_BY_SIDE), basis_of(3, COARSE)
    excess = np.array([1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 1e-2]) * 0.3
    motion = np.zeros((SIDE_BY_SIDE, 3, 7))
    motion[:, 0, 1], motion[:, 0, 2] = (0.3 + excess) * np.cos(0.43), (0.3 + excess) * np.sin(0.43)
    done = contact_forces(law, basis, motion)
    sine = done.coefficient[:, 0, 1] * np.sin(0.43) - done.coefficient[:, 0, 2] * np.cos(0.43)
    work = np.pi * (0.3 + excess) * sine
    np.testing.assert_allclose(np.abs(work), 4 * 0.3 * excess, rtol=2e-2, atol=1e-6)
    assert done.slip[0] < 1 / COARSE
