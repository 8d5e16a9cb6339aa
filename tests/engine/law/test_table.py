"""Another contact law than the cone: one module and one line of the table, and what then knows of it."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import systems
from simulation import FINE, REFERENCE, simulate

from timesim.element.elements import single_element
from timesim.element.motion import HarmonicMotion
from timesim.element.state_by_state import steady_cycle
from timesim.engine.law.table import LAWS, LawEntry, begin_of, law_class
from timesim.hbm.balance import Balance
from timesim.hbm.scheme import Scheme
from timesim.model.model import CONE, SEPARATION, SLIP, Contact, Model
from timesim.model.reduction import reduction_of
from timesim.model.solver import NEVER, SHOOT, Criterion
from timesim.model.start import given_start, resumed_start
from timesim.orbit.settling import Chain, steady_states
from timesim.orbit.two_motions.basin import placed
from timesim.study.recorder import contact_forces

GAP, STIFFNESS = 0.5, 400.0


@pytest.fixture(autouse=True)
def table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LAWS, "hunt_crossley", LawEntry("hunt_crossley", "HuntCrossley", ("damping",)))


def stop(damping: float, preload: float = -GAP * STIFFNESS) -> Contact:
    contact = systems.pad(0.0, 0.0, STIFFNESS, preload)
    return replace(contact, law="hunt_crossley", law_parameters={"damping": damping})


def driven(damping: float, preload: float = -0.02 * STIFFNESS) -> Model:
    """A mass of 1 Hz that is driven against its stop."""
    body = systems.structure([(2 * np.pi) ** 2], [0.1], [[0, 0, 1]])
    return Model(body, (stop(damping, preload),), systems.excitation(0.9, [1.0], [0.0]), systems.at_rest(1, 1))


def thrown(damping: float, speed: float) -> float:
    """Speed with which a free mass leaves the stop, over that with which it came."""
    body = systems.structure([1e-12], [0.0], [[0, 0, 1]])
    start = replace(systems.at_rest(1, 1), velocity=np.array([speed]))
    model = Model(body, (stop(damping),), systems.excitation(0.5, [0.0], [0.0]), start)
    trace = simulate(model, 1, FINE)
    assert trace.sequence == [(0, SEPARATION, SLIP), (0, SLIP, SEPARATION)]
    return float(-trace.run.velocity[0] / speed)


def test_a_law_is_found_by_its_name() -> None:
    assert law_class([stop(0.1)]).__name__ == "HuntCrossley"
    assert law_class([systems.pad(0.3, 1.0, 1.0, 1.0)]).__name__ == law_class([]).__name__ == "ConeLaw"
    with pytest.raises(ValueError, match="all must obey one law, not cone and hunt_crossley"):
        law_class([stop(0.1), systems.pad(0.3, 1.0, 1.0, 1.0)])
    with pytest.raises(ValueError, match="law must be one of cone, hunt_crossley, not glue"):
        law_class([replace(stop(0.1), law="glue")])


def test_the_table_loads_no_jax() -> None:
    code = "import sys, timesim.engine.law.table; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("preload", [-0.02 * STIFFNESS, 1.0])
def test_the_energy_balance_of_a_transient_closes(preload: float) -> None:
    trace = simulate(driven(0.3, preload), 20, replace(REFERENCE, reduce=True), 0.9)
    assert {after for _, _, after in trace.sequence} == {SLIP, SEPARATION}
    assert trace.energy_residual < 1e-10
    given, _, lost = trace.totals.work[-1]
    assert lost > 0.05 * given > 0


def test_the_speed_after_an_impact() -> None:
    """The restitution e(v) solves log((1 + c v) / (1 - c e v)) = c v (1 + e): energy over the impact."""
    assert thrown(0.0, 1.0) == pytest.approx(1.0, abs=1e-9)
    for damping, speed in ((0.1, 1.0), (0.2, 1.0), (0.1, 2.0)):
        e = thrown(damping, speed)
        c = damping * speed
        assert np.log((1 + c) / (1 - c * e)) == pytest.approx(c * (1 + e), abs=1e-9)
        assert 0.7 < e < 1 - 0.5 * c


def with_friction(model: Model) -> Model:
    """The same, its contact with a friction and a tangential stiffness that its law does not use."""
    (contact,) = model.contacts
    return replace(model, contacts=(replace(contact, friction=0.5, tangential_stiffness=20 * np.eye(2)),))


@pytest.mark.parametrize(("preload", "state"), [(-8.0, SEPARATION), (1.0, SLIP)])
def test_a_contact_starts_in_the_state_that_its_law_says(preload: float, state: int) -> None:
    model = with_friction(driven(0.3, preload))
    assert begin_of(model).state.tolist() == [state]
    assert {s for _, *pair in simulate(model, 5, FINE).sequence for s in pair} == {SLIP, SEPARATION}
    far = np.full((1, 2), 1.0)  # a slip that no cone would allow
    start = given_start(model, np.zeros(1), np.zeros(1), far)
    assert begin_of(replace(model, start=start)).state.tolist() == [state]
    np.testing.assert_array_equal(start.slip, 0 * far if state == SEPARATION else far)
    aside = placed(model, np.zeros(1), np.zeros(1), far, np.ones((1, 2)))
    assert aside.state.tolist() == [state]
    np.testing.assert_array_equal(aside.slip, start.slip)
    for before in (SLIP, SEPARATION):
        resumed = resumed_start(model, replace(start, state=np.array([before])), ["pad"])
        assert begin_of(replace(model, start=resumed)).state.tolist() == [state]


@pytest.mark.long
def test_shooting_finds_what_marching_finds() -> None:
    """A gap that is closed for a part of the cycle."""
    chains = [Chain(with_friction(driven(0.3)), (0.9,))]
    ways = [steady_states(chains, FINE, Criterion(1e-9, 500, first)) for first in (NEVER, SHOOT)]
    ((marched,),), ((shot,),) = ways
    assert marched.settled
    assert shot.settled
    np.testing.assert_allclose(shot.amplitude, marched.amplitude, rtol=1e-6)
    assert 0.1 < shot.slip_share[0] < 0.2
    assert shot.cycles < SHOOT + 10 < marched.cycles


def test_recorded_forces_are_those_of_the_law() -> None:
    """While the gap closes n lies above the spring's force, while it opens below."""
    from timesim.engine.history import sample
    from timesim.engine.trajectory import Phase, Run

    model = driven(0.3)
    steps = next(iter(Run(model, [Phase(0.9, 3)], FINE).batches()))
    samples = sample(steps, np.linspace(0, 3 / 0.9, 500))
    force, motion = contact_forces(model, samples)
    touching = samples.state[:, 0] == SLIP
    spring = STIFFNESS * (motion[touching, 0, 2] - 0.02)
    assert touching.sum() > 20
    np.testing.assert_allclose(force[touching, 0, 2], spring * (1 + 0.3 * samples.p[touching, 0]), rtol=1e-9)
    assert not force[~touching].any()
    assert not force[..., :2].any()


def test_nothing_is_left_out_of_what_no_proof_knows() -> None:
    open_for_ever = driven(0.3, -1e6)
    assert reduction_of(open_for_ever, [0.9]).live.tolist() == [0]
    cone = replace(open_for_ever, contacts=(replace(open_for_ever.contacts[0], law=CONE),))
    assert reduction_of(cone, [0.9]).apart.tolist() == [0]


def test_what_knows_the_cone_alone_refuses() -> None:
    motion = HarmonicMotion(1.0, 0.0, 0.5)
    with pytest.raises(ValueError, match="contact pad: prescribed motion knows the law cone only, not hunt_crossley"):
        steady_cycle(stop(0.1), motion)
    with pytest.raises(ValueError, match="contact pad: prescribed motion knows the law cone only, not hunt_crossley"):
        single_element(stop(0.1), motion)
    with pytest.raises(ValueError, match="law"):
        Balance(driven(0.3), 0.9, Scheme(3, 64))
