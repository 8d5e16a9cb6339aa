"""The steady state of a scene that is linear: no contact is left in it, or none leaves its state any more.

With the contacts that a reduction has proven to stick taken into the stiffness, a lane is

    q'' + D q' + K q = p_0 + sum_h Re(p_h exp(i h (t + phase)))

whose steady state is ``q_h = (K - h^2 + i h D)^-1 p_h``; it is reached from any start if all eigenvalues decay.
"""

from dataclasses import replace

import numpy as np

from timesim.engine.system import Point, System
from timesim.model.contact_state import obeys_cone
from timesim.model.model import SEPARATION, SLIP
from timesim.model.reduction import Reduction, keeps_states, reduction_of
from timesim.model.solver import Solver
from timesim.orbit.fourier import HARMONICS, half_range
from timesim.orbit.lane import Lane
from timesim.orbit.monodromy import HybridState
from timesim.orbit.steady_state import Orbit

ROUNDING = 1e-14
"""Decay, as a share of the fastest rate, that is rounding: of a dashpot's modes one without damping has some of it."""


def linear_orbit(lane: Lane) -> Orbit | None:
    """The steady state of a lane without a contact in it; None if it has contacts, or not all of its motions decay."""
    system, here = lane.system, lane.here
    if here.state.size:
        return None
    K, D = _matrices(lane)
    rates = _rates(K, D)
    if not np.all(rates.real < -ROUNDING * np.abs(rates).max()):
        return None
    phasor = _phasors(system, K, D)
    turn = np.exp(1j * np.arange(len(phasor)) * float(system.phase))[:, None]
    q, p = ((turn * phasor).real.sum(axis=0), (1j * np.arange(len(phasor))[:, None] * turn * phasor).real.sum(axis=0))
    end = replace(lane, here=HybridState(Point(q, p, here.point.w, None), here.state)).start()
    motion = (phasor @ lane.frame.shape.T).reshape(-1, len(lane.model.structure.points), 3)
    amplitude = half_range(motion[None])[0]
    kept = np.zeros((HARMONICS + 1, *amplitude.shape), complex)
    kept[: len(motion)] = motion[: HARMONICS + 1]
    slips, apart, lost = np.zeros((3, lane.model.num_contacts))
    apart[lane.reduction.apart] = 1.0
    multipliers = np.exp(2 * np.pi * rates)
    return Orbit(
        end=end,
        amplitude=amplitude,
        band=np.stack([amplitude, amplitude]),
        cycles=0,
        period=1,
        slip_share=slips,
        separation_share=apart,
        phasor=kept,
        dissipated_power=lost,
        floquet=multipliers[np.argsort(-np.abs(multipliers))],
        cycle_steps=0.0,
        cycle_transitions=np.zeros(lane.model.num_contacts),
        drift=np.zeros_like(amplitude),
    )


def slowest_decay(lane: Lane) -> float:
    """Least decay of a free motion over a cycle, of the logarithm of its amplitude; friction adds to it."""
    K, D = _matrices(lane)
    rates = _rates(K, D)
    moves = np.abs(rates) > ROUNDING * np.abs(rates).max()  # a free body stays where it is
    rings = 0.5 * np.linalg.eigvalsh(0.5 * (D + D.T))[0]
    # An overdamped motion creeps, more slowly the more it is damped.
    return float(2 * np.pi * np.min(-rates.real, initial=rings, where=moves))


def _matrices(lane: Lane) -> tuple[np.ndarray, np.ndarray]:
    """K and D of the modes kept, shape (M, M)."""
    system, own = lane.system, slice(lane.reduction.modes.size)
    D = np.asarray(system.damping)
    return np.diag(system.stiffness[own]), np.diag(D[own]) if D.ndim == 1 else D[own, own]


def _rates(K: np.ndarray, D: np.ndarray) -> np.ndarray:
    """Eigenvalues of the free motions, shape (2 M,)."""
    return np.linalg.eigvals(np.block([[np.zeros_like(K), np.eye(len(K))], [-K, -D]]))


def proven_orbit(lane: Lane, solver: Solver) -> Orbit | None:
    """The steady state of a lane in which no contact will ever leave its state from now on; None without a proof."""
    model = replace(lane.model, start=lane.start())
    if not solver.reduce or not keeps_states(model, lane.frequency):
        return None
    reduction = reduction_of(model, [lane.frequency])
    return linear_orbit(Lane.begin(model, reduction, lane.frequency, solver, model.start))


def held_lane(lane: Lane, solver: Solver) -> Lane | None:
    """A lane in the steady state that it has if every contact keeps its state and, stuck, its slip.

    Whether it does shows over the next cycle. None where a contact slips with friction or has another law than the
    cone, not all motions decay, or the cycle would not even start in those states.
    """
    start, model = lane.start(), lane.model
    rubs = (start.state == SLIP) & (model.friction > 0)
    if rubs.any() or not obeys_cone(model).all():
        return None
    # Without friction a closed contact has no tangential stiffness: it adds to the structure as a stuck one does.
    apart, none = start.state == SEPARATION, np.zeros(0, dtype=int)
    stuck = replace(model, start=start)
    held = Reduction(stuck, lane.reduction.modes, none, np.flatnonzero(~apart), np.flatnonzero(apart), None, ())
    orbit = linear_orbit(Lane.begin(stuck, held, lane.frequency, solver, start))
    if orbit is None:
        return None
    steady = lane.at(lane.frequency, replace(orbit.end, state=start.state), solver)
    return steady.moved(steady.vector)


def _phasors(system: System, K: np.ndarray, D: np.ndarray) -> np.ndarray:
    """Response by harmonic 0, 1, ... of the excitation, the highest one last, shape (H + 1, M)."""
    order = np.asarray(system.harmonic).astype(int)
    force = np.zeros((order.max(initial=0) + 1, len(K)), complex)
    np.add.at(force, order, np.asarray(system.cosine) - 1j * np.asarray(system.sine))
    force[0] += np.asarray(system.constant)
    h = np.arange(len(force))[:, None, None]
    return np.linalg.solve(K - h**2 * np.eye(len(K)) + 1j * h * D, force[..., None])[..., 0]
