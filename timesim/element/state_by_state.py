"""The state-by-state simulation of a contact under prescribed motion (sections 3 and 4 of the paper).

From theta = 0 with f = 0 the states follow one another: stick ends where the trial force leaves its cone
(section 3.1, closed form) or with the contact, slip where its speed falls to zero (12) or with the contact
(13), separation where the normal load rises (14), then by (15) to (17). Cycle after cycle, until the friction
force repeats to rounding. The symbols are those of `timesim.element.slip_path`; forces act on body 2, so f does the
work it takes from the motion.
"""

from dataclasses import dataclass, replace

import numpy as np

from timesim.element.cycle import JUDGED, PERIODIC, WITHDRAWN, ElementCycle, Stay, Transition, beyond
from timesim.element.motion import CYCLE, Array, PrescribedMotion
from timesim.element.slip_path import VANISHED, Law, SlipPath, constant_path, contact_direction, integrate_slip
from timesim.model.contact_state import contact_state, require_cone
from timesim.model.model import SEPARATION, SLIP, STICK, Contact
from timesim.orbit.extrapolation import limits

MAX_CYCLES = 1000
# Change of f from cycle to cycle that ends the march; so does one up to the second number that falls no further, and
# several up to `PERIODIC` that go to and fro.
ROUNDING, SLOW = 1e-14, 1e-13
MAX_TRANSITIONS = 400
# Cycles after which the march is carried on to its limit, if it converges geometrically.
MIN_FORCES = 7
# Length of a leap, relative to the largest mu n, that is not withdrawn, and before which a contact that slips by as
# little is at its full stick.
SHORT = 1e-8
# Work of slip, relative to the largest mu n and the amplitude, that is rounding.
NO_WORK = 1e-11
# A transition so near the end of the cycle [rad] belongs to the start of the next.
SEAM = 1e-11
# Angle [rad] after an extreme of the motion at which its rate has the direction of its second derivative.
AHEAD = 1e-4
TOUCH = 100.0  # of the load that counts as none: what a load is taken for that touches zero as the cycle begins


@dataclass(frozen=True)
class Spell:
    """What the contact is about to do at an angle.

    Attributes:
        state: `STICK`, `SLIP` or `SEPARATION`.
        leave, to: angle of the next transition [rad] and the state after it; in slip that of the separation,
            which sticking may forestall.
        slip: w in stick, shape (2,) [length].
        direction: of the friction force, in slip [rad].
        separation: angle at which this contact interval ends [rad]; inf if never.
    """

    state: int
    leave: float
    to: int
    slip: Array
    direction: float = 0.0
    separation: float = np.inf


@dataclass(frozen=True)
class Leap:
    """A way ahead of the march at theta = 0: from a spell and its friction force, by `way` [force]."""

    origin: Spell
    force: Array
    way: Array

    @property
    def length(self) -> float:
        """Of the way [force]."""
        return float(np.hypot(*self.way))

    def taken(self, march: "March") -> tuple[Spell, list[Array]]:
        """The spell at its end, and the friction force there, alone."""
        spell = march.moved(self.origin, self.force + self.way)
        return spell, [march.force(spell, 0.0)]


def steady_cycle(contact: Contact, motion: PrescribedMotion, *, max_cycles: int = MAX_CYCLES) -> ElementCycle:
    """March a contact through the prescribed motion, state by state, until its cycle repeats to rounding.

    One that creeps towards full stick comes to its border, and is given as full stick there.

    Of the contact friction, K_u, k_v and n0 are used; its points and frame are not. `ElementCycle.periodic` says
    whether the bound of the march sufficed.

    Raises:
        ValueError: there is no contact to speak of, or K_u and friction do not go together.
        RuntimeError: a slip could not be integrated, or the states change without end.
    """
    law = _law(contact)
    march = March(law, motion)
    spell = march.begin()
    forces, history, before, leap = [march.force(spell, 0.0)], [], np.inf, None
    for cycle in range(1, max_cycles + 1):
        state = spell.state
        stays, transitions, spell = march.cycle(spell)
        history += [replace(item, angle=item.angle + CYCLE * (cycle - 1)) for item in transitions]
        forces.append(march.force(spell, 0.0))
        residual = float(np.hypot(*(forces[-1] - forces[-2]))) / (march.largest or 1.0)
        reached = ElementCycle(law, motion, tuple(stays), tuple(transitions), cycle, residual, tuple(history))
        if leap is not None and len(forces) == JUDGED + 1:
            if leap.length > SHORT * march.largest and beyond(leap.way, forces[-1] - forces[-2]):
                leap = replace(leap, way=WITHDRAWN * leap.way)
                spell, forces = leap.taken(march)
                continue
            leap = None
        # A transition right at theta = 0 shows at the end of the first cycle only, as another state.
        settled = residual <= ROUNDING or (residual <= SLOW and residual > before / 2) or _wavers(forces, march.largest)
        if settled and leap is None and (spell.state == state or before <= PERIODIC):
            return _stuck(reached) if _sticks(reached, NO_WORK) else reached
        before = residual
        if len(forces) < MIN_FORCES:
            continue
        (limit,), (leads,) = limits(np.array([forces[-4:]]))
        if leads:
            leap = Leap(spell, forces[-1], limit - forces[-1])
            if leap.length <= SHORT * march.largest and _sticks(reached, SHORT):
                return _stuck(reached)
            spell, forces = leap.taken(march)
    return reached


def _wavers(forces: list[Array], load: float) -> bool:
    """Whether f has gone to and fro over the last cycles, by no more than rounding; a creep goes one way."""
    changes = np.diff(forces[-MIN_FORCES:], axis=0)
    sizes = np.hypot(*changes.T)
    to_and_fro = np.hypot(*changes.sum(axis=0)) < sizes.sum() / 2
    return bool(len(forces) >= MIN_FORCES and to_and_fro and sizes.max() <= PERIODIC * load)


def _sticks(cycle: ElementCycle, tolerance: float) -> bool:
    """Whether the contact all but sticks: by its work of slip, relative to the largest mu n and the amplitude."""
    states = {stay.state for stay in cycle.stays}
    scale = cycle.largest_limit * np.hypot(*cycle.motion.amplitude)
    return SEPARATION not in states and STICK in states and cycle.work <= tolerance * scale


def _stuck(cycle: ElementCycle) -> ElementCycle:
    """The same as full stick, as in the longest stay in it."""
    stays = [stay for stay in cycle.stays if stay.state == STICK]
    slip = max(stays, key=lambda stay: stay.stop - stay.start).slip
    return replace(cycle, stays=(Stay(STICK, 0.0, CYCLE, slip),), transitions=(), residual=0.0)


def _law(contact: Contact) -> Law:
    require_cone([contact], "prescribed motion")
    K = np.asarray(contact.tangential_stiffness, float)
    where = f"contact {contact.name}"
    if contact.normal_stiffness < 0 or contact.friction < 0:
        given = f"{contact.friction} and {contact.normal_stiffness}"
        raise ValueError(f"{where}: friction and normal stiffness must not be negative, not {given}")
    if contact.normal_stiffness == 0 and contact.preload <= 0:
        rule = f"without normal stiffness the preload must be positive, not {contact.preload}"
        raise ValueError(f"{where}: {rule}: there would never be contact")
    if not np.array_equal(K, K.T) or (contact.friction > 0 and np.linalg.eigvalsh(K)[0] <= 0):
        rule = "must be symmetric and positive definite, or zero together with friction 0"
        raise ValueError(f"{where}: the tangential stiffness {rule}, not {K.tolist()}")
    return Law(K, contact.friction, contact.normal_stiffness, contact.preload)


class March:
    """The rules by which one state follows another, for one contact and one motion."""

    def __init__(self, law: Law, motion: PrescribedMotion):
        self.law, self.motion = law, motion
        y, _ = motion.evaluate(motion.normal_extremes)
        self.largest = float(law.limit(y, y)[0].max())
        self.load_floor = 1e-14 * (abs(law.preload) + law.normal_stiffness * np.abs(y[2]).max())
        angles, rising = motion.crossings(np.array([0.0, 0.0, law.normal_stiffness]), law.preload)
        self.closings, self.openings = angles[rising], angles[~rising]
        if not angles.size and self.largest > 0 and law.load(motion.evaluate(0.0)[0]) <= self.load_floor:
            # A touch is no opening, whose closing would be waited for: at the seam, too, n stays above 0.
            self.law = replace(law, preload=law.preload + TOUCH * self.load_floor)
        self.trial = np.zeros((3, 3))
        self.trial[:2, :2] = law.stiffness
        self.trial[2, 2] = law.friction * law.normal_stiffness
        self.straight_stops = self._straight_stops()
        # After a separation a cycle repeats the one before to the last bit.
        self._paths: dict[tuple[float, float, float], SlipPath] = {}

    def _straight_stops(self) -> tuple[Array, Array, Array] | None:
        """Straight motion along a principal axis of K_u: the axis, where slip along and against it stops."""
        line = self.motion.line
        if self.law.frictionless or line is None:
            return None
        pull = self.law.stiffness @ line
        along = float(line @ pull)
        if np.hypot(*(pull - along * line)) > 1e-14 * along:
            return None
        stops = []
        for sign in (1.0, -1.0):
            weights = np.append(sign * along * line, -self.trial[2, 2])
            angles, rising = self.motion.crossings(weights, 0.0, rate=True)
            stops.append(angles[~rising])
        return line, stops[0], stops[1]

    def begin(self) -> Spell:
        """The start at theta = 0: f = 0, stuck if n > 0, else separated."""
        y, _ = self.motion.evaluate(0.0)
        state = contact_state(self.law.load(y), self.law.friction, SEPARATION, rounding=self.load_floor)
        if state == SEPARATION:
            return self._separated(0.0, SEAM)
        opening = _next(self.openings, 0.0)
        if state == SLIP:
            return Spell(SLIP, opening, SEPARATION, y[:2], 0.0, opening)
        return self._stuck(0.0, y[:2], opening, on_cone=False)

    def _separated(self, theta: float, slack: float = 0.0) -> Spell:
        return Spell(SEPARATION, _next(self.closings, theta, slack), STICK, np.zeros(2))

    def _stuck(self, theta: float, slip: Array, separation: float, *, on_cone: bool) -> Spell:
        offset = np.append(-self.law.stiffness @ slip, self.law.friction * self.law.preload)
        leave, to = self.motion.cone_exit(self.trial, offset, theta, on_cone=on_cone), SLIP
        # Where the cone and n = 0 are met at once the force only touches the cone, and `leave` is later.
        if separation <= leave:
            leave, to = separation, SEPARATION
        return Spell(STICK, leave, to, slip, 0.0, separation)

    def _touching(self, theta: float) -> Spell:
        """Re-contact: stick if |K_u u'| < mu n' (15), else slip (17)."""
        y, dy = self.motion.evaluate(theta)
        separation = _next(self.openings, theta)
        if np.hypot(*(self.law.stiffness @ dy[:2])) < self.law.limit(y, dy)[1]:
            return self._stuck(theta, y[:2], separation, on_cone=True)
        direction = 0.0 if self.law.frictionless else contact_direction(self.law, dy)[0]
        return Spell(SLIP, separation, SEPARATION, np.zeros(2), direction, separation)

    def _sliding(self, theta: float, spell: Spell) -> Spell:
        direction = self._direction(theta, self.force(spell, theta))
        return replace(spell, state=SLIP, leave=spell.separation, to=SEPARATION, direction=direction)

    def _direction(self, theta: float, force: Array) -> float:
        """Direction in which slip begins [rad]: of the force, or, where n only touches 0, of the motion right after."""
        y, _ = self.motion.evaluate(theta)
        rounding = ROUNDING * (np.abs(self.law.stiffness).sum() * np.abs(y[:2]).max())
        if np.hypot(*force) <= VANISHED * self.largest + rounding:
            return contact_direction(self.law, self.motion.evaluate(theta + AHEAD)[1])[0]
        return float(np.arctan2(force[1], force[0]))

    def _stopped(self, theta: float, spell: Spell) -> Spell:
        slip = self.motion.evaluate(theta)[0][:2] - self.law.compliance @ self.force(spell, theta)
        return self._stuck(theta, slip, spell.separation, on_cone=True)

    def force(self, spell: Spell, theta: float) -> Array:
        """Friction force at an angle, shape (2,) [force]."""
        y, dy = self.motion.evaluate(theta)
        if spell.state == STICK:
            return self.law.stiffness @ (y[:2] - spell.slip)
        if spell.state == SEPARATION:
            return np.zeros(2)
        return self.law.limit(y, dy)[0] * np.array([np.cos(spell.direction), np.sin(spell.direction)])

    def moved(self, spell: Spell, force: Array) -> Spell:
        """The spell at theta = 0 with another friction force, at most mu n."""
        y, dy = self.motion.evaluate(0.0)
        if spell.state == SLIP:
            return replace(spell, direction=float(np.arctan2(force[1], force[0])))
        excess = np.hypot(*force) / float(self.law.limit(y, dy)[0])
        slip = y[:2] - self.law.compliance @ (force / max(excess, 1.0))
        return self._stuck(0.0, slip, spell.separation, on_cone=False)

    def _slide(self, theta: float, spell: Spell, end: float) -> SlipPath:
        """Slip from an angle up to `end` at most: in closed form where the direction cannot change."""
        if self.law.frictionless:
            return constant_path(0.0, theta, end, False)
        if self.straight_stops is None:
            key = (theta, spell.direction, end)
            if key not in self._paths:
                self._paths[key] = integrate_slip(self.law, self.motion, spell.direction, theta, end, self.largest)
            return self._paths[key]
        line, forward, backward = self.straight_stops
        along = line @ [np.cos(spell.direction), np.sin(spell.direction)] > 0
        stop = _next(forward if along else backward, theta, SEAM)
        # Of a force that is next to nothing where slip begins the direction is rounding.
        first, second = line if along else -line
        return constant_path(float(np.arctan2(second, first)), theta, min(stop, end), stop < end)

    def cycle(self, spell: Spell) -> tuple[list[Stay], list[Transition], Spell]:
        """One cycle from theta = 0: its stays and transitions, and the spell in which the next one begins."""
        stays: list[Stay] = []
        transitions: list[Transition] = []
        theta = 0.0
        for _ in range(MAX_TRANSITIONS):
            inside = spell.leave < CYCLE - SEAM
            stop = max(theta, min(spell.leave, CYCLE)) if inside else CYCLE
            path = self._slide(theta, spell, stop) if spell.state == SLIP and stop > theta else None
            stuck = path is not None and path.stuck and path.stop < CYCLE - SEAM
            if path is not None:
                stop = path.stop if stuck else stop
                spell = replace(spell, direction=path.final)
            stays.append(Stay(spell.state, theta, stop, spell.slip, path))
            if not (stuck or inside):
                return stays, transitions, _rewound(spell)
            following = self._stopped(stop, spell) if stuck else self._follow(stop, spell)
            transitions.append(Transition(float(stop), spell.state, following.state))
            spell, theta = following, stop
        last = f"the last at {np.degrees(theta):.9g} degrees"
        raise RuntimeError(f"element: more than {MAX_TRANSITIONS} transitions in a cycle, {last}")

    def _follow(self, theta: float, spell: Spell) -> Spell:
        if spell.state == SEPARATION:
            return self._touching(theta)
        return self._separated(theta) if spell.to == SEPARATION else self._sliding(theta, spell)


def _next(angles: Array, theta: float, slack: float = 0.0) -> float:
    """First of the angles after theta, going round, or inf; one within `slack` before it is met at once."""
    if angles.size == 0:
        return np.inf
    ahead = (angles - theta + slack) % CYCLE - slack
    return float(theta + max(ahead.min(), 0.0))


def _rewound(spell: Spell) -> Spell:
    """The spell at the end of a cycle as the next one counts its angles."""
    direction = (spell.direction + np.pi) % CYCLE - np.pi
    return replace(spell, leave=spell.leave - CYCLE, separation=spell.separation - CYCLE, direction=direction)
