"""What every study section of the scene file has: a base of its own, lest the sections import each other."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import ClassVar, Self

from timesim.fault import RuleError
from timesim.model.model import Model
from timesim.scene.contact import ContactSection
from timesim.scene.section import Section


class StudyKind(Section):
    """What every study section has; `kind` is its tag."""

    requires: ClassVar[tuple[str, ...]] = ("structure", "excitation")
    """Keys that the scene must have."""
    uses_frequency: ClassVar[bool] = False
    """Whether ``excitation.frequency`` is the one it runs at."""
    explicit_only: ClassVar[bool] = False
    """Whether ``solver.method`` must be an explicit one."""

    def problems(self, contacts: Sequence[ContactSection], folder: Path) -> Iterator[RuleError]:
        """What is wrong with it in this scene, keys relative to the study; nothing by default."""
        yield from ()

    def fits(self, model: Model) -> Iterator[RuleError]:
        """What is wrong with it for this model, keys from the root of the scene; nothing by default."""
        yield from ()

    def lowest_frequency(self) -> float | None:
        """Lowest of the frequencies that it runs at in time [Hz]; None if it names none."""
        return None

    def points_told(self) -> str:
        """How many steady states it looks for, in words; empty where that is not what it does."""
        return ""

    def absolute(self, folder: Path) -> Self:
        """The same with paths that do not depend on the folder."""
        return self
