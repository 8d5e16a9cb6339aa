"""Sections of the scene file that say what is to be computed: one a kind of study, and the union of them.

To add a study, write its section with what `StudyKind` asks for, and name it in `STUDIES` and `StudySection`.
"""

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from timesim.fault import nearest
from timesim.scene.bistable import Bistable
from timesim.scene.element import Element, ElementMap
from timesim.scene.hbm import Compare, Hbm
from timesim.scene.jump import Jump
from timesim.scene.optimum import Optimum
from timesim.scene.section import Count, Section, Whole, refuse
from timesim.scene.study import StudyKind
from timesim.scene.sweep import Sweep


class Transient(StudyKind):
    """One run at one frequency."""

    requires: ClassVar[tuple[str, ...]] = ("structure", "excitation", "excitation.frequency")
    uses_frequency: ClassVar[bool] = True

    kind: Literal["transient"]
    cycles: Count
    """Excitation cycles to run."""
    samples_per_cycle: Annotated[Whole, Field(ge=2)] = 200
    """Recorded samples of one cycle."""
    record_last: Count | None = None
    """How many of the last cycles are recorded; all by default."""

    @model_validator(mode="after")
    def _within(self) -> Self:
        if self.record_last is None:
            object.__setattr__(self, "record_last", self.cycles)
        elif self.record_last > self.cycles:
            rule = f"must be at most the {self.cycles} cycles of the run"
            raise refuse(rule, key=("record_last",), value=self.record_last)
        return self


STUDIES = {
    "transient": Transient,
    "jump": Jump,
    "element": Element,
    "element_map": ElementMap,
    "sweep": Sweep,
    "hbm": Hbm,
    "compare": Compare,
    "bistable": Bistable,
    "optimum": Optimum,
}


def _known_study(value: Any) -> Any:
    if isinstance(value, dict):
        if "kind" not in value:
            raise refuse("is required", key=("kind",), hint=f"one of {', '.join(STUDIES)}")
        if not isinstance(kind := value["kind"], str) or kind not in STUDIES:
            raise refuse(f"must be one of {', '.join(STUDIES)}", key=("kind",), hint=nearest(kind, STUDIES), value=kind)
    return value


def _study_kind(value: Any) -> str | None:
    if isinstance(value, Section):
        return f"<{getattr(value, 'kind', None)}>"
    return f"<{value.get('kind')}>" if isinstance(value, dict) else None


StudySection = Annotated[
    Annotated[Transient, Tag("<transient>")]
    | Annotated[Jump, Tag("<jump>")]
    | Annotated[Element, Tag("<element>")]
    | Annotated[ElementMap, Tag("<element_map>")]
    | Annotated[Sweep, Tag("<sweep>")]
    | Annotated[Hbm, Tag("<hbm>")]
    | Annotated[Compare, Tag("<compare>")]
    | Annotated[Bistable, Tag("<bistable>")]
    | Annotated[Optimum, Tag("<optimum>")],
    Discriminator(_study_kind, custom_error_type="rule", custom_error_message="must be a mapping of keys with a kind"),
    BeforeValidator(_known_study),
]
