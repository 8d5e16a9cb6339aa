"""Why a run took many more steps than its accuracy asks for, in words, from its finished result."""

from collections.abc import Iterator

import numpy as np
from xarray import Dataset

from timesim.model.cost import REACH, steps_for
from timesim.model.model import SLIP, Model
from timesim.model.solver import Solver
from timesim.result.label import counted

MANY = 10
"""Multiple of the steps that the tolerance asks for, from which on a cause is looked for."""
CAUSE = 0.2
"""Share of the steps that a cause must account for."""
SWITCH = 3
"""Steps that a transition costs, about: one is cut there, and those after it are short."""


def effort_lines(data: Dataset, model: Model, solver: Solver) -> Iterator[str]:
    """A line on a run with cycles of many steps: how many, in which cycle most, and what asks for them."""
    steps = data["cycle_steps"].values
    if not solver.has_tolerance or not steps.size:
        return
    usual, most = steps_for(solver)[0], int(np.argmax(steps))
    if steps[most] < MANY * usual:
        return
    cycle = data.isel(cycle=most)
    causes = [*_vibrations(cycle, model, usual), *_transitions(cycle, data), *_turning(data, model)]
    why = "; ".join(causes) or "neither stiffness nor transitions nor little normal load account for them"
    yield (
        f"{steps.mean():.3g} steps a cycle, {steps[most]} in cycle {int(cycle['cycle'])}, where its tolerance asks for "
        f"about {round(usual, -1):.0f}: {why}"
    )


def _vibrations(cycle: Dataset, model: Model, usual: float) -> Iterator[str]:
    """Vibrations that are fast beside the excitation; each asks for as many steps as usually a cycle does."""
    number = model.stuck_rate / (2 * np.pi * float(cycle["cycle_frequency"]))
    if usual * number > CAUSE * int(cycle["cycle_steps"]):
        yield f"with its contacts stuck the structure vibrates up to {number:.3g} times in a cycle"


def _transitions(cycle: Dataset, data: Dataset) -> Iterator[str]:
    """Contacts that switch many times."""
    start, time = float(cycle["cycle_start"]), data["event_time"].values
    inside = (time > start) & (time <= start + float(cycle["cycle_period"]))
    if SWITCH * inside.sum() > CAUSE * int(cycle["cycle_steps"]):
        number = np.bincount(data["event_contact"].values[inside], minlength=data.sizes["contact"])
        worst = int(np.argmax(number))
        yield f"{counted(inside.sum(), 'transition')} in it, {number[worst]} of contact {data['contact'].values[worst]}"


def _turning(data: Dataset, model: Model) -> Iterator[str]:
    """Contacts that slip under so little normal load that the direction of slip turns fast, as k|u'|/(mu n).

    From the last cycle, of which samples are recorded.
    """
    steps, time, velocity = int(data["cycle_steps"].values[-1]), data["time"].values, data["modal_velocity"].values
    last = time >= float(data["cycle_start"].values[-1])
    for c, contact in enumerate(model.contacts):
        speed = np.linalg.norm(velocity[last] @ model.contact_shape[c, :2].T, axis=1)
        load = contact.friction * data["contact_force"].values[last, c, 2]
        slips = (data["contact_state"].values[last, c] == SLIP) & (load > 0)
        stiffness = np.linalg.eigvalsh(contact.tangential_stiffness)[-1]
        with np.errstate(over="ignore", invalid="ignore"):  # a load may be next to nothing
            rate = np.divide(stiffness * speed, load, out=np.zeros_like(speed), where=slips)
            asked = np.trapezoid(rate, time[last]) / REACH
        if asked > CAUSE * steps:
            yield f"contact {contact.name} slips under so little load that the direction of slip turns fast"
