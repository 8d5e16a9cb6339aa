"""The programs of usual studies, compiled beforehand: those of a contact and of harmonic balance serve scenes of any
size, those of time integration two modes with a contact.
"""

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from timesim.study.execution.worker import default_workers
from timesim.study.registry import carry_out, load_scene

CONTACT = {"friction": 0.5, "tangential_stiffness": 20.0, "normal_stiffness": 20.0, "preload": 3.0}
MODES = [
    {"frequency": 0.9, "damping_ratio": 0.02, "mass": 1.0, "shape": {"tip": [1, 1, 0.8]}},
    {"frequency": 1.1, "damping_ratio": 0.02, "mass": 1.0, "shape": {"tip": [1, -1, 0.6]}},
]
OSCILLATOR = {
    "structure": {"modes": MODES},
    "contacts": [{"name": "pad", "point": "tip", **CONTACT}],
    "excitation": {"frequency": 1.39, "modal_force": [{"amplitude": 1.0}, {"amplitude": 1.0}]},
}
ELEMENT = {"contacts": [{"name": "pad", **CONTACT}]}
USUAL: tuple[dict[str, Any], ...] = (
    OSCILLATOR | {"study": {"kind": "transient", "cycles": 1}},
    OSCILLATOR | {"study": {"kind": "sweep", "frequency": {"values": [1.39]}}},
    OSCILLATOR | {"study": {"kind": "hbm", "frequency": {"from": 1.39, "to": 1.4}}},
    ELEMENT | {"study": {"kind": "element", "A": 0.3, "B": 0.2, "D": 0.1}},
    ELEMENT | {"study": {"kind": "element_map", "A": [0.1, 0.3], "B": [0.1, 0.3], "D": 0.1}},
)
"""The studies, each short."""


def warm_up() -> str:
    """Carry out all of them, several at once, and say what that was."""
    clock = time.perf_counter()
    with ThreadPoolExecutor(default_workers()) as pool:
        list(pool.map(lambda scene: carry_out(load_scene(scene)), USUAL))
    kinds = dict.fromkeys(scene["study"]["kind"] for scene in USUAL)
    return f"compiled for {', '.join(kinds)} in {time.perf_counter() - clock:.0f} s"
