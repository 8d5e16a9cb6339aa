"""What a run leaves out or simplifies, in words for the user."""

from collections.abc import Iterator

import numpy as np

from timesim.model.model import Contact, Model, Structure


def proven(contact: Contact, margin: float, *, stuck: bool) -> str:
    """Why a contact keeps its state: the margin [force] by which it stays inside."""
    if stuck:
        reason = f"|f| stays more than {margin:.3g} below friction times normal load (preload {contact.preload:g})"
        return f"contact {contact.name} sticks from start to end and is taken into the structure: {reason}"
    start = f"gap {-contact.preload / contact.normal_stiffness:g}"
    start = start if contact.preload < 0 else f"preload {contact.preload:g}"
    reason = f"it stays open by more than {margin / contact.normal_stiffness:.3g} ({start})"
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
            where = f"along ({round(first, 6) + 0.0:g}, {round(second, 6) + 0.0:g}) of its plane"
            name = model.contacts[c].name
            yield f"contact {name} moves straight {where}: one tangential component is modelled"


def simplified(contact: Contact, shape: np.ndarray, *, is_straight: bool) -> Iterator[str]:
    """Simplifications of the contact law in a live contact."""
    name, K = contact.name, contact.tangential_stiffness
    if contact.friction == 0:
        yield f"contact {name} is a frictionless stop: no friction force and no slip are modelled"
        return
    if not is_straight and K[0, 0] == K[1, 1] and K[0, 1] == 0:
        direction = "slip begins along the velocity, without an equation for its direction"
        yield f"contact {name} has the same tangential stiffness {K[0, 0]:g} in all directions: {direction}"
    if contact.normal_stiffness == 0:
        yield f"contact {name} has the constant normal load {contact.preload:g}: it never separates"
    elif not np.any(shape[2]) and contact.preload > 0:
        reason = "no mode moves it along its normal"
        yield f"contact {name} keeps the normal load {contact.preload:g}: {reason}, so it never separates"


def turning(contact: Contact, rate: float, steps: float) -> str:
    """A contact whose direction of slip turns fast: its rate [rad/time], and the steps a cycle that this asks for."""
    why = f"friction {contact.friction:g} lets the direction of its slip turn at a rate of about {rate:.2g} a second"
    return (
        f"contact {contact.name}: {why}, for which explicit methods may take {float(f'{steps:.2g}'):,.0f} steps a cycle"
    )
