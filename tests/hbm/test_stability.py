"""Floquet multipliers of solutions by harmonic balance, against closed forms and the return map of time integration."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import systems
from scipy.optimize import linear_sum_assignment
from simulation import FINE, after_a_cycle

from timesim.hbm.balance import Balance
from timesim.hbm.continuation import Controls, Ending, solve
from timesim.hbm.curve import hbm_curve
from timesim.hbm.scheme import Scheme
from timesim.hbm.stability import floquet_multipliers, multipliers
from timesim.hbm.stability.offset import sign_with_offsets_kept
from timesim.model.held import springs
from timesim.model.model import GROUND, Contact, Model
from timesim.model.solver import PRESETS, Criterion
from timesim.orbit.settling import Chain, first_lane, steady_states

pytestmark = pytest.mark.long

MULTIPLIERS = "timesim.hbm.curve.evaluation.checked_multipliers"


@pytest.mark.parametrize(("share", "full"), [(None, False), (0.9, False), (None, True)])
def test_multipliers_of_a_stuck_structure(share, full):
    """Exponentials of the eigenvalues, and two that are 1 for the slip that nothing moves."""
    model, frequency = systems.oscillator(32.0, 1.0) if share is None else coupled(32.0, 1.0, share), 1.2
    if full:
        whole = np.array([[20.0, 9.0], [9.0, 14.0]])
        model = replace(model, contacts=(replace(model.contacts[0], tangential_stiffness=whole),))
    balance = Balance(model, frequency, Scheme(1, 64))
    solution = solve(balance, np.zeros(9), frequency, Controls())
    assert solution is not None
    body, shape = model.structure, model.contact_shape[0]
    stiffness = np.diag(body.stiffness) + shape.T @ springs(model.contacts[0]) @ shape
    damping = np.diag(body.damping) if share is None else body.damping
    state = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping]])
    exact = np.append(np.exp(np.linalg.eigvals(state) / frequency), [1.0, 1.0])
    found = floquet_multipliers(balance, solution[0][None], np.array([frequency]), samples=1024)[0]
    np.testing.assert_allclose(paired(found, exact), exact, rtol=1e-4)


@pytest.mark.parametrize(
    ("preload", "frequency"),
    [
        (-1.0, 0.97),
        (1.0, 1.2),
        (5.0, 1.52),
        pytest.param(2.0, 1.3, marks=pytest.mark.slow),
        pytest.param(3.0, 1.39, marks=pytest.mark.slow),
    ],
)
def test_multipliers_against_those_of_the_return_map(preload, frequency):
    """Motions with slip or separation; the others are exact derivatives of the event loop."""
    model = systems.oscillator(preload, frequency)
    curve = hbm_curve(model, frequency, 1.001 * frequency, scheme=Scheme(15, 256))
    ((marched,),) = steady_states([Chain(model, (frequency,))], PRESETS["standard"], Criterion())
    assert marched.settled
    assert curve.slip_share[0, 0] > 0.05
    np.testing.assert_allclose(curve.amplitude[0], marched.amplitude, rtol=1e-3)
    exact = np.abs(marched.floquet[0])
    assert 0.5 < exact < 0.9
    assert curve.floquet_max[0] == pytest.approx(exact, abs=2e-3)
    balance = Balance(model, frequency, Scheme(15, 256))
    x = curve.contact_motion[:1].reshape(1, -1) / balance.length
    fine = np.abs(floquet_multipliers(balance, x, curve.frequency[:1], samples=1024)[0])
    np.testing.assert_allclose(fine[:4], np.abs(marched.floquet[:4]), atol=1e-4)


@pytest.mark.parametrize(("preload", "frequency"), [(-1.0, 0.97), (1.0, 1.2)])
def test_multipliers_are_of_second_order_in_the_samples_and_extrapolated(preload, frequency):
    """Also where the contact begins to slip, closes or opens between two of them."""
    balance, x, f = solved(systems.oscillator(preload, frequency), frequency, Scheme(9, 256))
    numbers = np.array([64, 128, 256, 512])
    exact = np.abs(floquet_multipliers(balance, x, f, samples=4096)[0, :4])
    plain = [np.abs(multipliers._by_samples(balance, x, f, int(n))[0]) for n in numbers]
    better = [np.abs(floquet_multipliers(balance, x, f, samples=int(n))[0, :4]) for n in numbers]
    errors = np.abs(np.sort(plain)[:, :-5:-1] - exact).max(axis=1)
    assert -np.polyfit(np.log(numbers), np.log(errors), 1)[0] > 1.7, errors
    assert (np.abs(better - exact).max(axis=1)[1:] < errors[1:] / 2).all()


@pytest.mark.parametrize(("ratio", "speed", "error"), [(100.0, 1.0, 5e-4), (1000.0, 0.98, 1e-2)])
def test_multipliers_of_a_motion_that_meets_a_stiff_stop(ratio, speed, error):
    """Those of the samples alone err by 3.2e-3 and 0.037."""
    balance, x, f = solved(systems.stopped_chain(ratio), speed / systems.TURN, Scheme(27, 432))
    exact = np.abs(floquet_multipliers(balance, x, f, samples=8192)[0, 0])
    assert exact > 1.5
    assert np.abs(floquet_multipliers(balance, x, f)[0, 0]) == pytest.approx(exact, abs=error)


def solved(model, frequency, scheme):
    """A balance, and a solution of it at about a frequency [Hz]."""
    curve = hbm_curve(model, frequency, 1.001 * frequency, scheme=scheme, controls=Controls(max_points=2))
    balance = Balance(model, frequency, scheme)
    return balance, curve.contact_motion[:1].reshape(1, -1) / balance.length, curve.frequency[:1]


def test_what_samples_tell_of_multipliers():
    """Real ones, complex pairs and those that are exact are extrapolated; some stay as they are.

    They are a mode that is faster than the samples, a pair that has just become complex, and what may grow or not.
    """
    turn = np.exp(1j * np.array([1, -1]))
    exact = np.concatenate([[0.7, -0.8, 1.0], 0.9 * turn, 1.2 * turn])
    error = np.concatenate([[0.01, 0.02, 0.0], 0.01 * np.exp(0.3j * np.array([1, -1])), [0.02, 0.02]])
    fine, coarse = exact * np.exp(error), exact * np.exp(4 * error)
    found, doubt = multipliers.extrapolated(fine, coarse[::-1], 2.0)
    np.testing.assert_allclose(found, exact, rtol=1e-12)
    assert not doubt.any()
    fast, pair, near = 0.99 * turn, [0.5 + 0.01j, 0.5 - 0.01j], [1.004]
    fine = np.concatenate([fast, pair, near])
    coarse = np.concatenate([0.99 * turn**2, [0.6, 0.4], [0.998]])
    found, doubt = multipliers.extrapolated(fine, coarse, 2.0)
    np.testing.assert_array_equal(found, fine)
    assert doubt.tolist() == [False] * 4 + [True]


def test_multipliers_of_fast_modes_that_take_each_others_place_are_not_in_doubt():
    """The nearest of those with fewer samples is another mode's; in order, their moduli are the same."""
    slow, fast = np.exp(1j * np.array([1, -1])), np.exp(2j * np.array([1, -1]))
    fine, coarse = np.concatenate([0.95 * fast, 0.5 * slow]), np.concatenate([0.95 * slow, 0.5 * fast])
    found, doubt = multipliers.extrapolated(fine, coarse, 2.0)
    np.testing.assert_array_equal(found, fine)
    assert not doubt.any()


def test_the_largest_multiplier_is_in_doubt_where_it_changes_much():
    """It is shown; others may change as much where they stay clear of 1."""
    fine, coarse = np.array([4.0, 0.2, 0.1], complex), np.array([3.7, 0.26, 0.1], complex)
    found, doubt = multipliers.extrapolated(fine, coarse, 2.0)
    assert doubt.tolist() == [True, False, False]
    np.testing.assert_allclose(found[0], fine[0] * (fine[0] / coarse[0]) ** (1 / 3))


@pytest.mark.parametrize("share", [0.0, 0.9])
def test_a_contact_however_stiff_makes_no_solution_unstable(share):
    """It vibrates many times between two samples, here with the modes coupled by the damping as well."""
    model = coupled(1e3, 1.0, share) if share else systems.oscillator(1e3, 1.0)
    stiff = replace(model.contacts[0], tangential_stiffness=1e8 * np.eye(2), normal_stiffness=1e8)
    curve = hbm_curve(replace(model, contacts=(stiff,)), 1.2, 1.3, scheme=Scheme(3, 64))
    assert curve.complete
    assert curve.slip_share.max() == curve.separation_share.max() == 0
    assert curve.stable.all()
    np.testing.assert_allclose(curve.floquet_max, 1.0, rtol=1e-9)


def coupled(preload, frequency, share=0.9):
    """The oscillator with its modes coupled by the damping; `share` of what makes the matrix singular."""
    model = systems.oscillator(preload, frequency)
    damping = np.diag(model.structure.damping)
    damping[0, 1] = damping[1, 0] = share * np.sqrt(np.prod(model.structure.damping))
    return replace(model, structure=replace(model.structure, damping=damping))


def return_map_multipliers(model, frequency, start):
    """Eigenvalues of the derivative of the state after a cycle by that before it, by central differences."""
    lane = first_lane(Chain(replace(model, start=start), (frequency,)), FINE)
    state = lane.vector
    step = 1e-5 * np.abs(state).max()
    lanes = [lane.moved(state + sign * step * e) for e in np.eye(state.size) for sign in (1, -1)]
    ends = after_a_cycle(lanes, FINE)
    return np.linalg.eigvals((ends[::2] - ends[1::2]).T / (2 * step))


def paired(found, expected):
    """The multipliers in the order of those expected."""
    rows, columns = linear_sum_assignment(np.abs(np.subtract.outer(expected, found)))
    assert rows.tolist() == list(range(len(expected)))
    return found[columns]


@pytest.mark.slow
@pytest.mark.parametrize(("preload", "frequency"), [(-1.0, 0.97), (2.0, 1.3), (3.0, 1.39)])
def test_modes_coupled_by_damping(preload, frequency):
    """Response and complex multipliers against time integration; without the coupling both are quite different."""
    model, scheme = coupled(preload, frequency), Scheme(15, 256)
    curve = hbm_curve(model, frequency, 1.001 * frequency, scheme=scheme)
    ((marched,),) = steady_states([Chain(model, (frequency,))], FINE, Criterion(tolerance=1e-11))
    assert curve.slip_share[0, 0] > 0.2
    np.testing.assert_allclose(curve.amplitude[0], marched.amplitude, rtol=5e-5)
    balance = Balance(model, frequency, scheme)
    x = curve.contact_motion[:1].reshape(1, -1) / balance.length
    found = floquet_multipliers(balance, x, curve.frequency[:1], samples=1024)[0]
    exact = return_map_multipliers(model, frequency, marched.end)
    np.testing.assert_allclose(paired(marched.floquet, exact), exact, atol=1e-5)
    np.testing.assert_allclose(paired(found, exact), exact, atol=2e-4)
    assert curve.floquet_max[0] == pytest.approx(np.abs(exact).max(), abs=3e-3)
    turn = np.degrees(np.abs(np.angle(exact[np.argmax(np.abs(exact))])))
    assert curve.floquet_phase_deg[0] == pytest.approx(turn, abs=0.3)

    plain = coupled(preload, frequency, 0.0)
    other = hbm_curve(plain, frequency, 1.001 * frequency, scheme=scheme)
    assert abs(other.amplitude[0, 0, 0] / curve.amplitude[0, 0, 0] - 1) > 0.1
    x = other.contact_motion[:1].reshape(1, -1) / balance.length
    loose = floquet_multipliers(Balance(plain, frequency, scheme), x, other.frequency[:1], samples=1024)[0]
    assert np.abs(paired(loose, exact) - exact).max() > 0.05


@pytest.mark.parametrize(
    ("stiffness", "gap", "static", "ratio", "force", "ends", "turns", "folds"),
    [
        ((1.5, 1.7), 0.2, 0.2, 0.02, 0.04, (0.285, 0.2825), [0.28339, 0.28390], [False, False]),
        ((1.5, 1.3), 0.2, 1.0, 0.035, 0.075, (0.292, 0.302), [], []),
        ((1.3, 2.3), 0.8, 1.1, 0.03, 0.09, (0.292, 0.3065), [0.29434, 0.29331, 0.30591], [True, False, False]),
    ],
)
def test_a_free_offset_turns_the_curve_and_is_not_what_makes_it_unstable(
    stiffness, gap, static, ratio, force, ends, turns, folds
):
    """A pad that sticks all along holds a mass at a stop with an offset that follows the motion.

    The curve goes back where nothing is unstable, and goes on where something is.
    """
    body = systems.structure([1.0], [2 * ratio], [[1.0, 0.0, 0.0]])
    pad = Contact("pad", "tip", GROUND, np.eye(3), 1.0, stiffness[0] * np.eye(2), 0.0, 1.0)
    stop = Contact("stop", "tip", GROUND, np.roll(np.eye(3), -1, axis=0), 0.0, np.zeros((2, 2)), stiffness[1], -gap)
    model = Model(body, (pad, stop), systems.excitation(1.0, [force], [0.0], [static]), systems.at_rest(1, 2))
    scheme = Scheme(5, 64)
    curve = hbm_curve(model, *ends, scheme=scheme, stability=False)
    f = curve.frequency
    assert curve.complete
    turning = f[1:-1][np.diff(f[1:]) * np.diff(f[:-1]) < 0]
    np.testing.assert_allclose(turning[: len(turns)], turns, atol=2e-5)
    assert np.isin(turning, f[curve.fold])[: len(turns)].tolist() == folds
    balance = Balance(model, ends[0], scheme)
    x = curve.contact_motion.reshape(f.size, -1) / balance.length
    found = floquet_multipliers(balance, x, f, samples=512)
    # Not the two of the pad, which are 1.
    largest = np.max(np.where((found.imag == 0) & (np.abs(found - 1) > 1e-9), found.real, 0.0), axis=1)
    clear = ~curve.fold & (np.abs(largest - 1) > 0.01)
    np.testing.assert_array_equal(curve.stable[clear], largest[clear] < 1)
    assert np.count_nonzero(clear) > 0.6 * f.size


@pytest.mark.parametrize(("diagonal", "offset", "sign"), [((2, -3), True, -1), ((2, 3), True, 1), ((2, 3), False, -1)])
def test_the_sign_with_offsets_kept_is_that_of_their_own_derivative(diagonal, offset, sign):
    """Of a solution without an offset it is the one given, and of a fold 0 either way."""
    by_x = SimpleNamespace(sign=1, matrix=np.diag(np.array(diagonal, dtype=float)))
    kept = []
    balance = SimpleNamespace(
        has_offset=lambda x: offset,
        linearised=lambda x, frequency, keep_offsets: kept.append(keep_offsets) or (None, by_x, None),
    )
    assert sign_with_offsets_kept(balance, np.zeros(2), 1.0, -1) == sign
    assert sign_with_offsets_kept(balance, np.zeros(2), 1.0, 0) == 0
    assert kept == [True] * offset


@pytest.mark.parametrize(
    ("largest", "turn", "other", "stable"),
    [
        (1 + 5e-4, 2.0, 1.0, True),
        (1 + 2e-3, 2.0, 1.0, False),
        (1 + 2e-3, 0.01, 1.0, False),
        (1 + 2e-2, 0.0, 0.9, True),
        (1 + 2e-2, 0.0, 1.0, False),
        (1 + 4e-2, 0.0, 0.9, False),
        (1 + 2e-3, np.pi, 1.0, False),
    ],
)
def test_a_multiplier_beyond_the_unit_circle_is_unstable(largest, turn, other, stable, monkeypatch):
    """Also where the determinant says nothing of it: a complex pair, near 1 too, two real ones, or one that passes -1.

    ``other``: modulus of the second one, as a share.
    """
    pair = largest * np.exp([1j * turn, -1j * turn]) * [1.0, other]
    monkeypatch.setattr(MULTIPLIERS, lambda _, x, *given: np.tile(pair, (len(x), 1)))
    controls = Controls(max_points=2)
    curve = hbm_curve(systems.oscillator(32.0, 1.0), 1.2, 1.3, scheme=Scheme(1, 64), controls=controls)
    assert curve.stable.tolist() == [stable] * 2
    np.testing.assert_allclose(curve.floquet_max, largest)
    np.testing.assert_allclose(curve.floquet_phase_deg, np.degrees(turn))


def test_what_is_in_doubt_is_looked_at_with_more_samples(monkeypatch):
    """Where samples leave it open, and where the determinant is not that of so many real multipliers above 1."""
    turn = np.exp(2j) ** np.array([1, -1])
    complex_pairs = np.array([1.0042, 1.2, 0.99])[:, None] * turn
    coarse = np.concatenate([complex_pairs, [[1.3, 0.9], [1.3, 0.9], [1.3, 1.1], [0.9, 0.3], [0.9, 0.3]]])
    fine = 0.9985 * turn
    sign = np.array([1, 1, 1, 1, -1, -1, -1, 0])
    looked_at: list[list[float]] = []

    def given(_, x, frequency, samples=None):
        looked_at.append(frequency.tolist())
        doubt = np.zeros((len(x), 2), dtype=bool)
        doubt[[0, 2] if samples is None else [], 1] = True
        return coarse.copy() if samples is None else np.tile(fine, (len(x), 1)), doubt

    monkeypatch.setattr(multipliers, "_with_doubt", given)
    balance = Balance(systems.oscillator(-1.0, 0.97), 0.97, Scheme(1, 64))
    found = multipliers.checked_multipliers(balance, np.zeros((8, 1)), np.arange(8.0), sign)
    assert looked_at == [list(range(8)), [0, 2, 3, 5, 6]]
    np.testing.assert_allclose(np.abs(found[:, 0]), [0.9985, 1.2, 0.9985, 0.9985, 1.3, 0.9985, 0.9985, 0.9])
    assert multipliers.grows(found).tolist() == [False, True, False, False, True, False, False, False]


def test_multipliers_are_complex_where_all_are_real(monkeypatch):
    """Those that hardly grow are put in place of the first ones, and may well turn while those do not."""
    monkeypatch.setattr(multipliers, "monodromy", lambda *_: np.tile(np.diag([0.5, 1.002]), (3, 1, 1)))
    balance = Balance(systems.oscillator(-1.0, 0.97), 0.97, Scheme(1, 64))
    found = floquet_multipliers(balance, np.zeros((3, 9)), np.full(3, 0.97))
    assert found.dtype == complex
    np.testing.assert_array_equal(found, np.tile([1.002, 0.5], (3, 1)))


def test_a_diagonal_damping_matrix_is_that_of_modes_left_apart():
    model = systems.oscillator(-1.0, 0.97)
    found = [hbm_curve(m, 0.97, 0.971, scheme=Scheme(5, 256)).floquet_max for m in (model, coupled(-1.0, 0.97, 0.0))]
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)


def test_an_interrupt_among_the_multipliers_keeps_the_curve(monkeypatch):
    def interrupted(*given):
        raise KeyboardInterrupt

    monkeypatch.setattr(MULTIPLIERS, interrupted)
    curve = hbm_curve(systems.oscillator(-1.0, 0.97), 0.97, 0.975, scheme=Scheme(3, 64))
    assert curve.ending is Ending.INTERRUPTED
    assert curve.frequency.size > 2
    assert np.isnan(curve.floquet_max).all()
    assert curve.message.endswith("interrupted before the multipliers")


@pytest.mark.parametrize("stability", [True, False])
def test_an_interrupt_along_the_curve_leaves_its_multipliers_out(stability, monkeypatch):
    monkeypatch.setattr(MULTIPLIERS, lambda *_, **__: pytest.fail("they take long"))
    seen = []

    def watch(share, so_far):
        seen.append(share)
        if len(seen) == 3:
            raise KeyboardInterrupt

    options = {"scheme": Scheme(3, 64), "stability": stability, "watch": watch}
    curve = hbm_curve(systems.oscillator(-1.0, 0.97), 0.97, 0.975, **options)
    assert curve.ending is Ending.INTERRUPTED
    assert curve.frequency.size == 3
    assert np.isnan(curve.floquet_max).all()
    assert curve.message.endswith("after 3 points: interrupted" + " before the multipliers" * stability)
