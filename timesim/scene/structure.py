"""Sections of the scene file that describe a structure, by modes, matrices or files, and the forces on it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, Tag, model_validator

from timesim.fault import RuleError
from timesim.model import model
from timesim.model.eigenmodes import modal_structure
from timesim.model.matrices import Matrices, read_matrices
from timesim.result.label import counted
from timesim.scene.section import AsList, AsMapping, AsNumber, AsText, Section, by_form, refuse
from timesim.scene.value import (
    Count,
    Direction,
    FilePath,
    Matrix,
    Name,
    NotNegative,
    Number,
    PointName,
    Positive,
    Row,
    Vector,
    unit,
)

BuiltStructure = tuple[model.Structure, np.ndarray, tuple[str, ...]]
"""A structure, the scene's index of each of its modes, and notes."""
Files = dict[str, Matrices]
"""Matrices that have been read, by their files."""
EQUAL = 1e-8
"""Share by which eigenvalues may differ that are one but for rounding."""


class Mode(Section):
    """One mode: natural frequency, damping, modal mass and its displacement of each point."""

    frequency: NotNegative
    """Natural frequency [Hz]; 0 for a free motion."""
    damping_ratio: NotNegative
    """Share of critical damping; above 1 the mode does not oscillate."""
    mass: Positive
    """Modal mass."""
    shape: Annotated[dict[Name, Vector], Field(min_length=1)]
    """Displacement along x, y, z of each point for a unit of the mode."""


class ModalSection(Section):
    """A structure by its modes."""

    modes: Annotated[tuple[Mode, ...], Field(min_length=1)]
    """The modes, in any order; forces and starting states of the scene follow this order."""

    @model_validator(mode="after")
    def _same_points(self) -> Self:
        first = set(self.modes[0].shape)
        for i, mode in enumerate(self.modes):
            if odd := first ^ set(mode.shape):
                hint = f"only one of modes 0 and {i} names {', '.join(sorted(odd))}"
                rule = "must name the same points in every mode"
                raise refuse(rule, key=("modes", i, "shape"), hint=hint)
        return self

    def build(self) -> BuiltStructure:
        """The structure, frequency ascending."""
        order = np.argsort([mode.frequency for mode in self.modes], kind="stable")
        modes, points = [self.modes[i] for i in order], tuple(self.modes[0].shape)
        frequency, ratio, mass = np.array([(mode.frequency, mode.damping_ratio, mode.mass) for mode in modes]).T.copy()
        shape = np.moveaxis(np.array([[mode.shape[point] for point in points] for mode in modes]), 0, -1)
        return model.Structure(frequency, mass, 2 * ratio * 2 * np.pi * frequency * mass, points, shape), order, ()


class PointRows(Section):
    """Rows of the matrices for a point's motion along x, y, z; along an axis that is left out it does not move."""

    x: Row | None = None
    y: Row | None = None
    z: Row | None = None

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        if not self.rows():
            raise refuse("must name a row for at least one of x, y, z")
        if len(set(self.rows().values())) < len(self.rows()):
            raise refuse("must name a different row for each axis")
        return self

    def rows(self) -> dict[str, int]:
        """Row of each axis along which the point moves."""
        return self.model_dump(exclude_none=True)


Points = Annotated[dict[Name, PointRows], Field(min_length=1)]


Ratio = Annotated[
    AsNumber[NotNegative] | AsList[Annotated[tuple[NotNegative, ...], Field(min_length=1)]],
    by_form("a number, or a list of one a mode"),
]


class InlineMatrices(Section):
    """Matrices written out in the scene, with the damping and the points."""

    mass: Matrix
    """Mass matrix, symmetric positive definite, by its rows: [[2, 0], [0, 3]]."""
    stiffness: Matrix
    """Stiffness matrix, symmetric, by its rows: [[2, -1], [-1, 2]]."""
    damping: Matrix | None = None
    """Viscous damping matrix, symmetric; a share of critical damping is damping_ratio."""
    damping_ratio: Ratio | None = None
    """Share of critical damping of every mode, or one a mode; instead of the matrix."""
    points: Points
    """Row of each axis of each point, from 0."""

    @model_validator(mode="after")
    def _one_damping(self) -> Self:
        if self.damping is not None and self.damping_ratio is not None:
            raise refuse("excludes damping", key=("damping_ratio",), hint="give one of the two")
        return self


class MatrixSection(Section):
    """A structure by its matrices."""

    matrices: InlineMatrices
    keep_modes: Count | None = None
    """How many of the lowest modes; all by default."""

    def build(self) -> BuiltStructure:
        given = self.matrices
        matrices = Matrices(np.array(given.mass), np.array(given.stiffness), given.damping and np.array(given.damping))
        try:
            return _built(given, matrices, self.keep_modes)
        except RuleError as error:
            raise (error if error.key == ("keep_modes",) else error.below("matrices")) from None


def _cuts(matrices: Matrices, kept: int) -> Iterator[str]:
    """What is to be said where modes of one frequency, as disks have them, are kept in part."""
    squared, _ = matrices.solved[kept]
    if kept == len(squared) or squared[kept] - squared[kept - 1] > EQUAL * squared[kept]:
        return
    alike = np.flatnonzero(np.abs(squared - squared[kept - 1]) <= EQUAL * squared[kept])
    first, last, frequency = alike[0], alike[-1] + 1, np.sqrt(squared[kept]) / (2 * np.pi)
    fewer = f"{first} or " if first else ""
    more = " or more" if last == len(squared) < matrices.mass.shape[0] else ""
    parts = f"{kept} parts modes {first + 1} to {last}{more}, which have one frequency, {frequency:.6g} Hz"
    yield f"structure.keep_modes: {parts}: which of them is kept is chance; {fewer}{last}{more} keeps them together"


def _built(given: "InlineMatrices | FileSection", matrices: Matrices, keep_modes: int | None) -> BuiltStructure:
    points = {name: point.rows() for name, point in given.points.items()}
    own = modal_structure(matrices, points=points, damping_ratio=given.damping_ratio, keep_modes=keep_modes)
    return own, np.arange(own.num_modes), (*matrices.notes, *_cuts(matrices, own.num_modes))


class MatrixFiles(Section):
    """A file for each matrix: Matrix Market (.mtx), or .npz as scipy.sparse.save_npz writes it."""

    mass: FilePath
    stiffness: FilePath
    damping: FilePath | None = None


class FileSection(Section):
    """A structure by the matrices in a file."""

    file: Annotated[
        AsText[FilePath] | AsMapping[MatrixFiles], by_form("a .npz or .mat file, or paths of mass, stiffness, damping")
    ]
    """A .npz or .mat file with mass, stiffness, damping (or M, K, C), or a file for each."""
    damping_ratio: Ratio | None = None
    """Share of critical damping of every mode, or one a mode; takes precedence over a damping matrix in the file."""
    points: Points
    """Row of each axis of each point, from 0."""
    keep_modes: Count | None = None
    """How many of the lowest modes; all by default."""

    def build(self, folder: Path, files: Files) -> BuiltStructure:
        """The structure by the file's path from a folder; ``files`` holds the matrices that have been read."""
        paths = self._paths(folder)
        try:
            matrices = files[str(paths)] = files.get(str(paths)) or read_matrices(paths)
        except RuleError as error:
            raise error.below("file") from None
        except OSError as error:  # a name that is too long, a folder that may not be searched
            raise RuleError(("file",), "cannot be read", error.strerror or "", self.file) from None
        try:
            structure, order, notes = _built(self, matrices, self.keep_modes)
        except RuleError as error:
            raise self._placed(error) from None
        if self.damping_ratio is not None and matrices.damping is not None:
            notes = (*notes, "structure.damping_ratio is used; the damping matrix in the file is not")
        return structure, order, notes

    def _placed(self, error: RuleError) -> RuleError:
        if error.key[0] not in ("mass", "stiffness", "damping"):
            return error
        key = ("file",) if isinstance(self.file, str) else ("file", *error.key)
        value = self.file if isinstance(self.file, str) else getattr(self.file, str(error.key[0]))
        return RuleError(key, error.rule, error.hint, value)

    def _paths(self, folder: Path) -> Path | dict[str, Path]:
        if isinstance(self.file, str):
            return folder / self.file
        return {key: folder / path for key, path in self.file.model_dump(exclude_none=True).items()}


def _structure_form(value: Any) -> str | None:
    given = value if isinstance(value, dict) else vars(value) if isinstance(value, Section) else ()
    forms = [f"<{name}>" for name in ("modes", "matrices", "file") if name in given]
    return forms[0] if len(forms) == 1 else None


StructureSection = Annotated[
    Annotated[ModalSection, Tag("<modes>")]
    | Annotated[MatrixSection, Tag("<matrices>")]
    | Annotated[FileSection, Tag("<file>")],
    by_form("a mapping with exactly one of the keys modes, matrices, file", _structure_form),
]


def point_names(written: Any) -> tuple[str, ...] | None:
    """Names of the points of a structure, from its data as written; None where they cannot be read."""
    shapes: list[Any] = []
    match written:
        case {"modes": [*modes]}:
            shapes = [mode.get("shape") for mode in modes if isinstance(mode, dict)]
        case {"matrices": {"points": points}} | {"file": _, "points": points}:
            shapes = [points]
    return tuple(dict.fromkeys(name for shape in shapes if isinstance(shape, dict) for name in shape)) or None


# The forces on it

STILL = 1e-12  # of the largest entry of all mode shapes


class ModalForce(Section):
    """A harmonic force on one mode: amplitude cos(2 pi f t + phase)."""

    amplitude: Number
    phase_deg: Number = 0.0


class ConstantForce(Section):
    """A constant force on a point, along a direction."""

    point: PointName
    direction: Direction
    """Along x, y, z, such as [1, 0, 0]; its length does not count."""
    amplitude: Number

    def work(self, structure: model.Structure) -> np.ndarray:
        """Work of a unit of the force on a unit of each mode, shape (M,)."""
        return unit(self.direction) @ structure.shape[structure.points.index(self.point)]


class Force(ConstantForce):
    """A harmonic force on a point: amplitude cos(harmonic 2 pi f t + phase) along a direction."""

    phase_deg: Number = 0.0
    harmonic: Count = 1
    """Multiple of the base frequency."""


def cos_sin_deg(angle: float) -> tuple[float, float]:
    """Cosine and sine of an angle in degrees, exact at multiples of 90."""
    turns, rest = divmod(angle, 90.0)
    c, s = np.cos(np.deg2rad(rest)), np.sin(np.deg2rad(rest))
    return [(c, s), (-s, c), (-c, -s), (s, -c)][int(turns) % 4]


class ExcitationSection(Section):
    """The forces on the structure."""

    frequency: Positive | None = None
    """Base frequency [Hz]."""
    modal_force: tuple[ModalForce, ...] | None = None
    """One a mode, in the scene's order of modes."""
    forces: tuple[Force, ...] = ()
    constant_forces: tuple[ConstantForce, ...] = ()

    def build(self, structure: model.Structure, order: np.ndarray) -> model.Excitation:
        """Modal forces; ``order`` is the scene's index of each mode."""
        terms = [(force.harmonic, force.amplitude * force.work(structure), force.phase_deg) for force in self.forces]
        if self.modal_force is not None:
            if len(self.modal_force) != order.size:
                count = counted(order.size, "entry", "entries")
                rule = f"must have {count}, one a mode, not {len(self.modal_force)}"
                raise RuleError(("modal_force",), rule)
            sorted_forces = [self.modal_force[i] for i in order]
            for column, force in zip(np.eye(order.size), sorted_forces, strict=True):
                terms.append((1, force.amplitude * column, force.phase_deg))
        harmonic = np.array(sorted({1, *(multiple for multiple, _, _ in terms)}))
        cosine, sine = np.zeros((2, harmonic.size, order.size))
        for multiple, pull, phase_deg in terms:
            c, s = cos_sin_deg(phase_deg)
            row = np.searchsorted(harmonic, multiple)
            cosine[row] += c * pull
            sine[row] -= s * pull
        pushes = (force.amplitude * force.work(structure) for force in self.constant_forces)
        constant = sum(pushes, np.zeros(order.size))
        return model.Excitation(self.frequency, harmonic, cosine, sine, constant)

    def without_effect(self, structure: model.Structure) -> Iterator[str]:
        """Forces along directions in which no mode moves their point, in words."""
        least = STILL * np.abs(structure.shape).max()
        for key in ("forces", "constant_forces"):
            for i, force in enumerate(getattr(self, key)):
                if force.amplitude and np.abs(force.work(structure)).max() <= least:
                    yield f"excitation.{key}.{i} has no effect: no mode moves {force.point} along its direction"
