"""Harmonic balance against closed forms, reference computations and finite differences.

Numbers without a formula are reference computations: marched time integration with located events, and harmonic
balance by an independent code at 15 harmonics; the amplitudes of the paper's oscillator are settled ones of DOP853 with
located events at rtol 1e-12.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import systems
from scipy.optimize import minimize

from timesim.engine.contact import Law
from timesim.hbm.balance import Balance, to_complex, to_real
from timesim.hbm.continuation import Controls, solve
from timesim.hbm.curve import contact_motion, default_controls, hbm_curve, solutions_at
from timesim.hbm.located import located_forces, waves
from timesim.hbm.period import MAX_PASSES, basis_of, forces, motion_of
from timesim.hbm.setting import Setting
from timesim.hbm.stability import floquet_multipliers
from timesim.hbm.stuck_offset import acting, stuck_offset
from timesim.hbm.tangent import linearised
from timesim.model.model import Structure
from timesim.model.solver import PRESETS
from timesim.orbit.fourier import half_range
from timesim.orbit.settling import Task, settle

TURN = 2 * np.pi
# A, B, D and phase of the normal motion in degrees: u = (A cos, B cos(. + 90)), v = D cos(. + phase).
MOTIONS = {
    "ellipse": (1.0, 0.5, 0.0, 0.0),
    "stick and slip": (0.6, 0.1, 0.0, 0.0),
    "variable load": (1.0, 0.5, 0.5, 45.0),
    "separation": (1.0, 0.5, 1.5, 45.0),
    "straight": (1.0, 0.0, 1.5, 45.0),
}
STIFFNESS = {"isotropic": np.eye(2), "general": np.array([[1.0, 0.3], [0.3, 0.6]])}


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
    return Law(friction, tuple(map(jnp.asarray, stiffness)), tuple(map(jnp.asarray, compliance)), normal, preload)


def shifted(coefficient, num_shifts=6):
    """The same cycle begun at other angles within a sample, so that the samples meet transitions in many ways."""
    turn = np.exp(1j * np.outer(0.37 * np.arange(num_shifts), np.arange(coefficient.shape[-1] // 2 + 1)))
    return to_real(to_complex(coefficient) * turn[:, None])


@pytest.mark.parametrize("kind", STIFFNESS)
@pytest.mark.parametrize("name", MOTIONS)
def test_law_through_a_period_is_of_second_order(name, kind):
    contact, motion = element(STIFFNESS[kind]), prescribed(MOTIONS[name], 3)
    exact = located_forces(contact, motion)
    assert exact is not None
    numbers = np.array([64, 128, 256, 512, 1024, 2048, 4096])
    motions, exacts = shifted(motion), shifted(exact)
    errors, law = [], law_of([contact] * len(motions))
    for num in numbers:
        done = forces(law, basis_of(3, int(num)), jnp.asarray(motions))
        assert np.max(done.gap) <= 1
        assert 1 <= done.passes < MAX_PASSES
        errors.append(np.sqrt(np.mean((np.asarray(done.coefficient) - exacts) ** 2)))
    order = -np.polyfit(np.log(numbers), np.log(errors), 1)[0]
    assert order > 1.85, errors
    assert errors[4] < 2e-6


def test_slip_under_constant_load_is_of_third_order():
    contact, motion = element(np.eye(2)), prescribed(MOTIONS["ellipse"])
    exact = located_forces(contact, motion)
    numbers = np.array([64, 128, 256])
    errors = [
        np.abs(
            np.asarray(forces(law_of([contact]), basis_of(1, int(n)), jnp.asarray(motion[None])).coefficient[0]) - exact
        ).max()
        for n in numbers
    ]
    assert -np.polyfit(np.log(numbers), np.log(errors), 1)[0] > 2.8, errors


def test_full_stick_starts_from_no_slip():
    motion = prescribed((0.1, 0.05, 0.2, 30.0))
    done = forces(law_of([element(np.eye(2))]), basis_of(1, 64), jnp.asarray(motion[None]))
    expected = motion.copy()
    expected[2, 0] += 1.0
    np.testing.assert_allclose(done.coefficient[0], expected, atol=1e-14)
    assert done.slip[0] == done.separation[0] == 0


def differences(value, x, step):
    return np.array([(value(x + step * e) - value(x - step * e)) / (2 * step) for e in np.eye(x.size)]).T


@pytest.mark.parametrize("kind", STIFFNESS)
@pytest.mark.parametrize("preload", [1.0, 0.3, -0.3])
def test_force_derivatives_against_differences(kind, preload):
    rng = np.random.default_rng(3)
    contacts = [element(STIFFNESS[kind], preload)] * 3
    law, basis = law_of(contacts), basis_of(2, 128)
    y = rng.normal(size=(3, 3, 5)) * np.array([1.0, 1.0, 1.0, 0.2, 0.2])
    acts, slope = linearised(law, basis, jnp.asarray(y))
    assert np.max(acts.slip) > 0.2

    def value(flat):
        return np.asarray(forces(law, basis, jnp.asarray(flat.reshape(y.shape))).coefficient).ravel()

    whole = differences(value, y.ravel(), 1e-6).reshape(3, 15, 3, 15)
    own = np.stack([whole[i, :, i] for i in range(3)])
    np.testing.assert_allclose(slope, own, atol=2e-8)
    assert np.abs(whole).sum() == pytest.approx(np.abs(own).sum())


@pytest.mark.parametrize("kind", STIFFNESS)
def test_derivatives_where_no_slip_at_all_would_leave_the_cone(kind):
    """w = 0 lies outside: the contact sticks with an offset, which follows the motion."""
    contact = element(STIFFNESS[kind], 1.0)
    motion = np.zeros((1, 3, 3))
    motion[0] = [0.15, 0.2, 0.05], [-0.3, 0.02, -0.1], [0.1, 0.2, -0.1]
    law, basis = law_of([contact]), basis_of(1, 128)
    acts, slope = linearised(law, basis, jnp.asarray(motion))
    offset = acts.coefficient[0, :2, 0] - STIFFNESS[kind] @ motion[0, :2, 0]
    assert acts.slip[0] == acts.separation[0] == 0
    assert np.linalg.norm(offset) > 0.03

    def value(flat):
        return np.asarray(forces(law, basis, jnp.asarray(flat.reshape(motion.shape))).coefficient).ravel()

    np.testing.assert_allclose(slope[0], differences(value, motion.ravel(), 1e-6), atol=1e-7)


def test_offset_where_little_room_is_left():
    """|F cos + g| <= R (1 + cos / 2) leaves F - R/2 <= g <= 3R/2 - F: one offset where F reaches R, none beyond."""
    law, basis = law_of([element(np.eye(2), 1.0)]), basis_of(1, 256)
    for force, sticks, expected, within in ((0.9, 1, 0.15, 0.04), (0.999, 1, 0.15, 4e-4), (1.001, 0, 0.0, 0.0)):
        motion = np.zeros((1, 3, 3))
        motion[0, 0, 1], motion[0, 2, 1] = 0.3 * force, 0.5
        found = stuck_offset(law, motion_of(basis, jnp.asarray(motion)))
        assert found.sticks[0] == sticks
        assert abs(float(found.force[0][0]) - expected) <= within
        assert found.force[1][0] == pytest.approx(0, abs=1e-12)


def test_a_contact_sticks_wherever_it_can():
    """Against a search for the offset with which the force stays deepest in its cone, under motions in the plane."""
    rng, law, basis = np.random.default_rng(11), law_of([element(STIFFNESS["general"], 1.0)]), basis_of(3, 128)
    told = []
    for scale in np.linspace(0.05, 0.35, 60):
        y = rng.normal(size=(1, 3, 7)) * scale * np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.2, 0.2])
        motion = motion_of(basis, jnp.asarray(y))
        force, limit, _ = acting(law, motion)
        path, limit = np.stack([np.asarray(f)[:, 0] for f in force]), np.asarray(limit)[:, 0]
        if limit.min() <= 0:
            continue

        def excess(g, path=path, limit=limit):
            return np.max(np.linalg.norm(path + np.reshape(g, (2, 1)), axis=0) - limit)

        starts = (np.zeros(2), -path.mean(axis=1), -(path.max(axis=1) + path.min(axis=1)) / 2)
        fine = {"xatol": 1e-9, "fatol": 1e-9}
        best = min(minimize(excess, start, method="Nelder-Mead", options=fine).fun for start in starts)
        found = stuck_offset(law, motion)
        if abs(best) > 1e-4:
            told.append(bool(found.sticks[0]))
            assert told[-1] == (best < 0), best
        if found.sticks[0]:
            assert excess([float(f[0]) for f in found.force]) < 0
    assert 10 < sum(told) < len(told) - 10


@pytest.mark.parametrize("preload", [2.0, 5.0])
def test_a_curve_from_the_stuck_end_passes_the_onset_of_slip(preload):
    """From either end the same curve: the offset of the stuck part leads to the one with which slip begins."""
    model, curves = systems.oscillator(preload, 1.0), []
    for span in ((0.8, 1.65), (1.65, 0.8)):
        curve = hbm_curve(model, *span, setting=Setting(7, 512), stability=False)
        assert curve.complete
        curves.append(curve)
    there, back = curves
    assert there.fold.sum() == back.fold.sum() == (2 if preload == 2.0 else 0)
    slips = [np.sort(curve.frequency[(curve.slip_share > 0).any(axis=1)])[0] for curve in curves]
    assert slips[0] == pytest.approx(slips[1], abs=2e-3)
    for frequency in (0.9, 1.5):
        ends = [solutions_at(model, c, frequency, setting=Setting(7, 512), stability=False) for c in curves]
        np.testing.assert_allclose(ends[0].harmonic_amplitude[0, 1:], ends[1].harmonic_amplitude[0, 1:], atol=1e-8)


def balanced_models():
    zoo = systems.generated_models()
    picked = dict(list(zoo.items())[1::10])
    return {"oscillator": systems.oscillator(-1.0, 0.97), "inclined": systems.inclined(1.27), **picked}


@pytest.mark.parametrize("name", balanced_models())
def test_residual_derivatives_against_differences(name):
    """Among the models are whole damping matrices, general K_u, stops, constant loads and higher harmonics."""
    model = balanced_models()[name]
    frequency = model.excitation.frequency
    balance = Balance(model, frequency, Setting(3, 128))
    x = 0.7 * np.random.default_rng(5).normal(size=balance.num_unknowns)
    r, by_x, by_p = balance.linearised(x, frequency)
    np.testing.assert_allclose(r, balance.value(x, frequency), atol=1e-12)
    scale = np.abs(by_x).max()
    np.testing.assert_allclose(
        by_x / scale, differences(lambda z: balance.value(z, frequency), x, 1e-6) / scale, atol=2e-7
    )
    step = 1e-6 * frequency
    slope = (balance.value(x, frequency + step) - balance.value(x, frequency - step)) / (2 * step)
    np.testing.assert_allclose(by_p / np.abs(by_p).max(), slope / np.abs(by_p).max(), atol=1e-7)


def test_modes_of_frequency_zero():
    """A free mode gives the limit of a soft one."""
    soft, free = (oscillating_free(stiffness) for stiffness in (1e-7, 0.0))
    values = [hbm_curve(m, 1.1 / TURN, 1.2 / TURN, setting=Setting(3, 256)) for m in (soft, free)]
    assert all(v.complete for v in values)
    assert values[0].slip_share.max() > 0.2
    np.testing.assert_allclose(values[1].amplitude[-1], values[0].amplitude[-1], rtol=1e-5)


def oscillating_free(stiffness):
    model = systems.inclined(1.2)
    body = model.structure
    return replace(model, structure=replace(body, frequency=np.array([np.sqrt(stiffness) / TURN])))


@pytest.fixture(scope="module")
def circle():
    return hbm_curve(systems.circular(0.5, 1.0), 0.8 / TURN, 1.5 / TURN, setting=Setting(1, 1024))


@pytest.mark.parametrize("omega", [0.8, 1.0, 1.1, 1.2, 1.3, 1.5])
def test_circular_motion_is_exact_but_for_the_samples(circle, omega):
    assert circle.complete
    point = solutions_at(systems.circular(0.5, 1.0), circle, omega / TURN, setting=Setting(1, 1024))
    radius = systems.circular_radius(0.5, omega)
    np.testing.assert_allclose(point.amplitude[0, 0, :2], radius, rtol=1e-6)
    assert point.slip_share[0, 0] == pytest.approx(1)
    assert point.stable[0]
    assert point.closure[0] <= 1


def test_circular_motion_with_located_transitions():
    model, omega = systems.circular(0.5, 1.2), 1.2
    balance = Balance(model, omega / TURN, Setting(1, 256, "located"))
    radius = systems.circular_radius(0.5, omega)
    guess = np.array([0.0, 0.9, 0.0, 0.0, 0.0, 0.9, 0.0, 0.0, 0.0]) * radius / balance.length
    solution = solve(balance, guess, omega / TURN, replace(default_controls(), tolerance=1e-11))
    assert solution is not None
    motion = balance.coefficients(solution[0])[0] * balance.length
    np.testing.assert_allclose(np.hypot(motion[:2, 1], motion[:2, 2]), radius, rtol=1e-8)


@pytest.fixture(scope="module")
def fine():
    return Setting(15, 4096)


def test_jenkins_element(fine):
    curve = hbm_curve(systems.jenkins(1.2), 0.8 / TURN, 1.4 / TURN, setting=fine, stability=False)
    reference = {0.8: 0.435696, 1.0: 6.210084, 1.1: 2.344364, 1.2: 1.360174, 1.3: 0.965336, 1.4: 0.745879}
    for omega, amplitude in reference.items():
        point = solutions_at(systems.jenkins(1.2), curve, omega / TURN, setting=fine)
        assert point.amplitude[0, 0, 0] == pytest.approx(amplitude, rel=2e-6, abs=5e-7)
        assert point.slip_share[0, 0] > 0.3


@pytest.fixture(scope="module")
def jump(fine):
    return hbm_curve(systems.inclined(1.2), 1.2 / TURN, 1.4 / TURN, setting=fine)


def test_folds_of_the_inclined_contact(jump):
    assert jump.complete
    np.testing.assert_allclose(jump.frequency[jump.fold] * TURN, [1.28524, 1.25752], rtol=4e-6)
    assert jump.amplitude[jump.fold][0, 0, 0] == pytest.approx(0.711, abs=1e-3)
    assert jump.amplitude[jump.fold][1, 0, 0] == pytest.approx(2.004, abs=2e-3)
    assert jump.amplitude[:, 0, 0].max() == pytest.approx(2.0525, abs=2e-3)
    inner = ~jump.fold
    np.testing.assert_array_equal(jump.stable[inner], (jump.branch != 1)[inner])


@pytest.mark.parametrize(
    ("omega", "amplitudes"),
    [
        (1.2, [0.356815]),
        (1.27, [0.515554, 1.571736, 1.981047]),
        (1.28, [0.558662, 1.175391, 1.874116]),
        (1.3, [1.654722]),
        (1.4, [0.893366]),
    ],
)
def test_all_solutions_at_one_frequency(jump, fine, omega, amplitudes):
    points = solutions_at(systems.inclined(1.2), jump, omega / TURN, setting=fine)
    np.testing.assert_allclose(points.amplitude[:, 0, 0], amplitudes, rtol=2e-6, atol=5e-7)
    np.testing.assert_array_equal(points.stable, [True, False, True][: len(amplitudes)])
    unstable = points.floquet_max > 1.001
    np.testing.assert_array_equal(unstable, ~points.stable)


@pytest.mark.parametrize(
    ("force", "omega", "tangential", "normal"),
    [(10, 4.0, 5.852056, 0.036761), (50, 3.5, 10.974623, 0.163600), (80, 3.0, 10.452002, 0.238514)],
)
def test_two_degrees_under_variable_load(force, omega, tangential, normal):
    model = systems.two_degrees(force, omega)
    curve = hbm_curve(model, omega / TURN, 1.01 * omega / TURN, setting=Setting(8, 1024), stability=False)
    assert curve.amplitude[0, 0, 0] == pytest.approx(tangential, rel=2e-6)
    assert curve.amplitude[0, 0, 2] == pytest.approx(normal, abs=1e-6)
    assert curve.harmonic_amplitude[0, 0, 0, 2] * 21 == pytest.approx(100 * 21 / 42, rel=1e-9)


@pytest.mark.parametrize(
    ("preload", "span", "folds", "at", "amplitudes"),
    [
        (-4.0, (1.0, 0.92), (0.9472, 0.9416), 0.947, (0.4297, 0.2052)),
        (2.0, (1.32, 1.2), (1.2560, 1.2511), 1.255, (0.1343, 0.2861)),
    ],
)
def test_jumps_of_the_oscillator(preload, span, folds, at, amplitudes):
    """Folds where the time-domain sweeps jump, to their step of 1e-4 Hz, and the amplitudes of both branches."""
    model, setting = systems.oscillator(preload, 1.0), Setting(9, 1024)
    curve = hbm_curve(model, *span, setting=setting)
    assert curve.complete
    np.testing.assert_allclose(np.sort(curve.frequency[curve.fold]), np.sort(folds), atol=1e-4)
    points = solutions_at(model, curve, at, setting=setting)
    np.testing.assert_allclose(np.sort(points.amplitude[points.stable, 0, 0]), np.sort(amplitudes), atol=1e-4)
    assert points.stable.sum() == 2
    assert points.stable.size == 3


@pytest.mark.parametrize(
    ("preload", "frequency", "amplitude"), [(3.0, 1.39, 0.15612878), (-1.0, 0.97, 0.28839155), (5.0, 1.52, 0.15680399)]
)
def test_harmonics_lead_to_the_settled_response(preload, frequency, amplitude):
    model, errors = systems.oscillator(preload, frequency), []
    for harmonics in (1, 5, 15):
        curve = hbm_curve(model, frequency, 1.001 * frequency, setting=Setting(harmonics, 1024), stability=False)
        assert curve.slip_share[0, 0] > 0.05
        errors.append(abs(curve.amplitude[0, 0, 0] / amplitude - 1))
    assert errors[0] > 1e-3
    assert errors[1] < errors[0] / 3
    assert errors[2] < min(errors[1], 2e-4)


def test_multipliers_of_a_stuck_structure():
    """Exponentials of the eigenvalues, and two that are 1 for the slip that nothing moves."""
    model, frequency = systems.oscillator(32.0, 1.0), 1.2
    balance = Balance(model, frequency, Setting(1, 64))
    solution = solve(balance, np.zeros(9), frequency, default_controls())
    assert solution is not None
    body, shape = model.structure, model.contact_shape[0]
    stiffness = np.diag(body.stiffness) + 20 * shape.T @ shape
    state = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -np.diag(body.damping)]])
    exact = np.append(np.exp(np.linalg.eigvals(state) / frequency), [1.0, 1.0])
    found = floquet_multipliers(balance, solution[0][None], np.array([frequency]), samples=512)[0]
    np.testing.assert_allclose(np.sort(np.abs(found)), np.sort(np.abs(exact)), rtol=1e-4)


@pytest.mark.parametrize(("preload", "frequency"), [(-1.0, 0.97), (1.0, 1.2), (2.0, 1.3), (3.0, 1.39), (5.0, 1.52)])
def test_multipliers_against_those_of_the_return_map(preload, frequency):
    """Motions with slip or separation; the others are exact derivatives of the event loop."""
    model = systems.oscillator(preload, frequency)
    curve = hbm_curve(model, frequency, 1.001 * frequency, setting=Setting(15, 1024))
    marched = settle([Task(model, frequency)], PRESETS["standard"])[0]
    assert marched.settled
    assert curve.slip_share[0, 0] > 0.05
    np.testing.assert_allclose(curve.amplitude[0], marched.amplitude, rtol=1e-3)
    exact = np.abs(marched.floquet[0])
    assert 0.5 < exact < 0.9
    assert curve.floquet_max[0] == pytest.approx(exact, abs=3e-2)
    balance = Balance(model, frequency, Setting(15, 1024))
    x = curve.contact_motion[:1].reshape(1, -1) / balance.length
    fine = np.abs(floquet_multipliers(balance, x, curve.frequency[:1], samples=1024)[0])
    np.testing.assert_allclose(fine[:4], np.abs(marched.floquet[:4]), atol=4e-3)


def test_multipliers_of_a_whole_damping_matrix():
    """Modes coupled by a damping matrix, and the same without its off-diagonal terms given as either form."""
    model = systems.oscillator(-1.0, 0.97)
    whole = replace(model, structure=replace(model.structure, damping=np.diag(model.structure.damping)))
    found = [hbm_curve(m, 0.97, 0.971, setting=Setting(5, 256)).floquet_max for m in (model, whole)]
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)


def test_start_from_a_given_motion():
    """The upper solution at 0.947 Hz, which neither linear response leads to."""
    model, setting = systems.oscillator(-4.0, 1.0), Setting(5, 512)
    full = hbm_curve(model, 1.0, 0.92, setting=setting, stability=False)
    upper = solutions_at(model, full, 0.947, setting=setting)
    assert upper.frequency.size == 3
    shape = model.structure.shape[0, :2]
    best = np.argmax(upper.amplitude[:, 0, 0])
    waves_of = np.concatenate(
        [
            upper.harmonic_cos[best, :1, 0, :2],
            np.stack([upper.harmonic_cos[best, 1:, 0, :2], upper.harmonic_sin[best, 1:, 0, :2]], axis=1).reshape(-1, 2),
        ]
    )
    guess = waves_of @ np.linalg.inv(shape).T
    alone = hbm_curve(model, 0.947, 0.946, setting=setting, guess=guess, stability=False)
    assert alone.amplitude[0, 0, 0] == pytest.approx(upper.amplitude[best, 0, 0], rel=1e-7)


def test_half_range_is_that_of_the_continuous_motion():
    rng = np.random.default_rng(0)
    phasor = rng.normal(size=(3, 6, 2, 3)) + 1j * rng.normal(size=(3, 6, 2, 3))
    theta = np.linspace(0, TURN, 20001)
    values = np.einsum("kh,sh...->ks...", np.exp(1j * np.outer(theta, np.arange(6))), phasor).real
    np.testing.assert_allclose(half_range(phasor), (values.max(0) - values.min(0)) / 2, rtol=1e-6)


def test_phasors_and_coefficients():
    coefficient = np.random.default_rng(1).normal(size=(2, 3, 9))
    np.testing.assert_array_equal(to_real(to_complex(coefficient)), coefficient)
    theta = np.linspace(0, TURN, 7)
    expected = (to_complex(coefficient) @ np.exp(1j * np.outer(np.arange(5), theta))).real
    np.testing.assert_allclose(coefficient @ waves(theta, 9).T, expected, atol=1e-13)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: Setting(harmonics=0), "harmonics must be at least 1, not 0"),
        (lambda: Setting(harmonics=9, time_samples=20), "time_samples must be at least 36 for 9 harmonics, not 20"),
        (lambda: hbm_curve(systems.oscillator(3.0, 1.0), 0.0, 1.0), "frequency.from must be a positive number"),
        (lambda: hbm_curve(systems.oscillator(3.0, 1.0), 1.0, 1.0), "must differ, not both 1.0"),
        (lambda: Balance(silent(), 1.0, Setting()), "no periodic part"),
        (
            lambda: Balance(third_harmonic(), 1.0, Setting(2, 64)),
            "harmonics must be at least 3, since harmonic 3 is excited, not 2",
        ),
        (
            lambda: contact_motion(Balance(systems.oscillator(3.0, 1.0), 1.0, Setting(2, 64)), np.zeros((4, 2))),
            r"odd number of rows and 2 columns, not shape \(4, 2\)",
        ),
    ],
)
def test_what_cannot_be_balanced_is_refused(call, said):
    with pytest.raises(ValueError, match=said):
        call()


def silent():
    model = systems.oscillator(3.0, 1.0)
    return replace(model, excitation=replace(model.excitation, cosine=np.zeros((1, 2)), constant=np.ones(2)))


def third_harmonic():
    model = systems.oscillator(3.0, 1.0)
    return replace(model, excitation=replace(model.excitation, harmonic=np.array([3])))


def test_an_incomplete_curve_says_where_it_ended():
    controls = Controls(size=0.1, max_points=5)
    curve = hbm_curve(systems.circular(0.5, 1.0), 0.8 / TURN, 1.5 / TURN, setting=Setting(1, 1024), controls=controls)
    assert not curve.complete
    assert curve.frequency.size == 5
    assert f"{curve.frequency[-1]:.10g}" in curve.message
    assert "max_points" in curve.message


def test_no_start_gives_an_empty_curve_with_the_reason():
    """Without damping at the natural frequency of a structure that nothing touches there is no periodic response."""
    model = systems.den_hartog(1.0, 0.0, 0.0)
    body = Structure(model.structure.frequency, np.ones(1), np.zeros(1), ("tip",), model.structure.shape)
    apart = replace(model, structure=body, contacts=(systems.pad(0.3, 1.0, 1.0, -1e9),))
    with np.errstate(all="ignore"):
        curve = hbm_curve(apart, 1.0 / TURN, 1.2 / TURN, setting=Setting(1, 64))
    assert curve.frequency.size == 0
    assert not curve.complete
    assert "no solution at the start" in curve.message
