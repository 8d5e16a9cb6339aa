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
from timesim.hbm.period import ClosedPeriod, closed_period, ends_of, motion_of
from timesim.hbm.scheme import Scheme
from timesim.model.model import SEPARATION, SLIP, Model, Start
from timesim.model.solver import Solver
from timesim.orbit.cycle import one_cycle
from timesim.orbit.fourier import fourier_basis, fourier_coefficients
from timesim.orbit.settling import Task, settle
from timesim.result.coordinate import coordinates
from timesim.result.dataset import dataset

SAMPLES = 720
METHODS = ("sweep", "hbm")


def cycle_record(
    model: Model, solution: HbmCurve, scheme: Scheme, solver: Solver, values: Mapping[str, float]
) -> Dataset:
    """A cycle by time integration, started from the solution and settled, and by harmonic balance.

    Args:
        model: the model.
        solution: one stable solution.
        scheme, solver: of both methods.
        values: of the further axes, for the attributes.
    """
    frequency = float(solution.frequency[0])
    balance = Balance(model, frequency, scheme)
    coefficient = solution.contact_motion[0] / balance.length
    acts = solution.contact_force[0] / balance.force
    modal = balance.modes(coefficient.ravel(), acts, frequency)
    period = _period(balance, coefficient)
    marched = _marched(model, _start(balance, coefficient, modal, period, frequency), frequency, solver)
    angle = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
    q = np.einsum("kh,hm->km", np.exp(1j * np.outer(angle, np.arange(len(modal)))), modal).real
    shape, order = model.structure.shape, scheme.harmonics + 1
    x = np.stack([np.einsum("pam,km->kpa", shape, motion) for motion in (marched.q[:-1], q)])
    # The samples end where the phase is that of the last of them, one interval before a whole turn.
    found = np.stack([fourier_coefficients(motion, -2 * np.pi / SAMPLES)[: 2 * order - 1] for motion in x])
    height = np.concatenate([found[:, :1], np.hypot(found[:, 1::2], found[:, 2::2])], axis=1)
    variables = {
        "displacement": (("found_by", "excitation_angle", "point", "axis"), x),
        "contact_state": (
            ("found_by", "excitation_angle", "contact"),
            np.stack([marched.state[:-1], _states(balance, coefficient)]).astype(np.int8),
        ),
        "harmonic_amplitude": (("found_by", "harmonic", "point", "axis"), height),
    }
    coords = {"found_by": np.array(METHODS), "excitation_angle": np.rad2deg(angle)} | coordinates(variables, model)
    place = ", ".join([f"{frequency:g} Hz", *(f"{key} {value:g}" for key, value in values.items())])
    return dataset(variables, coords, {"place": place})


def _period(balance: Balance, coefficient: Array) -> ClosedPeriod:
    return closed_period(balance.law, motion_of(balance.basis, jnp.asarray(coefficient)))


def _start(balance: Balance, coefficient: Array, modal: Complex, period: ClosedPeriod, frequency: float) -> Start:
    """State of the solution at phase 0."""
    here = coefficient @ fourier_basis(np.zeros(1), coefficient.shape[2])[0]
    elastic = np.stack([np.asarray(part) for part in period.start], axis=1)
    speed = (1j * np.arange(len(modal))[:, None] * 2 * np.pi * frequency * modal).real.sum(axis=0)
    slip = (here[:, :2] - elastic) * balance.length
    return Start(modal.real.sum(axis=0), speed, slip, np.full(balance.num_contacts, -1))


def _marched(model: Model, start: Start, frequency: float, solver: Solver) -> Samples:
    """A cycle of the settled motion, both ends sampled."""
    orbit = settle([Task(replace(model, start=start), frequency)], solver)[0]
    return one_cycle(replace(model, start=orbit.end), frequency, solver, SAMPLES)


def _states(balance: Balance, coefficient: Array) -> Array:
    """State of each contact over most of each interval of the balance's own samples, at the angles of the record."""
    motion = motion_of(balance.basis, jnp.asarray(coefficient))
    ends = ends_of(balance.law, motion, closed_period(balance.law, motion))
    shares = np.stack([1 - ends.slip - ends.separation, ends.slip, ends.separation])
    states = np.argmax(shares, axis=0)
    assert (SLIP, SEPARATION) == (1, 2)
    return states[np.arange(SAMPLES) * len(states) // SAMPLES]
