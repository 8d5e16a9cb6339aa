"""Steady states by shooting: against marching, and the exact derivative of the return map against differences."""

from dataclasses import replace

import numpy as np
import pytest
import zoo
from simulation import after_a_cycle, simulate
from systems import at_rest, excitation, generated_model, oscillator, pad, structure

from timesim.engine.law.contact_law import Motion
from timesim.engine.law.table import begin_of
from timesim.model.model import SEPARATION, SLIP, Model
from timesim.model.reduction import reduction_of
from timesim.model.scales import scales_of
from timesim.model.solver import NEVER, PRESETS, SHOOT, Criterion, Solver
from timesim.orbit.batch import march_lanes, record
from timesim.orbit.lane import Lane
from timesim.orbit.settling import Chain, first_lane, steady_states
from timesim.orbit.threshold import CYCLES_A_ROUND
from timesim.study.registry import load_scene

pytestmark = pytest.mark.long

FINE = Solver("tsit5", 1e-9, 1e-11, reduce=False)
FINEST = replace(FINE, rtol=1e-12, atol=1e-14)
TOLERANCE = 1e-10


def chain(model):
    return Chain(model, (model.excitation.frequency,))


def both_ways(models, solver=FINE, max_cycles=500):
    chains = [chain(model) for model in models]
    by_march = steady_states(chains, solver, Criterion(TOLERANCE, max_cycles, NEVER))
    by_newton = steady_states(chains, solver, Criterion(TOLERANCE, max_cycles, SHOOT))
    return [orbit for (orbit,) in by_march], [orbit for (orbit,) in by_newton]


def partly(orbit):
    """Slip for a part of the cycle; and separation for a part of it."""
    slips = np.any((orbit.slip_share > 0.02) & (orbit.slip_share < 0.98))
    return slips, slips and np.any((orbit.separation_share > 0.02) & (orbit.separation_share < 0.98))


def assert_both_agree(models, wanted, solver=FINE):
    """March and shooting agree on every motion that repeats and slips; at least so many, a third with separation."""
    marched, shot = both_ways(models, solver)
    separating = []
    for number, (one, other) in enumerate(zip(marched, shot, strict=True)):
        if not (one.settled and one.period == 1 and partly(one)[0]):
            continue
        separating.append(partly(one)[1])
        size = np.max(one.amplitude)
        assert other.settled, number
        np.testing.assert_allclose(other.amplitude, one.amplitude, atol=1e-7 * size, rtol=0, err_msg=str(number))
        np.testing.assert_allclose(other.slip_share, one.slip_share, atol=1e-6, err_msg=str(number))
        assert np.abs(other.floquet[0]) < 1
        assert np.abs(other.floquet[0]) == pytest.approx(np.abs(one.floquet[0]), abs=1e-6)
    print(f"{len(separating)} motions slip for a part of the cycle, {sum(separating)} of them also separate")
    assert len(separating) >= wanted
    assert sum(separating) >= wanted / 3
    cycles = [sum(orbit.cycles for orbit in orbits) for orbits in (marched, shot)]
    assert cycles[1] < cycles[0]


def test_shooting_finds_what_marching_finds():
    cases = [(3.0, 1.39), (-1.0, 0.97), (5.0, 1.52), (0.0, 0.97), (-4.0, 0.93), (1.0, 1.25)]
    assert_both_agree([oscillator(*case) for case in cases], 6)


@pytest.mark.slow
def test_shooting_finds_what_marching_finds_on_generated_scenes():
    models = [generated_model(seed, 2, 1) for seed in range(48)] + [generated_model(seed, 3, 2) for seed in range(16)]
    # No tolerance controls a derivative: at 1e-9 one multiplier of these errs by 6e-6, at a neighbouring atol by 1e-8.
    assert_both_agree(models, 30, replace(FINE, rtol=1e-11, atol=1e-13))


def settled_lane(model, solver=FINEST):
    (orbit,) = steady_states([chain(model)], solver, Criterion(TOLERANCE, 1500, SHOOT))[0]
    assert orbit.settled
    everything = reduction_of(model, [model.excitation.frequency], reduce=False)
    return Lane.begin(model, everything, model.excitation.frequency, solver, orbit.end), orbit


def wide_model(frequency):
    """The oscillator on its contact beside 32 modes that move it little."""
    rows = np.arange(32)
    natural = 2 * np.pi * np.concatenate([[0.9, 1.1], 1.5 + 0.1 * rows])
    little = 0.05 * np.cos(np.add.outer(rows, [0.0, 1.0, 2.0]))
    body = structure(natural**2, 0.04 * natural, [[1.0, 1.0, 0.8], [1.0, -1.0, 0.6], *little])
    force = excitation(frequency, [5.0, 5.0, *np.zeros(32)], np.zeros(34))
    return Model(body, (pad(0.5, 20.0, 20.0, 3.0),), force, at_rest(34, 1))


def lane_at_rest(model):
    """A lane at the start of a model, nothing left out of it."""
    return first_lane(chain(model), FINE)


def differences(lane, solver, reach=1e-5):
    """Derivative of the state after a cycle by central differences, entries of separated contacts left out."""
    here = lane.vector
    size = np.max(np.abs(here))
    free = np.flatnonzero(~lane.apart)
    lanes = [lane.moved(here + side * reach * size * np.eye(here.size)[i]) for i in free for side in (1, -1)]
    assert None not in lanes
    ends = after_a_cycle(lanes, solver)
    slope = np.zeros((here.size, here.size))
    slope[:, free] = ((ends[::2] - ends[1::2]) / (2 * reach * size)).T
    return slope


@pytest.mark.parametrize(
    ("case", "solver"),
    [
        *(((n0, frequency), FINEST) for n0, frequency in ((-1.0, 0.97), (-4.0, 0.93), (3.0, 1.39), (0.5, 1.0))),
        pytest.param((-1.0, 0.97), replace(PRESETS["reference"], reduce=False), marks=pytest.mark.slow),
    ],
)
def test_multipliers_are_those_of_the_return_map(case, solver):
    """Of motions that slip, stick and separate; in slip at the section the state on the cone is moved along it."""
    lane, orbit = settled_lane(oscillator(*case), solver)
    assert partly(orbit)[0]
    exact = record([lane], solver, [1])[0]
    slope = differences(lane, solver)
    expected = np.linalg.eigvals(slope)
    expected = expected[np.argsort(-np.abs(expected))]
    found = np.zeros(expected.size, dtype=complex)
    found[: exact.multipliers.size] = exact.multipliers
    np.testing.assert_allclose(np.abs(found), np.abs(expected), atol=1e-6)
    np.testing.assert_allclose(exact.slope, slope, atol=3e-6 * max(1, np.abs(exact.slope).max()))


def sliding_fast(seed, share):
    """A generated stiff contact that slides fast under little load; at a share of the first natural frequency."""
    model, base = zoo.structure(seed, (2e-2, 0.3), (3, 1))
    load = replace(model.excitation, frequency=share * base, cosine=8 * np.abs(model.excitation.cosine))
    return replace(model, excitation=load)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["tsit5", "dopri8"])
@pytest.mark.parametrize("case", [(413, 0.5), (420, 1.1), (425, 0.6)], ids=str)
def test_multipliers_where_an_explicit_step_does_not_resolve_the_direction_of_slip(case, method):
    """Each such step would multiply a disturbance of it, up to 1e15 times in a cycle; truth by differences."""
    fine = Solver("exponential", 1e-11, 1e-13)
    lane, orbit = settled_lane(sliding_fast(*case), fine)
    assert partly(orbit)[0]
    expected = np.abs(np.linalg.eigvals(differences(lane, fine, reach=1e-6)))
    found = np.zeros(expected.size)
    solver = Solver(method, 1e-7, 1e-9)
    own = np.abs(record([lane.at(lane.frequency, orbit.end, solver)], solver, [1])[0].multipliers)
    found[: own.size] = own
    np.testing.assert_allclose(found, np.sort(expected)[::-1], rtol=0, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("rtol", [1e-5, 1e-7])
def test_multipliers_of_fast_modes_that_the_motion_hardly_shows(rtol):
    """Of themselves steps as long as the motion allows let such a mode grow up to 94 times in a cycle."""
    model, base = zoo.structure(704, (5e-5, 3e-4), (4, 1))
    load = replace(model.excitation, frequency=0.9 * base, cosine=300 * np.abs(model.excitation.cosine))
    fine, solver = Solver("exponential", 1e-9, 1e-12), Solver("tsit5", rtol, 1e-3 * rtol)
    lane, orbit = settled_lane(replace(model, excitation=load), fine)
    expected = np.sort(np.abs(np.linalg.eigvals(differences(lane, fine, reach=1e-6))))[::-1]
    found = np.abs(record([lane.at(lane.frequency, orbit.end, solver)], solver, [1])[0].multipliers)
    assert 0.999 < expected[0] < 0.9992
    np.testing.assert_allclose(found[:2], expected[:2], rtol=0, atol=2e-6)
    assert found.max() < 1


def test_a_stuck_offset_is_free_and_left_alone():
    """In full stick the motion settles around any offset: no multiplier shows it, and shooting does not move it."""
    model = oscillator(64.0, 1.3)
    offset = np.array([[0.02, -0.01]])
    moved = replace(model, start=replace(begin_of(model), slip=offset))
    orbits = [both_ways([m])[1][0] for m in (model, moved)]
    assert all(orbit.settled and orbit.slip_share[0] == 0 for orbit in orbits)
    np.testing.assert_allclose(orbits[1].end.slip, offset, atol=1e-12)
    np.testing.assert_allclose(orbits[1].amplitude, orbits[0].amplitude, rtol=1e-7)
    assert np.abs(orbits[1].floquet[0]) < 0.99


@pytest.mark.parametrize("push", [{"constant_forces": 1.0}, {"forces": 1.0}])
@pytest.mark.parametrize("also_a_spring", [False, True])
def test_a_body_that_nothing_holds_settles_unless_it_runs_away(push, also_a_spring):
    """Pushed by a constant force it runs away, by one that begins as a sine it keeps a mean velocity F / (m omega)."""
    ((kind, size),) = push.items()
    force = {"point": "body", "direction": [1, 0, 0], "amplitude": size}
    modes = [{"frequency": 0.0, "damping_ratio": 0.0, "mass": 2.0, "shape": {"body": [1, 0, 0]}}]
    modes += [{"frequency": 3.0, "damping_ratio": 0.05, "mass": 1.0, "shape": {"body": [0.4, 0, 0]}}] * also_a_spring
    scene = {
        "structure": {"modes": modes},
        "excitation": {"frequency": 1.0, kind: [force | ({"phase_deg": -90.0} if kind == "forces" else {})]},
        "study": {"kind": "transient", "cycles": 1},
    }
    model = load_scene(scene).model()
    ((orbit,),) = steady_states([chain(model)], PRESETS["standard"], Criterion(1e-8, 100, SHOOT))
    assert orbit.reason is None
    assert orbit.settled == (kind == "forces")
    steady = size / (2.0 * 2 * np.pi) if orbit.settled else 0.0
    np.testing.assert_allclose(orbit.drift, [[steady, 0, 0]], rtol=1e-6, atol=1e-12)


def test_a_place_out_of_its_contact_state_is_refused():
    model = oscillator(-4.0, 0.93)
    lane, _ = settled_lane(model)
    assert lane.here.state[0] == SEPARATION
    far = lane.vector.copy()
    far[:2] += 100.0
    assert lane.moved(far) is None
    np.testing.assert_allclose(lane.moved(lane.vector).vector, lane.vector)


def frictionless_stop(preload, frequency):
    """The oscillator's contact without friction: its slip is its motion, and it counts as slipping while closed."""
    model = oscillator(preload, frequency)
    stop = replace(model.contacts[0], friction=0.0, tangential_stiffness=np.zeros((2, 2)))
    return replace(model, contacts=(stop,))


@pytest.mark.parametrize("preload", [3.0, 0.2])
def test_a_closed_frictionless_stop_is_shot(preload):
    """Closed throughout the motion is linear; opening within the cycle it is not."""
    model = frictionless_stop(preload, 1.1)
    (marched,), (shot,) = both_ways([model], max_cycles=2000)
    assert shot.settled
    assert (shot.separation_share[0] == 0) == (preload == 3.0)
    np.testing.assert_allclose(shot.amplitude, marched.amplitude, atol=1e-7 * np.max(marched.amplitude), rtol=0)
    assert shot.cycles < SHOOT + 10 < marched.cycles
    if preload == 3.0:  # in closed form, and one cycle shows it
        assert (shot.cycles, shot.settled_to) == (SHOOT + 1, 0.0)


def test_every_cycle_of_a_shot_counts_once(monkeypatch):
    """Two rounds of marching, then one cycle an iteration of Newton's method; the last one is measured as well."""
    recorded = []

    def counted(lanes, solver, num_cycles, *most, **each):
        recorded.append(sum(num_cycles))
        return record(lanes, solver, num_cycles, *most, **each)

    monkeypatch.setattr("timesim.orbit.settling.record", counted)
    (orbit,) = steady_states([chain(oscillator(3.0, 1.39))], FINE, Criterion(TOLERANCE, 500, SHOOT))[0]
    shots = sum(recorded)
    assert orbit.settled
    assert shots < 8
    assert orbit.cycles == SHOOT + shots


@pytest.mark.parametrize("speed", [0.0, 1e-9, 0.3])
def test_no_reversal_ends_the_slip_of_a_frictionless_stop(speed):
    """It cannot stick: where its motion turns there is no transition, and only the normal load ends its contact."""
    law = lane_at_rest(frictionless_stop(3.0, 1.1)).system.law
    none, v = np.zeros(1), np.array([0.01])
    load, to_stick = law.margins(np.array([SLIP]), Motion((none, none), v, (none + speed, none), -v), (none, none))
    assert to_stick[0] == 1
    assert load[0] == pytest.approx(law.preload[0] + law.normal_stiffness[0] * v[0])
    touching = Motion((none, none), none, (none + speed, none), none + 1.0)
    assert law.successor(np.array([SEPARATION]), touching)[0] == SLIP


@pytest.mark.slow
def test_lanes_of_a_wide_system_end_where_each_ends_alone():
    """One after the other: each keeps its own frequency, and the same transitions."""
    lanes = [lane_at_rest(wide_model(frequency)) for frequency in (1.0, 1.1)]
    assert lanes[0].system.wide
    done = march_lanes(lanes, FINE, CYCLES_A_ROUND)
    for frequency, (_, returns) in zip((1.0, 1.1), done, strict=True):
        trace = simulate(wide_model(frequency), CYCLES_A_ROUND, FINE)
        scales = scales_of(wide_model(frequency), frequency)
        np.testing.assert_allclose(returns[-1][:34] * scales.mode, trace.run.displacement, rtol=0, atol=1e-11)
        assert len(trace.sequence) > 2 * CYCLES_A_ROUND


def test_the_state_after_a_cycle_is_that_of_the_lane():
    """Displacements, velocities and slips: what is compared from cycle to cycle is the whole state."""
    ((lane, returns),) = march_lanes([lane_at_rest(oscillator(3.0, 1.39))], FINE, CYCLES_A_ROUND)
    point = lane.here.point
    assert np.all(lane.here.state != SEPARATION)
    np.testing.assert_array_equal(returns[-1], np.concatenate([point.q, point.p, *point.w]))
    assert np.all(returns[-1][4:] != 0)
