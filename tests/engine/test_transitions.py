"""What follows a transition where the normal load is next to nothing."""

import jax.numpy as jnp
import numpy as np
import pytest
from systems import pad

from timesim.engine.law.cone import ConeLaw
from timesim.engine.law.contact_law import Motion
from timesim.model.model import SEPARATION, SLIP, STICK
from timesim.model.scales import Scales

ONE = Scales(1.0, np.ones(1), 1.0, 1.0, 1.0)
TINY = 1e-10


def plane(x: float, y: float) -> tuple[jnp.ndarray, jnp.ndarray]:
    return jnp.asarray([x]), jnp.asarray([y])


@pytest.mark.parametrize("n", [0.0, 0.5 * TINY, 2 * TINY])
@pytest.mark.parametrize(("before", "after"), [(STICK, SLIP), (SLIP, STICK)])
@pytest.mark.parametrize("rate", [-1.0, 1.0])
def test_a_contact_without_load_opens_only_if_its_load_falls(before: int, after: int, n: float, rate: float):
    """Just after it has touched a contact bears as little, but its load rises."""
    law = ConeLaw.of([pad(0.4, 2.0, 1.0, 0.0)], ONE)
    motion = Motion(plane(0.0, 0.0), jnp.asarray([n]), plane(1.0, 0.5), jnp.asarray([rate]))
    opens = rate < 0 and n <= TINY
    found = int(law.successor(jnp.asarray([before]), motion, tiny=jnp.asarray(TINY))[0])
    assert found == (SEPARATION if opens else after)


def test_a_contact_without_friction_has_no_speed_at_which_it_sticks():
    law = ConeLaw.of([pad(0.0, 0.0, 1.0, 1.0)], ONE)
    motion = Motion(plane(0.1, 0.2), jnp.asarray([0.5]), plane(0.03, -0.04), jnp.asarray([0.0]))
    _, speed = law.margins(jnp.asarray([SLIP]), motion, plane(0.1, 0.2))
    assert float(speed[0]) == 1.0


@pytest.mark.parametrize(("speed", "after"), [(0.15, STICK), (0.25, SLIP), (0.45, SLIP)])
def test_a_contact_that_closes_sticks_if_its_force_stays_below_mu_n(speed: float, after: int):
    """|K_u u'| against mu n', not against n' (15 to 17)."""
    law = ConeLaw.of([pad(0.4, 2.0, 1.0, 0.0)], ONE)
    motion = Motion(plane(0.0, 0.0), jnp.asarray([0.0]), plane(0.6 * speed, 0.8 * speed), jnp.asarray([1.0]))
    assert int(law.successor(jnp.asarray([SEPARATION]), motion, tiny=jnp.asarray(TINY))[0]) == after
