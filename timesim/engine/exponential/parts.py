"""Steps of collocation in parts whose dense output is the polynomial through their ends, as of any other method.

The record of a run evaluates polynomials, which the flow over a long step is not. A part is as short as the fastest
mode that moves asks for.
"""

from timesim.runtime import with_parts  # isort: skip

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from timesim.engine.exponential.collocation import Inside, modes_after, point_inside
from timesim.engine.exponential.flow import Weights, weights
from timesim.engine.exponential.steady import diagonals
from timesim.engine.lanes import by_rows
from timesim.engine.status import RunError
from timesim.engine.step import Step
from timesim.engine.system import Point, System
from timesim.program import program

FOLLOWED = 1e-3  # of the tolerance of a step: what a part may leave out of the motion
FINEST = 1e-9  # of the largest modal displacement, what it may leave out in any case
MOST_PARTS = 1e6  # of a step, some 200,000 vibrations: more would fill the memory
NO_PART = 1e-6  # of a part: rounding of its end


class Parts(NamedTuple):
    """Parts of steps that are short for the fastest mode.

    Attributes:
        step: number of the step that each is part of, shape (N,).
        start, end: times since the start of that step, shape (N,).
        first, last: whether it begins or ends the step.
    """

    step: np.ndarray
    start: np.ndarray
    end: np.ndarray
    first: np.ndarray
    last: np.ndarray


def parts_of(system: System, steps: Step, rtol: float) -> Parts:
    """Parts of all steps, in the order of time; steps are numpy arrays, their axis the first.

    The parts of a step that has been cut end where those of the whole one do, all but the last: many ends are the same.

    Raises:
        RunError: a step would take more than `MOST_PARTS`.
    """
    assert steps.inside is not None
    whole = np.maximum(np.ceil(steps.inside.h / _length_of_part(system, steps, max(FOLLOWED * rtol, FINEST))), 1)
    most = float(whole.max())
    if most > MOST_PARTS:
        hint = "keep fewer modes (structure.keep_modes), or excite it faster"
        raise RunError(f"a step holds so many vibrations that to record them takes {most:.1e} parts of it: {hint}")
    num = np.maximum(np.ceil(steps.h * whole / steps.inside.h - NO_PART), 1).astype(int)
    step = np.repeat(np.arange(num.size), num)
    part = np.arange(step.size) - np.repeat(np.cumsum(num) - num, num)
    start, end = (steps.inside.h[step] * (part + side) / whole[step] for side in (0, 1))
    last = part + 1 == num[step]
    end = np.where(last, steps.h[step], end)
    return Parts(step, start, end, part == 0, last)


def _length_of_part(system: System, steps: Step, followed: float) -> float:
    """Length up to which the quintic through both ends of a part follows every mode.

    A vibration ``a cos(omega t)`` leaves it by ``a (omega h)^6 / 46,080`` (Hairer, Norsett & Wanner, Solving Ordinary
    Differential Equations I, section II.6, for the interpolation error): a fast mode may be followed in few parts where
    it hardly moves. What decays fast of an overdamped mode is known by its velocity; the rest of it creeps.
    """
    stiffness, damping = (np.asarray(x) for x in diagonals(system))
    natural = np.sqrt(stiffness)
    rate = np.maximum(np.maximum(natural, damping), 1.0)
    ends = ((steps.start.q, steps.end.q), (steps.start.p, steps.end.p))
    q, p = (np.abs(np.concatenate(pair)).max(axis=0) for pair in ends)
    vibration = np.where(damping > 2 * natural, p / rate, np.maximum(q, p / rate))
    allowed = 46_080 * followed * max(q.max(), (p / rate).max(), 1e-300) / np.maximum(vibration, 1e-300)
    return float((allowed ** (1 / 6) / rate).min())


def short_steps(system: System, steps: Step, rtol: float) -> Step:
    """Steps in parts so short that values and rates at both ends of each are as good as the flow inside.

    Steps are as of `parts_of`, with their relative tolerance.
    """
    if steps.inside is None or not len(steps.h):
        return steps
    return in_parts(system, steps, parts_of(system, steps, rtol))


def in_parts(system: System, steps: Step, parts: Parts) -> Step:
    """Steps in these parts, without energies."""
    system = system.single()
    ends = _modes_at(system, steps, parts)
    held = (steps.state, steps.time, steps.start, steps.inside)
    end, end_rate = by_rows(_filled, (system,), (parts.end, ends), (held, parts.step))
    # The first part of a step begins with its start, the others with the end of the part before.
    start, start_rate = jax.tree.map(lambda rows: np.roll(rows, 1, axis=0), (end, end_rate))
    _set(parts.first, (start, start_rate), (steps.start, steps.start_rate))
    state = steps.state[parts.step]
    after = state.copy()
    own = with_parts(steps.end, work=None)
    _set(parts.last, (end, end_rate, after), (own, steps.end_rate, steps.state_after))
    time, length = steps.time[parts.step] + parts.start, parts.end - parts.start
    return with_parts(
        steps,
        cycle=steps.cycle[parts.step],
        time=time,
        h=length,
        start=start,
        start_rate=start_rate,
        end=end,
        end_rate=end_rate,
        state=state,
        state_after=after,
        inside=None,
    )


def _set(known: np.ndarray, rows: Any, own: Any) -> None:
    """Put one row of each step where it is known."""
    for target, values in zip(jax.tree.leaves(rows), jax.tree.leaves(own), strict=True):
        target[known] = values


def _modes_at(system: System, steps: Step, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and velocity of the modes at the end of each part.

    The flow until there is the same for all steps of one length, and the dearest part: it is computed once.
    """
    inside = steps.inside
    assert inside is not None
    pairs, number = np.unique(parts.end + 1j * inside.h[parts.step], return_inverse=True)
    flow = by_rows(_flows, (*diagonals(system), inside.force.shape[1]), (pairs.real, pairs.imag))
    held = (steps.time, steps.start, inside)
    return by_rows(_modes, (system,), (parts.end,), (flow, number), (held, parts.step))


@program
def _flows(stiffness: Array, damping: Array, num: int, span: Array, h: Array) -> Weights:
    return weights(stiffness, damping, span[:, None], h[:, None], num)


@program
def _modes(system: System, *columns: Any) -> tuple[Array, Array]:
    def one(span: Array, flow: Weights, held: tuple[Array, Point, Inside]) -> tuple[Array, Array]:
        return modes_after(system, *held, span, flow)

    return jax.vmap(one)(*columns)


@program
def _filled(system: System, *columns: Any) -> tuple[Point, Point]:
    """State and rate at the end of each part."""

    def one(span: Array, modes: tuple[Array, Array], held: tuple[Array, Array, Point, Inside]) -> tuple[Point, Point]:
        state, time, start, inside = held
        end = point_inside(system, (state, time, start), inside, span / inside.h, *modes)
        return end, system.field(state, time + span, end)

    return jax.vmap(one)(*columns)
