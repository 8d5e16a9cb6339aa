"""Scenes that cannot be meant: each breaks one rule at one key, which the message must name with its line."""

from dataclasses import dataclass

BASE = """\
title: base
structure:
  modes:
    - frequency: 0.9
      damping_ratio: 0.02
      mass: 1.0
      shape: {tip: [1, 1, 0.8], rim: [0, 1, 0]}
    - frequency: 1.1
      damping_ratio: 0.03
      mass: 2.0
      shape: {tip: [1, -1, 0.6], rim: [1, 0, 0]}
contacts:
  - name: pad
    point: tip
    against: ground
    normal: [0, 0, 1]
    tangent: [1, 0, 0]
    friction: 0.5
    tangential_stiffness: 20.0
    normal_stiffness: 21.0
    preload: 3.0
  - name: stop
    point: rim
    friction: 0.0
    tangential_stiffness: 0
    normal_stiffness: 5.0
excitation:
  frequency: 1.39
  modal_force:
    - {amplitude: 1.0, phase_deg: 0.0}
    - {amplitude: 1.0, phase_deg: 90.0}
  forces:
    - {point: tip, direction: [1, 0, 0], amplitude: 1.5, harmonic: 2}
  constant_forces:
    - {point: tip, direction: [0, 0, 2], amplitude: 0.5}
initial: rest
solver:
  accuracy: standard
study:
  kind: transient
  cycles: 60
  samples_per_cycle: 100
  record_last: 10
"""

MATRICES = """\
structure:
  matrices:
    mass: [[1, 0], [0, 1]]
    stiffness: [[2, -1], [-1, 2]]
    damping: [[0.1, 0], [0, 0.1]]
    points:
      m1: {x: 0}
      m2: {x: 1}
  keep_modes: 2
excitation:
  frequency: 0.2
  forces: [{point: m1, direction: [1, 0, 0], amplitude: 1}]
study: {kind: transient, cycles: 5}
"""


ELEMENT = """\
contacts:
  - name: pad
    friction: 0.3
    tangential_stiffness: 1.0
    normal_stiffness: 1.0
    preload: 1.0
study:
  kind: element
  A: 1.0
  B: 0.5
  phi_deg: 90
"""

JUMP = """\
structure:
  modes:
    - {frequency: 0.9, damping_ratio: 0.02, mass: 1.0, shape: {tip: [1, 1, 0.8]}}
excitation:
  modal_force:
    - {amplitude: 1.0}
study:
  kind: jump
  run_up:
    - {frequency: 0.8, cycles: 9}
  phases:
    - {frequency: 0.9, cycles: 5}
    - {frequency: 0.95, cycles: 7}
  samples_per_cycle: 100
"""

ELEMENT_MAP = """\
contacts:
  - name: pad
    friction: 0.3
    tangential_stiffness: 1.0
    normal_stiffness: 1.0
    preload: 1.0
study:
  kind: element_map
  A: {from: 0, to: 4, num: 5}
  B: [0, 1, 2]
  D: 0.5
"""

HBM = (
    BASE[: BASE.index("study:")]
    + """\
study:
  kind: hbm
  frequency: {from: 0.8, to: 1.65}
  harmonics: 7
  time_samples: 256
  over: {contacts.pad.preload: [1, 2]}
  continuation: {max_step: 0.1}
"""
)

BISTABLE = (
    BASE[: BASE.index("study:")]
    + """\
study:
  kind: bistable
  frequency: {from: 1.24, to: 1.27}
  step: 0.01
  width: 1e-4
  starts: 5
  over: {contacts.pad.preload: [1, 2]}
"""
)

OPTIMUM = (
    BASE[: BASE.index("study:")]
    + """\
study:
  kind: optimum
  along: {contacts.pad.preload: {from: 1, to: 5, num: 5}}
  frequency: {from: 1.2, to: 1.6, step: 0.1}
  accuracy: 0.01
  point: tip
  axis: x
"""
)

TRADEOFF = BASE[: BASE.index("study:")] + "study: {kind: tradeoff, cycles: 6, error: 1e-4, budget: 5}\n"

SWEEP = (
    BASE[: BASE.index("study:")]
    + """\
study:
  kind: sweep
  frequency: {from: 0.9, to: 1.1, step: 0.05}
  direction: both
  over: {contacts.pad.preload: [1, 2]}
  settle: {tolerance: 1e-8, max_cycles: 500}
  refine: 1e-3
"""
)


@dataclass(frozen=True)
class BadScene:
    """The text, the key that the message names, a piece of the line that it names, and words of the rule."""

    key: str
    text: str
    at: str
    rule: str

    @property
    def line(self) -> int:
        assert self.text.count(self.at) == 1, self.at
        return self.text[: self.text.index(self.at)].count("\n") + 1


def changed(base: str, key: str, old: str, new: str, rule: str, at: str = "") -> BadScene:
    """A good scene with one piece of its text replaced; the message names the first new line unless `at` is given."""
    assert base.count(old) == 1, old
    return BadScene(key, base.replace(old, new), at or new.split("\n")[0].strip(), rule)


_SLIP_SCENE = "initial:\n  modal_displacement: [0.5, 0.5]\n  slip: {pad: [0.0, 0.0]}\n"

# Of each good scene: the key that is refused, a piece of the text and what stands in its place, words of the rule, and
# where it is not the first new line, the line that the message names.
# fmt: off
CHANGES = (
    (BASE, (
        ("titel", "title: base", "titel: base", "did you mean title?"),
        ("title", "title: base", "title: 12", "must be text"),
        ("units.length", "title: base", "units: {length: 1e-3 m}", "must be the name of a unit, letters only"),
        ("units.time", "title: base", "units: {time: ms}", "is no key here"),
        ("structure", "structure:\n  modes:", "structure:\n  mods:", "exactly one of", "structure:"),
        ("structure.modes.0.frequency", "frequency: 0.9", "frequency: -0.9", "must be >= 0"),
        ("structure.modes.0.frequency", "frequency: 0.9", "frequency: .nan", "must be finite"),
        ("structure.modes.0.frequency", "frequency: 0.9", "frequency: 0.9 Hz", "must be a number"),
        ("structure.modes.0.frequency", "frequency: 0.9", "frequency:", "has no value", "- frequency:\n"),
        ("structure.modes.0.damping_ratio", "damping_ratio: 0.02", "damping_ratio: -0.02", "must be >= 0"),
        ("structure.modes.0.dampng_ratio", "damping_ratio: 0.02", "dampng_ratio: 0.02", "did you mean damping_ratio?"),
        ("structure.modes.1.mass", "mass: 2.0", "mass: 0.0", "must be > 0"),
        ("structure.modes.1.mass", "      mass: 2.0\n", "", "is required", "- frequency: 1.1"),
        ("structure.modes.1.shape", "rim: [1, 0, 0]", "rom: [1, 0, 0]", "same points", "rom:"),
        ("structure.modes.1.shape.rim", "rim: [1, 0, 0]", "rim: [1, 0]", "3 entries", "rim: [1, 0]"),
        ("structure.modes.1.shape.tip.0", "tip: [1, -1, 0.6]", "tip: ['1', -1, 0.6]", "must be a number", "['1'"),
        ("structure.modes.1.shape.a.b", "rim: [1, 0, 0]", "a.b: [1, 0, 0]", "without . and =", "a.b"),
        ("contacts", "contacts:\n  - name: pad", "contacts:\n  name: pad", "is no YAML", "    point: tip"),
        ("contacts.1.name", "name: stop", "name: pad2\n    name: pad", "stands twice", "    name: pad\n"),
        ("contacts.*.name", "name: stop", 'name: "*"', "other than ground and *", '- name: "*"'),
        ("contacts.1.name", "name: stop", "name: pad", "must differ", "- name: pad\n    point: rim"),
        ("contacts.pad.point", "point: tip\n    against", "point: tp\n    against", "did you mean tip?"),
        ("contacts.pad.point", "    point: tip\n    against", "    against", "is required", "- name: pad"),
        ("contacts.pad.against", "against: ground", "against: grund", "did you mean ground?"),
        ("contacts.pad.against", "against: ground", "against: tip", "another point"),
        ("contacts.pad.normal", "normal: [0, 0, 1]", "normal: [0, 0, 0]", "zero vector"),
        ("contacts.pad.normal", "normal: [0, 0, 1]", "normal: z", "must be a list (Direction from body 1 into body 2 "),
        ("contacts.pad.tangent", "tangent: [1, 0, 0]", "tangent: [0, 0, -2]", "parallel"),
        ("contacts.pad.friction", "friction: 0.5", "friction: -0.5", "must be >= 0"),
        ("contacts.pad.frction", "friction: 0.5", "frction: 0.5", "did you mean friction?"),
        ("contacts.pad.tangential_stiffness", "ness: 20.0", "ness: soft", "must be a number, [k1, k2]"),
        ("contacts.pad.tangential_stiffness", "ness: 20.0", "ness: [[1, 2], [2, 1]]", "positive definite"),
        ("contacts.pad.tangential_stiffness", "ness: 20.0", "ness: 0", "must be > 0 where friction",
         "ness: 0\n    normal_stiffness: 21"),
        ("contacts.pad.tangential_stiffness", "ness: 20.0", "ness: [1, 2, 3]", "2 entries"),
        ("contacts.pad.normal_stiffness", "ness: 21.0", "ness: -21.0", "must be >= 0"),
        ("contacts.pad.preload", "21.0\n    preload: 3.0", "0\n    preload: -3.0", "must be > 0 where normal",
         "preload: -3"),
        ("contacts.stop.preload", "normal_stiffness: 5.0", "normal_stiffness: 5.0\n    preload: [1]",
         "must be a number", "preload: [1]"),
        ("excitation.frequency", "  frequency: 1.39\n", "", "is required in a study of kind transient", "excitation:"),
        ("excitation.frequency", "frequency: 1.39", "frequency: -1.39", "must be > 0"),
        ("excitation.modal_force", "    - {amplitude: 1.0, phase_deg: 90.0}\n", "", "must have 2 entries",
         "modal_force:"),
        ("excitation.modal_force.1.phase", "phase_deg: 90.0", "phase: 90.0", "did you mean phase_deg?", "phase: 90"),
        ("excitation.forces.0.point", "point: tip, direction: [1", "point: top, direction: [1", "did you mean tip?",
         "point: top"),
        ("excitation.forces.0.direction", "[1, 0, 0], amplitude: 1.5", "[0, 0, 0], amplitude: 1.5", "zero vector",
         "amplitude: 1.5"),
        ("excitation.forces.0.amplitude", "amplitude: 1.5", "amplitude: .inf", "must be finite", ".inf"),
        ("excitation.forces.0.amplitude", "amplitude: 1.5", "amplitude: -2e100", "must be >= -1e+100", "-2e100"),
        ("excitation.modal_force.0.amplitude", "{amplitude: 1.0, phase_deg: 0.0}", "{amplitude: 1e200, phase_deg: 0.0}",
         "must be <= 1e+100", "1e200"),
        ("excitation.forces.0.harmonic", "harmonic: 2", "harmonic: 0", "must be >= 1", "harmonic: 0"),
        ("excitation.forces.0.harmonic", "harmonic: 2", "harmonic: 1.5", "whole number", "harmonic: 1.5"),
        ("excitation.constant_forces.0.point", "point: tip, direction: [0", "point: 7, direction: [0",
         "put it in quotes", "point: 7"),
        ("excitation.constant_forces.0.harmonic", "amplitude: 0.5", "amplitude: 0.5, harmonic: 2", "is no key",
         "harmonic: 2}\ninitial"),
        ("initial", "initial: rest", "initial: resting", "did you mean rest?"),
        ("initial", "initial: rest", "initial: 3", "must be rest, static"),
        ("initial", "initial: rest", "initial: {}", "must name"),
        ("initial", "[0, 0, 2], amplitude: 0.5}\ninitial: rest", "[3, 0, -1], amplitude: 50}\ninitial: static",
         "outside its friction cone", "initial: static"),
        ("initial.modal_displacement", "initial: rest", "initial: {modal_displacement: [1]}", "must have 2 entries"),
        ("initial.modal_velocity.1", "initial: rest", "initial: {modal_velocity: [1, .nan]}", "must be finite"),
        ("initial.slip.pod", "initial: rest", "initial: {slip: {pod: [0, 0]}}", "did you mean pad?"),
        ("initial.slip.pad", "initial: rest\n", _SLIP_SCENE, "outside its friction cone", "slip: {pad"),
        ("initial.from", "initial: rest", "initial: {from: no/result.nc}", "paths start at the scene's folder"),
        ("solver.accuracy", "accuracy: standard", "accuracy: fine", "'draft', 'standard' or 'reference'"),
        ("solver.method", "accuracy: standard", "accuracy: standard\n  method: tsit5", "excludes accuracy",
         "method: tsit5"),
        ("solver.method", "accuracy: standard", "method: euler", "'tsit5', 'dopri5'"),
        ("solver.rtol", "accuracy: standard", "rtol: 1e-8", "goes with method"),
        ("solver.rtol", "accuracy: standard", "{method: tsit5, rtol: 2}", "must be < 1"),
        ("solver.method", "accuracy: standard", "method: RK45", "(dopri5 is this pair of Dormand and Prince)", "RK45"),
        ("solver.steps_per_cycle", "accuracy: standard", "method: rk4\n  steps_per_cycle: 100", "must be >= 200",
         "steps_per_cycle: 100"),
        ("solver.steps_per_cycle", "accuracy: standard", "method: dopri8\n  steps_per_cycle: 300",
         "goes with method rk4", "steps_per_cycle: 300"),
        ("solver.reduce", "accuracy: standard", "reduce: yes", "true or false"),
        ("solver.max_steps", "accuracy: standard", "max_steps: 0", "must be >= 1"),
        ("study", BASE[BASE.index("study:") :], "", "is required", "title: base"),
        ("study.kind", "kind: transient", "kind: transent", "did you mean transient?"),
        ("study.kind", "  kind: transient\n", "", "is required", "study:"),
        ("study.cycles", "cycles: 60", "cycles: 60.5", "whole number"),
        ("study.cycles", "cycles: 60", "cycles: 0", "must be >= 1"),
        ("study.cycle", "cycles: 60", "cycle: 60", "did you mean cycles?", "cycle: 60"),
        ("study.samples_per_cycle", "cycle: 100", "cycle: 1\n", "must be >= 2", "samples_per_cycle: 1"),
        ("study.samples_per_cycle", "cycle: 100", "cycle: 100000001", "at most 1000000000 samples of the 10 cycles"),
        ("study.record_last", "record_last: 10", "record_last: 61", "at most the 60 cycles"),
        ("study.record_last", "record_last: 10", "record_last: !!int 10", "has the tag"),
    )),
    (MATRICES, (
        ("structure.matrices.mass", "mass: [[1, 0], [0, 1]]", "mass: [[1, 2], [2, 1]]", "positive definite"),
        ("structure.matrices.mass", "mass: [[1, 0], [0, 1]]", "mass: [[1, 0], [0, 1e-300]]", "of row 1 is 1e-300"),
        ("structure.matrices.mass", "mass: [[1, 0], [0, 1]]", "mass: [[1, 0], [1]]", "rows of one length"),
        ("structure.matrices.mass", "mass: [[1, 0], [0, 1]]", "mass: [[1, 0]]", "must be square"),
        ("structure.matrices.stiffness", "[-1, 2]]", "[-1.1, 2]]", "must be symmetric", "stiffness:"),
        ("structure.matrices.stiffness", "[[2, -1], [-1, 2]]", "[[1, 2], [2, 1]]", "no negative eigenvalue",
         "stiffness:"),
        ("structure.matrices.stiffness", "[[2, -1], [-1, 2]]", "[[1]]", "must be 2 x 2", "stiffness:"),
        ("structure.matrices.damping", "[0, 0.1]]", "[0, -0.1]]", "no negative eigenvalue", "damping:"),
        ("structure.matrices.damping_ratio", "    points:", "    damping_ratio: 0\n    points:", "excludes damping"),
        ("structure.matrices.damping_ratio", "damping: [[0.1, 0], [0, 0.1]]", "damping_ratio: [0.1]",
         "each of the 2 modes"),
        ("structure.matrices.damping_ratio", "    damping: [[0.1, 0], [0, 0.1]]\n", "", "no damping matrix",
         "matrices:"),
        ("structure.matrices.points.m2.x", "m2: {x: 1}", "m2: {x: 2}", "row from 0 to 1"),
        ("structure.matrices.points.m2.x", "m2: {x: 1}", "m2: {x: -1}", "must be >= 0"),
        ("structure.matrices.points.m2.r", "m2: {x: 1}", "m2: {r: 1}", "known: x, y, z"),
        ("structure.matrices.points.m2", "m2: {x: 1}", "m2: {x: 1, y: 1}", "different row"),
        ("structure.matrices.points.m2", "m2: {x: 1}", "m2: {}", "at least one of"),
        ("structure.keep_modes", "keep_modes: 2", "keep_modes: 3", "must be at most 2"),
    )),
    (ELEMENT, (
        ("study.A", "  A: 1.0\n", "  A: -1.0\n", "must be >= 0"),
        ("study.C", "  B: 0.5\n", "  C: 0.5\n", "is no key here"),
        ("study", "  A: 1.0\n  B: 0.5\n", "", "must name A, B or D, or motion", "study:"),
        ("study.A", "  phi_deg: 90", "  motion: cycle.csv", "excludes motion", "A: 1.0"),
        ("study.motion", "  A: 1.0\n  B: 0.5\n  phi_deg: 90\n", "  motion: no.csv\n", "does not exist, paths start at"),
        ("study.motion", "  A: 1.0\n  B: 0.5\n  phi_deg: 90\n", "  motion: 3\n", "must be the path of"),
        ("study.contact", "  phi_deg: 90", "  contact: pod", "did you mean pad?"),
        ("study.samples", "  phi_deg: 90", "  samples: 10", "must be >= 36"),
        ("study.harmonics", "  phi_deg: 90", "  harmonics: 0", "must be >= 1"),
        ("study.kind", "kind: element\n", "kind: elemnt\n", "did you mean element?"),
    )),
    (ELEMENT_MAP, (
        ("study", "  B: [0, 1, 2]\n", "", "must have two axes, not 1", "study:"),
        ("study", "  D: 0.5", "  D: [0, 1]", "must have two axes, not 3", "study:"),
        ("study.B", "[0, 1, 2]", "[0, 2, 1]", "must ascend, each value once", "B: [0, 2, 1]"),
        ("study.B", "[0, 1, 2]", "[-1, 1]", "must not be negative", "B: [-1, 1]"),
        ("study.A.to", "to: 4", "to: -4", "must be larger than from", "A: {from"),
        ("study.A.num", "num: 5", "num: 1", "must be >= 2", "A: {from"),
        ("study.A.step", "num: 5", "num: 5, step: 1", "is no key here", "A: {from"),
        ("study.preload", "  D: 0.5", "  preload: -2\n  normal_stiffness: 0",
         "must be > 0 where normal_stiffness is 0 (such a contact would never carry; a gap needs"),
        ("study.normal_stiffness", "preload: 1.0\nstudy:\n", "preload: -2.0\nstudy:\n  normal_stiffness: 0\n",
         "must be > 0 where preload is -2 (such a contact would never carry; a gap needs", "normal_stiffness: 0\n"),
    )),
    (JUMP, (
        ("study.samples_per_cycle", "cycle: 100", "cycle: 100000000", "at most 1000000000 samples of the 12 cycles"),
        ("study.phases.1.cycles:7", "cycles: 7", "cycles:7", "has no value (a space is missing: cycles: 7)"),
        ("study.phases.0.frequency", "{frequency: 0.9, cycles: 5}", "{frequency: -0.9, cycles: 5}", "must be > 0"),
        ("structure.modes.0.02", "ratio: 0.02", "ratio: 0,02", "has no value (a number takes a point", "0,02"),
        ("study.phases.1.cycles", "cycles: 7", "cycles: 0", "must be >= 1", "cycles: 0"),
        ("study.phases.1.cycles", "0.95, cycles: 7", "0.95", "is required", "frequency: 0.95"),
        ("study.phases.1.cycle", "cycles: 7", "cycle: 7", "did you mean cycles?", "cycle: 7"),
        ("study.run_up.0.cycles", "cycles: 9", "cycles: 9.5", "whole number", "cycles: 9.5"),
        ("study.run_up.0.cycles", "cycles: 9", 'cycles: "9"', "whole number (without quotes and unit)", 'cycles: "9"'),
        ("study.runup", "run_up:", "runup:", "did you mean run_up?"),
    )),
    (HBM, (
        ("study.over", "over: {contacts.pad.preload: [1, 2]}",
         "over: {contacts.pad.normal_stiffness: [0, 20], contacts.pad.preload: [3, -1]}",
         "cannot hold contacts.pad.normal_stiffness = 0, contacts.pad.preload = -1 together"),
        ("study.harmonics", "harmonics: 7", "harmonics: 0", ">= 1", "harmonics: 0"),
        ("study.harmonics", "harmonics: 7", "harmonics: 1", "harmonic 2 is excited", "harmonics: 1"),
        ("study.time_samples", "time_samples: 256", "time_samples: 27", "must be at least 28 for 7 harmonics"),
        ("study.harmonic", "harmonics: 7", "harmonic: 7", "did you mean harmonics?", "harmonic: 7"),
        ("study.frequency", "{from: 0.8, to: 1.65}", "1.4", "must be a mapping with from and to"),
        ("study.frequency.to", "to: 1.65}", "to: 0.8}", "must differ", "frequency: {from: 0.8"),
        ("study.frequency.step", "to: 1.65}", "to: 1.65, step: 0.1}", "is no key here", "frequency: {from: 0.8"),
        ("study.start", "harmonics: 7", "harmonics: 7\n  start: stuck", "'linear' or 'both_ends'", "start: stuck"),
        ("study.start.from", "harmonics: 7", "harmonics: 7\n  start: {from: no.nc}", "does not exist, paths start at",
         "start: {from"),
        ("study.over.contacts.pod.preload", "contacts.pad", "contacts.pod", "is no item of the list", "over:"),
        ("study.continuation.max_stop", "max_step", "max_stop", "did you mean max_step?", "continuation:"),
        ("study.continuation.min_step", "max_step: 0.1", "max_step: 1e-8", "at most first_step", "continuation:"),
        ("study.along", "harmonics: 7",
         "harmonics: 7\n  along: {contacts.pad.preload: {from: 1, to: 2}, contacts.pad.friction: {from: 0.1, to: 0.2}}",
         "must name one scalar, not 2", "along:"),
        ("study.over.contacts.0.preload", "contacts.pad.preload: [1, 2]",
         "contacts.pad.preload: [1, 2], contacts.0.preload: [3, 4]",
         "is the same scalar as over.contacts.pad.preload (name it once)", "over:"),
        ("study.over.contacts.*.preload", "contacts.pad.preload: [1, 2]",
         "contacts.pad.preload: [1, 2], contacts.*.preload: [3, 4]",
         "is the same scalar as over.contacts.pad.preload (name it once)", "over:"),
        ("study.along.contacts.pad.preload", "frequency: {from: 0.8, to: 1.65}",
         "frequency: 1.39\n  along: {contacts.pad.preload: {from: 1, to: 2}}",
         "is the same scalar as over.contacts.pad.preload (name it once)", "along:"),
    )),
    (BISTABLE, (
        ("study.over", "over: {contacts.pad.preload: [1, 2]}",
         "over: {contacts.pad.normal_stiffness: [0, 20], contacts.pad.preload: [3, -1]}",
         "normal_stiffness = 0, contacts.pad.preload = -1 together: contacts.pad.preload must be > 0 where"),
        ("study.frequency.to", "to: 1.27}", "to: 1.2}", "larger than from", "frequency: {from"),
        ("study.frequency.step", "to: 1.27}", "to: 1.27, step: 0.01}", "no key here", "frequency: {from"),
        ("study.width", "width: 1e-4", "width: 0.02", "must be at most the step of the sweeps", "width:"),
        ("study.width", "width: 1e-4", "width: 0", "must be > 0", "width:"),
        ("study.step", "step: 0.01", "step: 0.02", "must be at most half of the range", "step:"),
        ("study.starts", "starts: 5", "starts: -1", "must be >= 0", "starts:"),
        ("study.starts", "starts: 5", "starts: 7", "must be 0, or 5, 9, 13", "starts:"),
        ("study.harmonics", "starts: 5", "starts: 5\n  harmonics: 1", "harmonic 2 is", "harmonics: 1"),
        ("study.time_samples", "starts: 5", "starts: 5\n  time_samples: 20", "must be at least 36", "time_s"),
        ("study.over.contacts.pad.friction", "pad.preload: [1,", "pad.friction: [-1,", "must be >= 0", "over:"),
    )),
    (OPTIMUM, (
        ("study.along", "{contacts.pad.preload: {from: 1, to: 5, num: 5}}", "{}", "must name one scalar, not 0"),
        ("study.along.contacts.pad.preload.num", "num: 5", "num: 2", "must be at least 3", "along:"),
        ("study.along.contacts.pod.preload", "contacts.pad", "contacts.pod", "is no item of the list", "along:"),
        ("study.along.contacts.pad.friction", "pad.preload: {from: 1", "pad.friction: {from: -1", ">= 0", "along:"),
        ("study.accuracy", "accuracy: 0.01", "accuracy: 3", "must be at most half of the range", "accuracy: 3"),
        ("study.point", "  point: tip\n  axis", "  point: top\n  axis", "did you mean tip?", "point: top"),
        ("study.axis", "axis: x", "axis: w", "'x', 'y' or 'z'", "axis: w"),
    )),
    (SWEEP, (
        ("study.frequency", "  frequency: {from: 0.9, to: 1.1, step: 0.05}\n", "", "is required", "study:"),
        ("study.frequency.step", ", step: 0.05", "", "is required", "frequency: {from"),
        ("study.frequency.step", "to: 1.1, step: 0.05", "to: 0.9000000000000002, step: 2e-17",
         "larger than the rounding of a frequency (0.9 stands twice)", "frequency: {from"),
        ("study.frequency.step", "step: 0.05", "step: 1e-9", "at most 1000000 points", "frequency: {from"),
        ("study.frequency.step", "0.9, to: 1.1, step: 0.05", "1, to: 1e99, step: 1e-300", "points, not inf", "1e99"),
        ("study.frequency.to", "0.9, to: 1.1, step: 0.05", "1, to: 1e300, step: 1e-300", "<= 1e+100", "1e300"),
        ("study.frequency.to", "to: 1.1", "to: 0.8", "must not be smaller than from", "frequency: {from"),
        ("study.frequency.count", "step: 0.05", "step: 0.05, count: 5", "is no key here", "frequency: {from"),
        ("study.frequency.from", "step: 0.05", "values: [1.0]", "excludes values", "frequency: {from"),
        ("study.frequency.num", "step: 0.05", "step: 0.05, num: 5", "excludes step", "frequency: {from"),
        ("study.frequency.num", "step: 0.05", "num: 1", "must be >= 2", "frequency: {from"),
        ("study.frequency.to", "1.1, step: 0.05", "0.9, num: 5", "must be larger than from", "frequency: {from"),
        ("study.frequency.values", "{from: 0.9, to: 1.1, step: 0.05}", "{values: [1.0, 1.1, 1.0]}", "must differ"),
        ("study.frequency.values.1", "{from: 0.9, to: 1.1, step: 0.05}", "{values: [1.0, -1.1]}", "must be > 0"),
        ("study.direction", "direction: both", "direction: sideways", "'independent'"),
        ("study.refine", "direction: both", "direction: independent", "needs a direction", "refine:"),
        ("study.refine", "refine: 1e-3", "refine: 0.06", "must be at most the least step of frequency"),
        ("study.periodic", "direction: both", "direction: both\n  periodic: shot", "did you mean shoot?", "shot"),
        ("study.settle.tolerance", "tolerance: 1e-8", "tolerance: 0.1", "must be <= 0.01", "settle:"),
        ("study.settle.max_cycles", "max_cycles: 500", "max_cycles: 0", "must be >= 1", "settle:"),
        ("study.settle.cycles", "max_cycles: 500", "cycles: 500", "is no key here", "settle:"),
        ("study.over.contacts.pad.preload", "[1, 2]", "[1, 2, 1]", "differ from each other (1 stands", "over:"),
        ("study.over.contacts.pad.point", "pad.preload", "pad.point", "vary a key whose value is one number", "over:"),
        ("study.over.solver.rtol", "contacts.pad.preload", "solver.rtol", "the key of a scalar", "over:"),
        ("study.over.contacts.p/d.preload", "contacts.pad", "contacts.p/d", "must not hold a /", "over:"),
        ("study.over.excitation.frequency", "contacts.pad.preload", "excitation.frequency", "axis of its own", "over:"),
        ("study.over.contacts.pad.preload.num", "[1, 2]", "{from: 1, to: 2, num: 1}", "must be >= 2", "over:"),
        ("study.over", "{contacts.pad.preload: [1, 2]}",
         "{contacts.pad.preload: {from: 1, to: 2, num: 10000}, contacts.pad.friction: {from: 1, to: 2, num: 10000}}",
         "at most 100000 combinations of values, not 10000 x 10000 = 100000000", "over:"),
    )),
)
# fmt: on

BAD_SCENES = (
    *(changed(base, *change) for base, changes in CHANGES for change in changes),
    BadScene(
        "structure.file",
        "structure: {file: 3, points: {a: {x: 0}}}\nexcitation: {frequency: 1}\nstudy: {kind: transient, cycles: 1}\n",
        "file: 3",
        "must be a .npz or .mat file",
    ),
    BadScene(
        "study.phases",
        JUMP[: JUMP.index("  phases:")] + "  phases: []\n",
        "phases: []",
        "at least 1",
    ),
    BadScene("study.phases", JUMP[: JUMP.index("  phases:")], "study:", "is required"),
    BadScene("study.error", TRADEOFF.replace("1e-4", "2"), "error: 2", "must be < 1"),
    BadScene("study.budget", TRADEOFF.replace("budget: 5", "budget: 0"), "budget: 0", "must be > 0"),
    BadScene(
        "excitation",
        HBM[: HBM.index("excitation:")]
        + "excitation:\n  constant_forces: [{point: tip, direction: [1, 0, 0], amplitude: 1}]\n"
        + HBM[HBM.index("initial:") :],
        "excitation:",
        "moves no mode periodically",
    ),
)
