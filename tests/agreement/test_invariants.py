"""What the equations keep must be kept: scaling, rotation, mirror images, one contact as two, and the energy."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulation import REFERENCE, Trace, simulate
from systems import oscillator

from timesim.model.model import Contact, Excitation, Model, Start, Structure
from timesim.model.solver import PRESETS, Solver

pytestmark = pytest.mark.long

CYCLES = 8
FINE = Solver("tsit5", 1e-10, 1e-12, reduce=False)
POWERS = st.floats(-9, 9)
# Strict, gentle, with a gap: n0 and the frequency at which it slips and separates.
CASES = ((3.0, 1.39), (-1.0, 0.97), (1.0, 1.1))
few = settings(max_examples=8, deadline=None, derandomize=True)


def run(model: Model, frequency: float) -> Trace:
    return simulate(model, CYCLES, FINE, frequency)


def test_the_cases_slip_and_separate():
    seen = {state for preload, f in CASES for event in run(oscillator(preload, f), f).sequence for state in event[1:]}
    assert seen == {0, 1, 2}


def loads_scaled(model: Model, by: float) -> Model:
    excitation = model.excitation
    forces = Excitation(
        excitation.frequency,
        excitation.harmonic,
        excitation.cosine * by,
        excitation.sine * by,
        excitation.constant * by,
    )
    contacts = tuple(replace(contact, preload=contact.preload * by) for contact in model.contacts)
    return replace(model, excitation=forces, contacts=contacts)


def time_scaled(model: Model, by: float) -> Model:
    """Time runs ``by`` times slower: stiffness and forces by ``by^-2``, damping by ``by^-1``."""
    structure, excitation = model.structure, model.excitation
    slower = replace(structure, frequency=structure.frequency / by, damping=structure.damping / by)
    forces = Excitation(
        None, excitation.harmonic, excitation.cosine / by**2, excitation.sine / by**2, excitation.constant / by**2
    )
    contacts = tuple(
        replace(
            contact,
            tangential_stiffness=contact.tangential_stiffness / by**2,
            normal_stiffness=contact.normal_stiffness / by**2,
            preload=contact.preload / by**2,
        )
        for contact in model.contacts
    )
    return replace(model, structure=slower, excitation=forces, contacts=contacts)


def length_scaled(model: Model, by: float) -> Model:
    """Lengths in units ``by`` times smaller: shapes by ``by``, stiffness per length, force and mass unchanged."""
    structure = replace(model.structure, shape=model.structure.shape * by)
    contacts = tuple(
        replace(
            contact,
            tangential_stiffness=contact.tangential_stiffness / by**2,
            normal_stiffness=contact.normal_stiffness / by**2,
            preload=contact.preload / by,
        )
        for contact in model.contacts
    )
    return replace(model, structure=structure, contacts=contacts)


def assert_same_digits(one: Trace, other: Trace, factor: float) -> None:
    assert other.sequence == one.sequence
    scale = np.abs(one.run.displacement).max()
    np.testing.assert_allclose(other.run.displacement / factor, one.run.displacement, rtol=0, atol=1e-9 * scale)


@few
@given(power=POWERS, case=st.sampled_from(CASES))
def test_loads_and_preloads_scale_the_response(power: float, case: tuple[float, float]):
    model, by = oscillator(*case), 10.0**power
    assert_same_digits(run(model, case[1]), run(loads_scaled(model, by), case[1]), by)


@few
@given(power=POWERS, case=st.sampled_from(CASES))
def test_the_unit_of_time_does_not_matter(power: float, case: tuple[float, float]):
    model, by = oscillator(*case), 10.0**power
    assert_same_digits(run(model, case[1]), run(time_scaled(model, by), case[1] / by), 1.0)


@few
@given(power=POWERS, case=st.sampled_from(CASES))
def test_the_unit_of_length_does_not_matter(power: float, case: tuple[float, float]):
    model, by = oscillator(*case), 10.0**power
    one, other = run(model, case[1]), run(length_scaled(model, by), case[1])
    assert_same_digits(one, other, 1.0)
    live = one.run.state != 2
    np.testing.assert_allclose(other.run.slip[live] / by, one.run.slip[live], rtol=0, atol=1e-8)


def turned(model: Model, rotation: np.ndarray) -> Model:
    """The whole scene in other axes, or mirrored: points and contact frames alike."""
    shape = np.einsum("ab,pbm->pam", rotation, model.structure.shape)
    contacts = tuple(replace(contact, frame=contact.frame @ rotation.T) for contact in model.contacts)
    return replace(model, structure=replace(model.structure, shape=shape), contacts=contacts)


@few
@given(angles=st.tuples(*[st.floats(0, 6.3)] * 3), mirror=st.booleans())
def test_rotation_and_mirror_images(angles: tuple[float, float, float], mirror: bool):
    rotation = np.eye(3)
    for axis, angle in enumerate(angles):
        c, s = np.cos(angle), np.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        rotation = turn @ rotation
    rotation = rotation @ np.diag([1.0, -1.0 if mirror else 1.0, 1.0])
    model = oscillator(3.0, 1.39)
    assert_same_digits(run(model, 1.39), run(turned(model, rotation), 1.39), 1.0)


def test_mirrored_tangents_mirror_the_friction():
    model = oscillator(3.0, 1.39)
    flipped = replace(model.contacts[0], frame=np.diag([1.0, -1.0, 1.0]) @ model.contacts[0].frame)
    one, other = run(model, 1.39), run(replace(model, contacts=(flipped,)), 1.39)
    assert_same_digits(one, other, 1.0)
    np.testing.assert_allclose(other.run.slip, one.run.slip * [1, -1], atol=1e-9)


def split(contact: Contact, names: tuple[str, str]) -> tuple[Contact, ...]:
    return tuple(
        replace(
            contact,
            name=name,
            tangential_stiffness=contact.tangential_stiffness / 2,
            normal_stiffness=contact.normal_stiffness / 2,
            preload=contact.preload / 2,
        )
        for name in names
    )


@pytest.mark.parametrize("case", CASES)
def test_two_contacts_of_half_stiffness_are_one(case: tuple[float, float]):
    """Both switch at the same instant, each time."""
    model = oscillator(*case)
    start = Start(model.start.displacement, model.start.velocity, np.zeros((2, 2)), np.tile(model.start.state, 2))
    double = replace(model, contacts=split(model.contacts[0], ("one", "two")), start=start)
    one, two = run(model, case[1]), run(double, case[1])
    for index in (0, 1):
        mine = [event[1:] for event in two.sequence if event[0] == index]
        assert mine == [event[1:] for event in one.sequence]
    np.testing.assert_allclose(two.run.displacement, one.run.displacement, rtol=0, atol=1e-9)
    np.testing.assert_allclose(two.log.time[::2], two.log.time[1::2], rtol=0, atol=1e-12)


@pytest.mark.parametrize("case", CASES)
def test_the_energy_balance_closes(case: tuple[float, float]):
    trace = simulate(oscillator(*case), 20, REFERENCE, case[1])
    assert trace.energy_residual < 1e-8
    assert trace.totals.work[-1][2] > 0


def test_a_coarser_run_closes_its_balance_less_well():
    """The residual measures the error of the integration."""
    residuals = [
        simulate(oscillator(3.0, 1.39), 20, PRESETS[name], 1.39).energy_residual for name in ("draft", "reference")
    ]
    assert residuals[0] > 100 * residuals[1]


def test_an_undamped_structure_without_contacts_keeps_its_energy():
    structure = Structure(np.array([0.9, 1.1]), np.ones(2), np.zeros(2), ("tip",), np.ones((1, 3, 2)))
    still = Excitation(None, np.array([1]), np.zeros((1, 2)), np.zeros((1, 2)), np.zeros(2))
    start = Start(np.array([1.0, -0.5]), np.zeros(2), np.zeros((0, 2)), np.zeros(0, dtype=int))
    trace = simulate(Model(structure, (), still, start), 50, REFERENCE, 1.0)
    assert abs(trace.totals.stored[-1] / trace.totals.initial - 1) < 1e-9
