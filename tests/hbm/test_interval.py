"""The law over one interval between two samples: where less than all of it is needed, that gives the same."""

import timesim.runtime  # noqa: F401  isort: skip

import jax
import numpy as np
import pytest
from systems import oscillator_scene

from timesim.engine.law.contact_law import product
from timesim.hbm.balance import Balance
from timesim.hbm.interval import Interval, advance, sliding, unchanging
from timesim.hbm.scheme import Scheme
from timesim.study.registry import load_scene

pytestmark = pytest.mark.long

STIFFNESS = {"isotropic": 20.0, "by axes": [20.0, 35.0], "full": [[20.0, 6.0], [6.0, 30.0]]}
LANES = 4000


def drawn(law, rng: np.random.Generator) -> tuple[tuple, Interval]:
    """Elastic displacements, half of them on the cone, and smooth motions over an interval, for many lanes.

    One in eight goes to and fro within it.
    """
    unit = float(law.preload[0] / law.normal_stiffness[0])
    size = unit * 10.0 ** rng.uniform(-3, 0, LANES)
    change, du0, du1 = (tuple(size * x for x in rng.normal(size=(2, LANES))) for _ in range(3))
    bend = np.where(np.arange(LANES) % 8 == 0, 5.0, 0.2)
    near = [tuple(c + bend * r for c, r in zip(change, rate, strict=True)) for rate in (du0, du1)]
    v0, dv0, dv1 = rng.normal(size=(3, LANES)) * np.multiply(unit, [[1.5], [0.1], [0.1]])
    interval = Interval(change, *near, v0, v0 + (dv0 + dv1) / 2, dv0, dv1)
    limit = law.friction * np.maximum(law.preload + law.normal_stiffness * v0, 0.0)
    angle = rng.uniform(0, 2 * np.pi, LANES)
    share = limit * np.where(rng.random(LANES) < 0.5, 1.0, rng.random(LANES))
    return product(law.compliance, (share * np.cos(angle), share * np.sin(angle))), interval


def law_of(stiffness, friction):
    keys = {"tangential_stiffness": stiffness, "friction": friction}
    changes = {f"contacts.pad.{key}": value for key, value in keys.items()}
    model = load_scene(oscillator_scene(preload=1.0) | {"study": {"kind": "transient", "cycles": 1}},
                       changes | {"excitation.frequency": 1.0}).model()  # fmt: skip
    return Balance(model, 1.0, Scheme(1, 16)).law


@pytest.mark.parametrize("stiffness", STIFFNESS.values(), ids=STIFFNESS)
@pytest.mark.parametrize("friction", [0.5, 0.05])
def test_what_a_contact_plainly_does_is_what_the_whole_law_says(stiffness, friction):
    law = law_of(stiffness, friction)
    d, interval = drawn(law, np.random.default_rng(5))
    whole = jax.jit(advance)(law, d, interval)
    slip, separation = np.asarray(whole.slip), np.asarray(whole.separation)
    kinds = {"stick": (slip == 0) & (separation == 0), "slip": slip == 1, "separation": separation == 1}
    for name, ways in (("stick", unchanging), ("separation", unchanging), ("slip", sliding)):
        plainly, end = jax.jit(ways)(law, d, interval)
        said = np.asarray(plainly) & kinds[name]
        assert said.sum() > 0.3 * kinds[name].sum() > 10, name
        for ours, theirs in zip(
            (*end.d, *end.before, *end.after), (*whole.d, *whole.before, *whole.after), strict=True
        ):
            np.testing.assert_allclose(np.broadcast_to(ours, slip.shape)[said], theirs[said], rtol=1e-12, atol=1e-15)
        of_none = np.asarray(plainly) & ~np.any(list(kinds.values()), axis=0)
        assert not of_none.any(), name
    assert not (np.asarray(jax.jit(sliding)(law, d, interval)[0]) & ~kinds["slip"]).any()


@pytest.mark.parametrize("stiffness", STIFFNESS.values(), ids=STIFFNESS)
@pytest.mark.parametrize("friction", [0.5, 0.05])
def test_what_is_put_on_the_samples_is_no_larger_than_what_the_rates_can_do(stiffness, friction):
    """Where a load vanishes too: Bernoulli's polynomial is at most 1/6, and each change of a rate at most the rates."""
    law, rng = law_of(stiffness, friction), np.random.default_rng(11)
    _, interval = drawn(law, rng)
    unit = float(law.preload[0] / law.normal_stiffness[0])
    v0 = unit * (10.0 ** rng.uniform(-8, 0, LANES) * rng.choice([-1, 1], LANES) - 1)
    dv0 = unit * rng.normal(size=LANES) * 10.0 ** rng.uniform(-3, 0, LANES)
    dv1 = dv0 + 0.1 * unit * rng.normal(size=LANES)
    interval = interval._replace(v0=v0, v1=v0 + (dv0 + dv1) / 2, dv0=dv0, dv1=dv1)
    limit = law.friction * np.maximum(law.preload + law.normal_stiffness * v0, 0.0) * rng.random(LANES)
    angle = rng.uniform(0, 2 * np.pi, LANES)
    d = product(law.compliance, (limit * np.cos(angle), limit * np.sin(angle)))
    end = jax.jit(advance)(law, d, interval)
    put = np.abs([*end.before[:2], *end.after[:2]]).max(axis=0)
    stiffest = max(float(part[0]) for part in law.stiffness)
    rates = stiffest * np.abs([*interval.change, *interval.du0, *interval.du1]).max(axis=0)
    rates += friction * float(law.normal_stiffness[0]) * np.maximum(np.abs(dv0), np.abs(dv1))
    assert np.count_nonzero(put) > 1000
    assert np.all(put <= rates / 6)
