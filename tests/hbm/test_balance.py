"""Harmonic balance against closed forms, reference computations and finite differences.

Numbers without a formula are reference computations: marched time integration with located events, and harmonic
balance by an independent code at 15 harmonics; the amplitudes of the paper's oscillator are settled ones of DOP853 with
located events at rtol 1e-12.
"""

from dataclasses import replace

import numpy as np
import pytest
import systems

from timesim.hbm import first_guess
from timesim.hbm.balance import Balance
from timesim.hbm.branches import solutions_at, warm_up
from timesim.hbm.continuation import Controls, Ending, solve
from timesim.hbm.continuation.bordered import Bordered
from timesim.hbm.curve import hbm_curve
from timesim.hbm.first_guess import first_guesses, unknowns_of_modes
from timesim.hbm.scheme import Scheme
from timesim.hbm.tangent import compile_slopes
from timesim.model.model import Model, Structure
from timesim.orbit.fourier import to_coefficients
from timesim.program import LOADED

pytestmark = pytest.mark.long

TURN = 2 * np.pi


def differences(value, x, step):
    return np.array([(value(x + step * e) - value(x - step * e)) / (2 * step) for e in np.eye(x.size)]).T


@pytest.mark.parametrize("preload", [pytest.param(2.0, marks=pytest.mark.slow), 5.0])
def test_a_curve_from_the_stuck_end_passes_the_onset_of_slip(preload):
    """From either end the same curve: the offset of the stuck part leads to the one with which slip begins."""
    model, curves = systems.oscillator(preload, 1.0), []
    for span in ((0.8, 1.65), (1.65, 0.8)):
        curve = hbm_curve(model, *span, scheme=Scheme(7, 256), stability=False)
        assert curve.complete
        curves.append(curve)
    there, back = curves
    assert there.fold.sum() == back.fold.sum() == (2 if preload == 2.0 else 0)
    slips = [np.sort(curve.frequency[(curve.slip_share > 0).any(axis=1)])[0] for curve in curves]
    assert slips[0] == pytest.approx(slips[1], abs=2e-3)
    for frequency in (0.9, 1.5):
        ends = [solutions_at(model, c, frequency, scheme=Scheme(7, 256), stability=False) for c in curves]
        np.testing.assert_allclose(ends[0].harmonic_amplitude[0, 1:], ends[1].harmonic_amplitude[0, 1:], atol=1e-8)


def test_no_fold_lies_where_slip_begins_in_a_narrow_range():
    """The samples turn the offset of the stuck part to and fro, and the frequency with it, within 3e-7 of it."""
    curve = hbm_curve(systems.oscillator(4.996, 1.0), 1.36, 1.38, scheme=Scheme(7, 256), stability=False)
    assert curve.complete, curve.message
    assert not curve.fold.any()
    sticks = curve.slip_share == 0
    assert np.all(curve.dissipated_power[sticks] == 0)
    assert np.all(curve.dissipated_power[~sticks] > 0)
    assert 0 < sticks.sum() < sticks.size


def test_a_chain_turns_at_the_first_touch_of_a_stiff_stop():
    """By more than a right angle, within 1e-6 of the range; the curve goes on, without a fold."""
    curve = hbm_curve(systems.stopped_chain(1000.0), 0.154, 0.157, scheme=Scheme(21, 512), stability=False)
    assert curve.complete, curve.message
    assert not curve.fold.any()
    touching = np.flatnonzero(curve.separation_share[:, 0] < 1)
    assert np.all(np.diff(touching) == 1)
    assert curve.frequency[touching[0]] == pytest.approx(0.15554725, abs=1e-8)


def test_a_chain_that_meets_a_stop_has_two_folds():
    """The curve is almost upright below the upper one, and the samples turn its tangent to and fro. The amplitudes are
    those to which a time integration settles from the solution."""
    model, scheme = systems.stopped_chain(100.0), Scheme(21, 512)
    curve = hbm_curve(model, 0.15, 0.2, scheme=scheme, stability=False)
    assert curve.complete, curve.message
    np.testing.assert_allclose(curve.frequency[curve.fold], [0.199450, 0.162846], atol=3e-6)
    upper = solutions_at(model, curve, np.array([0.17, 0.197]), scheme=scheme, stability=False).amplitude[[0, 3], :, 2]
    np.testing.assert_allclose(upper, [[1.142204, 0.9720597], [2.195337, 1.243855]], rtol=4e-4)


def balanced_models():
    zoo = systems.generated_models()
    picked = dict(list(zoo.items())[1::10])
    return {"oscillator": systems.oscillator(-1.0, 0.97), "inclined": systems.inclined(1.27), **picked}


@pytest.mark.parametrize("size", [0.7, 1e-2])
@pytest.mark.parametrize("name", balanced_models())
def test_residual_derivatives_against_differences(name, size):
    """Among the models are whole damping matrices, general K_u, stops, constant loads and higher harmonics.

    Of a small motion, contacts stick or are apart all along: what is solved is smaller then.
    """
    model = balanced_models()[name]
    frequency, rng = model.excitation.frequency, np.random.default_rng(5)
    balance = Balance(model, frequency, Scheme(3, 256))
    x = size * rng.normal(size=balance.num_unknowns)
    r, by_x, by_p = balance.linearised(x, frequency)
    np.testing.assert_allclose(r, balance.value(x, frequency), atol=1e-12)
    step = 1e-6 * frequency
    slope = (balance.value(x, frequency + step) - balance.value(x, frequency - step)) / (2 * step)
    np.testing.assert_allclose(by_p / np.abs(by_p).max(), slope / np.abs(by_p).max(), atol=1e-7)
    row = rng.normal(size=x.size + 1)
    factors, each = Bordered(by_x, by_p, row), np.eye(x.size + 1)
    inverse = np.stack([factors.solve(right[:-1], right[-1]) for right in each], axis=1)
    change = differences(lambda z: balance.value(z, frequency), x, 1e-6 * size)
    whole = np.block([[change, by_p[:, None]], [row[None]]])
    scale = np.linalg.norm(whole, axis=1)[:, None] * np.linalg.norm(inverse, axis=0)
    np.testing.assert_allclose(whole @ inverse / scale, each / scale, atol=2e-7)
    tangent, sign = factors.tangent()
    np.testing.assert_allclose(tangent, inverse[:, -1] / np.linalg.norm(inverse[:, -1]), atol=1e-12)
    assert sign == np.sign(np.linalg.det(change))
    if size < 0.1:
        assert by_x.outer.size >= 2 * balance.size


@pytest.mark.parametrize("coupling", [0.0, 0.5])
def test_modes_of_any_mass_lead_back_to_the_motion_of_the_contacts(coupling):
    """Modal displacements of a solution, taken as a guess, are its unknowns; the shapes go with the masses."""
    model = systems.oscillator(-1.0, 0.97)
    body, mass = model.structure, np.array([4.0, 0.3])
    damping = np.diag(body.damping * mass)
    damping[0, 1] = damping[1, 0] = coupling * np.sqrt(damping[0, 0] * damping[1, 1])
    heavy = replace(model, structure=replace(body, mass=mass, damping=damping))
    balance = Balance(heavy, 0.97, Scheme(5, 256))
    solution = solve(balance, next(first_guesses(balance, 0.97, Controls()))[1], 0.97, Controls())
    assert solution is not None
    modal = balance.modes(solution[0], balance.contact_forces(solution[0]), 0.97)
    np.testing.assert_allclose(unknowns_of_modes(balance, to_coefficients(modal.T).T), solution[0], atol=1e-8)


def test_a_structure_that_is_singular_at_its_own_frequency_has_no_response(monkeypatch):
    """Undamped modes, as a matrix: one of them is not touched by the contact and meets its natural frequency.

    Without a march for the first guess: `tests/study/test_hbm.py` has a slow one that does not settle.
    """
    monkeypatch.setattr(first_guess, "_settled", lambda *_: ("time integration", None))
    model = systems.two_stops((1.0, 1.0))
    body = replace(model.structure, damping=np.zeros((2, 2)), frequency=np.array([1.0, 0.8]))
    free = replace(model, structure=body, contacts=model.contacts[1:], start=systems.at_rest(2, 1))
    with np.errstate(all="ignore"):
        curve = hbm_curve(free, 1.0, 1.1, scheme=Scheme(3, 64))
    assert curve.ending is Ending.START


def test_modes_of_frequency_zero():
    """A free mode gives the limit of a soft one."""
    soft, free = (oscillating_free(stiffness) for stiffness in (1e-7, 0.0))
    values = [hbm_curve(m, 1.1 / TURN, 1.2 / TURN, scheme=Scheme(3, 256)) for m in (soft, free)]
    assert all(v.complete for v in values)
    assert values[0].slip_share.max() > 0.2
    np.testing.assert_allclose(values[1].amplitude[-1], values[0].amplitude[-1], rtol=1e-5)


@pytest.mark.parametrize(("damping", "force", "constant"), [(0.0, 0.0, 0.0), (0.1, 0.1, 0.0), (0.1, 0.1, 0.1)])
def test_a_free_mode_that_nothing_holds(damping, force, constant, monkeypatch):
    """Along a frictionless stop: its waves are those of a free mass, its mean is free, if no force drives it away."""
    monkeypatch.setattr(first_guess, "_settled", lambda *_: ("time integration", None))
    body = systems.structure([0.0, 1.0], [damping, 0.02], [[1, 0, 0], [0, 0, 1]])
    load = systems.excitation(0.15, [force, 0.5], [0.0, 0.0], [constant, 0.0])
    model = Model(body, (systems.pad(0.0, 0.0, 5.0, -0.5),), load, systems.at_rest(2, 1))
    held = replace(model, structure=systems.structure([1.0], [0.02], [[0, 0, 1]]))
    alone = replace(held, excitation=systems.excitation(0.15, [0.5], [0.0]), start=systems.at_rest(1, 1))
    with np.errstate(all="ignore"):
        curve, expected = (hbm_curve(own, 0.15, 0.16, scheme=Scheme(5, 128)) for own in (model, alone))
    if constant:
        assert curve.ending is Ending.START
        return
    assert curve.complete
    omega = TURN * curve.frequency[-1]
    assert curve.amplitude[-1, 0, 0] == pytest.approx(force / np.hypot(omega**2, damping * omega), abs=1e-12)
    assert curve.amplitude[-1, 0, 2] == pytest.approx(expected.amplitude[-1, 0, 2], rel=1e-9)
    assert 0 < curve.separation_share[-1, 0] < 1
    assert curve.stable[-1] == expected.stable[-1]


@pytest.mark.parametrize("constant", [pytest.param(0.0, marks=pytest.mark.slow), 0.1])
def test_a_free_mass_that_friction_alone_holds(constant, monkeypatch):
    """While it slips its mean is free; one harmonic of it in closed form, as in `configs/one_slider.yaml` with k = 0.

    A constant force drives it away, however small it is.
    """
    monkeypatch.setattr(first_guess, "_settled", lambda *_: ("time integration", None))
    limit, stiffness, force = 0.5, 1.0, 1.0
    body, load = systems.structure([0.0], [0.0], [[1, 0, 0]]), systems.excitation(0.1, [force], [0.0], [constant])
    model = Model(body, (systems.pad(0.5, stiffness, 0.0, limit / 0.5),), load, systems.at_rest(1, 1))
    with np.errstate(all="ignore"):
        curve = hbm_curve(model, 0.1, 0.3, scheme=Scheme(1, 4096))
    if constant:
        assert curve.ending is Ending.START
        return
    assert curve.complete
    assert curve.stable.all()
    amplitude, elastic = curve.amplitude[:, 0, 0], limit / stiffness
    slips = amplitude > 1.01 * elastic
    assert slips.any()
    assert not slips.all()
    height = amplitude[slips]
    turn = np.arccos(1 - 2 * elastic / height)
    storing, losing = turn - np.sin(2 * turn) / 2, 4 * elastic * (height - elastic) / height**2
    dynamic = stiffness / np.pi * (storing + 1j * losing) - (TURN * curve.frequency[slips]) ** 2
    np.testing.assert_allclose(np.abs(dynamic) * height, force, rtol=1e-5)


def test_an_undamped_mode_at_its_natural_frequency():
    """The contact holds it: the curve that begins there is the limit of a hardly damped one."""
    model, values = systems.inclined(1.2), []
    for damping in (0.0, 1e-9, 1e-5):
        still = replace(model, structure=replace(model.structure, damping=np.array([damping])))
        values.append(hbm_curve(still, 1.0 / TURN, 1.05 / TURN, scheme=Scheme(3, 256)))
    assert all(v.complete for v in values)
    for value in values[:2]:
        np.testing.assert_allclose(value.amplitude[-1], values[2].amplitude[-1], rtol=1e-4)


def oscillating_free(stiffness):
    model = systems.inclined(1.2)
    body = model.structure
    return replace(model, structure=replace(body, frequency=np.array([np.sqrt(stiffness) / TURN])))


@pytest.fixture(scope="module")
def circle():
    return hbm_curve(systems.circular(0.5, 1.0), 0.8 / TURN, 1.5 / TURN, scheme=Scheme(1, 256))


@pytest.mark.parametrize("omega", [0.8, 1.0, 1.1, 1.2, 1.3, 1.5])
def test_circular_motion_is_exact_but_for_the_samples(circle, omega):
    assert circle.complete
    point = solutions_at(systems.circular(0.5, 1.0), circle, omega / TURN, scheme=Scheme(1, 256))
    radius = systems.circular_radius(0.5, omega)
    np.testing.assert_allclose(point.amplitude[0, 0, :2], radius, rtol=1e-6)
    assert point.slip_share[0, 0] == pytest.approx(1)
    assert point.stable[0]
    assert point.closure[0] <= 1


@pytest.fixture(scope="module")
def fine():
    return Scheme(15, 512)


def test_jenkins_element(fine):
    curve = hbm_curve(systems.jenkins(1.2), 0.8 / TURN, 1.4 / TURN, scheme=fine, stability=False)
    reference = {0.8: 0.435696, 1.0: 6.210084, 1.1: 2.344364, 1.2: 1.360174, 1.3: 0.965336, 1.4: 0.745879}
    for omega, amplitude in reference.items():
        point = solutions_at(systems.jenkins(1.2), curve, omega / TURN, scheme=fine)
        assert point.amplitude[0, 0, 0] == pytest.approx(amplitude, rel=2e-6, abs=5e-7)
        assert point.slip_share[0, 0] > 0.3


@pytest.fixture(scope="module")
def jump(fine):
    return hbm_curve(systems.inclined(1.2), 1.2 / TURN, 1.4 / TURN, scheme=fine)


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
    points = solutions_at(systems.inclined(1.2), jump, omega / TURN, scheme=fine)
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
    curve = hbm_curve(model, omega / TURN, 1.01 * omega / TURN, scheme=Scheme(8, 256), stability=False)
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
    model, scheme = systems.oscillator(preload, 1.0), Scheme(9, 256)
    curve = hbm_curve(model, *span, scheme=scheme)
    assert curve.complete
    np.testing.assert_allclose(np.sort(curve.frequency[curve.fold]), np.sort(folds), atol=1e-4)
    points = solutions_at(model, curve, at, scheme=scheme)
    np.testing.assert_allclose(np.sort(points.amplitude[points.stable, 0, 0]), np.sort(amplitudes), atol=1e-4)
    assert points.stable.sum() == 2
    assert points.stable.size == 3


@pytest.mark.parametrize("size", [1e2, 1e4])
def test_folds_are_found_beside_whatever_a_constant_force_or_a_start_moves(size):
    """A stop, and a constant force that moves the body along it, or a start: neither has to do with its waves."""
    model, curves = systems.oscillator(-4.0, 1.0), []
    stop = replace(model.contacts[0], friction=0.0, tangential_stiffness=np.zeros((2, 2)))
    along = model.structure.stiffness * np.array([0.6, -0.8])
    for force, start in ((0.0, 0.0), (size, 0.0), (0.0, 1e3 * size)):
        load = replace(model.excitation, constant=force * along)
        begin = replace(model.start, displacement=np.full(2, start))
        own = replace(model, contacts=(stop,), excitation=load, start=begin)
        curves.append(hbm_curve(own, 0.92, 0.96, scheme=Scheme(5, 256), stability=False))
    plain, *others = curves
    assert plain.complete
    assert plain.fold.sum() == 2
    for curve in others:
        np.testing.assert_allclose(curve.frequency, plain.frequency, rtol=1e-6)
        np.testing.assert_allclose(curve.amplitude, plain.amplitude, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("preload", "frequency", "amplitude"),
    [
        (3.0, 1.39, 0.15612878),
        (-1.0, 0.97, 0.28839155),
        pytest.param(5.0, 1.52, 0.15680399, marks=pytest.mark.slow),
    ],
)
def test_harmonics_lead_to_the_settled_response(preload, frequency, amplitude):
    model, errors = systems.oscillator(preload, frequency), []
    for harmonics in (1, 5, 15):
        curve = hbm_curve(model, frequency, 1.001 * frequency, scheme=Scheme(harmonics, 256), stability=False)
        assert curve.slip_share[0, 0] > 0.05
        errors.append(abs(curve.amplitude[0, 0, 0] / amplitude - 1))
    assert errors[0] > 1e-3
    assert errors[1] < errors[0] / 3
    assert errors[2] < min(errors[1], 2e-4)


def test_start_from_a_given_motion():
    """The upper solution at 0.947 Hz, which neither linear response leads to."""
    model, scheme = systems.oscillator(-4.0, 1.0), Scheme(5, 512)
    full = hbm_curve(model, 1.0, 0.92, scheme=scheme, stability=False)
    upper = solutions_at(model, full, 0.947, scheme=scheme)
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
    for ends, place in (((0.947, 0.946), 0), ((0.96, 0.947), 0), ((0.92, 0.96), None)):
        curve = hbm_curve(model, *ends, scheme=scheme, guess=guess, begin=0.947, stability=False)
        place = int(np.argmin(np.abs(curve.frequency - 0.947) + ~curve.stable)) if place is None else place
        assert curve.frequency[place] == pytest.approx(0.947, rel=1e-9)
        assert curve.amplitude[place, 0, 0] == pytest.approx(upper.amplitude[best, 0, 0], rel=1e-7)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: Scheme(harmonics=0), "harmonics must be at least 1, not 0"),
        (lambda: Scheme(harmonics=9, time_samples=20), "time_samples must be at least 36 for 9 harmonics, not 20"),
        (lambda: hbm_curve(systems.oscillator(3.0, 1.0), 0.0, 1.0), "frequency.from must be a positive number"),
        (lambda: hbm_curve(systems.oscillator(3.0, 1.0), 1.0, 1.0), "must differ, not both 1.0"),
        (lambda: Balance(silent(), 1.0, Scheme()), "moves no mode periodically"),
        (lambda: Balance(replace(silent(), contacts=()), 1.0, Scheme()), "contacts must hold at least one contact"),
        (
            lambda: Balance(third_harmonic(), 1.0, Scheme(2, 64)),
            "harmonics must be at least 3, since harmonic 3 is excited, not 2",
        ),
        (
            lambda: unknowns_of_modes(Balance(systems.oscillator(3.0, 1.0), 1.0, Scheme(2, 64)), np.zeros((4, 2))),
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
    curve = hbm_curve(systems.circular(0.5, 1.0), 0.8 / TURN, 1.5 / TURN, scheme=Scheme(1, 256), controls=controls)
    assert not curve.complete
    assert curve.frequency.size == 5
    assert f"{curve.frequency[-1]:.10g}" in curve.message
    assert "max_points" in curve.message


@pytest.mark.slow
def test_no_start_gives_an_empty_curve_with_the_reason():
    """Without damping at the natural frequency of a structure that nothing touches there is no periodic response."""
    model = systems.den_hartog(1.0, 0.0, 0.0)
    body = Structure(model.structure.frequency, np.ones(1), np.zeros(1), ("tip",), model.structure.shape)
    apart = replace(model, structure=body, contacts=(systems.pad(0.3, 1.0, 1.0, -1e9),))
    with np.errstate(all="ignore"):
        curve = hbm_curve(apart, 1.0 / TURN, 1.2 / TURN, scheme=Scheme(1, 64))
    assert curve.frequency.size == 0
    assert not curve.complete
    assert "no solution at the start" in curve.message


def test_whatever_the_contact_does_first_all_is_compiled_before_a_curve_is_followed():
    """At 0.8 Hz it sticks all along, at 1.26 Hz it slips."""
    model, scheme = systems.oscillator(2.0, 1.0), Scheme(5, 256)
    assert hbm_curve(model, 0.8, 0.801, scheme=scheme).slip_share[0, 0] == 0
    for programs in LOADED:
        programs.clear()
    compile_slopes(Balance(model, 0.8, scheme).law)
    slopes = [programs for programs in LOADED if programs]
    assert [len(programs) for programs in slopes] == [1, 1]
    warm_up(model, 0.8, scheme)
    assert [len(programs) for programs in slopes] == [1, 1]  # those that a curve takes
    ready = [len(programs) for programs in LOADED]
    curve = hbm_curve(model, 1.26, 1.27, scheme=scheme)
    assert curve.complete
    assert curve.slip_share.min() > 0.05
    assert [len(programs) for programs in LOADED] == ready


def test_a_load_that_grows_while_damping_leaves_leads_where_linear_responses_do_not():
    """Under a load that grows alone the motion turns at folds; no step got beyond 99 % of it.

    What limits steps along the frequency does not limit those of the load.
    """
    frequency, scheme = 1.26, Scheme(5, 256)
    model = systems.oscillator(2.0, frequency)
    balance = Balance(model, frequency, scheme)
    *linear, (way, guess), _ = first_guesses(balance, frequency, Controls(longest=lambda *_: 1e-6))
    assert all(given is not None and solve(balance, given, frequency, Controls()) is None for _, given in linear)
    assert way == "a load that grows from zero while damping leaves, 100% of the way"
    assert np.linalg.norm(balance.value(guess, frequency)) < 1e-8 * np.linalg.norm(guess)


def test_the_derivative_along_a_load_that_grows_while_damping_leaves():
    """By a difference quotient, of modal damping and of a matrix; at its ends there is no load, and all of it."""
    model = systems.oscillator(2.0, 1.26)
    whole = replace(model.structure, damping=np.array([[0.3, 0.1], [0.1, 0.4]]))
    for own in (model, replace(model, structure=whole)):
        balance = Balance(own, 1.26, Scheme(3, 256))
        ramp, x = first_guess._Ramp(balance, 1.26), 0.3 * balance.working
        np.testing.assert_allclose(ramp.value(x, 1.0), balance.value(x, 1.26), rtol=1e-12)
        assert np.linalg.norm(ramp.value(0 * x, 0.0)) < 1e-12
        r, _, by_p = ramp.linearised(x, 0.4)
        np.testing.assert_array_equal(r, ramp.value(x, 0.4))
        step = 1e-5
        by_difference = (ramp.value(x, 0.4 + step) - ramp.value(x, 0.4 - step)) / (2 * step)
        np.testing.assert_allclose(by_p, by_difference, atol=1e-5 * np.abs(by_difference).max())


def test_time_integration_leads_to_the_first_solution():
    """Near enough for Newton's method where the contact slips and separates, also of a motion that has not settled."""
    model = systems.oscillator(-1.0, 0.97)
    balance = Balance(model, 0.97, Scheme(5, 256))
    known = hbm_curve(model, 0.97, 1.0, scheme=Scheme(5, 256))
    assert known.slip_share[0, 0] > 0.05
    assert known.separation_share[0, 0] > 0.05
    *others, (way, guess) = first_guesses(balance, 0.97, Controls())
    assert way == "time integration, which settles"
    assert guess is not None
    solution = solve(balance, guess, 0.97, Controls())
    assert solution is not None
    assert np.linalg.norm(solution[0] - guess) < 0.02 * np.linalg.norm(guess)
    motion = balance.coefficients(solution[0])[0] * balance.length
    np.testing.assert_allclose(motion, known.contact_motion[0, 0], atol=1e-6)
    assert others[-1][0] == "a load that grows from zero while damping leaves, 100% of the way"
