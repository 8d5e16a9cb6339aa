"""Settled motions by marching, against amplitudes computed independently (DOP853 with located events, rtol 1e-12)."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulation import simulate
from systems import circular, circular_radius, oscillator

import timesim
from timesim.engine.status import RunError, Status
from timesim.model.solver import NEVER, PRESETS, SHOOT, SLOW, Criterion, Solver
from timesim.orbit.cycle import modal_coefficients
from timesim.orbit.fourier import phase_deg, to_phasors
from timesim.orbit.recurrence import Recurrence, is_irregular, nearest_period, recurrence_of, without_way
from timesim.orbit.search import Search, Task, after_march, after_measure, after_shot
from timesim.orbit.settling import Chain, first_lane, steady_states, warm_up
from timesim.orbit.shooting import Converged, Failure, Shot
from timesim.orbit.steady_state import without_orbit
from timesim.orbit.threshold import CYCLES_A_ROUND, LONGEST

HELD = np.zeros((0, 2))  # no body moves without an effect
SETTLED = {(3.0, 1.39): 0.15612878, (-1.0, 0.97): 0.28839155, (5.0, 1.52): 0.15680399}


def settled(preload, frequency, solver=PRESETS["standard"], **criterion):
    chain = Chain(oscillator(preload, frequency), (frequency,))
    ((orbit,),) = steady_states([chain], solver, Criterion(**criterion))
    return orbit


@pytest.fixture(scope="module")
def orbits():
    return [settled(*case) for case in SETTLED]


@pytest.mark.long
def test_settled_amplitudes(orbits):
    for orbit, amplitude in zip(orbits, SETTLED.values(), strict=True):
        assert orbit.settled
        assert orbit.period == 1
        assert orbit.reason is None
        assert orbit.amplitude[0, 0] == pytest.approx(amplitude, rel=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("cycles", [700, 980])
def test_a_decay_that_takes_its_time_is_not_called_irregular(cycles):
    """It settles after 994 cycles. At 700 free vibrations have decayed to 3 %; at 980 nothing touches any more."""
    modes = [{"frequency": 12.5, "damping_ratio": 0.001, "mass": 0.02, "shape": {"mid": [0, 1, 0]}}]
    modes += [{"frequency": 49, "damping_ratio": 0.001, "mass": 0.02, "shape": {"mid": [0, 0.6, 0.2]}}]
    stop = {"name": "up", "point": "mid", "normal": [0, 1, 0], "friction": 0.2, "tangential_stiffness": 15}
    scene = {
        "structure": {"modes": modes},
        "contacts": [stop | {"normal_stiffness": 200, "preload": -100}],
        "excitation": {"forces": [{"point": "mid", "direction": [0, 1, 0], "amplitude": 5}]},
        "initial": {"modal_displacement": [13.0, 0.0]},
        "study": {"kind": "sweep", "frequency": {"values": [15.3]}, "periodic": "shoot"},
    }
    result = timesim.run(scene, {"study.settle.max_cycles": cycles})
    assert result["settled"].item() == 0
    assert result["irregular"].item() == 0


@pytest.mark.long
def test_the_settled_motion_slips_and_separates(orbits):
    slip = np.array([orbit.slip_share[0] for orbit in orbits])
    apart = np.array([orbit.separation_share[0] for orbit in orbits])
    assert np.all((slip > 0.05) & (slip < 0.95))
    assert list(apart > 0.05) == [False, True, False]


@pytest.mark.long
def test_harmonics_and_power_of_a_settled_motion(orbits):
    """Against a cycle from the same state at the finest tolerance: its samples, and the energy that its loop counts."""
    for orbit, (preload, frequency) in zip(orbits, SETTLED, strict=True):
        model = replace(oscillator(preload, frequency), start=orbit.end)
        modal = to_phasors(modal_coefficients(model, frequency, PRESETS["reference"]).T).T[:10]
        expected = np.einsum("pam,hm->hpa", model.structure.shape, modal)
        np.testing.assert_allclose(orbit.phasor, expected, rtol=0, atol=1e-7 * np.abs(expected).max())
        np.testing.assert_allclose(orbit.dissipated_power, power_over_a_period(orbit, model), rtol=1e-7)


def power_over_a_period(orbit, model):
    """Power lost in each contact, by the energy that a loop at the finest tolerance counts."""
    frequency = model.excitation.frequency
    run = simulate(replace(model, start=orbit.end), orbit.period, PRESETS["reference"]).run
    return frequency * run.work[2:] / orbit.period


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("solver", [Solver("dopri8", 1e-8, 1e-10), Solver("exponential", 1e-7, 1e-9)])
def test_power_over_long_steps(solver):
    """As exact as the motion: in slip, with separation, and with impacts of a stiff stop over two cycles."""
    stop = replace(oscillator(-1e5, 0.9125).contacts[0], tangential_stiffness=5e5 * np.eye(2), normal_stiffness=5e5)
    models = [*(oscillator(*case) for case in SETTLED), replace(oscillator(-1e5, 0.9125), contacts=(stop,))]
    for model in models:
        ((orbit,),) = steady_states([Chain(model, (model.excitation.frequency,))], solver, Criterion())
        np.testing.assert_allclose(orbit.dissipated_power, power_over_a_period(orbit, model), rtol=1e-7)
    assert orbit.period == 2


@pytest.mark.long
def test_harmonics_do_not_depend_on_the_phase_of_the_start(orbits):
    model = oscillator(3.0, 1.39)
    chain = Chain(replace(model, start=replace(model.start, phase=0.7)), (1.39,))
    ((orbit,),) = steady_states([chain], PRESETS["standard"], Criterion())
    np.testing.assert_allclose(orbit.phasor, orbits[0].phasor, rtol=0, atol=1e-6 * orbit.largest)


@pytest.mark.long
def test_slip_in_a_circle():
    """The motion lags behind the force, and the slider moves on a circle of radius (R^2 - delta^2)^(1/2)."""
    omega, radius, elastic, limit = 1.2, circular_radius(1.0, 1.2), 0.3, 0.3
    chain = Chain(circular(1.0, omega), (omega / (2 * np.pi),))
    ((orbit,),) = steady_states([chain], PRESETS["standard"], Criterion())
    assert orbit.dissipated_power[0] == pytest.approx(limit * omega * np.sqrt(radius**2 - elastic**2), rel=1e-6)
    spring = (elastic / radius) ** 2
    lag = np.arctan2(0.02 * omega + elastic * np.sqrt(radius**2 - elastic**2) / radius**2, 1 - omega**2 + spring)
    phase = phase_deg(orbit.phasor)[0]
    np.testing.assert_allclose(phase[:2], np.rad2deg([-lag, -lag - np.pi / 2]) % 360 - [360, 0], rtol=1e-6)
    assert np.isnan(phase[2])


@pytest.mark.long
def test_a_motion_that_has_not_settled_is_recognised(orbits):
    orbit = settled(3.0, 1.39, max_cycles=CYCLES_A_ROUND)
    assert not orbit.settled
    assert orbit.period == 0
    assert np.all(orbit.amplitude > 0)
    assert np.isnan(orbit.phasor).all()
    assert orbit.cycles == CYCLES_A_ROUND + 10  # of which its amplitude is taken, and the band of that of each
    assert np.all(orbit.band[1] > orbit.band[0] * (1 + 1e-4))
    assert orbit.dissipated_power == pytest.approx(orbits[0].dissipated_power, rel=0.2)  # the mean of ten cycles


@pytest.mark.long
def test_a_march_that_fails_says_why():
    orbit = settled(3.0, 1.39, Solver("tsit5", 1e-7, 1e-9, budget=30))
    assert orbit.reason is not None
    assert "budget of 30 steps" in orbit.reason
    assert np.all(np.isnan(orbit.amplitude))


@pytest.mark.long
def test_a_chain_begins_anew_after_a_motion_that_fails(monkeypatch):
    """As if the failed frequency had not been in it: with its contact apart, as it is at rest."""

    def fails(search, lane, returns, solver, criterion):
        if lane.frequency == 0.96:
            return replace(search, task=Task.DONE, orbit=without_orbit(lane.model, "it broke", 3))
        return after_march(search, lane, returns, solver, criterion)

    monkeypatch.setattr("timesim.orbit.settling.after_march", fails)
    model = oscillator(-1.0, 0.97)
    chains = [Chain(model, (0.96, 0.97)), Chain(model, (0.97,))]
    (failed, anew), (alone,) = steady_states(chains, PRESETS["standard"], Criterion())
    assert failed.reason == "it broke"
    assert (anew.reason, anew.cycles) == (None, alone.cycles)
    np.testing.assert_allclose(anew.amplitude, alone.amplitude, rtol=1e-12)


def test_periods_of_sequences():
    """A slow drift is not taken for rest, and two to four cycles for one period."""
    cycles = np.arange(2 * CYCLES_A_ROUND)
    still = np.ones((cycles.size, 3))
    assert recurrence_of(still, 1e-8).period == 1
    assert recurrence_of(still + 1e-10 * (cycles % 2)[:, None], 1e-8).period == 1
    for period in (2, 3, 4):
        assert recurrence_of(still + 0.1 * (cycles % period)[:, None], 1e-8).period == period
    drift = still + (1e-6 * 0.999**cycles)[:, None]
    assert np.max(np.abs(np.diff(drift, axis=0))) < 1e-8
    assert recurrence_of(drift, 1e-8).period == 0
    assert recurrence_of(still + (1e-6 * 0.3**cycles)[:, None], 1e-8).period == 1


@pytest.mark.parametrize("ratio", [0.5, 0.9, 0.99])
def test_what_is_left_of_a_decay_is_all_that_is_to_come(ratio):
    """It is extrapolated from the largest change of the last half of a round, three cycles before the end."""
    decay = 1e-6 * ratio ** np.arange(2 * CYCLES_A_ROUND)
    left = decay[-1] / ratio**3
    for share, period in ((0.99, 0), (1.01, 1)):
        seen = recurrence_of((1 + decay)[:, None], share * left)
        assert seen.period == period
    assert seen.left == pytest.approx(left, rel=1e-4)


def test_the_longest_period_that_a_short_march_shows():
    """That over which half a round of changes is known."""
    returns = np.random.default_rng(4).normal(size=(CYCLES_A_ROUND, 2))[np.arange(12) % CYCLES_A_ROUND]
    assert nearest_period(returns, LONGEST) == Recurrence(CYCLES_A_ROUND, 0.0)


@pytest.mark.parametrize("period", [1, 2, 3])
def test_noise_about_a_motion_of_any_period_leads_nowhere(period):
    """The motion itself moves the state from cycle to cycle, by far more than the noise of the steps."""
    returns = 1 + 0.1 * (np.arange(2 * CYCLES_A_ROUND) % period)[:, None]
    returns = returns + 1e-8 * np.random.default_rng(2).choice([-1.0, 1.0], returns.shape)
    assert recurrence_of(returns, 1e-9).period == 0
    assert recurrence_of(returns, 1e-9, noise=1e-7).period == period


def test_what_is_alike_in_one_cycle_alone_is_no_period():
    """The last state is that of two cycles before."""
    returns = np.array([7.0, 1.0, 0.0, 7.0, 5.0])[np.arange(16) % 5]
    assert nearest_period(returns[:, None]) == Recurrence(5, 0.0)


def test_an_alternation_counts_from_thirty_times_the_tolerance():
    """A smaller one may be the end of a beat that decays: it neither repeats after one cycle nor after two."""
    cycles = np.arange(2 * CYCLES_A_ROUND)
    alternation = 1 + np.stack([cycles % 2] * 3, axis=1) * np.array([1.0, 0.5, 0.2])
    for times, period in ((0.5, 1), (2, 0), (25, 0), (40, 2)):
        assert recurrence_of(1 + times * 1e-8 * (alternation - 1), 1e-8).period == period


@pytest.mark.parametrize("multiplier", [-0.9, -0.97])
def test_a_motion_that_alternates_while_it_decays_has_its_own_period(multiplier):
    """Under a negative multiplier the change over twice the period falls below that over the period."""
    cycles = np.arange(3000)
    for period, multiple in ((1, 2), (2, 4)):
        decays = 1e-3 * (multiplier ** (cycles // period))
        returns = np.stack([1 + decays, 0.3 * (cycles % period)], axis=1)
        seen = [recurrence_of(returns[n - 16 : n], 1e-8).period for n in range(16, len(returns), CYCLES_A_ROUND)]
        assert set(seen) <= {0, period}
        assert seen[-1] == period
        assert multiple not in seen


def test_the_halves_of_a_period_must_differ_clearly():
    """Within the tolerance a motion of four cycles is one of two; just above it a difference may still decay."""
    cycles = np.arange(2 * CYCLES_A_ROUND)
    halves = 0.1 * (cycles % 2)
    for times, period in ((0.5, 2), (2, 0), (25, 0), (40, 4)):
        returns = 1 + halves + times * 1e-8 * (cycles % 4 // 2)
        assert recurrence_of(returns[:, None], 1e-8).period == period


def test_rounding_is_at_rest():
    """A change of rounding does not fall any more: what is left is of its size, not what its ratio leads to."""
    cycles = np.arange(2 * CYCLES_A_ROUND)
    for change in (2e-14, 5e-14):
        for returns in (1 + change * (cycles % 2), 1 + change * cycles):
            seen = recurrence_of(returns[:, None], 1e-8)
            assert seen.period == 1
            assert 0 < seen.left <= 1e-13


def test_a_decaying_vibration_is_no_multiple_period():
    """It nearly repeats after three cycles, by then within the tolerance; one that stays does repeat after three."""
    cycles = np.arange(200)
    free = np.stack([np.cos(2 * np.pi * cycles / 3), np.sin(2 * np.pi * cycles / 3)], axis=1)
    decays = 1 + 0.9 ** cycles[:, None] * free
    found = [recurrence_of(decays[max(0, n - 16) : n], 1e-8).period for n in range(16, 200)]
    assert set(found) == {0, 1}
    assert recurrence_of(1 + 1e-3 * free[-16:], 1e-8).period == 3


def test_what_does_not_repeat_is_told_from_what_is_slow():
    """Changes that neither fall nor are noise are of an irregular motion, if free vibrations would have decayed."""
    rounds, scatter = np.arange(250), np.random.default_rng(5).uniform(0.8, 1.25, 250)
    decays = 0.1 * np.exp(-0.003 * CYCLES_A_ROUND * rounds)
    assert is_irregular(0.1 * scatter, 0.003, 1e-5)
    assert not is_irregular(decays * scatter, 0.003, 1e-5)
    assert not is_irregular(1e-5 * scatter, 0.003, 1e-4)  # noise
    assert not is_irregular(scatter / (1 + rounds), 0.1, 1e-5)  # a contact that creeps
    assert is_irregular(0.1 * scatter * np.exp(-0.002 * rounds), 0.1, 1e-5)  # decays far less than is due
    assert is_irregular(0.03 * scatter * np.where(rounds < rounds.size // 2, 10, 1), 0.003, 1e-5)  # found its way late
    assert not is_irregular(0.1 * scatter, 1e-4, 1e-5)  # hardly damped at all
    assert not is_irregular([0.1] * 3, 0.003, 1e-5)
    assert not is_irregular(1e-3 * scatter * np.exp(0.015 * rounds), 0.003, 1e-5)  # leaves an unstable motion


@pytest.mark.parametrize("entry", range(4))
def test_every_entry_of_the_state_must_repeat(entry):
    """One that drifts keeps a motion from settling, be it a slip while all displacements repeat."""
    returns = np.tile([1.0, -0.7, 0.3, 0.2], (2 * CYCLES_A_ROUND, 1))
    assert recurrence_of(returns, 1e-8).period == 1
    returns[:, entry] += 1e-5 * np.arange(len(returns))
    assert recurrence_of(returns, 1e-8).period == 0


def test_the_tolerance_is_relative_to_the_largest_entry():
    """The change that is left, 1e-8 of 100 by a ratio of 0.5, is below the tolerance; that of 1 is not."""
    left = 0.5 ** np.arange(2 * CYCLES_A_ROUND)[:, None] * 1e-6 * 2**CYCLES_A_ROUND
    for size, settled_ in ((1.0, 0), (100.0, 1)):
        assert recurrence_of(np.concatenate([left, np.full_like(left, size)], axis=1), 1e-8).period == settled_


# A search from round to round


def marched(returns, *, cycles=CYCLES_A_ROUND, status=Status.RUNNING, **criterion):
    """A search after its second round, which has led to these states."""
    before = Search(
        0, 0, SimpleNamespace(status=Status.RUNNING), returns=tuple(returns[:CYCLES_A_ROUND]), cycles=cycles
    )
    lane, after = SimpleNamespace(status=status, quiet=0.0, shifts=HELD), returns[CYCLES_A_ROUND:]
    return after_march(before, lane, after, PRESETS["standard"], Criterion(**criterion))


STILL = np.tile([1.0, -0.7, 0.3, 0.2], (2 * CYCLES_A_ROUND, 1))
DRIFT = STILL + 1e-5 * np.outer(np.arange(2 * CYCLES_A_ROUND), [0, 0, 0, 1])


def test_what_repeats_is_measured_and_what_drifts_is_marched_on():
    settled_, drifting = marched(STILL), marched(DRIFT)
    assert (settled_.task, settled_.period, settled_.cycles) == (Task.MEASURE, 1, 2 * CYCLES_A_ROUND)
    assert (drifting.task, drifting.period) == (Task.MARCH, 0)
    spent = marched(DRIFT, max_cycles=2 * CYCLES_A_ROUND)
    assert (spent.task, spent.period) == (Task.MEASURE, 0)


def test_a_motion_whose_cycles_cannot_be_recorded_is_a_point_without_one_and_says_why():
    def orbit(*_, **__):
        raise RunError("a step holds so many vibrations")

    lane = SimpleNamespace(model=oscillator(3.0, 1.39), frequency=1.39, control=SimpleNamespace(rtol=1e-7))
    recorded = SimpleNamespace(complete=True, cycles=2, left=0.0, end=lane, orbit=orbit, is_unstable=False)
    search = Search(0, 0, lane, task=Task.MEASURE, cycles=30, period=1)
    after = after_measure(search, recorded, PRESETS["standard"], Criterion())
    assert (after.task, after.orbit.cycles) == (Task.DONE, 32)
    assert after.orbit.reason == "at 1.39 Hz: a step holds so many vibrations"


def test_what_ends_early_names_the_cycle_in_which_it_does():
    """Counted from 1: the fourth of a round after 16, and the second of those that are measured after 16."""
    lane = replace(first_lane(Chain(oscillator(3.0, 1.39), (1.39,)), PRESETS["standard"]), status=Status.BUDGET)
    search, recorded = Search(0, 0, lane, cycles=16), SimpleNamespace(complete=False, end=lane)
    recorded.steps = SimpleNamespace(cycle=np.array([0, 0, 1]))
    march = after_march(search, lane, np.zeros((3, 4)), PRESETS["standard"], Criterion())
    measure = after_measure(search, recorded, PRESETS["standard"], Criterion())
    for after, cycles in ((march, 19), (measure, 17)):
        assert (after.task, after.orbit.cycles) == (Task.DONE, cycles)
        assert after.orbit.reason.startswith(f"at 1.39 Hz, in cycle {cycles + 1}: ")


def test_it_is_shot_where_that_is_asked_for_and_not_too_early():
    assert marched(DRIFT, first_shot=SHOOT).task is Task.SHOOT
    assert marched(DRIFT, first_shot=SHOOT).shot.period == 1
    assert marched(DRIFT, first_shot=SHOOT, cycles=CYCLES_A_ROUND - 1).task is Task.MARCH
    assert marched(STILL, first_shot=SHOOT).task is Task.MEASURE
    for cycles, task in ((SLOW - CYCLES_A_ROUND - 1, Task.MARCH), (SLOW - CYCLES_A_ROUND, Task.SHOOT)):
        assert marched(DRIFT, cycles=cycles).task is task
    assert marched(DRIFT, first_shot=NEVER, cycles=SLOW).task is Task.MARCH


def test_the_change_after_each_round_is_kept():
    """All of them tell whether a motion settles at all."""
    lane = SimpleNamespace(status=Status.RUNNING, quiet=0.0, shifts=HELD)
    before = Search(0, 0, lane, returns=tuple(DRIFT[:CYCLES_A_ROUND]), changes=(0.1, 0.05), cycles=3 * CYCLES_A_ROUND)
    after = after_march(before, lane, DRIFT[CYCLES_A_ROUND:], PRESETS["standard"], Criterion())
    assert after.changes[:2] == (0.1, 0.05)
    assert after.changes[2:] == (pytest.approx(1e-5),)


@pytest.mark.parametrize(("cycles", "asked"), [(CYCLES_A_ROUND - 0.1, 0), (CYCLES_A_ROUND + 0.1, 1)])
def test_a_proof_that_no_contact_moves_needs_a_round_without_a_transition(cycles, asked, monkeypatch):
    """And three times as many cycles as the one before; where it fails the march goes on."""
    proofs = []
    monkeypatch.setattr("timesim.orbit.search.proven_orbit", lambda lane, solver: proofs.append(lane))
    lane = SimpleNamespace(status=Status.RUNNING, quiet=2 * np.pi * cycles, shifts=HELD)
    search = Search(0, 0, lane, returns=tuple(DRIFT[:CYCLES_A_ROUND]), cycles=CYCLES_A_ROUND)
    counts = []
    for _ in range(5):
        search = after_march(search, lane, DRIFT[CYCLES_A_ROUND:], PRESETS["standard"], Criterion(first_shot=NEVER))
        counts.append(len(proofs))
        assert search.task is Task.MARCH
    assert counts == ([0] * 5 if not asked else [1, 1, 1, 1, 2])  # after 16 and 48 cycles


def test_a_motion_that_is_proven_took_the_cycles_that_led_to_it(monkeypatch):
    known = replace(without_orbit(oscillator(3.0, 1.39), "", 0), reason=None, period=1)
    monkeypatch.setattr("timesim.orbit.search.proven_orbit", lambda lane, solver: known)
    lane = SimpleNamespace(status=Status.RUNNING, quiet=100.0, shifts=HELD)
    before = Search(0, 0, lane, returns=tuple(DRIFT[:CYCLES_A_ROUND]), cycles=CYCLES_A_ROUND)
    after = after_march(before, lane, DRIFT[CYCLES_A_ROUND:], PRESETS["standard"], Criterion())
    assert (after.task, after.orbit.cycles) == (Task.DONE, 2 * CYCLES_A_ROUND)


def test_what_nearly_repeats_after_several_cycles_is_shot_over_these_every_other_time():
    """A free vibration that decays may seem to."""
    turns = DRIFT + 0.1 * (np.arange(2 * CYCLES_A_ROUND) % 3)[:, None]
    lane = SimpleNamespace(status=Status.RUNNING, quiet=0.0, shifts=HELD)
    for attempts, period in ((0, 1), (1, 3), (2, 1)):
        before = Search(0, 0, lane, returns=tuple(turns[:CYCLES_A_ROUND]), cycles=3 * CYCLES_A_ROUND, attempts=attempts)
        last = turns[CYCLES_A_ROUND:]
        after = after_march(before, lane, last, PRESETS["standard"], Criterion(first_shot=SHOOT))
        assert (after.task, after.shot.period, after.attempts) == (Task.SHOOT, period, attempts + 1)


def test_what_repeats_but_for_noise_is_shot_over_its_period():
    noise = 1e-8 * np.random.default_rng(2).choice([-1.0, 1.0], STILL.shape)
    returns = STILL + 0.1 * (np.arange(len(STILL)) % 2)[:, None] + noise
    after = marched(returns, tolerance=1e-9)
    assert (after.task, after.shot.period, after.period) == (Task.SHOOT, 2, 2)
    assert marched(returns, tolerance=1e-9, first_shot=NEVER).task is Task.MEASURE


def measured(left: float = 0.0, period: int = 1, **recorded):
    """A recorded period that repeats, and its orbit: what it was called with."""
    lane = SimpleNamespace(control=SimpleNamespace(rtol=1e-7), frequency=1.39, model=oscillator(3.0, 1.39))
    default = {"complete": True, "closes": True, "cycles": period, "left": left, "is_unstable": False}
    orbit = lambda *given, **named: SimpleNamespace(given=given, **named)  # noqa: E731
    return SimpleNamespace(start=lane, end=lane, orbit=orbit, **(default | recorded))


def test_what_the_derivative_shows_to_be_still_on_its_way_is_shot():
    for left, task in ((0.5e-8, Task.DONE), (2e-8, Task.SHOOT)):
        recorded = measured(left, 2)
        search = Search(0, 0, recorded.start, task=Task.MEASURE, cycles=30, period=2)
        after = after_measure(search, recorded, PRESETS["standard"], Criterion(tolerance=1e-8))
        assert (after.task, after.cycles) == (task, 32)
        assert task is Task.DONE or after.shot == Shot(recorded.end, 2)
    given_up = after_measure(
        replace(after, task=Task.MEASURE), recorded, PRESETS["standard"], Criterion(tolerance=1e-8)
    )
    assert given_up.task is Task.DONE  # as nearly as can be told: it has been shot


def test_what_was_shot_over_several_cycles_is_measured_over_these(monkeypatch):
    """And what is not found where a motion nearly repeats is measured as it is: a march told its period."""
    recorded = measured(period=3)
    search = Search(0, 0, recorded.start, task=Task.SHOOT, cycles=30, shot=Shot(recorded.start, 3))
    for outcome, period in ((Converged(1e-9), 0), (Failure.ASTRAY, 3)):
        monkeypatch.setattr("timesim.orbit.search.iterated", lambda *_, outcome=outcome: outcome)
        after = after_shot(replace(search, period=period), recorded, Criterion())
        assert (after.cycles, after.period) == (33, 3)
        assert after.task is (Task.MEASURE if period else Task.DONE)
        assert period or after.orbit.given == (33, 3, 1e-9)
    assert after_shot(search, recorded, Criterion()).task is Task.MARCH


def test_a_motion_in_which_no_contact_moves_is_not_irregular(monkeypatch):
    """However little it has decayed within its budget."""
    monkeypatch.setattr("timesim.orbit.search.slowest_decay", lambda lane: 0.003)
    changes = tuple(0.1 * np.random.default_rng(5).uniform(0.8, 1.25, 250))
    for is_held in (False, True):
        recorded = measured(period=0, is_held=is_held)
        search = Search(0, 0, recorded.start, task=Task.MEASURE, cycles=2000, changes=changes)
        after = after_measure(search, recorded, PRESETS["standard"], Criterion())
        assert after.orbit.irregular != is_held


def test_what_nearly_repeats_after_a_long_period_is_shot_once_the_budget_is_spent():
    cycles = np.arange(LONGEST + CYCLES_A_ROUND)
    turning = np.stack([np.cos(2 * np.pi * cycles * 5 / 12), np.sin(2 * np.pi * cycles * 5 / 12)], axis=1)
    never = np.stack([np.cos(cycles * np.sqrt(2)), np.sin(cycles * np.sqrt(3))], axis=1)

    def spent(returns, **criterion):
        lane = SimpleNamespace(status=Status.RUNNING, quiet=0.0, shifts=HELD)
        before = Search(0, 0, lane, returns=tuple(returns[:-CYCLES_A_ROUND]), cycles=LONGEST)
        last, criterion = returns[-CYCLES_A_ROUND:], Criterion(max_cycles=len(returns), **criterion)
        return after_march(before, lane, last, PRESETS["standard"], criterion)

    found = spent(turning)
    assert (found.task, found.shot.period, found.last) == (Task.SHOOT, 12, True)
    marched_only = spent(turning, first_shot=NEVER)  # a shot may lead elsewhere
    assert (marched_only.task, marched_only.period) == (Task.MEASURE, 12)
    assert spent(turning * 0.999 ** cycles[:, None], first_shot=NEVER).period == 0
    decays = 1e-8 * (-0.97) ** (cycles // 5)  # changes less over ten cycles than over five
    assert spent(np.stack([cycles % 5, decays], axis=1), first_shot=NEVER).period == 5
    assert spent(never).task is Task.MEASURE
    assert spent(turning[CYCLES_A_ROUND:]).task is Task.MEASURE  # too short a march
    failed = after_shot(found, SimpleNamespace(closes=False, cycles=12), Criterion())
    assert failed.task is Task.MEASURE


@pytest.mark.long
def test_what_a_chain_needs_is_compiled_though_at_its_first_frequency_no_contact_could_move(monkeypatch):
    """With one frequency more is proven than with several, so that of the first tells nothing of the chain."""
    compiled = []
    monkeypatch.setattr("timesim.orbit.settling.march_lanes", lambda *given: compiled.append(given))
    monkeypatch.setattr("timesim.orbit.settling.record", lambda *given: compiled.append(given))
    model, solver = oscillator(3.0, 0.2), PRESETS["standard"]
    warm_up([Chain(model, (0.2,))], solver)
    assert not compiled, "it sticks at rest"
    warm_up([Chain(model, (0.2, 1.39))], solver)
    assert len(compiled) == 2


@pytest.mark.parametrize(("speed", "slides"), [(0.3, True), (1e-6, False)])
def test_the_way_of_a_body_that_slides_on_does_not_count(speed, slides):
    """Its place is the first entry; one that hardly moves has to come to rest."""
    count = np.arange(16)
    returns = np.stack([5 + speed * count, np.ones(16), 0.5 ** (20 + count)], axis=1)
    left = without_way(returns, np.array([[1.0, 0.0, 0.0]]))
    assert (recurrence_of(left, 1e-7).period == 1) == slides
    np.testing.assert_array_equal(left[:, 1:], returns[:, 1:])
