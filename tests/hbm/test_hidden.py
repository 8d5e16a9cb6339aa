"""Resonances that contacts hardly feel: two equal blades that move together beside a contact between them."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import systems

from timesim.hbm import parameter
from timesim.hbm.adaptive import AdaptiveBalance
from timesim.hbm.balance import Balance
from timesim.hbm.curve import hbm_curve
from timesim.hbm.curve.following import part_of_curve
from timesim.hbm.hidden import SHARE, Hidden, steps_to_resolve
from timesim.hbm.parameter import ParameterBalance, parameter_curve
from timesim.hbm.scheme import Controls, Scheme
from timesim.model.model import Contact, Model, Structure

RATIO = 1e-3
EQUAL = 10.0, 10.0
"""Two blades by themselves: modes of one frequency [Hz], of which that of both together is not among them."""


def blades(frequency=EQUAL, stiffness=4000.0, force=(1.0, 0.5)):
    """Masses of 1 on springs, joined by a contact that sticks all the time."""
    omega = systems.TURN * np.array(frequency)
    shape = np.zeros((2, 3, 2))
    shape[0, 0, 0] = shape[1, 0, 1] = 1.0
    structure = Structure(np.array(frequency), np.ones(2), 2 * RATIO * omega, ("one", "other"), shape)
    contact = Contact("shroud", "one", "other", np.eye(3), 0.3, stiffness * np.eye(2), 0.0, 1000.0)
    return Model(structure, (contact,), systems.excitation(10.0, force, [0.0, 0.0]), systems.at_rest(2, 1))


def longest(model, harmonics=1):
    """How far a step leads from a frequency [Hz] at most, under no force of the contact."""
    scheme = Scheme(harmonics, 16)
    balance = AdaptiveBalance(lambda own: Balance(model, 10.0, own), [scheme], model.num_contacts)
    return partial(steps_to_resolve(model, balance), x=np.zeros(balance.active.size))


def places(model, low, high):
    """Where steps of the longest allowed lead from one frequency to another [Hz]."""
    far, way = longest(model), [low]
    while way[-1] < high:
        way.append(way[-1] + far(way[-1]))
    return np.array(way)


def test_steps_show_the_top_of_a_resonance_that_the_contact_does_not_move():
    way = places(blades(), 5.0, 15.0)
    assert np.sum(np.abs(way - 10.0) < RATIO * 10.0) >= 2 / SHARE - 1
    assert way.size < 120


def test_one_harmonic_of_the_excitation_meets_it_at_its_share_of_the_frequency():
    model = blades()
    model = replace(model, excitation=replace(model.excitation, harmonic=np.array([4])))
    assert longest(model, 4)(2.5) == pytest.approx(SHARE * RATIO * 2.5)


@pytest.mark.parametrize("change", [{"frequency": (10.0, 13.0)}, {"force": (1.0, -1.0)}])
def test_steps_are_free_where_the_contact_moves_every_resonance_or_nothing_excites_the_others(change):
    assert longest(blades(**change))(10.0) > 1.0


def test_a_force_however_small_beside_others_but_no_rounding_of_these_shows_a_resonance():
    assert longest(blades(force=(1.0, -1.0 + 1e-9)))(10.0) == pytest.approx(SHARE * RATIO * 10.0)
    assert longest(blades(force=(1.0, -1.0 + 1e-15)))(10.0) > 1.0


def test_a_resonance_that_contacts_drive_is_met_where_they_do_and_not_from_then_on():
    hidden, still = Hidden(blades(force=(1.0, -1.0)), 1), (np.zeros((1, 2)), 1.0)
    driven = np.array([[1.0, 1.0]]) * hidden.low[0].min() ** 2, 1.0
    assert [np.isfinite(hidden.away(9.0, lambda now=now: now)).any() for now in (driven, still)] == [True, False]


@pytest.mark.parametrize(("share", "met"), [(0.99, False), (1.01, True)])
def test_a_resonance_that_contacts_drive_counts_from_a_share_of_the_largest_motion(share, met):
    """Of a force F on each blade both move by F / (2 zeta omega^2)."""
    hidden, force = Hidden(blades(force=(1.0, -1.0)), 1), share * 1e-2 * 3.0 * 2 * RATIO * (systems.TURN * 10.0) ** 2
    assert np.isfinite(hidden.away(9.0, lambda: (np.full((1, 2), force), 3.0))).any() == met


@pytest.mark.parametrize(("frequency", "away"), [(9.9, 0.1), (10.0125, 0.01), (10.125, 0.1)])
def test_between_both_ends_of_a_resonance_steps_are_those_within_it(frequency, away):
    """A pad that moves it from 10 to 10.025 Hz."""
    model = blades(frequency=(10.0, 30.0), stiffness=(1.0025**2 - 1) * (systems.TURN * 10.0) ** 2)
    model = replace(model, contacts=(replace(model.contacts[0], against="ground"),))
    assert longest(model)(frequency) == pytest.approx(SHARE * away, rel=1e-6)


@pytest.mark.parametrize("force", [(1.0, 0.5), (1.0, -1.0)])
def test_steps_do_not_depend_on_the_mass_of_a_mode(force):
    """Mode 2 with nine times its mass and damping, and three times its shape and modal force, is the same one."""
    model, root = blades(force=force), np.array([1.0, 3.0])
    body, load = model.structure, model.excitation
    body = replace(body, mass=body.mass * root**2, damping=body.damping * root**2, shape=body.shape * root)
    heavier = replace(model, structure=body, excitation=replace(load, cosine=load.cosine * root))
    assert longest(heavier)(10.0) == pytest.approx(longest(model)(10.0))
    assert (longest(model)(10.0) < 0.01) == (force[1] > 0)


@pytest.mark.long
@pytest.mark.parametrize("stiffness", [100.0, 1e6])
def test_a_curve_finds_the_peak_of_blades_that_move_together(stiffness):
    curve = hbm_curve(blades(stiffness=stiffness), 5.0, 18.0, scheme=Scheme(1, 16), stability=False)
    assert curve.complete
    together = 0.75 / (2 * RATIO * (systems.TURN * 10.0) ** 2)
    assert curve.harmonic_amplitude[:, 1].max() == pytest.approx(together, rel=0.02)


@pytest.mark.long
def test_so_does_a_part_of_it_that_another_process_follows_from_the_other_end():
    part = part_of_curve(blades(), 5.0, 18.0, 5.0, [Scheme(1, 16)], Controls(), lambda *_: None)
    assert part.complete
    assert np.sum(np.abs(part.p - 10.0) < RATIO * 10.0) >= 2 / SHARE - 1


def along_both_frequencies(first, last):
    """A curve at 10 Hz along the frequency of both blades [Hz]."""
    options = {"scheme": [Scheme(1, 16)], "controls": Controls(), "guess": None, "stability": False}
    return parameter_curve(lambda f: blades((f, f)), 10.0, first, last, watch=lambda *_: None, **options)


@pytest.mark.long
@pytest.mark.parametrize("ends", [(8.3, 13.0), (13.0, 8.3)])
def test_so_does_a_curve_along_a_scalar_that_moves_the_resonance(ends):
    curve = along_both_frequencies(*ends)
    assert curve.complete
    assert np.sum(np.abs(curve.parameter - 10.0) < RATIO * 10.0) >= 2 / SHARE - 1
    assert curve.parameter.size < 120
    together = 0.75 / (2 * RATIO * (systems.TURN * 10.0) ** 2)
    assert curve.harmonic_amplitude[:, 1].max() == pytest.approx(together, rel=0.02)


def test_a_scalar_that_moves_only_the_upper_end_of_a_resonance_counts():
    """A spring so soft that its resonance is hardly felt: it moves that of the stuck structure, and none without it."""
    body, omega = blades().structure, systems.TURN * 10.0
    one = replace(
        body, frequency=body.frequency[:1], mass=np.ones(1), damping=body.damping[:1], shape=body.shape[..., :1]
    )

    def model_at(stiffness):
        contact = Contact("pad", "one", "ground", np.eye(3), 0.3, stiffness * np.eye(2), 0.0, 1000.0)
        return Model(one, (contact,), systems.excitation(10.0, [1.0], [0.0]), systems.at_rest(1, 1))

    frequency, ends, scheme = 10.1, (1.0, 0.015 * omega**2), Scheme(1, 16)
    balance = AdaptiveBalance(lambda own: ParameterBalance(model_at, frequency, own, ends), [scheme], 1)
    far, stiffness = parameter.steps_to_resolve(model_at, frequency, ends, balance), 0.005 * omega**2
    stuck = np.sqrt(omega**2 + stiffness)
    way = (systems.TURN * frequency - stuck) * 2 * stuck
    assert far(stiffness, np.zeros(balance.active.size)) == pytest.approx(SHARE * way, rel=1e-4)


def light_mode():
    """A slider on a mode of 1 Hz; another of 3.3 Hz, which it hardly moves, moves another point much."""
    omega, shape = systems.TURN * np.array([1.0, 3.3]), np.zeros((2, 3, 2))
    shape[:, 0] = [[1.0, 0.05], [0.2, 5.0]]
    structure = Structure(omega / systems.TURN, np.ones(2), 2 * np.array([0.02, 2e-4]) * omega, ("pad", "tip"), shape)
    contact = Contact("pad", "pad", "ground", np.eye(3), 0.5, 40.0 * np.eye(2), 0.0, 1.0)
    return Model(structure, (contact,), systems.excitation(1.0, [2.0, 0.1], [0.0, 0.0]), systems.at_rest(2, 1))


@pytest.mark.long
def test_a_curve_shows_what_the_third_harmonic_of_friction_does_at_a_third_of_a_natural_frequency():
    curve = hbm_curve(light_mode(), 0.9, 1.3, scheme=Scheme(3, 64), stability=False)
    third = np.hypot(curve.harmonic_cos, curve.harmonic_sin)[:, 3, 1, 0]
    top = np.argmax(np.where(np.abs(curve.frequency - 1.1) < 0.05, third, 0.0))
    force = np.hypot(*curve.contact_force[top, 0, 0, [5, 6]])
    expected = force * 0.05 * 5.0 / (2 * 2e-4 * (systems.TURN * 3.3) ** 2)
    assert third[top] == pytest.approx(expected, rel=0.02)
    assert curve.amplitude[top, 1, 0] > 1.5 * curve.amplitude[np.abs(curve.frequency - 1.1) > 0.05, 1, 0].max()
