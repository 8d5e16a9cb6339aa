"""A model as the loops in numba take it: constants, the motion in flat rows, and where things lie in them.

What a careful engineer writes for speed: masses scaled out; forces from a table over the phase of the grid; the motion
of the contacts is carried along, so that a stage needs one product with the mode shapes each way; numbers of modes and
contacts are compile-time constants (the lengths of tuples), and all that a stage needs lies in flat arrays at offsets
known then; no allocation after the start.

Numba keeps what it compiled by the date of its own file alone: after a change of one of these modules delete
`__pycache__`.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from problems import Run

from timesim.model.model import Model

compiled = njit(cache=True, fastmath={"contract", "nsz", "reassoc", "arcp"}, error_model="numpy")
inlined = njit(cache=True, fastmath={"contract", "nsz", "reassoc", "arcp"}, error_model="numpy", forceinline=True)


class Scene(NamedTuple):
    """Constants. Modes are mass-normalised; `modes` and `pads` carry their numbers as types."""

    modes: tuple[int, ...]
    pads: tuple[int, ...]
    constant: np.ndarray  # flat: stiffness (M), damping (M), shape (3C, M), its transpose (M, 3C), pads (C, 9)
    load: np.ndarray  # (2N + 3, M): at half-steps, then two rows for points off the grid
    harmonic: np.ndarray  # (H,)
    cosine: np.ndarray  # (H, M)
    sine: np.ndarray
    mean: np.ndarray  # (M,)
    phase: float
    points: np.ndarray  # (3P, M)


class Work(NamedTuple):
    """What changes. Rows are flat arrays by `Columns`: the two ends of a step, the three inner stages."""

    start: np.ndarray
    end: np.ndarray
    second: np.ndarray
    third: np.ndarray
    fourth: np.ndarray
    pad: np.ndarray  # flat: force (C, 3), w (C, 2)
    state: np.ndarray  # (C,)
    extreme: np.ndarray  # (3P, 2)
    log: np.ndarray  # (events, 4)


class Columns(NamedTuple):
    """Where things lie in a row; in Scene.constant; in Work.pad."""

    q: int
    v: int
    a: int
    u: int  # motion of the contacts, 3C
    du: int
    ddu: int
    e: int  # 2C
    tau: int
    turn: int
    guard: int  # 2C
    slope: int
    width: int
    damping: int
    shape: int
    turned: int
    pad: int
    w: int


@inlined
def columns(modes, pads):
    M, C = len(modes), len(pads)
    K = 3 * C
    e = 3 * M + 3 * K
    return Columns(
        0, M, 2 * M, 3 * M, 3 * M + K, 3 * M + 2 * K,
        e, e + 2 * C, e + 3 * C, e + 4 * C, e + 6 * C, e + 8 * C,
        M, 2 * M, 2 * M + K * M, 2 * M + 2 * K * M, K,
    )  # fmt: skip


@compiled
def off_grid_load(s, row, theta):
    M = len(s.modes)
    for i in range(M):
        s.load[row, i] = s.mean[i]
    for k in range(s.harmonic.size):
        c, d = np.cos(s.harmonic[k] * theta), np.sin(s.harmonic[k] * theta)
        for i in range(M):
            s.load[row, i] += c * s.cosine[k, i] + d * s.sine[k, i]


def scene(model: Model, steps_per_cycle: int) -> Scene:
    """Constants of a model on a grid; they hold for every frequency."""
    s, x = model.structure, model.excitation
    if s.damping.ndim != 1:
        raise ValueError("structure.damping: this opponent takes one number a mode, not a matrix")
    root = np.sqrt(s.mass)
    shape = model.contact_shape.reshape(-1, s.num_modes) / root
    cosine, sine, mean = x.cosine / root, x.sine / root, x.constant / root
    theta = np.arange(2 * steps_per_cycle + 1) * np.pi / steps_per_cycle + model.start.phase
    load = np.zeros((2 * steps_per_cycle + 3, s.num_modes))
    angle = np.outer(theta, x.harmonic)
    load[:-2] = np.cos(angle) @ cosine + np.sin(angle) @ sine + mean
    own = [s.stiffness / s.mass, s.damping / s.mass, shape.ravel(), shape.T.ravel(), _pads(model).ravel()]
    constants = np.concatenate(own)
    return Scene(
        (0,) * s.num_modes, (0,) * model.num_contacts, constants, load,
        x.harmonic.astype(float), cosine, sine, mean, float(model.start.phase),
        np.ascontiguousarray(s.shape.reshape(-1, s.num_modes) / root),
    )  # fmt: skip


def _pads(model: Model) -> np.ndarray:
    s, x = model.structure, model.excitation
    load = np.abs(x.cosine).sum(0) + np.abs(x.sine).sum(0) + np.abs(x.constant)
    modal = load / s.stiffness + np.abs(model.start.displacement)
    rows = []
    for contact, shape in zip(model.contacts, np.abs(model.contact_shape), strict=True):
        k = contact.tangential_stiffness
        scale = abs(contact.preload) + max(k[0, 0], contact.normal_stiffness) * float((shape @ modal).max())
        scale = scale or 1.0
        rows.append([
            k[0, 0], k[0, 1], k[1, 1], contact.friction, contact.normal_stiffness, contact.preload,
            max(contact.preload, 0.0), 1 / scale, 1 / (scale * s.omega.min()),
        ])  # fmt: skip
    return np.array(rows).reshape(-1, 9)


def work(model: Model, start: Run | None, num_log: int) -> Work:
    """Room to work, with the start of the model, or the end of an earlier run, in row 0."""
    M, C, P = model.structure.num_modes, model.num_contacts, len(model.structure.points)
    root, s = np.sqrt(model.structure.mass), model.start
    q, v, w, state = (
        (s.displacement, s.velocity, s.slip, s.state)
        if start is None
        else (start.q, start.qdot, start.slip, start.state)
    )
    rows = [np.zeros(3 * M + 17 * C) for _ in range(5)]
    rows[0][:M], rows[0][M : 2 * M] = q * root, v * root
    extreme = np.tile([np.inf, -np.inf], (3 * P, 1))
    pad = np.concatenate([np.zeros(3 * C), np.ravel(w)])
    return Work(*rows, pad, np.array(state, dtype=np.int64), extreme, np.zeros((num_log, 4)))
