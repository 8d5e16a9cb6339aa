"""Which method integrates where none is given."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulation import simulate
from systems import generated_model, oscillator, scene

from timesim.model.choice import TABLE, choice, contact_rate
from timesim.model.cost import (
    REACH,
    Work,
    seconds,
    seconds_a_cycle,
    seconds_a_solution,
    slip_rates,
    slip_steps,
    stable_steps,
    steps_for,
)
from timesim.model.model import Model
from timesim.model.promise import preset
from timesim.model.solver import CLOSED_FORM, COMPANION, Solver
from timesim.scene.report import describe
from timesim.study.outcome import attributes
from timesim.study.registry import load_scene

ROOT = Path(__file__).parents[2]
OSCILLATOR = ROOT / "configs" / "oscillator.yaml"
MANY_MODES = ROOT / "tests" / "data" / "many_modes.yaml"
LONG, BUDGET = 10_000_000, 100_000


def taken(model: Model, cycles: float = LONG, accuracy: str = "standard", budget: int = BUDGET) -> Solver:
    assert model.excitation.frequency is not None
    work = Work(((model.excitation.frequency, cycles),), model.excitation.frequency)
    return choice(accuracy, model, work, budget).solver


def slowly_driven() -> Model:
    """The oscillator far below its modes, its contact not proven to stick."""
    return oscillator(2.0, 0.3)


def slippery(friction: float = 1e-4) -> Model:
    model = oscillator(3.0, 1.39)
    return replace(model, contacts=(replace(model.contacts[0], friction=friction),))


def test_the_table_by_the_rates_of_a_scene() -> None:
    """Little friction; a structure faster than its contacts; one faster than its excitation; none of these."""
    assert taken(slippery()).name == "exponential"
    assert taken(scene(MANY_MODES)).name == "exponential"
    assert taken(slowly_driven()).name == "dopri8"
    assert taken(oscillator(3.0, 1.39)).name == "tsit5"
    methods = [line.method for line in TABLE]
    assert methods == ["exponential", "kvaerno5", "exponential", "dopri8"]


def test_a_long_sweep_gains_by_fewer_steps() -> None:
    """More than its programs take longer to compile; of the blade, and of a structure with one contact."""
    names, blade = [], load_scene(ROOT / "configs" / "blade_response.yaml").model()
    for model, frequency in ((blade, 725.0), (slowly_driven(), 0.3)):
        once = Work(((frequency, 1),), frequency, sweep=True)
        for time in (3.0, 12.0):
            cycles = time / seconds(model, Solver("tsit5", 1e-7, 1e-9), once)
            work = Work(((frequency, cycles),), frequency, sweep=True)
            names.append(choice("standard", model, work, BUDGET).solver.name)
    assert names == ["tsit5", "dopri8"] * 2


@pytest.mark.parametrize("model", [slippery(), scene(MANY_MODES), slowly_driven()], ids=["slip", "fast", "slow"])
def test_a_short_run_does_not_pay_for_what_takes_longer_to_compile(model: Model) -> None:
    """The border is where what is saved of the time by tsit5 is what is lost in compiling."""
    line = next(line for line in TABLE if line.method == taken(model).name and line.applies(model, _frequency(model)))
    own = preset("standard", model, _frequency(model), 10_000)
    each = seconds_a_cycle(model, own, _frequency(model))
    assert each is not None
    border = line.compiling[0] / (1 - line.share[0]) / each
    assert own.name == "tsit5"
    assert taken(model, 0.9 * border) == preset("standard", model, _frequency(model), 0.9 * border)
    assert taken(model, 1.1 * border).name == line.method


def _frequency(model: Model) -> float:
    assert model.excitation.frequency is not None
    return model.excitation.frequency


def test_the_finest_accuracy_keeps_its_method_but_where_slip_is_stiff() -> None:
    assert taken(slippery(), accuracy="reference").name == "exponential"
    for model in (scene(MANY_MODES), slowly_driven(), oscillator(3.0, 1.39)):
        assert taken(model, accuracy="reference").name == "dopri8"


def test_collocation_of_stiff_slip_takes_no_loose_tolerance() -> None:
    """At 1e-5 and 1e-6 one in eight such runs came to no end."""
    assert taken(slippery(), accuracy="draft").rtol == 1e-7
    assert taken(slippery(), accuracy="draft").atol == pytest.approx(1e-9)
    assert taken(scene(MANY_MODES), accuracy="draft") == replace(
        preset("draft", scene(MANY_MODES), 1.0, LONG), name="exponential"
    )


def test_what_explicit_steps_cannot_do_within_the_budget_is_left_to_collocation_however_short() -> None:
    steps = slip_steps(slippery(), 1.39)
    assert taken(slippery(), 3, budget=int(0.39 * steps)).name == "exponential"
    assert taken(slippery(), 3, budget=int(0.41 * steps)).name == "tsit5"


def test_rate_at_which_the_direction_of_slip_turns() -> None:
    """By hand: one mass on springs along x, y, z, driven along x and z; k u' / (mu n) with n = n0 + k_v v."""
    model = load_scene(_mass(friction=0.04)).model()
    stiffness, omega = np.array([30.0, 30.0, 40.0 + 7.0]), 2 * np.pi * 1.5
    motion = np.abs(np.array([1.0, 0.0, 1.0]) / (stiffness * (1 + 1e-3j) - omega**2))
    assert slip_rates(model, 1.5) == pytest.approx(5 * omega * motion[0] / (0.04 * (3 + 7 * motion[2])))
    varying = load_scene(_mass(friction=0.04, preload=0.5)).model()
    assert slip_steps(varying, 1.5) == pytest.approx(slip_rates(varying, 1.5)[0] / (REACH * 1.5))
    assert contact_rate(model) == pytest.approx(np.sqrt(7.0))
    assert slip_steps(load_scene(_mass(friction=0.06, preload=0.5)).model(), 1.5) == 0.0


def test_under_a_steady_load_it_is_mu_n_that_counts() -> None:
    """The same equation, mu n = 0.01; whether it slides is told by the force that would hold it, by hand."""
    steady = {"normal_stiffness": 0.0, "tangential_stiffness": 5e6}
    little, large = (
        load_scene(_mass(friction=friction, preload=0.01 / friction, **steady)).model() for friction in (0.01, 0.5)
    )
    assert slip_steps(large, 1.5) == pytest.approx(slip_steps(little, 1.5))
    assert 0.4 * slip_steps(large, 1.5) > BUDGET
    assert taken(large, 2).name == taken(little, 2).name == "exponential"
    held = 5.0 / abs(30.0 + 5.0 - (2 * np.pi * 1.5) ** 2)
    soft = {"normal_stiffness": 0.0, "tangential_stiffness": 5.0, "friction": 0.5}
    assert slip_steps(load_scene(_mass(preload=1.98 * held, **soft)).model(), 1.5) > 0
    assert slip_steps(load_scene(_mass(preload=2.02 * held, **soft)).model(), 1.5) == 0.0


@pytest.mark.parametrize("normal_stiffness", [0.0, 7.0])
def test_what_slides_is_told_by_the_force_along_the_surface_in_resonance_too(normal_stiffness: float) -> None:
    """By hand: where the held mass is in resonance along x its damper alone balances the load, u = 1 / (c omega)."""
    omega, scene = 2 * np.pi * 1.5, _mass(friction=0.01, normal_stiffness=normal_stiffness)
    stiffness, damping = omega**2 - 5.0, 0.3
    scene["structure"]["modes"][0] |= {
        "frequency": float(np.sqrt(stiffness)) / (2 * np.pi),
        "damping_ratio": damping / (2 * float(np.sqrt(stiffness))),
    }
    scene["excitation"]["modal_force"][2]["amplitude"] = 10.0
    held = 5.0 / abs(1e-3j * stiffness + 1j * damping * omega)
    for share, slides in ((0.98, True), (1.02, False)):
        scene["contacts"][0]["preload"] = share * held / 0.01
        model = load_scene(scene).model()
        assert (slip_steps(model, 1.5) > 0) == slides
        free = 1 / abs(stiffness - omega**2 + 1e-3j * stiffness + 1j * damping * omega)
        pressed = 10.0 * normal_stiffness / abs(40.0 + normal_stiffness - omega**2)
        assert slip_rates(model, 1.5) == pytest.approx(5 * omega * free / (share * held + 0.01 * pressed), rel=1e-2)


def test_a_force_of_a_higher_harmonic_turns_the_slip_as_one_of_its_own_frequency() -> None:
    rates = []
    for harmonic, frequency in ((1, 3.0), (2, 1.5)):
        force = {"point": "m", "amplitude": 1.0, "harmonic": harmonic}
        forces = [force | {"direction": direction} for direction in ([1, 0, 0], [0, 0, 1])]
        pushed = _mass() | {"excitation": {"frequency": frequency, "forces": forces}}
        rates.append(slip_rates(load_scene(pushed).model(), frequency)[0])
    assert rates[0] > 0
    assert rates[1] == pytest.approx(rates[0])


def test_check_warns_of_a_method_that_slip_takes_beyond_the_budget() -> None:
    sliding = _mass(friction=0.5, preload=0.02, normal_stiffness=0.0, tangential_stiffness=5e6)
    (line,) = (
        own for own in describe(load_scene(sliding | {"solver": {"method": "tsit5"}}))["warnings"] if "max" in own
    )
    assert line.startswith("solver.max_steps: 100000 steps a cycle are fewer than the ")
    assert "that the direction of slip may ask for at 1.5 Hz" in line
    assert not any("max_steps" in own for own in describe(load_scene(sliding)).get("warnings", ()))


def test_nothing_turns_where_nothing_slides_or_only_along_a_line() -> None:
    assert slip_rates(load_scene(_mass(friction=0.0, tangential_stiffness=0)).model(), 1.5) == [0.0]
    free = 1 / abs(40.0 * (1 + 1e-3j) - (2 * np.pi * 1.5) ** 2)
    assert slip_rates(load_scene(_mass(preload=-7.0 * free * 1.001)).model(), 1.5) == [0.0]
    speed, pressed = (1 / abs(k * (1 + 1e-3j) - (2 * np.pi * 1.5) ** 2) for k in (30.0, 47.0))
    rate = 5 * 2 * np.pi * 1.5 * speed / (0.2 * 7 * pressed)
    assert slip_rates(load_scene(_mass(preload=-7.0 * free * 0.999)).model(), 1.5) == pytest.approx(rate)
    assert slip_rates(load_scene(_mass(modes=[0, 2])).model(), 1.5) == [0.0]
    assert slip_steps(oscillator(3.0, 1.39), 0.9) < stable_steps(oscillator(3.0, 1.39), 0.9)


def _mass(modes: Any = (0, 1, 2), **contact: Any) -> dict[str, Any]:
    frequency = np.sqrt([30.0, 30.0, 40.0]) / (2 * np.pi)
    return {
        "structure": {
            "modes": [
                {
                    "frequency": float(frequency[i]),
                    "damping_ratio": 0.0,
                    "mass": 1.0,
                    "shape": {"m": np.eye(3)[i].tolist()},
                }
                for i in modes
            ]
        },
        "contacts": [
            {"name": "pad", "point": "m", "friction": 0.2, "tangential_stiffness": 5.0, "normal_stiffness": 7.0}
            | {"preload": 3.0}
            | contact
        ],
        "excitation": {
            "frequency": 1.5,
            "modal_force": [{"amplitude": float(i != 1)} for i in modes],
        },
        "study": {"kind": "transient", "cycles": 2},
    }


def test_steps_that_slip_asks_for_count_for_explicit_methods_alone() -> None:
    model, work = slippery(), Work(((1.39, 10),), 1.39)
    explicit, other = (Solver(name, 1e-7, 1e-9) for name in ("tsit5", "exponential"))
    assert seconds(model, explicit, work) > 50 * seconds(model, other, work)
    assert seconds(model, other, work) < seconds(oscillator(3.0, 1.39), explicit, work)


def test_the_steps_that_stability_asks_for_are_those_of_a_run() -> None:
    """Of one whose contact sticks: its stiffest vibration has died out, and the steps follow it all the same."""
    model, solver = stuck(2e4), Solver("tsit5", 1e-7, 1e-9, reduce=False)
    damped = replace(model, structure=replace(model.structure, damping=15 * model.structure.damping))
    least, multiple = steps_for(solver)
    *_, last = simulate(damped, 16, solver).totals.steps
    assert last > 4 * least
    assert least + multiple * stable_steps(damped, 1.39) == pytest.approx(last, rel=0.3)


def test_the_work_of_a_schedule_is_that_of_its_phases() -> None:
    phases, model, solver = ((3.0, 10), (1.0, 5), (2.0, 7)), oscillator(3.0, 1.39), Solver("tsit5", 1e-7, 1e-9)
    alone, estimated = (Work.of_run(phases, estimated=also) for also in (False, True))
    assert (alone.lowest, alone.run_cycles) == (1.0, 22)
    parts = [seconds(model, solver, Work.of_run((phase,), estimated=False)) for phase in phases]
    assert seconds(model, solver, alone) == pytest.approx(sum(parts))
    assert seconds(model, solver, estimated) == pytest.approx((1 + COMPANION) * sum(parts))


# Through the scene file


LONG_SCENE = ["contacts.pad.preload=2", "study.cycles=10000000", "study.record_last=1", "excitation.frequency=0.3"]


def test_check_and_run_take_the_same_and_say_why() -> None:
    given = load_scene(OSCILLATOR, LONG_SCENE)
    (line,) = describe(given)["method"]
    assert line.startswith("dopri8: of order 8, it takes about half of the time of tsit5")
    assert given.solver().name == "dopri8"
    assert "by dopri8, rtol " in describe(given)["accuracy"][0]
    said = attributes(given, str(given.solver()), 0.0, 0.0, None)
    assert said["method_choice"] == f"dopri8: {given.choice.why}"
    short = load_scene(OSCILLATOR, [*LONG_SCENE[:1], "excitation.frequency=0.3"])
    assert short.solver().name == "tsit5"
    assert "since dopri8 would save about 0.0" in describe(short)["method"][0]


def test_a_method_that_is_given_is_obeyed() -> None:
    given = load_scene(OSCILLATOR, [*LONG_SCENE, "solver={method: tsit5}"])
    assert given.solver() == Solver("tsit5", 1e-8, 1e-10)
    assert given.choice is None
    assert describe(given)["method"][0].startswith("tsit5: given; stability asks")
    assert "method_choice" not in attributes(given, "tsit5", 0.0, 0.0, None)


def test_check_names_contacts_whose_slip_is_stiff() -> None:
    lines = describe(load_scene(OSCILLATOR, ["contacts.pad.friction=1e-4", "solver={method: tsit5}"]))["method"]
    rate = slip_rates(slippery(), 1.39)[0]
    assert lines[1].startswith(
        "contact pad: its friction force is so little (coefficient 0.0001) that the direction of "
    )
    assert f"{rate:.2g} a second" in lines[1]
    assert len(describe(load_scene(OSCILLATOR))["method"]) == 1


def test_all_points_of_a_sweep_take_one_method() -> None:
    """Values of `over` that alone would ask for another one do not: programs are shared."""
    study = (
        "study={kind: sweep, frequency: {from: 0.2, to: 0.4, step: 1e-5}, over: {contacts.pad.friction: [0.5, 1e-5]}}"
    )
    given = load_scene(OSCILLATOR, [study, "excitation.frequency=null"])
    assert given.solver().name == "dopri8"
    one = load_scene(OSCILLATOR, [study.replace("0.4, step: 1e-5", "0.4, step: 0.1"), "excitation.frequency=null"])
    assert one.solver().name == "tsit5"
    assert one.resolved_yaml() == load_scene(one.resolved_yaml()).resolved_yaml()
    assert "method: auto" in one.resolved_yaml()


def test_a_line_that_saves_nothing_in_a_sweep_leaves_it_to_the_next() -> None:
    """Of a structure far faster than its contacts, unless explicit steps would run out."""
    model = scene(MANY_MODES)
    work = Work(((_frequency(model), LONG),), _frequency(model), sweep=True)
    assert choice("standard", model, work, BUDGET).solver.name == "dopri8"
    assert choice("standard", model, work, 20).solver.name == "exponential"


def test_the_time_of_dopri8_follows_its_tolerance_where_stability_rules() -> None:
    """Of 20 modes and three contacts it takes 1,060 microseconds a cycle, tsit5 1,130 (timesim/model/choice.py)."""
    model = scene(MANY_MODES)
    one, other = (
        seconds_a_cycle(model, Solver(name, 1e-7, 1e-9), _frequency(model), marched=True)
        for name in ("dopri8", "tsit5")
    )
    assert 0.7 * other < one < other
    finest = seconds_a_cycle(
        model, preset("reference", model, _frequency(model), None), _frequency(model), marched=True
    )
    assert finest > 2 * one


def stuck(stiffness: float = 20.0) -> Model:
    """The oscillator whose contact is proven to stick."""
    model = oscillator(40.0, 1.39)
    pad = replace(model.contacts[0], tangential_stiffness=stiffness * np.eye(2), normal_stiffness=stiffness)
    return replace(model, contacts=(pad,))


@pytest.mark.parametrize(("accuracy", "share"), [("draft", 1e-7), ("standard", 1e-9), ("reference", 1e-11)])
def test_a_run_of_which_no_contact_is_left_needs_no_method(accuracy: str, share: float) -> None:
    found = taken(stuck(), 5, accuracy)
    assert (found.name, found.rtol) == (CLOSED_FORM, pytest.approx(share))
    work = Work(((1.39, 5.0),), 1.39)
    assert choice(accuracy, stuck(), work, BUDGET, reduce=False).solver.name != CLOSED_FORM
    assert choice(accuracy, stuck(), replace(work, sweep=True), BUDGET).solver.name != CLOSED_FORM


def test_vibrations_too_many_to_be_recorded_are_left_to_collocation() -> None:
    assert taken(stuck(2e9), 5).name == CLOSED_FORM
    assert taken(stuck(2e9), 5, budget=int(stable_steps(stuck(2e9), 1.39)) - 1).name == "exponential"


@pytest.mark.parametrize(
    ("modes", "contacts", "harmonics", "samples", "curve", "multipliers"),
    [
        (3, 8, 9, 256, 4.4, 4.4),
        (50, 1, 9, 256, 1.2, 2.8),
        (50, 8, 9, 256, 4.9, 8.2),
        (12, 6, 39, 624, 15.6, 4.5),
        (18, 7, 9, 256, 4.1, 3.9),
        (24, 12, 9, 256, 8.5, 9.1),
    ],
)
def test_the_cost_of_a_balance_grows_as_measured(
    modes: int, contacts: int, harmonics: int, samples: int, curve: float, multipliers: float
) -> None:
    """CPU of a solution, and of its multipliers, over that of a solution with 3 modes, 1 contact and 9 harmonics."""
    unit = seconds_a_solution(generated_model(0, 3, 1), 9, 256, stability=False)
    model = generated_model(0, modes, contacts)
    alone, whole = (seconds_a_solution(model, harmonics, samples, stability=stability) for stability in (False, True))
    assert alone / unit == pytest.approx(curve, rel=0.4)
    assert (whole - alone) / unit == pytest.approx(multipliers, rel=0.4)
