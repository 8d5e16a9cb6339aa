"""Whether the samples of a curve that grows are enough: one that needs more would be followed again anyway."""

from collections.abc import Callable

from timesim.hbm.convergence import with_more_samples
from timesim.hbm.curve import SoFar, Watch
from timesim.hbm.scheme import Scheme
from timesim.model.model import Model

CHECKED = 50  # solutions after which they are checked at one


class TooFewSamplesError(Exception):
    """A curve needs more samples, those of the schemes."""

    def __init__(self, schemes: tuple[Scheme, ...]):
        super().__init__(schemes)
        self.schemes = schemes


def checking_samples(model_at: Callable[[float], Model], schemes: tuple[Scheme, ...], watch: Watch) -> Watch:
    """What watches a curve by some schemes, and gives it up by a `TooFewSamplesError` where their samples are too few.

    ``model_at``: the model for a value of the parameter of the curve.
    """
    number = 0

    def seen(share: float, so_far: SoFar) -> None:
        nonlocal number
        number += 1
        if number % CHECKED == 0 and (finer := with_more_samples(model_at, so_far(1), schemes)) is not None:
            raise TooFewSamplesError(finer)
        watch(share, so_far)

    return seen
