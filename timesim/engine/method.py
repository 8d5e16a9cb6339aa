"""One step of an integration method, behind one interface.

A method advances the continuous state over a step in which every contact keeps its state, and says how large its
error is. It gives the rate at the end of the step as well: with it the step has a dense output (`dense_output`).
The explicit Runge-Kutta methods follow the tableaus of diffrax.

tsit5: Ch. Tsitouras, Runge-Kutta pairs of order 5(4) satisfying only the first column simplifying assumption, Computers
& Mathematics with Applications 62 (2011) 770-775. dopri5: J. R. Dormand & P. J. Prince, A family of embedded
Runge-Kutta formulae, Journal of Computational and Applied Mathematics 6 (1980) 19-26; in both the last stage is the
rate at the end (first same as last). dopri8: P. J. Prince & J. R. Dormand, High order embedded Runge-Kutta formulae,
the same journal 7 (1981) 67-75. kvaerno5: A. Kvaerno, Singly diagonally implicit Runge-Kutta methods with an explicit
first stage, BIT 44 (2004) 489-502.
"""

import timesim.runtime  # noqa: F401  isort: skip

import abc
import functools
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from timesim.engine.barrier import apart
from timesim.engine.exponential.collocation import Flow, Ladder, Solved, solve
from timesim.engine.law.contact_law import Dynamics, State
from timesim.engine.law.rule import rule_of
from timesim.engine.tolerance import NO_TIME
from timesim.model.solver import Solver

Y: TypeAlias = PyTree
"""A continuous state, a rate or an error: methods take any tree of arrays."""


class Advance(NamedTuple):
    """The end of a step, its estimated error, None where the step is fixed, and the step where it was `solved` for."""

    point: Y
    rate: Y
    error: Y | None
    solved: Solved | None = None


FEW_NODES, MANY_NODES = 3, 5
MANY_FROM = 1e-5
"""Largest tolerance at which more nodes of a collocated step cost less than shorter steps."""


class Method(eqx.Module):
    """A one-step method.

    Attributes:
        order: order of the solution that is carried on.
        collocates: whether a step is solved for at all its nodes at once. Then its energies are integrated afterwards,
            it needs something of the system that is `prepared`, and trajectories are advanced one after the other: its
            steps have loops and branches of their own, so that each of those side by side would wait for the slowest.
    """

    order: eqx.AbstractVar[int]
    collocates: ClassVar[bool] = False

    @abc.abstractmethod
    def advance(
        self, dynamics: Dynamics, state: State, time: Array, point: Y, rate: Y, h: Array, tolerance: Array | None = None
    ) -> Advance:
        """A step in which every contact keeps its state.

        Args:
            dynamics: the system.
            state: states of the contacts.
            time: start of the step within the cycle.
            point, rate: continuous state there and its rate.
            h: length.
            tolerance: error that is allowed, for a method that iterates, which needs it.
        """

    def prepared(self, dynamics: Any, longest: Float[Array, ""]) -> Any:
        """The system with what the steps of the method need of it, once; none is longer than ``longest``."""
        return dynamics

    def length(self, dynamics: Any, wanted: Array, limit: Array, remaining: Array) -> Array:
        """Length of the step to try, from the one that the error control wants, a limit, and the rest of the cycle."""
        wanted = jnp.minimum(wanted, limit)
        # The length of a step is no function of the parameters; only what is left of a cycle after an event is.
        return jnp.where(wanted < remaining * (1 - NO_TIME), jax.lax.stop_gradient(wanted), remaining)


class Tableau(NamedTuple):
    """An explicit Runge-Kutta method whose last stage is the end of the step, as of Butcher.

    Attributes:
        order: of the solution.
        nodes: of the stages behind the first, as shares of the step, the last one 1.
        stages: weights of the slopes before each of them, the last row those of the solution.
        error_weights: of all slopes, that at the end among them.
    """

    order: int
    nodes: tuple[float, ...]
    stages: tuple[tuple[float, ...], ...]
    error_weights: tuple[float, ...]

    @property
    def weights(self) -> np.ndarray:
        """Those of all slopes for each stage behind the first, shape (stage, stage + 1)."""
        return np.array([np.pad(row, (0, len(self.error_weights) - len(row))) for row in self.stages])


RK4 = Tableau(
    order=4,
    nodes=(0.5, 0.5, 1.0, 1.0),
    stages=((0.5,), (0.0, 0.5), (0.0, 0.0, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
    error_weights=(0.0, 0.0, 0.0, 0.0, 0.0),
)


@functools.cache
def tableau(name: str) -> Tableau:
    """The tableau of an explicit method."""
    if name == "rk4":
        return RK4
    import diffrax

    solver = {"tsit5": diffrax.Tsit5, "dopri5": diffrax.Dopri5, "dopri8": diffrax.Dopri8}[name]
    own = solver.tableau  # in all of them the last stage is the end
    return Tableau(
        order=solver().order(None),
        nodes=tuple(np.asarray(own.c, dtype=float).tolist()),
        stages=tuple(tuple(np.asarray(row, dtype=float).tolist()) for row in own.a_lower),
        error_weights=tuple(np.asarray(own.b_error, dtype=float).tolist()),
    )


class Explicit(Method):
    """An explicit Runge-Kutta method, known by its name: a step that is compiled already needs no tableau.

    The stages are unrolled, which runs fastest, or the turns of a loop, of which one is compiled: a step of thirteen
    unrolled stages takes XLA up to four times as long, its derivative a minute.

    Attributes:
        looped: whether they are turns of a loop in any case, and not only where the dynamics ask for it.
    """

    name: str = eqx.field(static=True)
    looped: bool = eqx.field(static=True, default=False)

    @property
    def order(self) -> int:
        return tableau(self.name).order

    def advance(
        self, dynamics: Dynamics, state: State, time: Array, point: Y, rate: Y, h: Array, tolerance: Array | None = None
    ) -> Advance:
        own = tableau(self.name)
        estimates = any(own.error_weights)
        if self.looped or dynamics.wide:
            rows, weights = self.slopes(dynamics, state, time, point, rate, h), h * jnp.asarray(own.weights)
            end = _moved_by_all(point, rows, weights[-1])
            error = _moved_by_all(None, rows, h * jnp.asarray(own.error_weights)) if estimates else None
            return Advance(end, jax.tree.map(lambda leaf: leaf[-1], rows), error)
        slopes, end = [rate], point
        for node, row in zip(own.nodes, own.stages, strict=True):
            end = moved(point, slopes, row, h)
            slopes.append(dynamics.field(state, time + node * h, end))
        return Advance(end, slopes[-1], moved(None, slopes, own.error_weights, h) if estimates else None)

    def slopes(self, dynamics: Dynamics, state: State, time: Array, point: Y, rate: Y, h: Array) -> Y:
        """Those at all stages of a step, their axis the first, by a loop over the stages."""
        own = tableau(self.name)
        nodes, weights = jnp.asarray(own.nodes), jnp.asarray(own.weights)

        def stage(i: Array, rows: Y) -> Y:
            here = _moved_by_all(point, rows, h * weights[i])
            slope = dynamics.field(state, time + nodes[i] * h, here)
            return jax.tree.map(partial(jax.lax.dynamic_update_index_in_dim, index=i + 1, axis=0), rows, slope)

        rows = jax.tree.map(lambda leaf: jnp.zeros((len(own.nodes) + 1, *leaf.shape)).at[0].set(leaf), rate)
        return jax.lax.fori_loop(0, len(own.nodes), stage, rows)


def moved(point: Y | None, slopes: list[Y], weights: tuple[float, ...], h: Float[Array, ""]) -> Y:
    """point + h sum(weights * slopes), terms of weight zero left out."""
    terms = [(weight, slope) for weight, slope in zip(weights, slopes, strict=False) if weight != 0]
    return _combined(point, [slope for _, slope in terms], [h * weight for weight, _ in terms])


@apart
def _combined(point: Y | None, slopes: list[Y], weights: list[Array]) -> Y:
    def combine(*leaves: Array) -> Array:
        return sum(weight * leaf for weight, leaf in zip(weights, leaves, strict=True))

    step = jax.tree.map(combine, *slopes)
    return step if point is None else jax.tree.map(jnp.add, point, step)


@apart
def _moved_by_all(point: Y | None, slopes: Y, weights: Float[Array, " slope"]) -> Y:
    """`moved` by slopes whose first axis is theirs, in a loop: a product of matrices is no part of its function."""

    def combined(rows: Array) -> Array:
        return sum((weights[i] * rows[i] for i in range(1, len(rows))), start=weights[0] * rows[0])

    step = jax.tree.map(combined, slopes)
    return step if point is None else jax.tree.map(jnp.add, point, step)


class Implicit(Method):
    """A diffrax solver for stiff contacts, stepped one step at a time.

    Where its Newton iteration fails the explicit method makes the step: a slip that begins at n = 0 looks the same at
    every length of the step, so a shorter one would not help.
    """

    order: int = eqx.field(static=True)
    solver: eqx.Module
    fallback: Explicit

    def advance(
        self, dynamics: Dynamics, state: State, time: Array, point: Y, rate: Y, h: Array, tolerance: Array | None = None
    ) -> Advance:
        import diffrax

        field = partial(dynamics.field, state)
        term = diffrax.ODETerm(lambda t, y, args: field(t, y))
        start = self.solver.init(term, time, time + h, point, None)
        end, error, _, _, result = self.solver.step(term, time, time + h, point, None, start, made_jump=True)
        good = result == diffrax.RESULTS.successful
        implicit, explicit = (end, error), self.fallback.advance(dynamics, state, time, point, rate, h)
        end, error = jax.tree.map(lambda a, b: jnp.where(good, a, b), implicit, (explicit.point, explicit.error))
        return Advance(end, field(time + h, end), error)


class Exponential(Method):
    """Exponential collocation by a rule of so many nodes (`timesim.engine.exponential.collocation`)."""

    num_nodes: int = eqx.field(static=True)
    collocates: ClassVar[bool] = True

    @property
    def order(self) -> int:
        return self.num_nodes + 1

    def prepared(self, dynamics: Any, longest: Float[Array, ""]) -> Any:
        if dynamics.ladder is not None:
            return dynamics
        ladder = Ladder.of(dynamics, rule_of(self.num_nodes), longest)
        return replace(dynamics, ladder=ladder)

    def length(self, dynamics: Any, wanted: Array, limit: Array, remaining: Array) -> Array:
        # What is not needed of a step is cut off.
        return dynamics.ladder.rung(wanted, jnp.minimum(limit, remaining)).h

    def advance(
        self, dynamics: Any, state: State, time: Array, point: Y, rate: Y, h: Array, tolerance: Array | None = None
    ) -> Advance:
        assert tolerance is not None
        rule = rule_of(self.num_nodes)
        flow = Flow.of(dynamics, rule, h) if dynamics.ladder is None else dynamics.ladder.rung(h, h)
        solved = solve(dynamics, flow, state, time, point, rule=rule, tolerance=tolerance)
        return Advance(solved.end, dynamics.field(state, time + h, solved.end), solved.error, solved)


@functools.cache
def _stage_newton() -> Any:
    """Newton's method that has converged once a step is shorter than `kappa` tolerances, or the next one would be.

    Not by the residual: beside a damper 1e5 times as fast as all else that of a solution is rounding above tolerances.
    Nor by the ratio of two steps alone: where both are rounding, the second one may be longer.
    """
    import optimistix

    class StageNewton(optimistix.Newton):
        def terminate(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> tuple[Array, Any]:
            ends, result = super().terminate(fn, y, args, options, state, tags)
            short = state.diffsize < self.kappa
            return ends | short, optimistix.RESULTS.where(short, optimistix.RESULTS.successful, result)

    return StageNewton


@functools.cache
def _kvaerno5(rtol: float, atol: float) -> Implicit:
    import diffrax

    # The Newton iteration is to be a hundred times finer than the step, or its remainder shows up as noise. Where a
    # slip begins at n = 0 the Jacobian changes over any step, however short: diffrax's own VeryChord, which keeps it,
    # diverges there until the step is rounding (and takes 18 times as many steps elsewhere).
    root_finder = _stage_newton()(rtol=max(rtol, 1e-11), atol=max(atol, 1e-12), kappa=1e-2, cauchy_termination=False)
    # Of diffrax's loops over the stages only the plain one has a forward-mode derivative, which multipliers need.
    solver = diffrax.Kvaerno5(root_finder=root_finder, scan_kind="lax")
    return Implicit(order=5, solver=solver, fallback=Explicit("tsit5"))


@functools.lru_cache(maxsize=64)  # it is asked for in each round of a sweep
def step_method(solver: Solver) -> Method:
    """The method that takes the steps."""
    if solver.name == "exponential":
        return Exponential(FEW_NODES if solver.rtol > MANY_FROM else MANY_NODES)
    return _kvaerno5(solver.rtol, solver.atol) if solver.name == "kvaerno5" else Explicit(solver.name)
