"""The study of the scalar that makes the response smallest, as the scene file writes it."""

from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, model_validator

from timesim.fault import RuleError, nearest
from timesim.model.model import Model
from timesim.scene.axis import OVER_PARTS, Frequencies, Range
from timesim.scene.section import Positive, Text, refuse
from timesim.scene.study import StudyKind
from timesim.scene.sweep import Settle, product_told

THOUSANDTH = 1e-3  # of the range: the accuracy where none is given
FEWEST = 3  # values, one of which may be the least between two others


def _one_scalar(along: Mapping[str, Range]) -> Mapping[str, Range]:
    if len(along) != 1:
        raise refuse(f"must name one scalar, not {len(along)}")
    for key, given in along.items():
        part = key.partition(".")[0]
        if part not in OVER_PARTS or key == part:
            raise refuse("must be the key of a scalar of the scene", key=(key,), hint=nearest(part, OVER_PARTS))
        if key == "excitation.frequency":
            raise refuse("is the study's own frequency", key=(key,), hint="use frequency")
        if given.num < FEWEST:
            raise refuse(f"must be at least {FEWEST}", key=(key, "num"), value=given.num)
    return along


class Optimum(StudyKind):
    """The peak of the response over frequency against a scalar of the scene, and where it is least."""

    requires: ClassVar[tuple[str, ...]] = ("structure", "excitation")

    kind: Literal["optimum"]
    along: Annotated[dict[Text, Range], AfterValidator(_one_scalar)]
    """A scalar of the scene by its key, with from, to and num: the values looked at before the least is sought."""
    frequency: Frequencies
    """{from, to, step} or {values: [...]} [Hz]; swept up and down, and the peak is sought between its points."""
    accuracy: Positive | None = None
    """Of the scalar where the peak is least; by default a thousandth of its range."""
    point: Text | None = None
    """Point whose amplitude counts; the largest of all by default."""
    axis: Literal["x", "y", "z"] | None = None
    """Axis along which it counts; the largest of all by default."""
    settle: Settle = Settle()
    """When a motion counts as settled."""
    periodic: Literal["march", "shoot"] = "march"
    """How a periodic motion is found: marching until it settles, or Newton's method on the state after a period."""

    @model_validator(mode="after")
    def _accurate(self) -> Self:
        span = self.scalar[1].to - self.scalar[1].first
        if self.accuracy is None:
            object.__setattr__(self, "accuracy", THOUSANDTH * span)
        elif self.accuracy > span / 2:
            rule = "must be at most half of the range of the scalar"
            raise refuse(rule, key=("accuracy",), value=self.accuracy)
        return self

    @property
    def scalar(self) -> tuple[str, Range]:
        """The key of the scalar, and its range."""
        ((key, given),) = self.along.items()
        return key, given

    def lowest_frequency(self) -> float:
        """The first."""
        return float(self.frequency.values()[0])

    def points_told(self) -> str:
        """Those of the first values."""
        key, given = self.scalar
        return f"{product_told(self.frequency.count, {key: given.num}, 2)}, and the search for the least"

    def fits(self, model: Model) -> Iterator[RuleError]:
        """The point is one of the structure's."""
        points = model.structure.points
        if self.point is not None and self.point not in points:
            yield RuleError(("study", "point"), "is no point of the structure", nearest(self.point, points), self.point)
