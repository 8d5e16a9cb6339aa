"""The table of all names in result files, with their meaning and units.

Units are those of the scene's own consistent system. Where the scene does not name them, quantities stand in their
place: ``length``, ``force``, ``length/s``, ``force*length`` (energy), ``force/length`` (stiffness). Time is in ``s``,
frequency in ``Hz``, angles in ``degree``, pure numbers in ``1``. Modal displacements are in ``modal length``: times the
mode shape of the scene they give a length. Names, flags and text have no units.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from timesim.model.model import STATE_NAMES

# Name: (long name, units or None). What follows a semicolon explains it.
LABELS: dict[str, tuple[str, str | None]] = {
    # coordinates
    "point": ("point of the structure", None),
    "contact": ("contact", None),
    "body_1": ("point of body 1 of the contact", None),
    "body_2": ("point of body 2 of the contact, or the ground", None),
    "axis": ("axis of the scene", None),
    "mode": ("mode, natural frequency ascending", "1"),
    "component": ("axis of the contact: in-plane t1, t2 and normal n", None),
    "tangent": ("in-plane axis of the contact", None),
    "harmonic": ("multiple of the excitation frequency", "1"),
    "cycle": ("excitation cycle, counted from 1", "1"),
    "time": ("time", "s"),
    "frequency": ("excitation frequency", "Hz"),
    "angle": ("phase angle of the prescribed motion", "degree"),
    "direction": ("direction of the sweep", None),
    "end": ("end of the bistable range", None),
    "a": ("amplitude of the motion along t1", "length"),
    "b": ("amplitude of the motion along t2", "length"),
    "d": ("amplitude of the normal motion", "length"),
    "phi_deg": ("phase of the motion along t2", "degree"),
    "psi_deg": ("phase of the normal motion", "degree"),
    "friction": ("coefficient of friction", "1"),
    "normal_stiffness": ("normal stiffness", "force/length"),
    "preload": ("preload", "force"),
    # transient, jump
    "displacement": ("displacement", "length"),
    "velocity": ("velocity", "length/s"),
    "modal_displacement": ("modal displacement", "modal length"),
    "modal_velocity": ("modal velocity", "modal length/s"),
    "contact_force": ("friction force on body 2 (t1, t2) and normal load (n)", "force"),
    "contact_state": ("contact state; 0 stick, 1 slip (of a frictionless stop: closed), 2 separation", None),
    "contact_displacement": ("relative motion (u1, u2, v) in the contact's axes", "length"),
    "slip": ("slip displacement w", "length"),
    "event_time": ("time of the transition", "s"),
    "event_contact": ("contact of the transition; position along the contacts from 0", None),
    "event_from": ("contact state before the transition", None),
    "event_to": ("contact state after the transition", None),
    "cycle_amplitude": ("displacement amplitude of the cycle; (max - min)/2", "length"),
    "cycle_amplitude_error": (
        "estimated error of the amplitudes of the cycle; relative to the largest of them, NaN where it is not known",
        "1",
    ),
    "cycle_start": ("time at the start of the cycle", "s"),
    "cycle_period": ("length of the cycle", "s"),
    "cycle_steps": ("steps of the time integration in the cycle; of a steady state, the mean over a period", "1"),
    "cycle_transitions": ("transitions of the contact in a cycle; the mean over a period", "1"),
    "drift": ("way by which the point moves on in a cycle; the rest is what one who moves on with it sees", "length"),
    "cycle_frequency": ("excitation frequency of the cycle", "Hz"),
    "final_modal_displacement": ("modal displacement at the end", "modal length"),
    "final_modal_velocity": ("modal velocity at the end", "modal length/s"),
    "contact_frame": ("axis of the contact, along those of the scene", "1"),
    "mode_shape": ("displacement of the point for a unit of the mode", "length/modal length"),
    "final_slip": ("slip displacement w at the end", "length"),
    "final_contact_state": ("contact state at the end", None),
    "final_phase_deg": ("phase of the excitation at the end", "degree"),
    "energy_input": ("work of the excitation in the cycle", "force*length"),
    "energy_damping": ("energy lost to structural damping in the cycle", "force*length"),
    "energy_stored_change": ("change of the stored energy over the cycle", "force*length"),
    "energy_residual": ("energy that the other terms of the cycle leave unexplained", "force*length"),
    "energy_friction": ("energy lost to friction in the cycle", "force*length"),
    # sweep
    "amplitude": (
        "displacement amplitude; (max - min)/2 over a period; of a motion that has not settled, over the ten cycles "
        "that were measured, which may be more than that of any one of them",
        "length",
    ),
    "phase_deg": (
        "phase of the first harmonic; of the excitation's frequency, x ~ A cos(2 pi f t + phase), on the clock of the "
        "forces' phase_deg, which it does not subtract; NaN where the motion has no period or no first harmonic",
        "degree",
    ),
    "dissipated_power": (
        "power lost in the contact; the mean over a period; where the motion has none, over the cycles measured",
        "force*length/s",
    ),
    "settled": ("1 where the motion settled", None),
    "settled_to": (
        "estimated distance of the state from one that repeats; relative to its largest entry; of a motion that has "
        "not settled, the least change over a period",
        "1",
    ),
    "irregular": (
        "1 where the motion is irregular; it repeats after no number of cycles up to 64, while free vibrations would "
        "have decayed: quasi-periodic, irregular, or of a longer period",
        None,
    ),
    "cycles": ("excitation cycles run", "1"),
    "period": ("period of the motion in excitation periods", "1"),
    "floquet_max": (
        "largest modulus of the Floquet multipliers; of a contact in full stick, whose offset is free, the balance "
        "counts the multipliers 1, the time integration does not",
        "1",
    ),
    "floquet_phase_deg": (
        "phase of that multiplier; disturbances change their sign in each period at 180, and turn in between",
        "degree",
    ),
    "slip_share": ("share of a period in slip; in which it is closed, of a frictionless stop", "1"),
    "separation_share": ("share of a period in separation", "1"),
    "amplitude_band": ("smallest and largest amplitude of one of the cycles that were measured", "length"),
    "band": ("end of the band of amplitudes", None),
    "failure": ("why the point could not be computed; empty where it was", None),
    "jump_low": ("lower end of the step of frequency over a jump; over a jump or a slope if jumps_bisected is 0", "Hz"),
    "jump_high": ("upper end of that step", "Hz"),
    # bistable
    "range": ("frequency at the ends of the range with two motions", "Hz"),
    "amplitude_upper": ("displacement amplitude of the larger motion at mid-range", "length"),
    "amplitude_lower": ("displacement amplitude of the smaller motion at mid-range", "length"),
    "motion": ("the motion of smaller (lower) or larger (upper) amplitude", None),
    "jump_from": ("displacement amplitude at the end of the range, before the jump", "length"),
    "jump_to": ("displacement amplitude beyond the end of the range, after the jump", "length"),
    "range_cut": ("1 where the search ends before the range does; -1: no range", None),
    "range_settled": ("1 where the motion next to the end had settled; -1: no range", None),
    "range_irregular": (
        "motion that loses its period at the end; it no longer counts beyond: 0 none, 1 the smaller, 2 the larger; -1: "
        "no range",
        None,
    ),
    "share_lower": ("share of the smaller motion's state in the start", "1"),
    "share_upper": ("share of the larger motion's state in the start", "1"),
    "start_branch": (
        "motion that the start leads to; 0 the smaller, 1 the larger, 2 another, 3 one that does not repeat, -1 none",
        None,
    ),
    "start_failure": ("why the motion from the start could not be computed; empty where it was", None),
    "start_cycles": ("excitation cycles run from the start", "1"),
    "start_amplitude": ("displacement amplitude of the motion that the start leads to", "length"),
    "offset_low": ("smallest slip displacement w over the starts; NaN where the contact does not stick", "length"),
    "offset_high": ("largest slip displacement w over the starts; NaN where the contact does not stick", "length"),
    # optimum
    "peak": ("largest displacement amplitude over the frequencies", "length"),
    "peak_frequency": ("frequency of the largest displacement amplitude", "Hz"),
    "peak_at_end": ("1 where the largest amplitude is at the first or last frequency", None),
    "peak_settled": ("1 where the motion of the largest amplitude has settled", None),
    "peak_irregular": ("1 where that motion is irregular; as in the variable irregular", None),
    "peak_carried": ("1 where that motion goes on from a value beside; no sweep comes to it", None),
    "peak_of": ("point and axis of the largest displacement amplitude", None),
    "optimum": ("value of the scalar with the least peak", None),
    "optimum_peak": ("least peak", "length"),
    "optimum_frequency": ("frequency of the least peak", "Hz"),
    # tradeoff
    "method": ("method of integration", None),
    "rtol": ("tolerance of a step, relative to the state", "1"),
    "error": ("relative error of the state at the end, or of the settled amplitude", "1"),
    "seconds_a_cycle": ("time that a cycle of the excitation takes", "s"),
    "steps_a_cycle": ("steps of a cycle", "1"),
    "steps_asked": ("fixed steps of a cycle; 0 where a tolerance rules", "1"),
    "pareto": ("1 where no other run of the whole scene is both faster and better", None),
    "modes_kept": ("lowest modes that were kept", "1"),
    "reduced": ("1 where what the scene cannot need was left out", None),
    "preset": ("accuracy of which it is the solver; empty where it is of none", None),
    "seconds_scatter": ("how much longer than the least the times of the run were; NaN where timed once", "1"),
    "compile_seconds_before": ("time of compilation before it; 0 where the program was compiled", "s"),
    # element, element map
    "u": ("tangential relative displacement", "length"),
    "v": ("normal relative displacement", "length"),
    "first_force": ("friction force over the first cycle, from f = 0", "force"),
    "force": ("friction force", "force"),
    "normal_load": ("normal load", "force"),
    "state": ("contact state; 0 stick, 1 slip, 2 separation", None),
    "transition_angle_deg": ("phase angle of the transition", "degree"),
    "transition_from": ("contact state before the transition", None),
    "transition_to": ("contact state after the transition", None),
    "transition_force": ("friction force at the transition", "force"),
    "history_angle_deg": ("phase angle of the transition, counted from the start", "degree"),
    "history_from": ("contact state before the transition", None),
    "history_to": ("contact state after the transition", None),
    "force_cos": ("cosine part of the friction force's harmonic; harmonic 0: the mean", "force"),
    "force_sin": ("sine part of the friction force's harmonic", "force"),
    "friction_work": ("work of the friction force on the slip in a cycle", "force*length"),
    "transitions": ("transitions in the cycle", "1"),
    "offset_free": (
        "1 where the contact sticks throughout, or all but; w, and with it f_b, may keep another offset",
        None,
    ),
    "principal_f_b": ("mean friction force along the principal axes, the major one first", "force"),
    "principal_f_s": ("friction force in phase with the displacement along the principal axes", "force"),
    "principal_f_c": ("friction force in phase with the velocity along the principal axes", "force"),
    "principal_effective_stiffness": ("effective stiffness along the principal axes", "force/length"),
    "principal_effective_damping": ("effective damping along the principal axes", "force/length"),
    "principal_amplitude": ("amplitude of the motion along the principal axes", "length"),
    "principal_phase_deg": ("phase of the motion along the principal axes", "degree"),
    "principal_direction": ("direction of the principal axes in the contact plane", "1"),
    "f_b": ("mean friction force", "force"),
    "f_s": ("friction force in phase with the displacement", "force"),
    "f_c": ("friction force in phase with the velocity", "force"),
    "dissipation": ("energy lost to friction in a cycle", "force*length"),
    "effective_stiffness": ("friction force in phase with the displacement over its amplitude", "force/length"),
    "effective_damping": ("friction force in phase with the velocity over the amplitude", "force/length"),
    # harmonic balance
    "stable": ("1 where the solution is stable", None),
    "fold": ("1 at a turning point of the branch, unless a free offset turns it", None),
    "branch": ("number of the branch: folds passed before", None),
    "curve": ("number of the curve", None),
    "closure": (
        "how far contacts are from repeating; u - w after a period, as a multiple of what is tolerated, at most 1",
        "1",
    ),
    "harmonics": ("harmonics balanced", "1"),
    "time_samples": ("time samples of a period", "1"),
    "change_with_harmonics": ("change of the amplitudes from the most harmonics; last: from the fewer before", "1"),
    "change_with_samples": ("change of the amplitudes from the most samples; last: from the fewer before", "1"),
    "harmonic_amplitude": ("amplitude of the harmonic; harmonic 0: the signed mean", "length"),
    "harmonic_cos": ("cosine part of the harmonic; harmonic 0: the signed mean", "length"),
    "harmonic_sin": ("sine part of the harmonic", "length"),
    # compare
    "found_by": ("time integration (sweep) or harmonic balance (hbm)", None),
    "excitation_angle": ("phase angle of the excitation", "degree"),
    "relative_difference": (
        "(harmonic balance - sweep)/sweep of the amplitude; the values along its axes are those of the group sweep",
        "1",
    ),
    "other_offset": (
        "1 where contacts keep another offset; the methods differ since a contact that sticks all the time does",
        "1",
    ),
}

# Units of the scalars of a scene, which may be axes of a parameter study, by the last part of their key.
SCENE_UNITS = {
    "frequency": "Hz",
    "phase_deg": "degree",
    "damping_ratio": "1",
    "friction": "1",
    "tangential_stiffness": "force/length",
    "normal_stiffness": "force/length",
    "preload": "force",
    "forces.amplitude": "force",
    "constant_forces.amplitude": "force",
}

YES_NO = {0: "no", 1: "yes"}
FLAGS = {
    **dict.fromkeys(("settled", "irregular", "stable", "fold", "pareto", "reduced"), YES_NO),
    **dict.fromkeys(("peak_at_end", "peak_settled", "peak_irregular", "peak_carried"), YES_NO),
    "range_cut": {-1: "no_range", **YES_NO},
    "range_settled": {-1: "no_range", **YES_NO},
    "range_irregular": {-1: "no_range", 0: "none", 1: "smaller", 2: "larger"},
    "start_branch": {-1: "none", 0: "smaller", 1: "larger", 2: "another", 3: "irregular"},
}
"""Meaning of the values of variables whose numbers stand for words."""


BASE = ("length", "force")
"""Quantities whose units a scene may name; the other units follow from them, such as ``N*mm/s`` of power."""
SI = {"N*m": "J", "N*m/s": "W"}
"""Names of such units of their own."""


EVERY = "*"
"""In the key of a scalar, every item of a list: ``contacts.*.preload``."""


def is_scalar_key(name: str) -> bool:
    """Whether a variable or an axis of a result is a scalar of the scene, named by its key: they alone have a dot."""
    return "." in name


def attributes(name: str, named: Mapping[str, str] | None = None) -> dict[str, Any]:
    """`long_name`, `comment` and `units` of a variable or coordinate, and what flags mean; empty for a name not listed.

    The name may be the key of a scalar in the scene, such as ``contacts.pad.preload``. ``named``: units of the
    quantities of `BASE`, ``{"length": "mm"}``.
    """
    if is_scalar_key(name):
        part, _, key = re.sub(r"\.(?:\d+|\*)", "", name).rpartition(".")
        long_name = f"scene value {name}"
        units = SCENE_UNITS.get(key, SCENE_UNITS.get(f"{part.rpartition('.')[2]}.{key}"))
    elif name in LABELS:
        long_name, units = LABELS[name]
    else:
        return {}
    long_name, *comment = long_name.split("; ", 1)
    attrs: dict[str, Any] = {"long_name": long_name, **({"comment": comment[0]} if comment else {})}
    if units is not None:
        units = re.sub("length|force", lambda quantity: (named or {}).get(quantity[0], quantity[0]), units)
        attrs["units"] = SI.get(units, units)
    flags = dict(enumerate(STATE_NAMES)) if long_name.startswith("contact state") else FLAGS.get(name, {})
    values = {"flag_values": np.array(list(flags), dtype=np.int8), "flag_meanings": " ".join(flags.values())}
    return attrs | (values if flags else {})


def with_unit(number: str, attrs: Mapping[str, Any]) -> str:
    """A number, as text, with the unit in the attributes of its variable, if the scene names it."""
    units = str(attrs.get("units", "1"))
    return number if units == "1" or set(BASE) & set(re.findall("[a-zA-Z]+", units)) else f"{number} {units}"


def counted(number: int, one: str, several: str = "") -> str:
    """A number and what it counts: ``counted(1, "point")`` and ``counted(0, "entry", "entries")``."""
    return f"{number} {one if number == 1 else several or one + 's'}"


def first_few(items: Sequence[str], most: int, rest: Callable[[int], str]) -> list[str]:
    """At most so many items, and what ``rest`` says of the number left out, if any are."""
    return [*items[:most], *([rest(len(items) - most)] if len(items) > most else [])]


def axis_value(value: float | str) -> str:
    """A value along an axis of a result, as text."""
    return str(value) if isinstance(value, str) else f"{value:.10g}"


EXACT = 17  # digits that tell any two numbers apart


def told_apart(values: Sequence[float] | np.ndarray, digits: int = 6) -> list[str]:
    """Numbers as text, with as many significant digits as tell those apart that differ, ``digits`` at least."""
    different = len(set(values))
    texts: list[str] = []
    for count in range(digits, EXACT + 1):
        texts = [f"{value + 0.0:.{count}g}" for value in values]  # -0 is 0
        if len(set(texts)) == different:
            break
    return texts


WIDTH = 60  # letters of a value in a message


def shortened(text: str, length: int) -> str:
    """The text, cut to at most ``length`` characters."""
    return text if len(text) <= length else f"{text[: length - 1]}…"


def in_words(values: Mapping[str, float], end: str = "") -> str:
    """Values of scalars of the scene with their keys, followed by ``end``; empty if there are none."""
    words = ", ".join(f"{key} {axis_value(value)}" for key, value in values.items())
    return words + end if words else ""
