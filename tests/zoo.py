"""Generated structures with frictional contacts in units of any size: 2 to 14 modes, 1 to 4 contacts, light damping.

Contacts are up to 300 times as stiff as the first mode, some of them gaps, some frictionless stops, to the ground or
from point to point. Every quantity has its own power of ten, as in metres and newtons; the force is such that the first
mode alone would reach a share of the length that gaps and preloads are set by.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from timesim.model.model import GROUND, Contact, Excitation, Model, Structure
from timesim.model.start import rest_start


def structure(
    seed: int, damping: tuple[float, float] = (1e-3, 3e-2), size: tuple[int, int] | None = None
) -> tuple[Model, float]:
    """A generated model at rest, and the natural frequency of its first mode without contacts [Hz].

    Args:
        seed: each gives another structure.
        damping: least and largest damping ratio, the same for all modes.
        size: modes and contacts; by the seed where it is not given.
    """
    rng = np.random.default_rng([seed, 77])
    num_modes, num_contacts = int(rng.integers(2, 15)), int(rng.integers(1, 5))
    if size is not None:
        (num_modes, num_contacts), rng = size, np.random.default_rng([seed, *size])
    base, unit, length = 10 ** rng.uniform(-0.5, 2.5), 10 ** rng.uniform(-2, 2), 10 ** rng.uniform(-5, 0)
    natural = np.sort(base * np.concatenate([[1.0], rng.uniform(1.05, 12, num_modes - 1)]))
    mass = unit * rng.uniform(0.7, 1.4, num_modes)
    ratio = 10 ** rng.uniform(np.log10(damping[0]), np.log10(damping[1]))
    points = tuple(f"p{i}" for i in range(num_contacts + 1))
    shape = rng.uniform(-1, 1, (len(points), 3, num_modes))
    body = Structure(natural, mass, 2 * ratio * mass * (2 * np.pi * natural), points, shape)
    stiffness = unit * (2 * np.pi * base) ** 2
    amplitude = rng.uniform(0.2, 1)
    contacts = tuple(_contact(rng, i, points, stiffness, length) for i in range(num_contacts))
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    force = stiffness * length * 2 * ratio * amplitude * (direction @ shape[-1])
    none = np.zeros((1, num_modes))
    load = Excitation(None, np.array([1]), force[None], none, none[0])
    return Model(body, contacts, load, rest_start(num_modes, num_contacts)), base


def driven(seed: int, size: tuple[int, int]) -> tuple[Model, int]:
    """A generated model under a force and a frequency that mostly make its contacts switch, and a number of cycles."""
    model, base = structure(seed, (1e-3, 5e-2), size)
    rng, load = np.random.default_rng([seed, *size, 1]), model.excitation
    share = 10 ** rng.uniform(-0.7, 0.6) / (2 * model.structure.damping_ratio[0])
    load = replace(load, frequency=float(base * rng.uniform(0.7, 2.0)), cosine=share * load.cosine)
    return replace(model, excitation=load), int(np.exp(rng.uniform(np.log(8), np.log(80))))


def with_full_stiffness(model: Model, seed: int) -> Model:
    """The model with K_u of each contact of two principal values, up to ten times apart, along axes of its own."""
    rng = np.random.default_rng([seed, 5])

    def full(contact: Contact) -> Contact:
        angle, share = rng.uniform(0, np.pi), 10 ** rng.uniform(0, 0.5)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        stiffness = contact.tangential_stiffness[0, 0] * turn @ np.diag([share, 1 / share]) @ turn.T
        return replace(contact, tangential_stiffness=(stiffness + stiffness.T) / 2)

    return replace(model, contacts=tuple(map(full, model.contacts)))


def scene_of(model: Model) -> dict[str, Any]:
    """What a scene file says of a generated model, without a study."""
    body, force = model.structure, model.excitation.cosine[0]
    modes = [
        {
            "frequency": float(body.frequency[i]),
            "mass": float(body.mass[i]),
            "damping_ratio": float(body.damping_ratio[i]),
            "shape": {name: body.shape[p, :, i].tolist() for p, name in enumerate(body.points)},
        }
        for i in range(body.num_modes)
    ]
    load: dict[str, Any] = {
        "modal_force": [{"amplitude": abs(float(f)), "phase_deg": 0.0 if f >= 0 else 180.0} for f in force]
    }
    if model.excitation.frequency is not None:
        load["frequency"] = model.excitation.frequency
    contacts = [_contact_section(contact) for contact in model.contacts]
    return {"structure": {"modes": modes}, "contacts": contacts, "excitation": load}


def _contact_section(contact: Contact) -> dict[str, Any]:
    tangent, _, normal = contact.frame.tolist()
    stiffness = contact.tangential_stiffness
    isotropic = np.array_equal(stiffness, stiffness[0, 0] * np.eye(2))
    return {
        "name": contact.name,
        "point": contact.point,
        "against": contact.against,
        "normal": normal,
        "tangent": tangent,
        "friction": float(contact.friction),
        "tangential_stiffness": float(stiffness[0, 0]) if isotropic else stiffness.tolist(),
        "normal_stiffness": float(contact.normal_stiffness),
        "preload": float(contact.preload),
    }


def _contact(rng: np.random.Generator, index: int, points: tuple[str, ...], stiffness: float, length: float) -> Contact:
    tangential = stiffness * 10 ** rng.uniform(0, np.log10(300))
    normal = tangential * rng.uniform(0.5, 2)
    is_stop, has_gap = rng.random() < 0.2, rng.random() < 0.35
    if has_gap:
        preload = -normal * length * rng.uniform(0.02, 0.3)
    else:
        preload = normal * length * rng.uniform(0.0, 0.3) * min(1, 5 * stiffness / normal)
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    if np.linalg.det(frame) < 0:
        frame[0] *= -1
    return Contact(
        name=f"c{index}",
        point=points[index],
        against=GROUND if rng.random() < 0.6 else points[(index + 1) % len(points)],
        frame=frame,
        friction=0.0 if is_stop else rng.uniform(0.1, 0.8),
        tangential_stiffness=np.zeros((2, 2)) if is_stop else tangential * np.eye(2),
        normal_stiffness=normal,
        preload=preload,
    )
