"""A zoo of models with known answers, and generated ones that slip and separate.

Sources: the oscillator of the paper's Table 1; systems of one or two degrees of freedom whose steady states
are known in closed form or were computed by other codes (circular motion, Jenkins element, Den Hartog 1931,
a jump on an inclined contact, and the example `2dof_eldry_fric` of TMDSimPy). Those are given at angular
frequencies.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from timesim.element.motion import HarmonicMotion
from timesim.model.model import GROUND, Contact, Excitation, Model, Start, Structure

GENERATED_CYCLES = 12
CREEPING = (322, 789, 1230, 1304, 1382, 2748, 3154, 3493)
TURN = 2 * np.pi


Numbers = Sequence[float] | np.ndarray


def excitation(frequency: float, cosine: Numbers, sine: Numbers, constant: Numbers | None = None) -> Excitation:
    """Modal forces of the first harmonic."""
    cosines, sines = np.array([cosine], dtype=float), np.array([sine], dtype=float)
    rest = np.zeros(cosines.shape[1]) if constant is None else np.array(constant, dtype=float)
    return Excitation(frequency, np.array([1]), cosines, sines, rest)


def at_rest(num_modes: int, num_contacts: int) -> Start:
    return Start(np.zeros(num_modes), np.zeros(num_modes), np.zeros((num_contacts, 2)), np.full(num_contacts, -1))


def structure(stiffness: Numbers, damping: Numbers, shape: Sequence[Sequence[float]]) -> Structure:
    """Unit masses and one point; `shape` holds x, y, z of it a mode."""
    frequency = np.sqrt(np.array(stiffness, dtype=float)) / (2 * np.pi)
    shapes = np.array(shape, dtype=float).T[None]
    return Structure(frequency, np.ones(len(stiffness)), np.array(damping, dtype=float), ("tip",), shapes)


def pad(friction: float, tangential: float, normal: float, preload: float, frame: np.ndarray | None = None) -> Contact:
    axes = np.eye(3) if frame is None else frame
    return Contact("pad", "tip", GROUND, axes, friction, tangential * np.eye(2), normal, preload)


def contact(
    stiffness: float | Numbers = 1.0, friction: float = 0.3, normal: float = 1.0, preload: float = 1.0
) -> Contact:
    """A contact by itself, for prescribed motion; K_u a number or a matrix."""
    matrix = np.asarray(stiffness, dtype=float)
    K = matrix if matrix.ndim == 2 else matrix * np.eye(2)
    return Contact("pad", "tip", GROUND, np.eye(3), friction, K, normal, preload)


def creeping(seed: int) -> tuple[Contact, HarmonicMotion]:
    """A contact and a motion; of the seeds `CREEPING` it creeps towards full stick, in 23 to 400 cycles."""
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(2, 2))
    friction, preload = rng.uniform(0.2, 0.8), rng.uniform(0.5, 1.5)
    size, phase = (*rng.uniform(0.1, 1, 2), 0.5 * rng.integers(2) * preload), rng.uniform(0, TURN, 2)
    return contact(half @ half.T / 2 + 0.3 * np.eye(2), friction, 1.0, preload), HarmonicMotion(*size, *phase)


def slipping_pair(rng: np.random.Generator, full: bool) -> tuple[Contact, HarmonicMotion]:
    """A contact and a motion that mostly slip for part of the cycle; many of them separate.

    ``full``: K_u is a whole matrix, else it is isotropic.
    """
    A, B = rng.uniform(0.3, 2.0), rng.choice([0.0, 0.02, 0.3, 1.0]) * rng.uniform(0.3, 2.0)
    D, preload = rng.choice([0.0, 0.5, 1.5]), rng.choice([1.0, 1.0, 0.0, -0.4])
    D = max(D, 0.9) if preload <= 0 else D
    turn, ratio = rng.uniform(0, np.pi), rng.uniform(1.0, 4.0)
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    K = axes @ np.diag([1.0, ratio]) @ axes.T
    phi, psi = rng.uniform(0, 2 * np.pi, 2)
    chosen = contact((K + K.T) / 2 if full else 1.0, rng.uniform(0.2, 1.0), 1.0, preload)
    return chosen, HarmonicMotion(A, B, D, phi, psi)


def oscillator(preload: float, frequency: float) -> Model:
    """Table 1 of the paper; `frequency` [Hz]."""
    natural = np.array([0.9, 1.1])
    shape = [[1.0, 1.0, 0.8], [1.0, -1.0, 0.6]]
    body = structure((2 * np.pi * natural) ** 2, 2 * 0.02 * 2 * np.pi * natural, shape)
    return Model(body, (pad(0.5, 20.0, 20.0, preload),), excitation(frequency, [1.0, 1.0], [0.0, 0.0]), at_rest(2, 1))


def oscillator_scene(preload: float, phase_deg: float = 0.0) -> dict[str, Any]:
    """The same oscillator as a scene file writes it, without a study; the force on mode 2 has a phase."""
    modes = [
        {"frequency": 0.9, "damping_ratio": 0.02, "mass": 1.0, "shape": {"tip": [1, 1, 0.8]}},
        {"frequency": 1.1, "damping_ratio": 0.02, "mass": 1.0, "shape": {"tip": [1, -1, 0.6]}},
    ]
    contact = {
        "name": "pad",
        "point": "tip",
        "friction": 0.5,
        "tangential_stiffness": 20.0,
        "normal_stiffness": 20.0,
        "preload": preload,
    }
    forces = [{"amplitude": 1.0}, {"amplitude": 1.0, "phase_deg": phase_deg}]
    return {"structure": {"modes": modes}, "contacts": [contact], "excitation": {"modal_force": forces}}


def circular(force: float, omega: float) -> Model:
    """Rotating force on a mass on a plane: in slip the steady motion is a circle, see `circular_radius`."""
    body = structure([1.0, 1.0], [0.02, 0.02], [[1, 0, 0], [0, 1, 0]])
    load = excitation(omega / (2 * np.pi), [force, 0.0], [0.0, force])
    return Model(body, (pad(0.3, 1.0, 0.0, 1.0),), load, at_rest(2, 1))


def circular_radius(force: float, omega: float) -> float:
    """Exact radius R of `circular` in steady slip, delta = mu N / k_t = 0.3; NaN where it sticks."""
    delta, low, high = 0.3, 0.3, 0.3

    def excess(radius: float) -> float:
        ratio = (delta / radius) ** 2
        imaginary = 0.02 * omega + delta * np.sqrt(max(radius**2 - delta**2, 0.0)) / radius**2
        return float(np.hypot(1 - omega**2 + ratio, imaginary) * radius - force)

    if excess(low) > 0:
        return float("nan")
    while excess(high) < 0:
        high *= 2
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) < 0 else (low, middle)
    return high


def jenkins(omega: float) -> Model:
    """One mass on a Jenkins element under constant load: amplitude 1.360172 at 1.2, 0.965336 at 1.3."""
    body = structure([1.0], [0.02], [[1, 0, 0]])
    load = excitation(omega / (2 * np.pi), [0.5], [0.0])
    return Model(body, (pad(0.3, 1.0, 0.0, 1.0),), load, at_rest(1, 1))


def den_hartog(omega: float, friction_force: float, tangential: float) -> Model:
    """Undamped mass with Coulomb friction under ``cos``; rigid as `tangential` grows (Den Hartog 1931)."""
    body = structure([1.0], [0.0], [[1, 0, 0]])
    load = excitation(omega / (2 * np.pi), [1.0], [0.0])
    return Model(body, (pad(friction_force, tangential, 0.0, 1.0),), load, at_rest(1, 1))


def den_hartog_amplitude(omega: float, friction_force: float) -> float:
    """Exact amplitude of `den_hartog` with a rigid element, without stops."""
    response = 1 / (1 - omega**2)
    damping = np.sin(np.pi / omega) / (omega * (1 + np.cos(np.pi / omega)))
    return float(np.sqrt(response**2 - (friction_force * damping) ** 2))


def inclined(omega: float) -> Model:
    """One mass on a contact inclined by 45 degrees: two stable motions between 1.2575 and 1.2850."""
    r = np.sqrt(0.5)
    frame = np.array([[r, 0, -r], [0, 1, 0], [r, 0, r]])
    body = structure([1.0], [0.02], [[1, 0, 0]])
    load = excitation(omega / (2 * np.pi), [0.2], [0.0])
    return Model(body, (pad(0.4, 1.0, 1.0, 1.0, frame),), load, at_rest(1, 1))


def two_degrees(force: float, omega: float) -> Model:
    """TMDSimPy's `2dof_eldry_fric`: a tangential and a normal mode, closed by a constant force of 100."""
    body = structure([12.0, 21.0], [0.1 * np.sqrt(12.0), 2.0], [[1, 0, 0], [0, 0, 1]])
    load = excitation(omega / (2 * np.pi), [force, 0.1 * force], [0.0, 0.0], [0.0, 100.0])
    return Model(body, (pad(0.85, 5.0, 21.0, 0.0),), load, at_rest(2, 1))


def two_stops(gaps: tuple[float, float]) -> Model:
    """Two uncoupled, equally forced masses; each meets a frictionless stop at its own gap."""
    natural, points = np.array([0.8, 0.8]), ("first", "second")
    shape = np.zeros((2, 3, 2))
    shape[0, 2, 0] = shape[1, 2, 1] = 1.0
    omega = 2 * np.pi * natural
    body = Structure(natural, np.ones(2), 0.1 * omega, points, shape)
    stops = tuple(
        Contact(point, point, GROUND, np.eye(3), 0.0, np.zeros((2, 2)), 40.0, -40.0 * gap)
        for point, gap in zip(points, gaps, strict=True)
    )
    return Model(body, stops, excitation(1.0, [1.0, 1.0], [0.0, 0.0]), at_rest(2, 2))


def grazing_stop(part: float, stiffness: float) -> Model:
    """A mass in its steady motion without contact; a frictionless stop at the given part of its amplitude."""
    omega, natural, damping = 2 * np.pi, 2 * np.pi * 0.8, 0.5
    response = 1.0 / (natural**2 - omega**2 + 1j * damping * omega)
    body = structure([natural**2], [damping], [[0, 0, 1]])
    stop = pad(0.0, 0.0, stiffness, -stiffness * part * abs(response))
    start = Start(np.array([response.real]), np.array([-omega * response.imag]), np.zeros((1, 2)), np.array([-1]))
    return Model(body, (stop,), excitation(1.0, [1.0], [0.0]), start)


def stopped_chain(ratio: float) -> Model:
    """Two unit masses between unit springs; the second meets a stop so many times as stiff, at a gap of 1."""
    natural, points = np.sqrt([1.0, 3.0]) / TURN, ("first", "second")
    shape = np.zeros((2, 3, 2))
    shape[:, 2] = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2)
    body = Structure(natural, np.ones(2), 0.02 * TURN * natural, points, shape)
    stop = Contact("stop", "second", GROUND, np.eye(3), 0.0, np.zeros((2, 2)), ratio, -ratio)
    return Model(body, (stop,), excitation(0.15, 0.1 * shape[0, 2], [0.0, 0.0]), at_rest(2, 1))


def scene(path: Path) -> Model:
    """A scene file with modes given directly, phases 0 or 180 degrees, at rest; read without the program."""
    tree: Any = YAML(typ="safe").load(path)
    modes, points = tree["structure"]["modes"], tuple(tree["structure"]["modes"][0]["shape"])
    frequency, zeta, mass = (np.array([m[k] for m in modes]) for k in ("frequency", "damping_ratio", "mass"))
    shape = np.array([[mode["shape"][point] for mode in modes] for point in points]).swapaxes(1, 2)
    contacts = tuple(_scene_contact(entry) for entry in tree["contacts"])
    drive = tree["excitation"]
    if "modal_force" in drive:
        force = [entry["amplitude"] * np.cos(np.deg2rad(entry["phase_deg"])) for entry in drive["modal_force"]]
    else:
        force = sum(
            f["amplitude"] * np.array(f["direction"]) @ shape[points.index(f["point"])] for f in drive["forces"]
        )
    body = Structure(frequency, mass, 2 * zeta * 2 * np.pi * frequency * mass, points, shape)
    load = excitation(drive["frequency"], force, np.zeros(len(modes)))
    return Model(body, contacts, load, at_rest(len(modes), len(contacts)))


def _scene_contact(entry: dict[str, Any]) -> Contact:
    normal, tangent = np.array(entry["normal"], dtype=float), np.array(entry["tangent"], dtype=float)
    normal /= np.linalg.norm(normal)
    tangent -= (tangent @ normal) * normal
    tangent /= np.linalg.norm(tangent)
    return Contact(
        name=entry["name"],
        point=entry["point"],
        against=entry.get("against", GROUND),
        frame=np.array([tangent, np.cross(normal, tangent), normal]),
        friction=entry["friction"],
        tangential_stiffness=entry["tangential_stiffness"] * np.eye(2),
        normal_stiffness=entry["normal_stiffness"],
        preload=entry["preload"],
    )


def _frame(rng: np.random.Generator) -> np.ndarray:
    return Rotation.random(random_state=rng.integers(2**31)).as_matrix()


def _tangential(rng: np.random.Generator, scale: float) -> np.ndarray:
    if rng.random() < 0.3:
        return scale * np.eye(2)
    turn = Rotation.from_euler("z", rng.uniform(0, np.pi)).as_matrix()[:2, :2]
    full = turn @ np.diag([1.0, rng.uniform(0.2, 0.7)]) @ turn.T
    return scale * 0.5 * (full + full.T)


def _contact(rng: np.random.Generator, index: int, stiffness: float, length: float, joined: bool) -> Contact:
    """Mostly a full contact; now and then a frictionless stop or one under constant normal load."""
    kind = rng.choice(["full", "stop", "constant"], p=[0.84, 0.08, 0.08])
    normal = stiffness * rng.uniform(0.3, 1.5)
    preload = normal * length * rng.uniform(-0.35, 0.6)
    return Contact(
        name=f"c{index}",
        point=f"p{index + 1}",
        against=f"p{index}" if joined else GROUND,
        frame=_frame(rng),
        friction=0.0 if kind == "stop" else rng.uniform(0.15, 0.9),
        tangential_stiffness=_tangential(rng, stiffness * rng.uniform(0.3, 1.5)) * (kind != "stop"),
        normal_stiffness=0.0 if kind == "constant" else normal,
        preload=abs(preload) if kind == "constant" else preload,
    )


def _damping(rng: np.random.Generator, mass: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Modal damping, in a third of the models as a matrix that the modes do not diagonalise."""
    diagonal = 2 * rng.uniform(0.02, 0.08, mass.size) * omega * mass
    if rng.random() < 2 / 3:
        return diagonal
    coupling = rng.uniform(-0.15, 0.15, (mass.size, mass.size)) * np.sqrt(np.outer(diagonal, diagonal))
    return np.diag(diagonal) + 0.5 * (coupling + coupling.T)


def generated_model(seed: int, num_modes: int, num_contacts: int) -> Model:
    """A random model, its units of time, mass and length random as well; the same for the same arguments."""
    rng = np.random.default_rng([seed, num_modes, num_contacts])
    base, unit_mass, length = 10 ** rng.uniform(-0.5, 2.5), 10 ** rng.uniform(-2, 2), 10 ** rng.uniform(-5, 0)
    natural = np.sort(base * rng.uniform(0.6, 3.0, num_modes))
    mass, omega = unit_mass * rng.uniform(0.7, 1.4, num_modes), 2 * np.pi * natural
    stiffness = unit_mass * (2 * np.pi * base) ** 2
    points = tuple(f"p{i}" for i in range(num_contacts + 1))
    body = Structure(natural, mass, _damping(rng, mass, omega), points, rng.uniform(-1, 1, (len(points), 3, num_modes)))
    contacts = tuple(
        _contact(rng, i, stiffness * 0.5, length, joined=i > 0 and rng.random() < 0.4) for i in range(num_contacts)
    )
    size = np.array([1.0, rng.choice([0.0, 0.3])])[:, None] * stiffness * length
    load = Excitation(
        frequency=base * rng.uniform(0.8, 1.6),
        harmonic=np.array([1, rng.integers(2, 4)]),
        cosine=size * rng.uniform(-1, 1, (2, num_modes)),
        sine=size * rng.uniform(-1, 1, (2, num_modes)),
        constant=rng.choice([0.0, 0.2]) * stiffness * length * rng.uniform(-1, 1, num_modes),
    )
    return Model(body, contacts, load, at_rest(num_modes, num_contacts))


def provable_model(seed: int, room: float) -> Model:
    """A generated model, its preloads and gaps `room` times as wide; some start displaced or with slip."""
    num_modes, num_contacts = ((2, 1), (3, 2), (4, 3))[seed % 3]
    model = generated_model(seed, num_modes, num_contacts)
    size = model.excitation.cosine.max() / model.structure.stiffness.max()
    rng = np.random.default_rng([seed, 5])
    contacts = tuple(_roomy(contact, room, size) for contact in model.contacts)
    start = Start(
        rng.choice([0.0, 0.5]) * size * rng.uniform(-1, 1, num_modes),
        rng.choice([0.0, 0.5]) * size * model.structure.omega * rng.uniform(-1, 1, num_modes),
        rng.choice([0.0, 0.5]) * size * rng.uniform(-1, 1, (num_contacts, 2)),
        np.full(num_contacts, -1),
        rng.uniform(0, 2 * np.pi),
    )
    return replace(model, contacts=contacts, start=start)


def _roomy(contact: Contact, room: float, size: float) -> Contact:
    width = max(abs(contact.preload), 0.1 * contact.normal_stiffness * size)
    stop = contact.friction == 0
    return replace(contact, preload=room * width * (-1 if stop or contact.preload < 0 else 1))


# (seed, modes, contacts): found by search so that a contact slips for 5 to 95 % of the last of 12 cycles
# and the end state does not hang on the tolerance (two settings agree to 1e-8); the tests assert both
# again.
GENERATED = tuple(
    (seed, num_modes, num_contacts)
    for num_modes, num_contacts, seeds in (
        (2, 1, (1, 2, 5, 6, 7)),
        (3, 2, (0, 1, 2, 3, 4)),
        (3, 3, (1, 2, 3, 4)),
        (4, 3, (0, 1, 2, 4)),
        (5, 4, (0, 1, 2, 3, 4)),
        (6, 5, (0, 1, 2, 3, 4)),
    )
    for seed in seeds
)


def generated_models() -> dict[str, Model]:
    """The generated models that slip, by name; run them for `GENERATED_CYCLES`."""
    return {
        f"seed{seed}-{num_modes}modes-{num_contacts}contacts": generated_model(seed, num_modes, num_contacts)
        for seed, num_modes, num_contacts in GENERATED
    }
