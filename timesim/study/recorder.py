"""What is recorded of a run: samples of the last cycles, all transitions, totals of every cycle, contact forces."""

import timesim.runtime  # noqa: F401  isort: skip

from typing import Any

import jax.numpy as jnp
import numpy as np

from timesim.engine.companion import totals_of
from timesim.engine.history import Events, Samples, events, joined, sample
from timesim.engine.lanes import by_rows
from timesim.engine.law.contact_law import ContactLaw, Motion
from timesim.engine.law.table import law_class
from timesim.engine.trajectory import Run, Steps
from timesim.model.model import Model
from timesim.model.scales import scales_of
from timesim.program import program
from timesim.scene.transient import Schedule


class Recorder:
    """Records a run from its steps.

    Attributes:
        lost: why there are no samples, where there should be; else None.
    """

    def __init__(self, run: Run, plan: Schedule):
        self.run, self.plan = run, plan
        self.totals = totals_of(run)
        self.lost: str | None = None
        self._samples: list[Samples] = []
        self._events: list[Events] = []
        self._times, self._taken = plan.sample_times(), 0

    def add(self, steps: Steps, completed: int) -> None:
        """Record a batch of steps; ``completed``: cycles that are complete at its end."""
        if steps.time.size == 0:
            return
        self.totals.add(steps, completed)
        self._events.append(events(steps))
        end = steps.time[-1] + steps.h[-1]
        finished = completed == self.run.num_cycles
        upto = self._times.size if finished else int(np.searchsorted(self._times, end * (1 - 1e-13), side="left"))
        if upto > self._taken and self.lost is None:
            try:
                self._samples.append(sample(steps, self._times[self._taken : upto]))
            except MemoryError:
                self.forget_samples()
        self._taken = upto

    def forget_samples(self) -> None:
        """Give up the samples, for which the memory does not suffice; all else is recorded on."""
        self._samples.clear()
        less = "a smaller samples_per_cycle, or fewer recorded cycles, would do with less"
        self.lost = f"the memory does not suffice for {self._times.size} samples, which are left out; {less}"

    @property
    def samples(self) -> Samples:
        m, c = self.run.model.structure.num_modes, self.run.model.num_contacts
        none = Samples(np.zeros(0), np.zeros((0, m)), np.zeros((0, m)), np.zeros((0, c, 2)), np.zeros((0, c)))
        return joined(self._samples or [none])

    @property
    def events(self) -> Events:
        return joined(self._events or [Events(*np.zeros((4, 0)))])


def contact_forces(model: Model, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Force (f1, f2, n) on the contacts and their relative motion (u1, u2, v), each of shape (N, C, 3)."""
    x, dx = (np.einsum("cam,nm->nca", model.contact_shape, y) for y in (samples.q, samples.p))
    if not model.contacts:
        return x, x
    scales = scales_of(model, 1.0)
    law = law_class(model.contacts).of(model.contacts, scales)
    whole = (x / scales.length, dx / (scales.length * scales.omega), samples.w / scales.length, samples.state)
    force: np.ndarray = by_rows(_force, (law,), whole) if len(x) else x
    return force * scales.force, x


@program
def _force(law: ContactLaw, x: Any, dx: Any, w: Any, state: Any) -> Any:
    moves = Motion((x[..., 0], x[..., 1]), x[..., 2], (dx[..., 0], dx[..., 1]), dx[..., 2])
    acts = law.reaction(state, moves, (w[..., 0], w[..., 1]))
    return jnp.stack([*acts.f, acts.n], axis=-1)
