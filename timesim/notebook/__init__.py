"""Structures, contacts and forces from arrays, and the studies of them as functions, for notebooks and scripts.

structure = timesim.modes([0.9, 1.1], 0.02, {"tip": [[1, 1, 0.8], [1, -1, 0.6]]})
pad = timesim.contact("pad", "tip", friction=0.5, tangential_stiffness=20, normal_stiffness=20, preload=3)
system = timesim.system(structure, [pad], timesim.modal_forces([1, 1]))
result = timesim.integrate(system, 1.39, 60)
"""

from timesim.notebook.parts import contact, matrices, modal_forces, modes, point_force, system
from timesim.notebook.studies import follow, integrate, plot, settle, show, sweep
