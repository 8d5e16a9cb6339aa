"""What a run leaves out or simplifies, in words for the user, in the units of length and force that a scene names."""

from collections.abc import Iterator, Mapping

import numpy as np

from timesim.model.model import Contact, Model, Structure

Units = Mapping[str, str]
"""Names of the units of length and force, as far as the scene gives them."""


def _size(number: str, units: Units, *quantities: str) -> str:
    """A number with the unit of a quantity, or of the quotient of two."""
    names = [units[quantity] for quantity in quantities if quantity in units]
    return f"{number} {'/'.join(names)}" if len(names) == len(quantities) else number


def proven(contact: Contact, margin: float, units: Units, *, stuck: bool) -> str:
    """Why a contact keeps its state: the margin [force] by which it stays inside."""
    preload = f"preload {_size(f'{contact.preload:g}', units, 'force')}"
    if stuck:
        reason = f"|f| stays more than {_size(f'{margin:.3g}', units, 'force')} below friction times normal load"
        return f"contact {contact.name} sticks from start to end and is taken into the structure: {reason} ({preload})"
    gap, room = -contact.preload / contact.normal_stiffness, margin / contact.normal_stiffness
    start = f"gap {_size(f'{gap:g}', units, 'length')}" if contact.preload < 0 else preload
    reason = f"it stays open by more than {_size(f'{room:.3g}', units, 'length')} ({start})"
    return f"contact {contact.name} never touches and is left out: {reason}"


def left_out(structure: Structure, still: np.ndarray, share: float) -> str:
    """Modes that nothing moves by more than a share of the scale of the scene."""
    names = ", ".join(f"{i + 1} ({structure.frequency[i]:.6g} Hz)" for i in still)
    noun, verb, them = ("mode", "is", "it") if still.size == 1 else ("modes", "are", "them")
    size = f", beyond {share:.1g} of the scene's scale" if share > 0 else ""
    return f"{noun} {names} {verb} left out: no force, contact or start value moves {them}{size}"


def straight(model: Model, live: np.ndarray, line: np.ndarray) -> Iterator[str]:
    """Contacts that move along a line of their plane."""
    for row in np.argsort(live):
        c, (first, second) = live[row], line[row]
        if model.contacts[c].friction > 0:
            # A unit vector: beyond its sixth decimal is rounding.
            where = f"moves straight along ({round(first, 6) + 0.0:g}, {round(second, 6) + 0.0:g}) of its plane"
            where = where if np.any(model.contact_shape[c, :2]) else "is moved by no mode in its plane"
            yield f"contact {model.contacts[c].name} {where}: one tangential component is modelled"


def simplified(contact: Contact, shape: np.ndarray, units: Units, *, is_straight: bool) -> Iterator[str]:
    """Simplifications of the contact law in a live contact."""
    name, K, load = contact.name, contact.tangential_stiffness, _size(f"{contact.preload:g}", units, "force")
    if contact.friction == 0:
        yield f"contact {name} is a frictionless stop: no friction force and no slip are modelled"
        return
    if not is_straight and K[0, 0] == K[1, 1] and K[0, 1] == 0:
        direction = "slip begins along the velocity, without an equation for its direction"
        stiffness = _size(f"{K[0, 0]:g}", units, "force", "length")
        yield f"contact {name} has the same tangential stiffness {stiffness} in all directions: {direction}"
    if contact.normal_stiffness == 0:
        yield f"contact {name} has the constant normal load {load}: it never separates"
    elif not np.any(shape[2]) and contact.preload > 0:
        reason = "no mode moves it along its normal"
        yield f"contact {name} keeps the normal load {load}: {reason}, so it never separates"


def turning(contact: Contact, rate: float, steps: float) -> str:
    """A contact whose direction of slip turns fast: its rate [rad/time], and the steps a cycle that this asks for."""
    little = f"its friction force is so little (coefficient {contact.friction:g})"
    why = f"{little} that the direction of its slip may turn at a rate of about {rate:.2g} a second"
    return (
        f"contact {contact.name}: {why}, for which explicit methods may take {float(f'{steps:.2g}'):,.0f} steps a cycle"
    )
