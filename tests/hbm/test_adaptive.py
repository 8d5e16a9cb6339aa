"""Harmonics that follow the solution along a curve, and what is said of those that are left out."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import systems

from timesim.hbm import adaptive, first_guess
from timesim.hbm.adaptive import AdaptiveBalance, tail
from timesim.hbm.balance import Balance
from timesim.hbm.branches import solutions_at
from timesim.hbm.continuation import Bordered, Controls, Curve, Ending, Nearby
from timesim.hbm.continuation.bordered import STEEPEST
from timesim.hbm.convergence import neglected
from timesim.hbm.curve import by_schemes, evaluated, hbm_curve
from timesim.hbm.scheme import NEGLECTED, Scheme, coarsest, finer_schemes
from timesim.model.model import GROUND, Contact, Excitation, Model, Structure

pytestmark = pytest.mark.long

SCHEMES = [Scheme(harmonics, 256) for harmonics in (3, 7, 11, 15)]
FINE = Scheme(25, 256)


@pytest.fixture(scope="module")
def model():
    return systems.oscillator(10.0, 1.5)


@pytest.fixture(scope="module")
def curve(model):
    """Through the peak, where the contact slips, from full stick to full stick."""
    return hbm_curve(model, 1.5, 1.75, scheme=SCHEMES, stability=False)


def used(curve):
    """The highest harmonic of each solution."""
    return np.array([np.flatnonzero(own.any(axis=(1, 2)))[-1] for own in curve.harmonic_amplitude])


def test_harmonics_come_and_go_along_a_curve(curve):
    count = used(curve)
    assert curve.complete, curve.message
    assert count[0] <= 3
    assert count[-1] <= 3
    assert count.max() > 3
    assert set(count) <= {1, *(scheme.harmonics for scheme in SCHEMES)}
    assert curve.harmonic_cos.shape[1] == count.max() + 1


def test_solutions_by_several_schemes_keep_their_order_and_branches(model):
    """Folds count along the whole curve, whichever harmonics the solutions before have."""
    balance = AdaptiveBalance(lambda own: Balance(model, 1.6, own), SCHEMES, 1)
    rows = []
    for i, (highest, fold) in enumerate([(1, False), (7, True), (3, False), (1, True), (15, False)]):
        x = np.zeros(balance.shape)
        x[0, 2 * highest] = 1e-3
        rows.append((x.ravel(), 1.6 + i / 100, fold, 0))
    curve = Curve.of(rows, np.prod(balance.shape), Ending.COMPLETE, "")
    whole = by_schemes(balance, curve, partial(evaluated, stability=False))
    np.testing.assert_allclose(whole.frequency, 1.6 + np.arange(5) / 100)
    assert whole.fold.tolist() == [False, True, False, True, False]
    assert whole.branch.tolist() == [0, 0, 1, 1, 2]
    waves = np.abs(whole.contact_motion[:, 0, 0])
    assert np.argmax(waves, axis=1).tolist() == [2, 14, 6, 2, 30]


def test_the_motion_is_that_of_many_harmonics(curve, model):
    # Where slip just begins several solutions lie within 1e-8 Hz, and other harmonics may have none there.
    rows = np.flatnonzero(curve.slip_share[:, 0] > 1e-3)[::4]
    fine = solutions_at(
        model, curve.with_harmonics(FINE.harmonics), curve.frequency[rows], scheme=FINE, stability=False
    )
    np.testing.assert_allclose(fine.amplitude, curve.amplitude[rows], rtol=0, atol=NEGLECTED * fine.amplitude.max())


@pytest.mark.parametrize(("preload", "frequency"), [(3.0, 1.39), (-1.0, 0.97)])
def test_the_tail_says_what_few_harmonics_leave_out(preload, frequency):
    """Within a factor of three of the harmonics that a solution with many of them has."""
    model, few = systems.oscillator(preload, frequency), Scheme(3, 256)
    curve = hbm_curve(model, frequency, 1.001 * frequency, scheme=few, stability=False)
    assert curve.slip_share[0, 0] > 0.05
    balance = Balance(model, frequency, few)
    expected = tail(balance, curve.contact_motion[0].ravel() / balance.length, frequency)
    fine = solutions_at(model, curve.with_harmonics(FINE.harmonics), frequency, scheme=FINE, stability=False)
    size = fine.harmonic_amplitude[0].max(axis=(1, 2))
    assert neglected(lambda _: model, curve, [few]) >= expected[3] > expected[4]
    for order in (3, 5, 8):
        left = np.sqrt(np.sum(size[order + 1 :] ** 2)) / size[1]
        assert left / 3 < expected[order] < 3 * left


def lightly_damped(preload: float, frequency: float) -> Model:
    """The oscillator with a damping of 0.5 %."""
    model = systems.oscillator(preload, frequency)
    return replace(model, structure=replace(model.structure, damping=model.structure.damping / 4))


def beside(balance: Balance, x: np.ndarray, frequency: float) -> Nearby:
    """Solutions next to one, the derivatives those at the solution."""
    _, by_x, by_p = balance.linearised(x, frequency)
    size = float(np.linalg.norm(x))
    plane = np.append(np.zeros(x.size), 1.0)
    return Nearby(Bordered(by_x, by_p * (frequency / size), plane), size, frequency, frequency)


@pytest.mark.parametrize(("preload", "frequency"), [(3.0, 1.39), (-1.0, 0.97), (1.0, 1.2)])
@pytest.mark.parametrize("order", [3, 5])
def test_what_harmonics_change_below_them_is_known(preload, frequency, order):
    model, few = lightly_damped(preload, frequency), Scheme(order, 256)
    curve = hbm_curve(model, frequency, 1.001 * frequency, scheme=few, stability=False)
    balance = Balance(model, frequency, few)
    x = curve.contact_motion[0].ravel() / balance.length
    above = adaptive._Above.of(balance, x, frequency)
    fine = solutions_at(model, curve.with_harmonics(FINE.harmonics), frequency, scheme=FINE, stability=False)
    size = curve.harmonic_amplitude[0]
    rise = fine.harmonic_amplitude[0, 1 : order + 1] - size[1:]
    expected = np.sqrt(np.sum(rise**2, axis=0)).max() / size[1:].max()
    assert expected > 1e-4
    assert above.below(balance, x, beside(balance, x, frequency)) == pytest.approx(expected, rel=0.1)


def test_what_harmonics_change_below_them_does_not_depend_on_the_masses_of_the_modes():
    model, few, mass = lightly_damped(3.0, 1.39), Scheme(3, 256), np.array([4.0, 0.3])
    body, load, root = model.structure, model.excitation, np.sqrt(mass)
    heavy = replace(
        model,
        structure=replace(body, mass=mass, damping=body.damping * mass, shape=body.shape * root),
        excitation=replace(load, cosine=load.cosine * root, sine=load.sine * root),
    )
    motion = hbm_curve(model, 1.39, 1.001 * 1.39, scheme=few, stability=False).contact_motion[0].ravel()
    changes = []
    for own in (model, heavy):
        balance = Balance(own, 1.39, few)
        x = motion / balance.length
        changes.append(adaptive._Above.of(balance, x, 1.39).below(balance, x, beside(balance, x, 1.39)))
    assert changes[1] == pytest.approx(changes[0], rel=1e-6)


def test_what_harmonics_change_below_them_is_left_out_too():
    """Their own size is what may be left out; with what they change it is more."""
    model, few = lightly_damped(3.0, 1.39), Scheme(7, 256)
    curve = hbm_curve(model, 1.39, 1.001 * 1.39, scheme=few, stability=False)
    own = Balance(model, 1.39, few)
    assert tail(own, curve.contact_motion[0].ravel() / own.length, 1.39)[7] < NEGLECTED
    assert neglected(lambda _: model, curve, [few]) > NEGLECTED


def test_near_a_fold_solutions_of_other_equations_are_those_across_the_curve():
    """Of x^2 = p - r that at the same p is sqrt(p - r), unless it is far steeper there than at any resonance."""
    for x, change in ((1.0, -0.5e-6), (-1.0, 0.5e-6), (1e-3, None)):
        factors = Bordered(np.array([[2 * x]]), np.array([-1.0]), np.array([0.0, 1.0]))
        found = Nearby(factors, 1.0, 1.0, 1.0).change(np.array([1e-6]))[0]
        if change is not None:
            assert found == pytest.approx(change, rel=1e-6)
        else:
            assert abs(found) == pytest.approx(1e-6 / STEEPEST, rel=0.05)


def test_the_tail_is_relative_to_the_largest_wave():
    """Not to the mean, which a constant force may make as large as it likes."""
    np.testing.assert_allclose(adaptive._above(np.array([50.0, 4.0, 3.0, 0.0, 4.0])), [41**0.5 / 4, 1.25, 1, 1, 0])


def test_the_tail_does_not_depend_on_how_the_structure_is_given(curve, model):
    """Nor on the masses of its modes; where damping is a matrix it is supported at its contacts, whose forces go."""
    body, load, mass = model.structure, model.excitation, np.array([4.0, 0.3])
    root = np.sqrt(mass)
    heavy = replace(body, mass=mass, damping=body.damping * mass, shape=body.shape * root)
    others = (
        replace(model, structure=replace(body, damping=np.diag(body.damping))),
        replace(model, structure=heavy, excitation=replace(load, cosine=load.cosine * root, sine=load.sine * root)),
    )
    order, row = used(curve).max(), np.argmax(curve.slip_share[:, 0])
    assert used(curve)[row] == order
    tails = []
    for own in (model, *others):
        balance = Balance(own, 1.5, Scheme(order, 256))
        tails.append(tail(balance, curve.contact_motion[row].ravel() / balance.length, curve.frequency[row])[order:])
    assert tails[0][0] > 1e-6
    for other in tails[1:]:
        np.testing.assert_allclose(other[:20], tails[0][:20], rtol=1e-6)


def resounding(stiffness: float, frequency: float) -> Model:
    """The oscillator with a hub, of one more mode, whose contact sticks: so it resounds to higher harmonics."""
    model = systems.oscillator(0.5, frequency)
    body, load, none = model.structure, model.excitation, np.zeros((1, 1))
    hub_shape = np.array([[[0.8, 0.3], [0.5, -0.6], [0.2, 0.4]]])
    third = np.array([[0.7, -0.5, 0.3], [-0.9, 0.6, 0.5]])
    shape = np.concatenate([np.concatenate([body.shape, hub_shape]), third[:, :, None]], axis=2)
    structure = Structure(
        np.append(body.frequency, 3.1),
        np.ones(3),
        np.append(body.damping, 0.04 * 2 * np.pi * 3.1),
        ("tip", "hub"),
        shape,
    )
    pad, stiff = model.contacts[0], stiffness * np.eye(2)
    hub = replace(
        pad, name="hub", point="hub", preload=1e3, tangential_stiffness=stiff, normal_stiffness=float(stiffness)
    )
    waves = (np.append(3 * own, none, axis=1) for own in (load.cosine, load.sine))
    force = Excitation(frequency, load.harmonic, *waves, np.zeros(3))
    return Model(structure, (pad, hub), force, systems.at_rest(3, 2))


@pytest.mark.parametrize(("stiffness", "frequency", "order"), [(300.0, 0.6, 3), (600.0, 0.45, 5)])
def test_the_tail_knows_how_stiff_contacts_are_that_stick(stiffness, frequency, order):
    """The harmonics that resound with the stuck structure, which are up to six times as large as without contacts."""
    model, few = resounding(stiffness, frequency), Scheme(3, 256)
    curve = hbm_curve(model, frequency, 1.001 * frequency, scheme=few, stability=False)
    assert curve.slip_share[0, 0] > 0.2
    assert curve.slip_share[0, 1] == 0
    balance = Balance(model, frequency, few)
    expected = tail(balance, curve.contact_motion[0].ravel() / balance.length, frequency)
    fine = solutions_at(model, curve.with_harmonics(FINE.harmonics), frequency, scheme=FINE, stability=False)
    size = fine.harmonic_amplitude[0].max(axis=(1, 2))
    left = np.sqrt(np.sum(size[order + 1 :] ** 2)) / size[1]
    assert left / 2.5 < expected[order] < 2.5 * left


def test_the_coarsest_scheme_of_a_motion_has_all_its_harmonics():
    motion = np.zeros((2, 3, 31))
    assert coarsest(SCHEMES, motion) == 0
    for place, scheme in enumerate(SCHEMES[:-1]):
        motion[1, 2, 2 * scheme.harmonics] = 1.0  # the sine of the highest
        assert coarsest(SCHEMES, motion) == place
        motion[0, 1, 2 * scheme.harmonics + 1] = 1.0  # the cosine of the next
        assert coarsest(SCHEMES, motion) == place + 1


def test_a_scheme_in_words():
    assert str(Scheme(1, 64)) == "harmonic balance, 1 harmonic, 64 time samples"
    assert str(Scheme(9, 256)) == "harmonic balance, 9 harmonics, 256 time samples"


def test_harmonics_are_added_one_scheme_after_the_other(model, monkeypatch):
    """From a solution with few harmonics, one with many is out of reach of Newton's method where contacts are stiff."""
    balance = AdaptiveBalance(lambda own: Balance(model, 1.6, own), SCHEMES, 1)
    monkeypatch.setattr(adaptive, "tail", lambda own, x, frequency: np.ones(65))
    places = []
    while balance.adapt(balance.whole(np.zeros(balance.residual.num_unknowns), balance.place), 1.6):
        places.append(balance.place)
    assert places == [1, 2, 3]


def with_tail_up_to(order, size, monkeypatch):
    """Solutions whose harmonics add much up to an order, and nothing above it."""
    monkeypatch.setattr(adaptive, "tail", lambda own, x, frequency: np.where(np.arange(65) < order, size, 0.0))


def test_a_scheme_is_kept_where_a_coarser_one_would_leave_out_too_much(model, monkeypatch):
    """Not left because it leaves out nothing itself."""
    balance, places = AdaptiveBalance(lambda own: Balance(model, 1.6, own), SCHEMES, 1), []
    with_tail_up_to(7, 0.1, monkeypatch)
    for _ in range(4):
        balance.adapt(balance.whole(np.zeros(balance.residual.num_unknowns), balance.place), 1.6)
        places.append(balance.place)
    assert places == [1, 1, 1, 1]


def test_no_curve_is_to_begin_where_harmonics_above_its_own_add_much(model, monkeypatch):
    """Whatever is above those of the finest scheme."""
    balance = AdaptiveBalance(lambda own: Balance(model, 1.6, own), SCHEMES, 1)
    with_tail_up_to(7, 0.1, monkeypatch)
    for demanding, place, refused in ((True, 0, True), (True, 1, False), (False, 0, False)):
        balance.demanding, balance.refused, balance.place = demanding, False, place
        assert balance.refuses(np.zeros(np.prod(balance.shape)), 1.6) == refused


def test_the_largest_displacement_is_that_of_all_points_and_harmonics():
    """Of a structure that sticks and is driven at twice the frequency, with a point that moves the most."""
    model = systems.oscillator(64.0, 0.7)
    shape = np.concatenate([model.structure.shape * times for times in (1, 3)])
    body = replace(model.structure, points=("tip", "top"), shape=shape)
    model = replace(model, structure=body, excitation=replace(model.excitation, harmonic=np.array([2])))
    pad, root, turn = model.contacts[0], model.contact_shape[0], 4 * np.pi * 0.7
    spring = root[:2].T @ pad.tangential_stiffness @ root[:2] + pad.normal_stiffness * np.outer(root[2], root[2])
    modes = np.linalg.solve(
        np.diag(body.omega**2 - turn**2 + 1j * turn * body.damping) + spring, model.excitation.cosine[0]
    )
    balance = AdaptiveBalance(lambda own: Balance(model, 0.7, own), [Scheme(3, 64)], 1)
    _, guess = next(first_guess.first_guesses(balance.residual, 0.7, Controls()))
    forces, largest = balance.driven(guess, 0.7)
    assert forces.shape == (3, 2)
    assert largest == pytest.approx(np.abs(shape @ modes).max(), rel=1e-9)


def test_a_finer_scheme_is_the_least_until_it_is_given_back(model, monkeypatch):
    balance = AdaptiveBalance(lambda own: Balance(model, 1.6, own), SCHEMES, 1)
    monkeypatch.setattr(adaptive, "tail", lambda own, x, frequency: np.zeros(65))

    def adapted():
        return balance.adapt(balance.whole(np.zeros(balance.residual.num_unknowns), balance.place), 1.6)

    assert balance.refine()
    assert not adapted()
    assert [balance.refine(), balance.refine(), balance.refine()] == [True, True, False]
    balance.restore()
    balance.restore()
    assert balance.place == 1
    assert not adapted()
    assert balance.refine()
    balance.restore()
    assert balance.place == 1
    balance.begin(np.zeros(np.prod(balance.shape)))
    balance.place = 2
    assert balance.refine()
    balance.restore()
    assert adapted()
    assert balance.place == 1
    assert adapted()
    assert balance.place == 0


def test_a_finer_scheme_is_left_again_behind_a_fold(model, monkeypatch):
    balance = AdaptiveBalance(lambda own: Balance(model, 1.6, own), SCHEMES, 1)
    monkeypatch.setattr(adaptive, "tail", lambda own, x, frequency: np.zeros(65))
    assert balance.refine()
    places = []
    for _ in range(adaptive.HELD + 1):
        balance.adapt(balance.whole(np.zeros(balance.residual.num_unknowns), balance.place), 1.6)
        places.append(balance.place)
    assert places == [1] * adaptive.HELD + [0]


def rattling():
    """A contact so stiff that it rings 19 times a cycle."""
    frequency, mass = np.array([85.0, 174.0, 324.0]), np.array([0.1443, 0.5948, 0.3973])
    damping = 4 * np.pi * frequency * mass * [0.00618, 0.00724, 0.00597]
    touching = np.array([[-0.954, 0.22, 0.542], [-0.851, -0.0366, -0.155], [1.19, 0.701, -0.31]])
    pushed = np.array([[-0.13, -1.39, -1.57], [-0.96, 0.564, 0.0688], [-0.361, -0.116, 0.0612]])
    force, normal = np.array([0.535, -0.0332, 1.41]), np.array([0.0, 0.3, 1.0]) / np.hypot(0.3, 1.0)
    ahead, phase = 9.0 * force @ pushed / np.linalg.norm(force), np.deg2rad(70.0)
    body = Structure(frequency, mass, damping, ("t",), touching[None])
    frame = np.array([[1.0, 0.0, 0.0], np.cross(normal, [1.0, 0.0, 0.0]), normal])
    contact = Contact("c", "t", GROUND, frame, 0.2, 4.564e6 * np.eye(2), 1.141e7, 6.0)
    load = systems.excitation(100.0, ahead + 5 * np.cos(phase) * touching[2], -5 * np.sin(phase) * touching[2])
    return Model(body, (contact,), load, systems.at_rest(3, 1))


@pytest.mark.slow
def test_no_curve_begins_at_a_solution_that_more_harmonics_do_not_have():
    """13 harmonics have one of more than twice the amplitude; the other is that of a time integration."""
    schemes = finer_schemes(Scheme(9, 256), rattling(), choose_samples=True)
    assert schemes[-1].harmonics == 81
    curve = hbm_curve(rattling(), 100.0, 100.4, scheme=schemes, controls=Controls(max_points=2))
    assert curve.stable.all()
    assert curve.amplitude[0].max() == pytest.approx(7.2466e-6, rel=1e-3)


def test_a_guess_that_is_refused_is_the_last_resort(model, monkeypatch):
    balance, guesses = AdaptiveBalance(lambda own: Balance(model, 1.6, own), SCHEMES, 1), []
    first = np.zeros(balance.residual.num_unknowns)
    monkeypatch.setattr(first_guess, "first_guesses", lambda *_: iter([("one", first), ("none", None), ("two", first)]))

    def followed(guess):
        guesses.append(balance.demanding)
        balance.refused = balance.demanding and len(guesses) == 1
        ending = Ending.START if balance.demanding else Ending.COMPLETE
        return Curve.of([], guess.size, ending, "")

    assert first_guess.curve_near(balance, 1.6, 1.6, Controls(), None, followed).complete
    assert guesses == [True, True, False]


@pytest.mark.parametrize("second", [Ending.COMPLETE, Ending.STEP])
def test_a_guess_from_which_the_curve_does_not_go_on_is_not_the_last(model, second, monkeypatch):
    """With few harmonics there may be a solution on no curve; it stays only where no guess leads further."""
    balance = AdaptiveBalance(lambda own: Balance(model, 1.6, own), SCHEMES, 1)
    first = np.zeros(balance.residual.num_unknowns)
    monkeypatch.setattr(first_guess, "first_guesses", lambda *_: iter([("one", first), ("two", first)]))
    endings = iter([Ending.STEP, second])

    def followed(guess):
        ending = next(endings)
        return Curve.of([(guess, 1.6, False, 1)], guess.size, ending, ending.name)

    curve = first_guess.curve_near(balance, 1.6, 1.6, Controls(), None, followed)
    assert curve.ending is second
    assert curve.message == ("COMPLETE" if second is Ending.COMPLETE else "STEP; tried: one, two")
