"""The contact laws by the name that a contact gives: a law is one module, and one line here. Nothing here loads JAX."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from timesim.model.contact_state import start_states
from timesim.model.model import CONE, Contact, Model, Start

if TYPE_CHECKING:
    from timesim.engine.law.contact_law import ContactLaw


@dataclass(frozen=True)
class LawEntry:
    """Where a contact law is.

    Attributes:
        module, name: module and class, final under `timesim.engine.law.contact_law.ContactLaw`.
        parameters: names of its own parameters, beside those of `timesim.model.model.Contact`; each a number that
            stands in ``law_parameters`` of a contact, in the units of the scene.
    """

    module: str
    name: str
    parameters: tuple[str, ...] = ()


LAWS = {
    CONE: LawEntry("timesim.engine.law.cone", "ConeLaw"),
}


def law_class(contacts: Sequence[Contact]) -> "type[ContactLaw]":
    """The law that all of some contacts obey; that of the cone where there are none.

    Raises:
        ValueError: they obey different ones, or one of no such name.
    """
    names = {contact.law for contact in contacts} or {CONE}
    if len(names) > 1:
        raise ValueError(f"contacts: all must obey one law, not {' and '.join(sorted(names))}")
    (name,) = names
    if name not in LAWS:
        raise ValueError(f"contacts: law must be one of {', '.join(LAWS)}, not {name}")
    entry = LAWS[name]
    return getattr(importlib.import_module(entry.module), entry.name)


def begin_of(model: Model) -> Start:
    """The start of a model with the state of each contact, as given or as its law says."""
    return replace(model.start, state=start_states(model, law_class(model.contacts).start_states))
