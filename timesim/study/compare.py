"""The `compare` study: the steady states of a scene by time integration and by harmonic balance, side by side.

Both use the same contact law but share nothing else: time integration locates every transition and marches until the
motion repeats; harmonic balance solves for a truncated Fourier series. Where the contacts only stick, or stay apart,
the motion is linear. Agreement there proves nothing of the contacts, so the verdict leaves such points out.
"""

from collections.abc import Sequence
from concurrent.futures import BrokenExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from math import prod

import numpy as np
from xarray import Dataset

from timesim.engine.history import Samples
from timesim.engine.status import RunError
from timesim.hbm.balance import Array, Balance, Complex
from timesim.hbm.branches import solutions_at
from timesim.hbm.continuation import joined, part_of
from timesim.hbm.curve import HbmCurve
from timesim.hbm.period import period_of
from timesim.hbm.scheme import Scheme
from timesim.model.model import SEPARATION, SLIP, STICK, Model, Start
from timesim.model.solver import Solver
from timesim.orbit.cycle import one_cycle
from timesim.orbit.fourier import fourier_basis, fourier_coefficients
from timesim.orbit.settling import Chain, steady_states
from timesim.orbit.two_motions.basin import placed
from timesim.result.dataset import dataset
from timesim.result.label import counted, in_words
from timesim.result.state import states_in
from timesim.scene.hbm import ComparePlan
from timesim.scene.resolution import Scene
from timesim.scene.study import SweepPlan
from timesim.study.curves.collection import Curves
from timesim.study.execution.campaign import INTERRUPTED, Execution
from timesim.study.execution.processes import Processes, unseen
from timesim.study.execution.progress import CURVE, Phases
from timesim.study.hbm import compile_beside, followed_behind, left_out
from timesim.study.outcome import Outcome, attributes, took, unit_names
from timesim.study.summary.comparison import WORTH_ASKING, Points, compared_points, comparison_lines
from timesim.study.summary.curve import curve_lines
from timesim.study.summary.effort import sweep_effort_lines
from timesim.study.summary.sweep import jump_lines
from timesim.study.sweep import sweep_record

# Amplitudes below this share of the largest of a motion are those of axes that do not move.
STILL = 1e-9
SAMPLES = 720
METHODS = ("sweep", "hbm")


@dataclass(frozen=True)
class Match:
    """The balance's stable solution nearest to each point of a sweep; V sets of values, D directions, F frequencies.

    Attributes:
        difference: (hbm - sweep) / sweep, shape (V, D, F, P, 3); NaN where there is no solution, and along axes without
            motion.
        solution: position in `solutions`, shape (V, D, F), -1 where there is none.
        solutions: all solutions at the sweep's frequencies, for each set of values.
    """

    difference: np.ndarray
    solution: np.ndarray
    solutions: list[HbmCurve | None]


def matched(amplitude: np.ndarray, frequency: np.ndarray, curves: Curves, processes: Processes | None = None) -> Match:
    """Find the solution nearest to each point of a sweep, on curves of the same sets of values.

    From the sweep's amplitudes, shape (V, D, F, P, 3), and frequencies [Hz], shape (F,). ``processes``: solve for the
    solutions at these, if they have been started.
    """
    nearest = np.full_like(amplitude, np.nan)
    solution = np.full(amplitude.shape[:3], -1)
    solutions = _all_solutions(curves, frequency, processes)
    for (v, curve), d, f in product(enumerate(solutions), range(amplitude.shape[1]), range(frequency.size)):
        if curve is None or not np.isfinite(amplitude[v, d, f]).all():
            continue
        rows = np.flatnonzero(curve.stable & (curve.frequency == frequency[f]))
        if rows.size:
            far = np.abs(curve.amplitude[rows] - amplitude[v, d, f]).max(axis=(1, 2))
            solution[v, d, f] = rows[np.argmin(far)]
            nearest[v, d, f] = curve.amplitude[solution[v, d, f]]
    with np.errstate(invalid="ignore", divide="ignore"):
        difference = (nearest - amplitude) / amplitude
    size = np.nanmax(np.where(np.isfinite(amplitude), amplitude, 0.0), axis=(3, 4), keepdims=True)
    difference[~(amplitude > STILL * size)] = np.nan
    return Match(difference, solution, solutions)


def _all_solutions(curves: Curves, frequency: np.ndarray, processes: Processes | None) -> list[HbmCurve | None]:
    """Solutions at some frequencies, for each set of values."""
    works = []
    for values in curves.values:
        own = [(one.model_at(0.0), one.curve) for one in curves.curves if one.values == values]
        works.append((own, frequency, curves.scheme, curves.plan.stability))
    if processes is not None and processes.begun:
        with suppress(BrokenExecutor):
            done = dict(processes.each([(unseen, _solutions, work) for work in works]))
            return [done[place] for place in range(len(works))]
    return [_solutions(*work) for work in works]


def _solutions(
    curves: Sequence[tuple[Model, HbmCurve]], frequency: np.ndarray, scheme: Scheme, stability: bool
) -> HbmCurve | None:
    """Solutions of all curves of a set of values at some frequencies."""
    own = [(model, curve) for model, curve in curves if curve.frequency.size]
    parts = [solutions_at(model, curve, frequency, scheme=scheme, stability=stability) for model, curve in own]
    return joined(parts) if parts else None


def study(scene: Scene, execution: Execution) -> Outcome:
    """Run a compare scene; the result is marked incomplete where either method did not finish."""
    plan: ComparePlan = scene.plan
    size, sets = plan.sweep.size, prod(map(len, plan.sweep.over.values()))
    phases = Phases(execution.progress, {"sweep": size, "balance": CURVE * sets, "comparison": size / 2})
    compile_beside(scene, plan.balance)
    sweep, sweep_reason = sweep_record(scene, plan.sweep, replace(execution, progress=phases["sweep"]))
    # Curves are kept on disk only if the sweep is complete, since they begin from its points too.
    folder = execution.folder if sweep_reason is None else None
    after = replace(execution, progress=phases["balance"], folder=folder)
    if (sweep_reason or "").startswith(INTERRUPTED):
        hbm, curves, hbm_reason = left_out(scene, plan.balance)
    else:
        hbm, curves, hbm_reason = followed_behind(scene, plan.balance, after, states_in(sweep))
    faults = [f"{name}: {why}" for name, why in (("sweep", sweep_reason), ("hbm", hbm_reason)) if why]
    reason = "; ".join(faults) or None
    phases["comparison"](0, 1, "comparison of the methods")
    arrays, compared, cycle, interrupted = _compared(scene, sweep, hbm, curves, after.several, whole=reason is None)
    groups, reason = {"sweep": sweep, "hbm": hbm} | cycle, reason or interrupted
    lines = [*jump_lines(sweep), *compared, *sweep_effort_lines(sweep, scene)]
    by_time = f"{counted(sweep['settled'].size, 'point')} {took(sweep.attrs)}"
    by_balance = f"{counted(hbm.sizes['solution'], 'solution')} {took(hbm.attrs)}"
    lines.append(f"time integration: {by_time}; harmonic balance: {by_balance}")
    compiling = hbm.attrs["compile_seconds"] + sweep.attrs["compile_seconds"]
    running = sweep.attrs["run_seconds"] + hbm.attrs["run_seconds"]
    attrs = attributes(scene, f"{scene.solver()}; {curves.scheme}", compiling, running, reason)
    dims = tuple(map(str, sweep["amplitude"].dims))
    variables = {name: (dims[: array.ndim], array) for name, array in arrays.items()}
    # Not those of the frequency and of further axes: groups inherit them, and the balance has its own.
    coords = {name: sweep[name].values for name in ("direction", "point", "axis")}
    root = dataset(variables, coords, attrs | {"verdict": "\n".join(lines)})
    return Outcome({"": root, **groups}, reason, (*curve_lines(hbm, curves.notes), *lines))


def _compared(
    scene: Scene, sweep: Dataset, hbm: Dataset, curves: Curves, processes: Processes | None, *, whole: bool
) -> tuple[dict[str, np.ndarray], list[str], dict[str, Dataset], str | None]:
    """The difference of the methods on the axes of the sweep's amplitude, the verdict, and a cycle by both methods.

    With the difference goes whether another offset explains it. The last entry is why something is missing, or None.
    """
    amplitude, lines, cycle = sweep["amplitude"].values, list[str](), dict[str, Dataset]()
    arrays = {"relative_difference": np.full_like(amplitude, np.nan)}
    arrays["other_offset"] = np.zeros(amplitude.shape[:-2], dtype=np.int8)
    try:
        grid, frequency = amplitude.reshape(-1, *amplitude.shape[-4:]), sweep["frequency"].values
        match = matched(grid, frequency, curves, processes)
        arrays["relative_difference"][:] = match.difference.reshape(amplitude.shape)
        points = compared_points(sweep, hbm, match.difference, curves.whole)
        points = replace(points, other_offset=other_offsets(scene, curves, match, points))
        arrays["other_offset"][:] = points.other_offset.reshape(amplitude.shape[:-2])
        lines += comparison_lines(points)
        if points.worst is not None and whole:
            cycle["cycle"] = cycle_by_both(scene, curves, match, points.worst)
    except NotSettledError as error:
        lines.append(f"no cycle is shown by both methods: {error}")
    except KeyboardInterrupt:
        return arrays, lines, cycle, f"{INTERRUPTED} while the methods were compared"
    return arrays, lines, cycle, None


class NotSettledError(Exception):
    """Time integration from a solution of the balance does not settle; the message says why."""


def cycle_by_both(scene: Scene, curves: Curves, match: Match, place: tuple[int, int, int]) -> Dataset:
    """A cycle of the solution at a point of the sweep, by harmonic balance, and by time integration begun from it.

    Raises:
        NotSettledError: time integration does not lead to a motion that repeats each cycle.
    """
    model, frequency, modal, states = _begun(scene, curves, match, place)
    marched, order = _settled_cycle(model, frequency, scene.solver(), scene.plan.sweep), curves.scheme.harmonics + 1
    angle = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
    q = np.einsum("kh,hm->km", np.exp(1j * np.outer(angle, np.arange(len(modal)))), modal).real
    x = np.stack([np.einsum("pam,km->kpa", model.structure.shape, motion) for motion in (marched.q[:-1], q)])
    # `fourier_coefficients` takes the phase of the last sample, which is one interval before a whole turn.
    coefficients = np.stack([fourier_coefficients(motion, -2 * np.pi / SAMPLES)[: 2 * order - 1] for motion in x])
    height = np.concatenate([coefficients[:, :1], np.hypot(coefficients[:, 1::2], coefficients[:, 2::2])], axis=1)
    state = np.stack([marched.state[:-1], states]).astype(np.int8)
    variables = {
        "displacement": (("found_by", "excitation_angle", "point", "axis"), x),
        "contact_state": (("found_by", "excitation_angle", "contact"), state),
        "harmonic_amplitude": (("found_by", "harmonic", "point", "axis"), height),
    }
    coords = {"found_by": np.array(METHODS), "excitation_angle": np.rad2deg(angle)}
    where = ", ".join(filter(None, (f"{frequency:g} Hz", in_words(curves.values[place[0]]))))
    return dataset(variables, coords, {"place": where} | unit_names(scene), model)


def other_offsets(scene: Scene, curves: Curves, match: Match, points: Points) -> np.ndarray:
    """Doubtful points at which time integration from the balance's solution stays there, shape (V, D, F).

    There the sweep has another offset of a contact that sticks all along. The offset is free, but it changes the loads
    on the other contacts.
    """
    found, places = np.zeros(points.doubtful.shape, dtype=bool), [tuple(row) for row in np.argwhere(points.doubtful)]
    begun = (_begun(scene, curves, match, place) for place in places)
    chains = [Chain(model, (frequency,)) for model, frequency, _, _ in begun]
    if not chains:
        return found
    plan = scene.plan.sweep
    orbits = steady_states(chains, scene.solver(), plan.criterion)
    for place, (orbit,) in zip(places, orbits, strict=True):
        own = match.solutions[place[0]]
        assert own is not None
        amplitude = own.amplitude[match.solution[place]]
        off = np.max(np.abs(orbit.amplitude - amplitude)) / np.max(amplitude)
        found[place] = orbit.reason is None and orbit.period == 1 and off <= WORTH_ASKING
    return found


def _begun(scene: Scene, curves: Curves, match: Match, place: tuple[int, ...]) -> tuple[Model, float, Complex, Array]:
    """The model that starts on the solution at a point of the sweep, and the frequency [Hz] of that solution.

    Also its modal harmonics, and the states of the contacts at the angles of the cycle.
    """
    model, solutions, at = scene.variant(curves.values[place[0]]), match.solutions[place[0]], int(match.solution[place])
    assert solutions is not None
    solution = part_of(solutions, slice(at, at + 1))
    frequency = float(solution.frequency[0])
    balance = Balance(model, frequency, curves.scheme)
    coefficient = solution.contact_motion[0] / balance.length
    modal = balance.modes(coefficient.ravel(), solution.contact_force[0] / balance.force, frequency)
    elastic, states = _contacts(balance, coefficient)
    start = _start(model, balance, coefficient, modal, elastic, frequency)
    return replace(model, start=start), frequency, modal, states


def _contacts(balance: Balance, coefficient: Array) -> tuple[Array, Array]:
    """Elastic displacement of each contact at phase 0, shape (C, 2), and its states at the angles of the cycle.

    The state at an angle is the one that lasts longest in its interval between two samples of the balance.
    """
    period = period_of(balance.law, balance.basis, coefficient)
    slip, separation = np.asarray(period.ends.slip), np.asarray(period.ends.separation)
    shares = {STICK: 1 - slip - separation, SLIP: slip, SEPARATION: separation}
    states = np.argmax([shares[state] for state in sorted(shares)], axis=0)
    elastic = np.stack([np.asarray(part) for part in period.start], axis=1)
    return elastic, states[np.arange(SAMPLES) * len(states) // SAMPLES]


def _start(
    model: Model, balance: Balance, coefficient: Array, modal: Complex, elastic: Array, frequency: float
) -> Start:
    """State of the solution at phase 0, friction forces set back into the cones, to which the balance keeps roughly."""
    displacement = modal.real.sum(axis=0)
    speed = (1j * np.arange(len(modal))[:, None] * 2 * np.pi * frequency * modal).real.sum(axis=0)
    here = coefficient @ fourier_basis(np.zeros(1), coefficient.shape[2])[0]
    return replace(placed(model, displacement, speed, (here[:, :2] - elastic) * balance.length), phase=0.0)


def _settled_cycle(model: Model, frequency: float, solver: Solver, plan: SweepPlan) -> Samples:
    """A cycle of the motion that a model settles to, both ends sampled."""
    ((orbit,),) = steady_states([Chain(model, (frequency,))], solver, plan.criterion)
    if orbit.reason is not None:
        raise NotSettledError(orbit.reason)
    if orbit.drift.any():
        raise NotSettledError(f"at {frequency:g} Hz the body drifts, as nothing holds it")
    if not orbit.settled or orbit.period != 1:
        budget = plan.criterion.max_cycles
        never = "does not repeat" if orbit.irregular else "does not settle"
        many = f"repeats after {orbit.period} cycles" if orbit.settled else never
        raise NotSettledError(f"at {frequency:g} Hz the motion {many} in settle.max_cycles = {budget}")
    try:
        return one_cycle(replace(model, start=orbit.end), frequency, solver, SAMPLES)
    except RunError as error:
        raise NotSettledError(str(error)) from None
