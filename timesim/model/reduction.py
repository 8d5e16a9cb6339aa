"""What a run need not model, proved from the scene before the run starts.

1. Modes that nothing moves. Modes and contacts are coupled through the rows B of the contacts and through
   damping that the modes do not diagonalise; a coupled part without contacts stays at rest if neither a force nor
   the start moves it.
2. Contacts that never change their state. While every contact of a part keeps the state it starts in (stuck
   on its start slip, or apart), the part is linear, with the springs of its stuck contacts in its
   stiffness. If a bound on that motion over all time (`timesim.model.linear_bound`) leaves every contact strictly
   inside its state, ``e . f - mu n < 0`` for every direction e of its plane or ``n0 + k_v v < 0``, no
   contact is ever the first to leave, and the linear motion is the exact one. The bound may fail where the
   contacts would in fact keep their states; it never holds where they would not. A part that fails stays
   live as a whole.
3. Straight motion. Where the tangential rows of B of a live contact have rank one, along an eigenvector of
   K_u, and the slip starts on that line, u, w and f stay on it.

Plain numpy, so that a scene is checked without loading JAX.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from timesim.model.contact_state import start_states
from timesim.model.finding import Units, left_out, proven, simplified, straight
from timesim.model.held import constant_force, natural_modes, springs
from timesim.model.linear_bound import Envelope, Oscillation, envelopes
from timesim.model.model import CONE, SEPARATION, SLIP, STICK, Contact, Model

COUPLED = 1e-14
"""Share of the largest entry of a contact's rows, or of the damping, below which an entry is rounding."""
STILL = 1e-13
"""A mode that moves less than this share of the scene's own scale is left out."""
STRAIGHT = 1e-13
"""Share by which a motion may leave its line, or K_u turn it: rounding."""
MARGIN = 1e-4
"""Share of the bound by which a contact must stay inside its state: more than the error of the bound."""
DISTANT = 100.0
"""Times the motion without contacts that a gap is wide which is worth a warning."""
RECENT = 16
"""Models whose parts and proofs are cached: a sweep asks at every frequency, a run and its companion at one."""
DIRECTIONS = 720
"""Directions of a contact plane that are tried; what lies between them is covered by a Lipschitz constant."""


@dataclass(frozen=True)
class Reduction:
    """What remains of a model.

    Attributes:
        modes: modes kept, at least one, ascending, shape (K,).
        live: contacts that remain in the event loop, shape (L,); these and the next two as in `Model.summation_order`.
        stuck: contacts proven to stick from start to end with w their start slip.
        apart: contacts proven never to touch.
        line: unit vector of the contact plane along which each live contact moves, shape (L, 2), where all
            of them move straight (a frictionless one counts as straight); else None.
        findings: what is left out or simplified, and why; sentences.
    """

    model: Model
    modes: np.ndarray
    live: np.ndarray
    stuck: np.ndarray
    apart: np.ndarray
    line: np.ndarray | None
    findings: tuple[str, ...]

    @cached_property
    def natural(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Natural modes of what is kept with the stuck contacts in it, of `timesim.model.held.natural_modes`."""
        return natural_modes(self.model, self.modes, self.stuck)

    @property
    def held_force(self) -> np.ndarray:
        """Constant modal force of the contacts left out, in the modes kept, shape (K,)."""
        force, shape = np.zeros(self.modes.size), self.model.contact_shape[:, :, self.modes]
        for c in (*self.stuck, *self.apart):
            contact, slip = self.model.contacts[c], self.model.start.slip[c]
            force += shape[c].T @ constant_force(contact, slip, stuck=c in self.stuck)
        return force

    def of_all(self, values: np.ndarray) -> np.ndarray:
        """Numbers of the live contacts, the last axis L, as those of all contacts: 0 of the others."""
        whole = np.zeros((*values.shape[:-1], self.model.num_contacts))
        whole[..., self.live] = values
        return whole


def reduction_of(
    model: Model, frequencies: Sequence[float], *, reduce: bool = True, units: Units | None = None
) -> Reduction:
    """Find what need not be modelled.

    Args:
        frequencies: base frequencies that the run visits [Hz], in any order. With exactly one the bounds of
            contact forces use the response at it; else they hold for every schedule, and are much wider.
        reduce: False keeps everything; so does a contact of another law than the cone, which the proofs do not know.
        units: of length and force, for the findings.
    """
    units = units or {}
    every, none = model.summation_order, np.arange(0)
    if not reduce or any(contact.law != CONE for contact in model.contacts):
        return Reduction(model, np.arange(model.structure.num_modes), every, none, none, None, ())
    scene = _normalised(model)
    parts = _parts(scene)
    modes, still = _kept_modes(scene, parts, max(frequencies, default=0.0))
    visited = set(frequencies)
    omega = 2 * np.pi * visited.pop() if len(visited) == 1 else None
    margins: dict[int, float] = {}
    for part in parts:
        margins |= _proof(scene, part, omega)
    live = np.array([c for c in every if c not in margins], dtype=int)
    stuck = np.array([c for c in every if c in margins and scene.state[c] == STICK], dtype=int)
    apart = np.array([c for c in every if c in margins and scene.state[c] == SEPARATION], dtype=int)
    lines = [_direction(scene, int(c), modes) for c in live]
    line = None if any(own is None for own in lines) else np.array(lines, dtype=float).reshape(-1, 2)
    kept = (proven(model.contacts[c], margins[c], units, stuck=scene.state[c] == STICK) for c in sorted(margins))
    findings = [*still, *kept, *(() if line is None else straight(model, live, line))]
    for c in sorted(live):
        findings += simplified(model.contacts[c], scene.shape[c], units, is_straight=line is not None)
    return Reduction(model, modes, live, stuck, apart, line, tuple(findings))


def keeps_states(model: Model, frequency: float) -> bool:
    """Whether it is proven that no contact ever leaves the state it starts in, at one base frequency [Hz]."""
    if any(contact.law != CONE for contact in model.contacts):
        return False
    scene, omega = _normalised(model), 2 * np.pi * frequency
    return all(_proof(scene, part, omega) for part in _parts(scene) if part.contacts.size)


@dataclass(frozen=True, eq=False)
class _Scene:
    """A model with unit modal masses.

    Attributes:
        damping: D, shape (M, M).
        shape: B, entries that are rounding set to zero, shape (C, 3, M).
        wave: force amplitudes P, ``Re(P exp(i h theta))`` a harmonic, shape (H, M).
        constant: constant forces, shape (M,).
        displacement, velocity: start, shape (M,).
        state: state in which each contact starts, shape (C,).
    """

    model: Model
    damping: np.ndarray
    shape: np.ndarray
    wave: np.ndarray
    constant: np.ndarray
    displacement: np.ndarray
    velocity: np.ndarray
    state: np.ndarray

    @property
    def force(self) -> np.ndarray:
        """Largest force on each mode, shape (M,)."""
        return np.abs(self.constant) + np.abs(self.wave).sum(axis=0)


@lru_cache(maxsize=RECENT)
def _normalised(model: Model) -> _Scene:
    structure, load, start = model.structure, model.excitation, model.start
    root = np.sqrt(structure.mass)
    shape = model.contact_shape / root
    shape[np.abs(shape) <= COUPLED * np.abs(shape).max(axis=(1, 2), keepdims=True, initial=0.0)] = 0.0
    return _Scene(
        model,
        structure.decays,
        shape,
        (load.cosine - 1j * load.sine) / root,
        load.constant / root,
        start.displacement * root,
        start.velocity * root,
        start_states(model),
    )


@dataclass(frozen=True, eq=False)
class _Part:
    """Modes and contacts that are coupled with each other and with nothing else."""

    modes: np.ndarray
    contacts: np.ndarray


@lru_cache(maxsize=RECENT)
def _parts(scene: _Scene) -> list[_Part]:
    num_contacts, _, num_modes = scene.shape.shape
    rate = np.sqrt(np.abs(np.diag(scene.damping)))
    damped = np.abs(scene.damping) > COUPLED * np.outer(rate, rate)
    touched = np.any(scene.shape != 0, axis=1)
    graph = np.block([[damped, touched.T], [touched, np.zeros((num_contacts, num_contacts), dtype=bool)]])
    label = _connected(graph)
    of_mode, of_contact = label[:num_modes], label[num_modes:]
    return [_Part(np.flatnonzero(of_mode == k), np.flatnonzero(of_contact == k)) for k in np.unique(label)]


def _connected(graph: np.ndarray) -> np.ndarray:
    """The first of the nodes that each node is connected with, itself included."""
    near, label = graph | graph.T, np.full(len(graph), -1)
    for first in range(len(graph)):
        fresh = np.flatnonzero([label[first] < 0]) + first
        while fresh.size:
            label[fresh] = first
            fresh = np.flatnonzero(near[fresh].any(axis=0) & (label < 0))
    return label


def _kept_modes(scene: _Scene, parts: list[_Part], frequency: float) -> tuple[np.ndarray, tuple[str, ...]]:
    """Modes that something moves, and a sentence about those that nothing does."""
    structure = scene.model.structure
    floor = np.maximum(structure.omega, 2 * np.pi * frequency)
    floor = np.where(floor**2 > 0, floor, 1.0)
    start = np.hypot(scene.displacement, scene.velocity / floor)
    scale = float(np.max(np.maximum(scene.force / floor**2, start), initial=0.0))
    reach = _reach(scene)
    moved = np.zeros(structure.num_modes, dtype=bool)
    for part in parts:
        allowed = STILL * scale if part.modes.size == 1 else 0.0
        moved[part.modes] = part.contacts.size > 0 or np.any(reach[part.modes] > allowed)
    moved[0] |= not np.any(moved)
    still = np.flatnonzero(~moved)
    if not still.size:
        return np.flatnonzero(moved), ()
    share = float(np.max(reach[still])) / (scale or 1.0)
    return np.flatnonzero(moved), (left_out(structure, still, share),)


def distant_stops(model: Model, live: np.ndarray) -> Iterator[tuple[Contact, float]]:
    """Live contacts with a gap so wide that the structure hardly closes it, with how many times it is too wide.

    No proof, since the forces of other contacts may move the structure further than it moves without any.
    """
    reach = _reach(_normalised(model)) / np.sqrt(model.structure.mass)
    for c in sorted(live):
        contact, shape = model.contacts[c], model.contact_shape[c, 2]
        moves = float(np.abs(shape[shape != 0]) @ reach[shape != 0])
        if contact.preload < 0 and contact.law == CONE and moves > 0:
            times = -contact.preload / contact.normal_stiffness / moves
            if times > DISTANT:
                yield contact, times


def _reach(scene: _Scene) -> np.ndarray:
    """Bound on the motion of each mode by itself under any force of its size at any frequency, shape (M,).

    The integral of the absolute value of its impulse response is
    ``coth(pi zeta / (2 sqrt(1 - zeta^2))) / omega^2``, or ``1 / omega^2`` from zeta = 1 on; infinite without
    damping or stiffness.
    """
    omega, decay = scene.model.structure.omega, np.diag(scene.damping)
    reach = np.zeros(omega.size)
    for i in np.flatnonzero((scene.force > 0) | (scene.displacement != 0) | (scene.velocity != 0)):
        if omega[i] ** 2 == 0 or decay[i] <= 0:
            reach[i] = np.inf
            continue
        with np.errstate(over="ignore"):  # a bound that overflows is infinite
            zeta = decay[i] / (2 * omega[i])
            rings = 1 / np.tanh(np.pi * zeta / (2 * np.sqrt(1 - zeta**2))) if zeta < 1 else 1.0
            free = np.hypot(scene.displacement[i], scene.velocity[i] / omega[i])
            reach[i] = scene.force[i] * rings / omega[i] ** 2 + free
    return reach


@lru_cache(maxsize=RECENT)
def _proof(scene: _Scene, part: _Part, omega: float | None) -> dict[int, float]:
    """Margin of each contact of a part if none of them ever changes its state; else nothing.

    ``omega``: circular frequency of the excitation, None where it changes.
    """
    if not part.contacts.size or np.any(scene.state[part.contacts] == SLIP):
        return {}
    contacts = [scene.model.contacts[c] for c in part.contacts]
    shape = scene.shape[np.ix_(part.contacts, np.arange(3), part.modes)]
    slip = scene.model.start.slip[part.contacts]
    output = np.array([springs(contact) @ own for contact, own in zip(contacts, shape, strict=True)])
    offset = np.array([[*(-c.tangential_stiffness @ w), c.preload] for c, w in zip(contacts, slip, strict=True)])
    bounds = envelopes(_kept_states(scene, part, shape, output), output, offset, omega)
    margins = {
        int(c): max((_margin(bound, contact, int(scene.state[c])) for bound in own), default=-np.inf)
        for c, contact, own in zip(part.contacts, contacts, bounds, strict=True)
    }
    return margins if min(margins.values()) > 0 else {}


def _kept_states(scene: _Scene, part: _Part, shape: np.ndarray, output: np.ndarray) -> Oscillation:
    """The linear system that a part is while every contact keeps the state it starts in."""
    stiffness = np.diag(scene.model.structure.omega[part.modes] ** 2)
    force = scene.constant[part.modes]
    for row, c in enumerate(part.contacts):
        stuck = bool(scene.state[c] == STICK)
        contact, slip = scene.model.contacts[c], scene.model.start.slip[c]
        force = force + shape[row].T @ constant_force(contact, slip, stuck=stuck)
        stiffness = stiffness + stuck * (shape[row].T @ output[row])
    return Oscillation(
        stiffness,
        scene.damping[np.ix_(part.modes, part.modes)],
        scene.model.excitation.harmonic,
        scene.wave[:, part.modes],
        force,
        scene.displacement[part.modes],
        scene.velocity[part.modes],
    )


def _margin(envelope: Envelope, contact: Contact, state: int) -> float:
    """How far [force] a contact at least stays from the end of its state; positive: the state never ends."""
    if state == SEPARATION:
        highest = float(envelope.highest(np.array([[0.0, 0.0, 1.0]]))[0])
        return -highest - MARGIN * envelope.size(slice(2, 3))
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    cone = np.stack([np.cos(angle), np.sin(angle), np.full(DIRECTIONS, -contact.friction)], axis=1)
    tangential = envelope.size(slice(0, 2))
    between = tangential * np.pi / DIRECTIONS
    rounding = MARGIN * (tangential + contact.friction * envelope.size(slice(2, 3)))
    return -float(envelope.highest(cone).max()) - between - rounding


def _direction(scene: _Scene, c: int, modes: np.ndarray) -> np.ndarray | None:
    """Direction in which a live contact moves, shape (2,); None if it moves in its plane."""
    contact, slip = scene.model.contacts[c], scene.model.start.slip[c]
    if contact.friction == 0:
        return np.array([1.0, 0.0])
    # A contact that starts apart takes its slip from its motion.
    own = np.zeros(2) if scene.state[c] == SEPARATION else slip
    vectors, values, _ = np.linalg.svd(scene.shape[c, :2][:, modes])
    if not np.any(values):
        vectors, values, _ = np.linalg.svd(own[:, None]) if np.any(own) else (np.eye(2), np.zeros(2), None)
        vectors = np.linalg.eigh(contact.tangential_stiffness)[1] if not np.any(values) else vectors
    along, across = vectors.T
    K = contact.tangential_stiffness
    is_straight = (
        values[1:].max(initial=0.0) <= STRAIGHT * values[0]
        and abs(across @ K @ along) <= STRAIGHT * (along @ K @ along)
        and abs(across @ own) <= STRAIGHT * np.linalg.norm(own)
    )
    return along * np.sign(along[np.argmax(np.abs(along))]) if is_straight else None
