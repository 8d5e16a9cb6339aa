"""Why a run, or points of a sweep, took many more steps than their accuracy asks for, from the finished result."""

from collections.abc import Iterator

import numpy as np
from xarray import Dataset

from timesim.model.cost import REACH, slip_rates, steps_for
from timesim.model.model import SLIP, Model
from timesim.model.solver import Solver
from timesim.result.coordinate import over_keys
from timesim.result.label import axis_value, counted, in_words
from timesim.scene.resolution import Scene

MANY = 10
"""Multiple of the steps that the tolerance asks for, from which on a cause is looked for."""
CAUSE = 0.2
"""Share of the steps that a cause must account for."""
SWITCH = 3
"""Steps that a transition costs, about: one is cut there, and those after it are short."""
UNKNOWN = "neither stiffness nor transitions nor little normal load account for them"
FINER = "shooting takes finer steps where the noise of the usual ones is above settle.tolerance"


def effort_lines(data: Dataset, model: Model, solver: Solver) -> Iterator[str]:
    """A line on a run with cycles of many steps: how many, in which cycle most, and what asks for them."""
    steps = data["cycle_steps"].values
    if not solver.has_tolerance or not steps.size:
        return
    usual, most = steps_for(solver)[0], int(np.argmax(steps))
    if steps[most] < MANY * usual:
        return
    cycle = data.isel(cycle=most)
    causes = [
        *_vibrations(steps[most], model, float(cycle["cycle_frequency"]), usual),
        *_transitions(steps[most], _in_cycle(cycle, data), data["contact"].values),
        *_turning_lines(steps[-1], _turning(data, model), data["contact"].values),
    ]
    asked = f"where its tolerance asks for about {round(usual, -1):.0f}: {'; '.join(causes or [UNKNOWN])}"
    yield f"{steps.mean():.3g} steps a cycle, {steps[most]} in cycle {int(cycle['cycle'])}, {asked}"


def sweep_effort_lines(data: Dataset, scene: Scene) -> Iterator[str]:
    """A line on the points of a sweep whose cycles take many steps: how many, where most, and what asks for them."""
    steps, solver = np.nan_to_num(data["cycle_steps"].values), scene.solver()
    usual = steps_for(solver)[0] if solver.has_tolerance else np.inf
    number = int(np.count_nonzero(steps >= MANY * usual))
    if not number:
        return
    place = dict(zip(data["cycle_steps"].dims, np.unravel_index(np.argmax(steps), steps.shape), strict=True))
    point, most = data.isel({dim: int(index) for dim, index in place.items()}), float(steps.max())
    values, frequency = {key: float(point[key]) for key in over_keys(data)}, float(point["frequency"])
    model = scene.variant(values)
    causes = [
        *_vibrations(most, model, frequency, usual),
        *_transitions(most, point["cycle_transitions"].values, data["contact"].values),
        *_turning_lines(most, slip_rates(model, frequency) / (REACH * frequency), data["contact"].values),
    ]
    points = counted(number, "point takes", "points take")
    there = f"the most, {most:.0f} a cycle where it asks for about {round(usual, -1):.0f}"
    where = f"{in_words(values, ', ')}{axis_value(frequency)} Hz: {'; '.join(causes or [UNKNOWN, FINER])}"
    yield f"{points} ten times the steps that the tolerance asks for; {there}, at {where}"


def _vibrations(steps: float, model: Model, frequency: float, usual: float) -> Iterator[str]:
    """Vibrations, or damping, fast beside the excitation; each asks for as many steps as usually a cycle does."""
    number, decays = np.array([model.stuck_omega[-1], model.stuck_rate]) / (2 * np.pi * frequency)
    if usual * number > CAUSE * steps:
        yield f"with its contacts stuck the structure vibrates up to {number:.3g} times in a cycle"
    elif usual * decays > CAUSE * steps:
        yield f"its damping is up to {decays:.3g} times as fast as the excitation"


def _transitions(steps: float, number: np.ndarray, names: np.ndarray) -> Iterator[str]:
    """Contacts that switch many times, by the number of transitions of each."""
    if SWITCH * number.sum() > CAUSE * steps:
        worst = int(np.argmax(number))
        yield f"{counted(round(number.sum()), 'transition')} in it, {number[worst]:.0f} of contact {names[worst]}"


def _turning_lines(steps: float, asked: np.ndarray, names: np.ndarray) -> Iterator[str]:
    """Contacts that whose direction of slip turns fast, under little normal load, by the steps that asks for."""
    for name in names[asked > CAUSE * steps]:
        yield f"contact {name} slips under so little load that the direction of slip turns fast"


def _in_cycle(cycle: Dataset, data: Dataset) -> np.ndarray:
    """Transitions of each contact in a cycle, shape (C,)."""
    start, time = float(cycle["cycle_start"]), data["event_time"].values
    inside = (time > start) & (time <= start + float(cycle["cycle_period"]))
    return np.bincount(data["event_contact"].values[inside], minlength=data.sizes["contact"])


def _turning(data: Dataset, model: Model) -> np.ndarray:
    """Steps that the direction of slip asks for as it turns by k|u'|/(mu n), of each contact, shape (C,).

    From the last cycle, of which samples are recorded.
    """
    time, velocity, asked = data["time"].values, data["modal_velocity"].values, np.zeros(model.num_contacts)
    last = time >= float(data["cycle_start"].values[-1])
    for c, contact in enumerate(model.contacts):
        speed = np.linalg.norm(velocity[last] @ model.contact_shape[c, :2].T, axis=1)
        load = contact.friction * data["contact_force"].values[last, c, 2]
        slips = (data["contact_state"].values[last, c] == SLIP) & (load > 0)
        stiffness = np.linalg.eigvalsh(contact.tangential_stiffness)[-1]
        with np.errstate(over="ignore", invalid="ignore"):  # a load may be next to nothing
            rate = np.divide(stiffness * speed, load, out=np.zeros_like(speed), where=slips)
            asked[c] = np.trapezoid(rate, time[last]) / REACH
    return asked
