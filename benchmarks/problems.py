"""The problems of the benchmarks as models, and what every opponent hands back.

`oscillator` is the paper's 3-DOF oscillator (Table 1); `many_contacts` is a made-up structure of ten modes
with five contacts, one of them with a full K_u, one with unequal axes and one between two points, that
stick, slip and separate: 18 transitions a cycle; over cycles 11 to 20 each contact slips for 18 to 94 % of
the time, and three are apart for 36 to 65 %.
"""

from typing import NamedTuple

import numpy as np

from timesim.model.model import GROUND, Contact, Excitation, Model, Start, Structure

Event = tuple[float, int, int, int]


class Run(NamedTuple):
    """The end of a run: modal displacement and velocity (M,), slip (C, 2), state (C,), and its transitions.

    ``events`` holds (time, contact, state left, state entered), and is empty where it was not asked for.
    """

    q: np.ndarray
    qdot: np.ndarray
    slip: np.ndarray
    state: np.ndarray
    num_events: int
    events: list[Event]


def error(run: Run, reference: Run) -> float:
    """Largest difference of the last state (q, qdot), relative to its largest component."""
    mine, truth = (np.concatenate([r.q, r.qdot]) for r in (run, reference))
    return float(np.abs(mine - truth).max() / np.abs(truth).max())


def rest(num_modes: int, num_contacts: int) -> Start:
    return Start(np.zeros(num_modes), np.zeros(num_modes), np.zeros((num_contacts, 2)), np.full(num_contacts, -1))


def oscillator(preload: float, frequency: float | None = None) -> Model:
    """The paper's oscillator (Table 1) from rest at any preload."""
    omega = 2 * np.pi * np.array([0.9, 1.1])
    shape = np.array([[[1.0, 1.0], [1.0, -1.0], [0.8, 0.6]]])
    structure = Structure(omega / (2 * np.pi), np.ones(2), 2 * 0.02 * omega, ("tip",), shape)
    pad = Contact("pad", "tip", GROUND, np.eye(3), 0.5, 20.0 * np.eye(2), 20.0, preload)
    excitation = Excitation(frequency, np.array([1]), np.ones((1, 2)), np.zeros((1, 2)), np.zeros(2))
    return Model(structure, (pad,), excitation, rest(2, 1))


def many_contacts(frequency: float | None = None) -> Model:
    """Ten modes, five contacts; 18 transitions a cycle at `MANY_CONTACTS_FREQUENCY`."""
    random = np.random.default_rng(1)
    natural = np.geomspace(0.8, 4.0, 10)
    names = tuple(f"p{k}" for k in range(5))
    shape = random.uniform(-1, 1, (5, 3, 10))
    structure = Structure(natural, np.ones(10), 2 * 0.02 * 2 * np.pi * natural, names, shape)
    stiffness = [
        6 * np.eye(2),
        np.array([[8.0, 2.0], [2.0, 4.0]]),
        5 * np.eye(2),
        np.diag([3.0, 7.0]),
        4 * np.eye(2),
    ]
    preload = [0.6, 0.3, -0.2, 0.15, 0.4]
    frames = [np.linalg.qr(random.normal(size=(3, 3)))[0] for _ in names]
    contacts = tuple(
        Contact(
            f"c{k}", names[k], names[0] if k == 4 else GROUND, np.linalg.det(frames[k]) * frames[k],
            0.4, stiffness[k], 6.0, preload[k],
        )
        for k in range(5)
    )  # fmt: skip
    cosine, sine = random.uniform(-1, 1, (2, 1, 10))
    excitation = Excitation(frequency, np.array([1]), cosine, sine, np.zeros(10))
    return Model(structure, contacts, excitation, rest(10, 5))


MANY_CONTACTS_FREQUENCY = 1.0


def many_modes(num_modes: int, num_contacts: int, frequency: float | None = None) -> Model:
    """Modes up to 40 times the excitation of 1 Hz, with contacts to the ground that stick, slip and separate."""
    random = np.random.default_rng(3)
    natural = np.geomspace(0.8, 40.0, num_modes)
    names = tuple(f"p{k}" for k in range(num_contacts))
    shape = random.uniform(-1, 1, (num_contacts, 3, num_modes)) * 3 / np.sqrt(num_modes * natural)
    structure = Structure(natural, np.ones(num_modes), 2 * 0.02 * 2 * np.pi * natural, names, shape)
    contacts = tuple(
        Contact(f"c{k}", name, GROUND, np.eye(3), 0.4, 20 * np.eye(2), 20.0, float(random.uniform(-0.2, 1.0)))
        for k, name in enumerate(names)
    )
    cosine, sine = (random.uniform(-1, 1, (1, num_modes)) / natural for _ in range(2))
    excitation = Excitation(frequency, np.array([1]), cosine, sine, np.zeros(num_modes))
    return Model(structure, contacts, excitation, rest(num_modes, num_contacts))
