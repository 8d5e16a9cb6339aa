"""The tolerances of the event loop, and how they depend on one another.

All of them are of the dimensionless form: time is the angle of the excitation, a cycle is 2 pi, motions are of the
size 1 and margins are over the size of the forces in them. A number of that size is known to eps = 2.2e-16, an angle
within the cycle to four times that. From the smallest to the largest:

=============  =====  ================================================================================================
SHORTEST       1e-13  step; a hundred spacings of the angle: a shorter one is not known to a percent
AGREEMENT      1e-13  change of u over a step, by values and by rates: their rounding, a few hundred eps
FORCE_FLOOR    1e-13  elastic force without a direction: the same of a force
VIOLATED       1e-12  margin that is rounding: ten times what the terms of a margin leave (motion, K_u, slip)
TOGETHER       1e-11  margins that are zero at the same instant: ten times `VIOLATED`, since each may err by that
NO_LOAD        1e-10  n where the cone is reached at once: a margin of `TOGETHER` is mu n - ``|f|``, down to mu = 0.1
NO_TIME        1e-9   time between two transitions that is none, a tenth of `LANDING`; share of a step left at its end
LANDING        1e-8   time from a guard that an Euler step may correct: its error is half the square, below eps
SINGULAR       3e-8   time from n = 0 where the direction of slip is rounding: three times `LANDING`, so that no step
                      that has landed next to n = 0 asks for a slip speed there
SOON           1e-6   time to n = 0 up to which a falling n counts as none, within `NO_LOAD`: it moves nothing by 5e-13
SHORT          1e-3   step in which the change of u is better had from its rates: by values it errs by eps over the step
=============  =====  ================================================================================================

`SINGULAR` is a time and not a share of n, which may be tiny for long under stiff contacts.
"""

SHORTEST = 1e-13
AGREEMENT = SHORTEST
FORCE_FLOOR = SHORTEST
VIOLATED = 10 * SHORTEST
TOGETHER = 10 * VIOLATED
NO_LOAD = 1e-10  # 10 * TOGETHER
LANDING = 1e-8
NO_TIME = 0.1 * LANDING
SINGULAR = 3e-8  # 3 * LANDING
SOON = 1e-6
SHORT = 1e-3
