"""Monodromy matrix: derivative of the map from the state at a cycle's start to that at its end, from recorded steps.

Each step moves a disturbance, at fixed time, by the derivative of the method's own step. At a transition the time of
the event moves with the disturbance: with the guard m, the rates f-, f+ before and after, and the map T of the state
at the event,

    dy+ = DT (dy- + f- dt) - f+ dt,        dt = -Dm dy- / (Dm f-),

the saltation matrix [1]_ [2]_ [3]_ applied to dy-. The product over the steps is exact for the method's own orbit up
to its tolerance, but for what an explicit step does not resolve of disturbances: directions of slip, see
`timesim.engine.law.cone.felt_direction`, and modes, of the structure as contacts hold it, that are fast over a step. Of
itself it would let these grow or die out, however little they move; what they do by themselves is therefore taken out
of the rates, and exact [4]_. Its eigenvalues are the Floquet multipliers.

.. [1] M. A. Aizerman & F. R. Gantmakher, On the stability of periodic motions, Journal of Applied Mathematics and
   Mechanics 22 (1958) 1065-1078.
.. [2] R. I. Leine & H. Nijmeijer, *Dynamics and Bifurcations of Non-Smooth Mechanical Systems*, Springer (2004).
.. [3] M. di Bernardo, C. J. Budd, A. R. Champneys & P. Kowalczyk, *Piecewise-smooth Dynamical Systems*, Springer
   (2008), section 2.5.
.. [4] J. D. Lawson, Generalized Runge-Kutta processes for stable systems with large Lipschitz constants, SIAM Journal
   on Numerical Analysis 4 (1967) 372-380.
"""

from timesim.orbit.monodromy.collocated import Collocated
from timesim.orbit.monodromy.derivative import HybridState, derivative, point_of, state_vector, vector_of
from timesim.orbit.monodromy.disturbed import LOST, MANY, Disturbed, error_of
from timesim.orbit.monodromy.linearised import linear
