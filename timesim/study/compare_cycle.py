"""One cycle of a motion by both methods: displacement, states of the contacts and harmonics side by side."""

import timesim.runtime  # noqa: F401  isort: skip

from collections.abc import Mapping
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from xarray import Dataset

from timesim.engine.history import Samples
from timesim.hbm.balance import Array, Balance, Complex
from timesim.hbm.curve import HbmCurve
from timesim.hbm.period import closed_period, ends_of, motion_of
from timesim.hbm.scheme import Scheme
from timesim.model.contact_state import contact_loads, contact_state, slip_follows_motion
from timesim.model.model import SEPARATION, SLIP, STICK, Model, Start
from timesim.model.solver import Solver
from timesim.orbit.basin import INSIDE
from timesim.orbit.cycle import one_cycle
from timesim.orbit.fourier import fourier_basis, fourier_coefficients
from timesim.orbit.settling import Chain, Criterion, steady_states
from timesim.result.coordinate import coordinates
from timesim.result.dataset import dataset

SAMPLES = 720
METHODS = ("sweep", "hbm")


class NotSettledError(Exception):
    """Time integration from a solution of the balance does not come to rest; the message says why."""


def cycle_by_both(
    model: Model,
    solution: HbmCurve,
    scheme: Scheme,
    solver: Solver,
    criterion: Criterion,
    values: Mapping[str, float],
) -> Dataset:
    """A cycle by time integration, started from the solution and settled, and by harmonic balance.

    Args:
        model: what moves.
        solution: one stable solution.
        scheme, solver: of the two methods.
        criterion: when the motion counts as settled.
        values: of the further axes, for the attributes.

    Raises:
        NotSettledError: time integration does not lead to a motion that repeats each cycle.
    """
    frequency, order = float(solution.frequency[0]), scheme.harmonics + 1
    balance = Balance(model, frequency, scheme)
    coefficient = solution.contact_motion[0] / balance.length
    modal = balance.modes(coefficient.ravel(), solution.contact_force[0] / balance.force, frequency)
    elastic, states = _contacts(balance, coefficient)
    start = _start(model, balance, coefficient, modal, elastic, frequency)
    marched = _settled_cycle(replace(model, start=start), frequency, solver, criterion)
    angle = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
    q = np.einsum("kh,hm->km", np.exp(1j * np.outer(angle, np.arange(len(modal)))), modal).real
    x = np.stack([np.einsum("pam,km->kpa", model.structure.shape, motion) for motion in (marched.q[:-1], q)])
    # The samples end where the phase is that of the last of them, one interval before a whole turn.
    found = np.stack([fourier_coefficients(motion, -2 * np.pi / SAMPLES)[: 2 * order - 1] for motion in x])
    height = np.concatenate([found[:, :1], np.hypot(found[:, 1::2], found[:, 2::2])], axis=1)
    state = np.stack([marched.state[:-1], states]).astype(np.int8)
    variables = {
        "displacement": (("found_by", "excitation_angle", "point", "axis"), x),
        "contact_state": (("found_by", "excitation_angle", "contact"), state),
        "harmonic_amplitude": (("found_by", "harmonic", "point", "axis"), height),
    }
    coords = {"found_by": np.array(METHODS), "excitation_angle": np.rad2deg(angle)} | coordinates(variables, model)
    place = ", ".join([f"{frequency:g} Hz", *(f"{key} {value:g}" for key, value in values.items())])
    return dataset(variables, coords, {"place": place})


def _contacts(balance: Balance, coefficient: Array) -> tuple[Array, Array]:
    """Elastic displacement of each contact at phase 0, shape (C, 2), and its states at the angles of the cycle.

    The state is that over most of the interval of the balance's own samples.
    """
    motion = motion_of(balance.basis, jnp.asarray(coefficient))
    period = closed_period(balance.law, motion)
    ends = ends_of(balance.law, motion, period)
    shares = {STICK: 1 - ends.slip - ends.separation, SLIP: ends.slip, SEPARATION: ends.separation}
    states = np.argmax([shares[state] for state in sorted(shares)], axis=0)
    elastic = np.stack([np.asarray(part) for part in period.start], axis=1)
    return elastic, states[np.arange(SAMPLES) * len(states) // SAMPLES]


def _start(
    model: Model, balance: Balance, coefficient: Array, modal: Complex, elastic: Array, frequency: float
) -> Start:
    """State of the solution at phase 0, friction forces inside their cones: they hold to the balance's tolerance."""
    displacement = modal.real.sum(axis=0)
    speed = (1j * np.arange(len(modal))[:, None] * 2 * np.pi * frequency * modal).real.sum(axis=0)
    here = coefficient @ fourier_basis(np.zeros(1), coefficient.shape[2])[0]
    loads = contact_loads(model, displacement, (here[:, :2] - elastic) * balance.length)
    state = contact_state(loads.normal, model.friction)
    follows = slip_follows_motion(state, model.friction)[:, None]
    return Start(displacement, speed, np.where(follows, loads.motion, loads.slip_in_cone(INSIDE)), state)


def _settled_cycle(model: Model, frequency: float, solver: Solver, criterion: Criterion) -> Samples:
    """A cycle of the motion that a model settles to, both ends sampled."""
    ((orbit,),) = steady_states([Chain(model, (frequency,))], solver, criterion)
    if orbit.reason is not None:
        raise NotSettledError(orbit.reason)
    if not orbit.settled or orbit.period != 1:
        many = f"repeats after {orbit.period} cycles" if orbit.settled else "does not settle"
        raise NotSettledError(f"at {frequency:g} Hz the motion {many} in settle.max_cycles = {criterion.max_cycles}")
    return one_cycle(replace(model, start=orbit.end), frequency, solver, SAMPLES)
