"""Which of the curves from both ends of a range are told, and how they end."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from systems import oscillator

from timesim.hbm import branches, first_guess
from timesim.hbm.adaptive import AdaptiveBalance
from timesim.hbm.balance import Balance
from timesim.hbm.branches import SettledMotion, curves_from_ends, isolated_curves, passes, warm_up
from timesim.hbm.continuation import Controls, Curve, Ending, crossings
from timesim.hbm.curve import HbmCurve
from timesim.hbm.first_guess import curve_near, first_guesses
from timesim.hbm.scheme import Scheme

LOW, HIGH = 1.0, 2.0


def curve(ending, *solutions):
    """A curve of solutions by their frequency and the size of their motion."""
    frequency, size = np.array(solutions, dtype=float).T
    count = frequency.size
    waves, alike = size[:, None, None, None] * np.ones((count, 1, 3, 3)), np.zeros((count, 1))
    return HbmCurve(
        parameter=frequency,
        frequency=frequency,
        stable=np.ones(count, dtype=bool),
        fold=np.zeros(count, dtype=bool),
        branch=np.zeros(count, dtype=np.int64),
        amplitude=size[:, None, None] * np.ones((count, 1, 3)),
        harmonic_cos=np.zeros((count, 2, 1, 3)),
        harmonic_sin=np.zeros((count, 2, 1, 3)),
        slip_share=alike,
        separation_share=alike,
        contact_motion=waves,
        contact_force=waves,
        floquet_max=np.ones(count),
        floquet_phase_deg=np.zeros(count),
        closure=np.zeros(count),
        ending=ending,
        message=f"continuation at {frequency[-1]:g}, after {count} points: {ending.value}",
    )


WHOLE = curve(Ending.COMPLETE, (LOW, 3.0), (HIGH, 4.0))
BACK_TO_LOW = curve(Ending.LEFT, (LOW, 3.0), (1.5, 5.0), (LOW, 6.0))
BACK_TO_HIGH = curve(Ending.LEFT, (HIGH, 5.0), (1.5, 5.0), (HIGH, 6.0))
FROM_HIGH = curve(Ending.COMPLETE, (HIGH, 4.0), (LOW, 3.0))
OTHER_FROM_HIGH = curve(Ending.COMPLETE, (HIGH, 4.0), (LOW, 2.0))
ANOTHER = curve(Ending.COMPLETE, (HIGH, 4.1), (LOW, 2.0))
FAILS_FROM_LOW = curve(Ending.STEP, (LOW, 3.0), (1.4, 3.5))
FAILS_FROM_HIGH = curve(Ending.STEP, (HIGH, 4.0), (1.7, 2.0))
NO_START = replace(
    FAILS_FROM_LOW.with_harmonics(1),
    **{name: np.zeros((0, *np.shape(getattr(WHOLE, name))[1:])) for name in ("frequency", "contact_motion")},
    ending=Ending.START,
    message=f"continuation at 1, after 0 points: {Ending.START.value}; tried: this and that",
)


@pytest.mark.parametrize(
    ("there", "back", "both", "expected"),
    [
        (WHOLE, None, False, [(Ending.COMPLETE, LOW)]),
        (WHOLE, FROM_HIGH, True, [(Ending.COMPLETE, LOW)]),
        (WHOLE, curve(Ending.COMPLETE, (HIGH, 4.1), (LOW, 3.0)), True, [(Ending.COMPLETE, HIGH)]),
        (WHOLE, ANOTHER, True, [(Ending.COMPLETE, LOW), (Ending.COMPLETE, HIGH)]),
        (BACK_TO_LOW, FROM_HIGH, False, [(Ending.COMPLETE, HIGH)]),
        (BACK_TO_LOW, OTHER_FROM_HIGH, False, [(Ending.RETURNED, LOW), (Ending.COMPLETE, HIGH)]),
        (WHOLE, BACK_TO_HIGH, True, [(Ending.COMPLETE, LOW), (Ending.RETURNED, HIGH)]),
        (BACK_TO_LOW, FAILS_FROM_HIGH, False, [(Ending.LEFT, LOW), (Ending.STEP, HIGH)]),
        (FAILS_FROM_LOW, FROM_HIGH, False, [(Ending.BACKWARDS, HIGH)]),
        (FAILS_FROM_LOW, OTHER_FROM_HIGH, False, [(Ending.STEP, LOW), (Ending.COMPLETE, HIGH)]),
        (FAILS_FROM_LOW, FAILS_FROM_HIGH, False, [(Ending.STEP, LOW), (Ending.STEP, HIGH)]),
        (NO_START, FROM_HIGH, False, [(Ending.BACKWARDS, HIGH)]),
        (WHOLE, curve(Ending.INTERRUPTED, (HIGH, 4.0), (1.7, 3.5)), True, [(Ending.INTERRUPTED, LOW)]),
        (curve(Ending.INTERRUPTED, (LOW, 3.0)), None, True, [(Ending.INTERRUPTED, LOW)]),
    ],
)
def test_curves_from_both_ends(there, back, both, expected, monkeypatch):
    """One where they are the same; one that turned back is whole only if that from the other end is, and another."""
    known = {LOW: there, HIGH: back}
    monkeypatch.setattr(branches, "hbm_curve", lambda _, start, stop: known[start])
    found = curves_from_ends(None, LOW, HIGH, both=both)
    assert [(own.ending, own.frequency[0]) for own in found] == expected
    if found[0].ending is Ending.RETURNED:
        assert found[0].message == f"continuation at 1, after 3 points: {Ending.RETURNED.value}"
    if found[0].ending is Ending.BACKWARDS:
        whole = f"continuation at 1, after 2 points: {Ending.BACKWARDS.value}"
        assert found[0].complete
        assert found[0].message == f"{whole}; from the first one: {there.message}"


def test_a_curve_that_goes_round_a_closed_branch_is_followed_once_more_in_shorter_steps(monkeypatch):
    """Then, if it does so again, from the other end."""
    steps = []

    def followed(_, start, stop, controls):
        steps.append((start, controls.max_step))
        return WHOLE if controls.max_step < least else curve(Ending.AGAIN, (start, 3.0), (1.5, 3.5))

    monkeypatch.setattr(branches, "hbm_curve", followed)
    least = 0.15
    (found,) = curves_from_ends(None, LOW, HIGH, both=False, controls=Controls(max_step=0.2))
    assert found is WHOLE
    assert steps == [(LOW, 0.2), (LOW, 0.1)]
    least = 0.05
    found = curves_from_ends(None, LOW, HIGH, both=False, controls=Controls(max_step=0.2))
    assert [one.ending for one in found] == [Ending.AGAIN] * 2
    assert not any(one.complete for one in found)
    assert steps[2:] == [(LOW, 0.2), (LOW, 0.1), (HIGH, 0.2), (HIGH, 0.1)]


def test_an_interrupt_at_the_other_end_keeps_the_first_curve(monkeypatch):
    def followed(_, start, stop):
        if start == HIGH:
            raise KeyboardInterrupt
        return BACK_TO_LOW

    monkeypatch.setattr(branches, "hbm_curve", followed)
    (found,) = curves_from_ends(None, LOW, HIGH, both=False)
    assert found.ending is Ending.INTERRUPTED
    assert found.frequency.size == 3


def test_a_curve_passes_a_motion_if_all_its_amplitudes_do():
    motion = SettledMotion(1.5, np.array([[3.5, 3.5, 3.5]]), lambda: None)
    assert passes(WHOLE, motion)
    assert not passes(WHOLE, replace(motion, amplitude=np.array([[3.5, 3.5, 3.0]])))
    between = SettledMotion(1.25, np.full((1, 3), 3.25), lambda: None)
    assert passes(WHOLE, between)
    assert not passes(WHOLE, replace(between, amplitude=np.full((1, 3), 3.75)))


def test_a_motion_at_an_end_of_the_range_begins_a_curve_of_its_own(monkeypatch):
    """Also where its frequency, of a range in steps, is not quite that end."""
    begun = []

    def followed(*_, begin, **__):
        begun.append(begin)
        return curve(Ending.COMPLETE, (LOW, 9.0), (HIGH, 9.0))

    monkeypatch.setattr(branches, "hbm_curve", followed)
    monkeypatch.setattr(branches, "_leads_elsewhere", lambda *_: True)
    for frequency in (LOW, HIGH, np.nextafter(HIGH, 3.0), 1.01 * HIGH):
        motion = SettledMotion(frequency, np.full((1, 3), 9.0), lambda: np.zeros((3, 1)))
        list(isolated_curves(None, [WHOLE], [motion], (LOW, HIGH), scheme=Scheme()))
    assert begun == [LOW, HIGH, np.nextafter(HIGH, 3.0)]


def test_a_curve_may_lead_straight_up():
    assert [*crossings(np.array([0.9, 1.0, 1.0, 1.1]), 1.0)] == [(1, 0.0), (2, 0.0)]


def test_an_interrupt_while_it_compiles_is_not_lost(monkeypatch):
    monkeypatch.setattr(branches, "compile_slopes", lambda _: None)
    monkeypatch.setattr(branches, "hbm_curve", lambda *_, **__: curve(Ending.INTERRUPTED, (1.0, 1.0)))
    with pytest.raises(KeyboardInterrupt):
        warm_up(oscillator(-1.0, 0.97), 0.97, Scheme(3, 64))


def test_an_interrupt_while_the_load_grows_is_not_lost(monkeypatch):
    """No time integration begins after it."""
    cut = Curve.of([], 21, Ending.INTERRUPTED, "interrupted", 0)
    monkeypatch.setattr(first_guess, "follow", lambda *_, **__: cut)
    monkeypatch.setattr(first_guess, "_linear_guess", lambda *_: None)
    monkeypatch.setattr(first_guess, "_settled", lambda *_: pytest.fail("a march has begun"))
    with pytest.raises(KeyboardInterrupt):
        list(first_guesses(Balance(oscillator(-1.0, 0.97), 0.97, Scheme(3, 64)), 0.97, Controls()))


# Guesses of a first solution


def residual_of(balance, x, frequency):
    """The largest residual of a guess, relative to the largest entry of the guess."""
    return np.abs(balance.value(x, frequency)).max() / np.abs(x).max()


@pytest.mark.parametrize("whole", [False, True])
def test_the_linear_guess_of_a_structure_that_sticks_is_its_solution(whole):
    """Also where damping is a matrix, and the balance supports the structure at its contacts."""
    model = oscillator(64.0, 1.3)
    if whole:
        model = replace(model, structure=replace(model.structure, damping=np.diag(model.structure.damping)))
    balance = Balance(model, 1.3, Scheme(3, 64))
    way, guess = next(first_guesses(balance, 1.3, Controls()))
    assert way == "the linear response with contacts stuck where they are closed at rest"
    assert residual_of(balance, guess, 1.3) < 1e-10


def test_unknowns_of_modes_are_the_motion_of_the_contacts():
    balance = Balance(oscillator(3.0, 1.39), 1.39, Scheme(3, 64))
    modal = np.random.default_rng(1).normal(size=(9, 2))
    x = first_guess.unknowns_of_modes(balance, modal).reshape(3, 7) * balance.length
    np.testing.assert_allclose(x, balance.model.contact_shape[0] @ modal[:7].T, rtol=1e-12)


@pytest.mark.long
def test_the_last_guess_is_the_settled_motion_by_all_harmonics(monkeypatch):
    """Of a balance by many of them it is nearly a solution."""
    monkeypatch.setattr(first_guess, "follow", lambda *_, **__: Curve.of([], 21, Ending.STEP, "", 0))
    coarse, fine = (Balance(oscillator(3.0, 1.39), 1.39, Scheme(own, 256)) for own in (3, 15))
    *_, (ramp, none), (way, guess) = first_guesses(coarse, 1.39, Controls(), fine)
    assert ramp.endswith("0% of the way")
    assert none is None
    assert way == "time integration, which settles"
    assert guess.size == fine.num_unknowns
    assert residual_of(fine, guess, 1.39) < 1e-3


def test_a_motion_whose_body_moves_on_is_no_guess(monkeypatch):
    orbit = SimpleNamespace(reason=None, drift=np.array([[0.1, 0.0, 0.0]]), settled=True, period=1)
    monkeypatch.setattr(first_guess, "steady_states", lambda *_: [[orbit]])
    monkeypatch.setattr(first_guess, "modal_coefficients", lambda *_: pytest.fail("its cycle does not repeat"))
    way, guess = first_guess._settled(Balance(oscillator(3.0, 1.39), 1.39, Scheme(3, 64)), 1.39)
    assert guess is None
    assert "drifts" in way


def test_a_load_that_grows_begins_without_motion_and_ends_as_the_balance():
    balance = Balance(oscillator(3.0, 1.39), 1.39, Scheme(3, 64))
    ramp, x = first_guess._Ramp(balance, 1.39), 0.01 * np.random.default_rng(1).normal(size=balance.num_unknowns)
    np.testing.assert_allclose(ramp.value(np.zeros_like(x), 0.0), 0.0, atol=1e-12)
    np.testing.assert_allclose(ramp.value(x, 1.0), balance.value(x, 1.39), rtol=1e-12, atol=1e-14)
    r, _, by_p = ramp.linearised(x, 0.4)
    np.testing.assert_allclose(r, ramp.value(x, 0.4), rtol=1e-9, atol=1e-12)
    slope = (ramp.value(x, 0.401) - ramp.value(x, 0.399)) / 2e-3
    np.testing.assert_allclose(by_p, slope, rtol=0, atol=1e-3 * np.abs(slope).max())


def ended(ending, count, place=1.6):
    """A curve of so many solutions from one place on."""
    rows = [(np.zeros(21), place + 1e-3 * i, False, 1) for i in range(count)]
    return Curve.of(rows, 21, ending, ending.name)


@pytest.mark.parametrize(
    ("curves", "chosen"),
    [
        ((ended(Ending.STEP, 2), ended(Ending.COMPLETE, 5)), 1),
        ((ended(Ending.STEP, 3), ended(Ending.COMPLETE, 5)), 0),
        ((ended(Ending.START, 0), ended(Ending.LEFT, 1)), 1),
        ((ended(Ending.STEP, 1, 1.6), ended(Ending.STEP, 2, 1.7)), 0),
        ((ended(Ending.START, 0), ended(Ending.STEP, 1)), 1),
    ],
)
def test_a_curve_begins_at_the_first_guess_from_which_it_goes_on(curves, chosen, monkeypatch):
    """By more than two solutions; else at the first that is a solution."""
    adaptive = AdaptiveBalance(lambda own: Balance(oscillator(3.0, 1.6), 1.6, own), [Scheme(3, 64)], 1)
    guesses = [np.full(21, float(i)) for i in range(len(curves))]
    monkeypatch.setattr(first_guess, "first_guesses", lambda *_: iter([("a guess", own) for own in guesses]))
    found = curve_near(adaptive, 1.6, 1.6, Controls(), None, lambda guess: curves[int(guess[0])])
    assert found.p.tolist() == curves[chosen].p.tolist()


def test_the_first_of_the_guesses_that_are_refused_is_the_last_resort(monkeypatch):
    """Where none is a solution that lacks little."""
    adaptive = AdaptiveBalance(lambda own: Balance(oscillator(3.0, 1.6), 1.6, own), [Scheme(3, 64)], 1)
    guesses = [np.full(21, float(i)) for i in range(3)]
    monkeypatch.setattr(first_guess, "first_guesses", lambda *_: iter([("a guess", own) for own in guesses]))

    def followed(guess):
        adaptive.refused = adaptive.demanding
        return ended(Ending.START, 0) if adaptive.demanding else ended(Ending.COMPLETE, 4, 1 + guess[0])

    assert curve_near(adaptive, 1.6, 1.6, Controls(), None, followed).p[0] == 1.0
