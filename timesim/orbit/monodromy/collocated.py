"""What steps of collocation do to small disturbances: the solved equations of each linearised, contact by contact.

The motion at the nodes is linear in the start and in the forces at the nodes, and each contact makes its own forces of
its own motion. So the forces of all contacts at all nodes are the unknowns, however many modes there are. Where damping
couples these, so are its forces on each mode.
"""

from timesim.runtime import tree_class  # isort: skip

from operator import itemgetter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from timesim.engine.exponential.collocation import Flow, solve
from timesim.engine.exponential.steady import coupling
from timesim.engine.lanes import by_rows
from timesim.engine.law.contact_law import ContactLaw, Motion, State
from timesim.engine.law.rule import Rule, rule_of
from timesim.engine.method import Exponential
from timesim.engine.step import Step
from timesim.engine.system import Point, System
from timesim.orbit.monodromy.columns import Columns, product
from timesim.orbit.monodromy.linearised import (
    Ends,
    contacts_of,
    derivatives,
    ends_of,
    flattened,
    local,
    parted,
    repeated,
)
from timesim.program import program

DECAY = 2.0  # of a disturbed direction of slip over a part of a step
MOST_PARTS = 8
STEEPEST = 7.0  # logarithm of the ratio of the decay's rates at both ends of a step
LEAST = 1e-6  # decay, and such a logarithm, beside which none counts
EXACT = 1e-8  # relative tolerance of a step whose derivative is sought
ROWS = 64  # steps, or parts of them, of one call
ENTRIES = 100_000  # of matrices of parts that are led through at a time: more do not stay in the caches


@tree_class
class Part:
    """What a part of a step does to small disturbances, but for what the structure alone does.

    Attributes:
        flow: of the modes.
        nodes: derivative of (f, n) at each node, inner values there, and w at the end by (u, v) at each node, (u', v')
            there, inner values there, those at the start, and w there, (disturbance, change, contact).
        start: of inner values, w and (f, n) at the start by (u, v, u', v', w) there.
    """

    flow: Flow
    nodes: Float[Array, "disturbance change contact"]
    start: Float[Array, "disturbance change contact"]


@tree_class
class Row:
    """A part of a step: its begin and its end, from the start of the step on."""

    begin: Float[Array, ""]
    end: Float[Array, ""]
    step: Step


@program
def cut(system: System, steps: Step) -> tuple[Ends, Int[Array, " step"], Float[Array, "step cut"]]:
    """Transitions at the ends of steps, the number of parts of each, and the ends of these from its start on.

    Steps are as long as the direction of slip is smooth, however fast a disturbed one is led back to it. Where that is
    so as a power of n, a disturbance dies out alike in each part.
    """
    contacts = contacts_of(system, steps)
    law, state, _, h, *ends = contacts
    rates = jnp.stack(law.decays(state, h, [parted(end) for end in ends])).reshape(2, *steps.state.shape)
    fastest = jnp.argmax(rates.sum(axis=0), axis=1)[None, :, None] if rates.size else None
    first, last = jnp.zeros((2, steps.h.size, 1)) if fastest is None else jnp.take_along_axis(rates, fastest, axis=2)
    num = jnp.clip(jnp.ceil((first + last) / (2 * DECAY)), 1, MOST_PARTS).astype(int)
    steepness = jnp.log(jnp.maximum(first, LEAST) / jnp.maximum(last, LEAST))
    steepness = jnp.where(jnp.abs(steepness) < LEAST, LEAST, jnp.clip(steepness, -STEEPEST, STEEPEST))
    part, h = jnp.arange(MOST_PARTS + 1), steps.h[:, None]
    places = jnp.where(part < num, h * jnp.expm1(steepness * part / num) / jnp.expm1(steepness), h)
    return ends_of(system, steps, contacts), num[:, 0], places


@program
def parts(method: Exponential, system: System, count: Int[Array, ""], before: Point, row: Row) -> tuple[Part, Point]:
    """Some parts, their axis the first, and the state that they lead to.

    They are solved anew, one after the other: where n is small the dense output of a step has the force, but hardly
    its direction, on which the derivative hangs.

    Args:
        count: how many there are; rows beyond are empty.
        before: the state that the parts before have led to.
    """
    rule = rule_of(method.num_nodes)
    powers = jnp.asarray(rule.nodes[1:, None] ** np.arange(len(rule.nodes)))

    def nodes(point: Point, row: Row) -> tuple[tuple[Array, Any, Array], Point]:
        """Motion of the contacts at the nodes and its rate, inner values there, disturbance of the start; the end."""
        step, flow = row.step, Flow.of(system, rule, row.end - row.begin)
        point = jax.tree.map(lambda x, y: jnp.where(row.begin == 0, x, y), step.start, point)
        here, exact = (step.state, step.time + row.begin, point), EXACT * system.size(point)
        found = solve(system, flow, *here, rule=rule, tolerance=exact)
        moves = jnp.stack([jnp.stack(found.nodes.x), jnp.stack(found.nodes.dx)])[:, :, 1:]
        return (moves, jax.tree.map(lambda c: powers @ c, found.inside.inner), local(system, point)), found.end

    def body(i: Array, carry: tuple) -> tuple:
        point, rows = carry
        found, point = nodes(point, jax.tree.map(lambda leaf: leaf[i], row))
        return point, jax.tree.map(lambda known, own: known.at[i].set(own), rows, found)

    blank = jax.eval_shape(nodes, before, jax.tree.map(lambda leaf: leaf[0], row))[0]
    rows = jax.tree.map(lambda leaf: jnp.zeros((row.end.size, *leaf.shape), leaf.dtype), blank)
    after, rows = jax.lax.fori_loop(0, count, body, (before, rows))
    h, state = row.end - row.begin, row.step.state
    law, length = repeated(system.law, h.size), jnp.repeat(h, state.shape[1])
    found = _linearised(rule, law, state.ravel(), length, flattened(rows))
    of_nodes, of_start = (jnp.moveaxis(x.reshape(*x.shape[:2], *state.shape), 2, 0) for x in found)
    return Part(Flow.of(system, rule, h), of_nodes, of_start), after


def _linearised(
    rule: Rule, law: ContactLaw, state: State, h: Array, own: tuple[Array, Any, Array]
) -> tuple[Float[Array, "disturbance change contact"], Float[Array, "disturbance change contact"]]:
    """Derivatives of what contacts do in parts of some lengths, of each by itself, see `Part`.

    ``own``: motion at the nodes and its rate, (2, axis, node, contact); inner values; the disturbance of the start.
    """
    moves, inner, start = own
    axes, num = moves.shape[1], moves.shape[2]
    leaves, form = jax.tree.flatten(inner)
    here = jnp.concatenate([moves.reshape(2 * axes * num, state.size), *leaves])

    def begun(z: Float[Array, "disturbance contact"]) -> Float[Array, "change contact"]:
        motion, w = parted(z)
        acts = law.reaction(state, motion, w)
        return jnp.stack([*jax.tree.leaves(law.inner(state, motion, w)), *w, *acts.f, acts.n])

    first, of_start = derivatives(begun, start)

    def acts(z: Float[Array, "disturbance contact"]) -> Float[Array, "change contact"]:
        nodes, begun = z[: len(here)], z[len(here) :]
        x, dx = nodes[: 2 * axes * num].reshape(moves.shape)
        inner = nodes[2 * axes * num :].reshape(len(leaves), num, state.size)
        whole = jax.tree.unflatten(form, [*jnp.concatenate([begun[: len(leaves), None], inner], axis=1)])
        motion = Motion(tuple(x[:-1]), x[-1], tuple(dx[:-1]), dx[-1])
        within = law.collocated(state, tuple(begun[len(leaves) :]), motion, whole, h, rule)
        after = [rows[1:] for rows in jax.tree.leaves(within.inner)]
        return jnp.concatenate([*within.f, within.n, *after, *(rows[-1:] for rows in within.w)])

    _, of_nodes = derivatives(acts, jnp.concatenate([here, first[: len(leaves) + axes - 1]]))
    return of_nodes, of_start


class Collocated(Columns):
    """Matrices by which steps of collocation move small disturbances, in the order of `vector_of`.

    Args:
        system: of one trajectory, its arrays of numpy.
    """

    def __init__(self, method: Exponential, system: System):
        super().__init__(system)
        self.method, self.system, self.num = method, system, method.num_nodes
        self.forces = self.axes * self.contacts
        couples = system.damping.ndim == 2
        self.coupling = np.asarray(coupling(system, np.eye(self.modes))).T if couples else np.zeros((0, self.modes))
        self.places = np.concatenate([self.shape, np.eye(len(self.coupling), self.modes)])
        """Displacements that the unknown forces act along, for a unit of each mode."""

    def moved(self, steps: Step) -> np.ndarray:
        """The product of those of steps in a row, shape (n, n)."""
        if not len(steps.h):
            return np.eye(self.size)
        ends, num, places = by_rows(cut, (self.system,), (steps,), rows=ROWS)
        step = np.repeat(np.arange(len(num)), num)
        part = np.arange(step.size) - np.repeat(np.cumsum(num) - num, num)
        found, point = [], jax.tree.map(lambda rows: rows[0], steps.start)
        for first in range(0, step.size, ROWS):
            at = np.minimum(np.arange(first, first + ROWS), step.size - 1)
            those = step[at]
            row = Row(places[those, part[at]], places[those, part[at] + 1], jax.tree.map(itemgetter(those), steps))
            own, point = parts(self.method, self.system, np.array(min(ROWS, step.size - first)), point, row)
            found.append(own)
        found = jax.tree.map(lambda *rows: np.concatenate(rows)[: step.size], *found)
        last = np.flatnonzero(part + 1 == num[step])
        whole = self.put(ends.opening[:1], np.eye(self.size)[None])[0]
        unknown = self.num * len(self.places)
        some = max(1, ENTRIES // (unknown * (unknown + self.size)))
        for first in range(0, step.size, some):
            moves = self._moves(jax.tree.map(itemgetter(slice(first, first + some)), found))
            ended = slice(*np.searchsorted(last, [first, first + some]))
            those = last[ended] - first
            moves[those] = self.ended(jax.tree.map(itemgetter(ended), ends), moves[those])
            whole = product(moves) @ whole
        return whole

    def _moves(self, some: Part) -> np.ndarray:
        """Those of a few parts without transitions, shape (N, n, n)."""
        flow, count, num, places = some.flow, len(some.start), self.num, len(self.places)
        law = self._without_inner(some.nodes)
        start = some.start.transpose(0, 3, 2, 1) @ self.of_contacts(np.eye(self.size)[None]).swapaxes(1, 2)
        begun = -_by_places(start[:, :, -self.axes :], 1)[:, 0]
        damped = np.pad(self.coupling, [(0, 0), (self.modes, self.size - 2 * self.modes)])
        begun = np.concatenate([begun, np.broadcast_to(damped, (count, *damped.shape))], axis=1)

        # Motion at the nodes by the forces there, (N, 2, node, place, node, place), and by the start.
        weights = np.stack([flow.q_force, flow.p_force], axis=1)
        response = (self.places * weights[..., None, :]) @ self.places.T
        free = np.zeros((count, 2, num, places, self.size))
        for k, part in enumerate([(flow.q_q, flow.q_p), (flow.p_q, flow.p_p)]):
            for j, rows in enumerate(part):
                free[:, k, ..., j * self.modes : (j + 1) * self.modes] = self.places * rows[:, :, None]
        free += response[:, :, :, 0] @ begun[:, None, None]
        response = np.moveaxis(response[:, :, :, 1:], 3, 4).reshape(count, 2, num, places, num * places)

        force_by_force, slip_by_force = self._acts(law, response)
        force, slip = self._acts(law, free, start[:, :, : -self.axes])
        force = np.linalg.solve(np.eye(num * places) - force_by_force, force)
        slip += slip_by_force @ force

        whole = np.concatenate([begun, force], axis=1)
        columns = np.zeros((count, self.size, self.size))
        for k in range(2):
            by_force = weights[:, k, -1, :, None] * self.places
            rows = columns[:, k * self.modes : (k + 1) * self.modes]
            rows += by_force.reshape(count, (num + 1) * places, self.modes).swapaxes(1, 2) @ whole
        own = np.arange(self.modes)
        for k, part in enumerate([(flow.q_q, flow.q_p), (flow.p_q, flow.p_p)]):
            for j, values in enumerate(part):
                columns[:, k * self.modes + own, j * self.modes + own] += values[:, -1]
        columns[:, 2 * self.modes :] = slip
        return columns

    def _without_inner(self, law: np.ndarray) -> np.ndarray:
        """Of (f, n) at the nodes and w at the end by motion there and the start, (N, contact, change, disturbance)."""
        law = law.transpose(0, 3, 2, 1)
        forces, num = self.num * self.axes, law.shape[2] - self.num * self.axes - (self.axes - 1)
        own, those = slice(forces, forces + num), slice(2 * forces, 2 * forces + num)
        matrix = np.eye(num) - law[..., own, those]
        matrix[..., range(num), range(num)] += (matrix == 0).all(axis=-1)  # what does not change, as of a stuck contact
        kept = np.delete(law, those, axis=-1)
        change = np.linalg.solve(matrix, kept[..., own, :])
        return np.delete(kept, own, axis=-2) + np.delete(law, own, axis=-2)[..., those] @ change

    def _of_each(self, motion: np.ndarray) -> np.ndarray:
        """Motion at the nodes by contact, (N, contact, (2, axis, node), column), from (N, 2, node, place, column)."""
        count, _, num, _, columns = motion.shape
        own = motion[:, :, :, : self.forces].reshape(count, 2, num, self.axes, self.contacts, columns)
        return own.transpose(0, 4, 1, 3, 2, 5).reshape(count, self.contacts, 2 * self.axes * num, columns)

    def _acts(
        self, law: np.ndarray, motion: np.ndarray, start: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces at the nodes, ((node, place), column) of each part, and w at the end, ((axis, contact), column).

        By motion at the nodes, and by what contacts have at the start.
        """
        moves, rows = self._of_each(motion), self.num * self.axes
        found = law[..., : moves.shape[2]] @ moves
        if start is not None:
            found += law[..., moves.shape[2] :] @ start
        damped = self.coupling @ motion[:, 1, :, self.forces :] if len(self.coupling) else motion[:, 1, :, :0]
        force = np.concatenate([-_by_places(found[:, :, :rows], self.num), damped], axis=2)
        force = force.reshape(len(found), self.num * len(self.places), found.shape[-1])
        return force, _by_places(found[:, :, rows:], 1)[:, 0]


def _by_places(found: np.ndarray, num: int) -> np.ndarray:
    """(N, node, (axis, contact), column) from (N, contact, (axis, node), column)."""
    count, contacts, rows, columns = found.shape
    parts = found.reshape(count, contacts, rows // num, num, columns)
    return parts.transpose(0, 3, 2, 1, 4).reshape(count, num, contacts * rows // num, columns)
