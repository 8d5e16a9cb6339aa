"""The modal mass is a matter of scale: mode i with mass and damping times s and shape and modal force times sqrt(s) is
the same mode, its coordinate divided by sqrt(s). No result about points and contacts may change.

The scales are powers of four: their roots are exact, so the two runs may differ by nothing that rounding explains.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from commands import CONFIGS
from simulation import FINE, simulate
from systems import at_rest, excitation, generated_model, oscillator, oscillator_scene, pad, structure
from typer.testing import CliRunner

import timesim
from timesim.cli import app
from timesim.engine.history import stored_energy
from timesim.engine.system import system_of
from timesim.hbm.curve import hbm_curve
from timesim.hbm.scheme import Scheme
from timesim.model.model import Contact, Model, Start
from timesim.model.reduction import reduction_of
from timesim.model.scales import scales_of
from timesim.model.start import static_start
from timesim.scene.report import describe
from timesim.study.registry import load_scene

pytestmark = pytest.mark.long

SCALES = (16.0, 0.25, 64.0, 0.0625, 4.0, 256.0)
ROOTS = np.sqrt(SCALES)
CLOSE = 1e-9


def rescaled(model: Model) -> Model:
    """The same model in other modal masses."""
    body, load, start = model.structure, model.excitation, model.start
    s, root = np.array(SCALES[: body.num_modes]), ROOTS[: body.num_modes]
    damping = body.damping * (s if body.damping.ndim == 1 else np.outer(root, root))
    return replace(
        model,
        structure=replace(body, mass=body.mass * s, damping=damping, shape=body.shape * root),
        excitation=replace(load, cosine=load.cosine * root, sine=load.sine * root, constant=load.constant * root),
        start=replace(start, displacement=start.displacement / root, velocity=start.velocity / root),
    )


def rescaled_scene(scene: Mapping[str, Any]) -> dict[str, Any]:
    """The same scene in other modal masses; forces at points follow the shapes."""
    modes, load = scene["structure"]["modes"], dict(scene["excitation"])
    heavier = [
        mode | {"mass": mode["mass"] * s, "shape": {p: [x * root for x in row] for p, row in mode["shape"].items()}}
        for mode, s, root in zip(modes, SCALES, ROOTS.tolist(), strict=False)
    ]
    if "modal_force" in load:
        rows = zip(load["modal_force"], ROOTS.tolist(), strict=False)
        load["modal_force"] = [row | {"amplitude": row["amplitude"] * root} for row, root in rows]
    changed = dict(scene) | {"structure": {"modes": heavier}, "excitation": load}
    if isinstance(initial := scene.get("initial"), dict) and "modal_displacement" in initial:
        keys = ("modal_displacement", "modal_velocity")
        changed["initial"] = initial | {key: (np.array(initial[key]) / ROOTS[: len(modes)]).tolist() for key in keys}
    return changed


def assert_same(one: Any, other: Any, name: str = "", roots: np.ndarray | float = 1.0) -> None:
    """Numbers to rounding, of the size of the largest; text and flags exactly."""
    one, other = np.asarray(one), np.asarray(other)
    if one.dtype.kind not in "fc":
        np.testing.assert_array_equal(other, one, err_msg=name)
        return
    size = float(np.max(np.abs(one), initial=0.0, where=np.isfinite(one)))
    np.testing.assert_allclose(other * roots, one, rtol=0, atol=CLOSE * size, err_msg=name)


def assert_same_result(one: Any, other: Any) -> None:
    """Results of two runs: modal coordinates and shapes in their scales, everything else the same."""
    groups = [tree.subtree if isinstance(tree, xarray.DataTree) else [tree] for tree in (one, other)]
    for here, there in zip(*groups, strict=True):
        assert set(here.variables) == set(there.variables)
        assert here.attrs.get("complete", 1) == there.attrs.get("complete", 1) == 1
        for name, variable in here.variables.items():
            # The residual of an energy balance is an error: it is judged by the energies themselves.
            found, size = there.variables[name], np.ones(1)
            if "mode" in variable.dims and name != "mode":
                size = ROOTS[: variable.sizes["mode"]]
            if name == "mode_shape":
                size = 1 / size
            if name == "energy_residual":
                np.testing.assert_allclose(found, variable, rtol=0, atol=1e-9 * abs(here["energy_input"]).max())
                continue
            assert_same(variable.values, found.values, str(name), size)


def both(scene: Mapping[str, Any]) -> tuple[Any, Any]:
    """Results of a scene and of the same in other modal masses."""
    one, other = timesim.run(scene), timesim.run(rescaled_scene(scene))
    assert_same_result(one, other)
    return one, other


def slips_and_opens(result: Any, least: float = 0.02) -> bool:
    return bool(result["slip_share"].max() > least and result["separation_share"].max() > least)


# --- every kind of study -----------------------------------------------------------------------------

RICH: dict[str, Any] = oscillator_scene(preload=1.0, phase_deg=40.0)
RICH["excitation"] |= {
    "frequency": 1.1,
    "forces": [{"point": "tip", "direction": [1, 0.3, 0], "amplitude": 0.2, "harmonic": 2, "phase_deg": 30.0}],
    "constant_forces": [{"point": "tip", "direction": [0, 0, 1], "amplitude": 0.1}],
}
# Of one harmonic, as other tests have it: the loops of steady states are compiled for each number of them.
PLAIN = RICH | {"excitation": RICH["excitation"] | {"forces": [RICH["excitation"]["forces"][0] | {"harmonic": 1}]}}
DRAFT = {"solver": {"accuracy": "draft"}}
QUICK = {"settle": {"tolerance": 1e-5, "max_cycles": 400}}


def test_transient() -> None:
    study = {"kind": "transient", "cycles": 6, "samples_per_cycle": 20}
    result, _ = both(RICH | {"study": study})
    assert set(np.unique(result["contact_state"])) == {0, 1, 2}
    assert float(result["energy_friction"].sum()) > 0.01


def test_transient_from_a_given_state() -> None:
    state = {"modal_displacement": [0.05, -0.1], "modal_velocity": [0.4, 0.2], "slip": {"pad": [-0.045, 0.145]}}
    study = {"kind": "transient", "cycles": 3, "samples_per_cycle": 20}
    one, other = both(RICH | {"initial": state, "study": study})
    assert float(one["energy_friction"].sum()) > 0.01
    # The scaled scene names another state for the same motion.
    assert np.abs(one["final_modal_displacement"] - other["final_modal_displacement"]).max() > 0.01


def test_transient_from_equilibrium() -> None:
    load = {"constant_forces": [{"point": "tip", "direction": [0.3, 0.2, 1], "amplitude": 0.8}]}
    scene = RICH | {"initial": "static", "excitation": RICH["excitation"] | load}
    result, _ = both(scene | {"study": {"kind": "transient", "cycles": 2, "samples_per_cycle": 20}})
    assert abs(result["displacement"].values[0]).min() > 1e-4


def test_jump() -> None:
    phases = [{"frequency": 1.1, "cycles": 3}, {"frequency": 1.0, "cycles": 3}]
    result, _ = both(RICH | {"study": {"kind": "jump", "phases": phases, "run_up": phases[1:], "samples_per_cycle": 8}})
    assert set(np.unique(result["event_to"])) == {0, 1, 2}


@pytest.mark.parametrize("periodic", [pytest.param("march", marks=pytest.mark.slow), "shoot"])
def test_sweep(periodic: str) -> None:
    study = {"kind": "sweep", "frequency": {"values": [1.05, 1.1, 1.25]}, "direction": "both", "periodic": periodic}
    over = {"over": {"contacts.pad.preload": [1.0, 32.0]}}
    result, _ = both(PLAIN | DRAFT | {"study": study | over | QUICK})
    assert result["settled"].values.all()
    assert slips_and_opens(result)
    assert (result["slip_share"].isel({"contacts.pad.preload": 1}) == 0).all()


@pytest.mark.slow
def test_bistable() -> None:
    study: dict[str, Any] = {"kind": "bistable", "frequency": {"from": 1.245, "to": 1.265}, "step": 0.005}
    study |= {"width": 2e-3, "starts": 0, "harmonics": 3, "time_samples": 64}
    result, _ = both(oscillator_scene(preload=2.0) | DRAFT | {"study": study | QUICK})
    assert result["range"].shape == (1, 2)
    assert result["hbm"].to_dataset()["fold"].values.sum() == 2


@pytest.mark.slow
def test_optimum() -> None:
    study: dict[str, Any] = {"kind": "optimum", "along": {"contacts.pad.preload": {"from": 3.0, "to": 4.4, "num": 3}}}
    study |= {"frequency": {"values": [1.41, 1.46, 1.51]}, "accuracy": 0.5}
    result, _ = both(oscillator_scene(preload=3.0) | DRAFT | {"study": study | QUICK})
    assert 3.0 < float(result["optimum"]) < 4.4


@pytest.mark.slow
@pytest.mark.parametrize("along", [False, True])
def test_hbm(along: bool) -> None:
    study: dict[str, Any] = {"kind": "hbm", "harmonics": 3, "time_samples": 64, "continuation": {"max_step": 0.2}}
    preload = {"contacts.pad.preload": {"from": 2.0, "to": 1.0}}
    study |= {"frequency": 1.25, "along": preload} if along else {"frequency": {"from": 1.25, "to": 1.05}}
    result, _ = both(RICH | {"study": study})
    assert slips_and_opens(result)
    assert result["floquet_max"].values.min() > 0.1


@pytest.mark.slow
def test_compare() -> None:
    study: dict[str, Any] = {"kind": "compare", "frequency": {"values": [1.05, 1.25]}, "harmonics": 5}
    one, other = both(PLAIN | DRAFT | {"study": study | QUICK | {"time_samples": 64}})
    assert slips_and_opens(one["sweep"])
    assert np.abs(one["relative_difference"]).max() < 0.02
    assert one.attrs["verdict"].splitlines()[:-1] == other.attrs["verdict"].splitlines()[:-1]  # the last tells seconds


def test_from_the_result_of_another_run(tmp_path: Path) -> None:
    """The state that a result holds is in its own modal coordinates."""
    first = RICH | {"study": {"kind": "transient", "cycles": 4, "samples_per_cycle": 8}}
    found = []
    for name, scene in (("one", first), ("other", rescaled_scene(first))):
        path = tmp_path / f"{name}.yaml"
        path.write_text(load_scene(scene).resolved_yaml())
        done = CliRunner().invoke(app, ["run", str(path), "-o", str(tmp_path / name), "--no-plots"])
        assert done.exit_code == 0, done.output
        found.append(timesim.run(scene | {"initial": {"from": str(tmp_path / name / "result.nc")}}))
    assert_same_result(*found)
    assert set(np.unique(found[0]["contact_state"])) == {0, 1}


# --- what is left out of a run --------------------------------------------------------------------------


def damped_together(model: Model) -> Model:
    """With damping that couples all modes."""
    body = model.structure
    rate = np.sqrt(body.damping * body.mass if body.damping.ndim == 1 else np.diag(body.damping))
    share = np.full((body.num_modes, body.num_modes), 0.4) + 0.6 * np.eye(body.num_modes)
    return replace(model, structure=replace(body, damping=share * np.outer(rate, rate) * 0.2))


def moving(contact: Contact, *, coupled: bool = False, still: bool = False) -> Model:
    """Three modes of one point that a force of two components, a constant one and a given start move."""
    body = structure([1.0, 4.0, 9.0], [0.02, 0.04, 0.06], [[1, 0.2, 0.5], [0, 1, 0.3], [0.4, 0, 1]])
    load = excitation(0.2, [0.3, 0.0, 0.3], [0.2, 0.5, 0.1], [0.1, 0.0, 0.2])
    start = Start(np.array([0.1, 0.2, -0.1]), np.array([0.2, -0.1, 0.3]), np.zeros((1, 2)), np.array([-1]))
    model = Model(body, (contact,), load, at_rest(3, 1) if still else start)
    return damped_together(model) if coupled else model


def border(proven: Callable[[float], bool], low: float, high: float) -> float:
    """The preload from which on a contact is proven to keep its state, by bisection; `low` is not, `high` is."""
    assert proven(high)
    assert not proven(low)
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if proven(middle) else (middle, high)
    return high


@pytest.mark.parametrize("frequencies", [[0.2], [0.2, 0.3]])
@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("still", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_state_is_proven_for_the_same_loads(frequencies: list[float], coupled: bool, still: bool, sign: float):
    """Stuck from the same preload on, apart from the same gap on: neither sooner nor later."""

    def model(size: float) -> Model:
        return moving(pad(0.5, 2.0, 3.0, sign * size), coupled=coupled, still=still)

    def proven(change: Callable[[Model], Model]) -> Callable[[float], bool]:
        return lambda size: reduction_of(change(model(size)), frequencies).live.size == 0

    plain = border(proven(lambda item: item), 1.0, 1e4)
    assert border(proven(rescaled), 1.0, 1e4) == pytest.approx(plain, rel=1e-9)
    for size in (0.999 * plain, 1.001 * plain):
        one, other = (reduction_of(item, frequencies) for item in (model(size), rescaled(model(size))))
        assert other.findings == one.findings
        for name in ("modes", "live", "stuck", "apart"):
            np.testing.assert_array_equal(getattr(other, name), getattr(one, name))


def test_a_contact_that_touches_is_not_proven_never_to_touch() -> None:
    """Each mode by itself made lighter or heavier: the gap is just not enough, and a run does touch."""
    model = oscillator(-7.0, 0.9)
    for s in (0.25, 4.0):
        for mode in range(2):
            scale = np.where(np.arange(2) == mode, s, 1.0)
            body, load = model.structure, model.excitation
            root = np.sqrt(scale)
            other = replace(
                model,
                structure=replace(body, mass=scale, damping=body.damping * scale, shape=body.shape * root),
                excitation=replace(load, cosine=load.cosine * root),
            )
            assert reduction_of(other, [0.9]).live.tolist() == [0]
    assert {state for event in simulate(rescaled(model), 60, FINE).sequence for state in event[1:]} > {2}


def test_a_mode_that_hardly_moves_is_left_out_whatever_its_mass() -> None:
    for push in (1e-11, 1e-17):
        model = replace(moving(pad(0.5, 2.0, 3.0, 1.0)), contacts=(), start=at_rest(3, 0))
        model = replace(model, excitation=excitation(0.2, [1.0, push, 0.3], [0.0, 0.0, 0.1]))
        one, other = reduction_of(model, [0.2]), reduction_of(rescaled(model), [0.2])
        np.testing.assert_array_equal(other.modes, one.modes)
        assert other.findings == one.findings
        assert one.modes.size == (3 if push == 1e-11 else 2)


@pytest.mark.parametrize("preload", [-40.0, -1.0, 1.0, 32.0])
def test_check_says_the_same(preload: float) -> None:
    scene = oscillator_scene(preload) | {"study": {"kind": "transient", "cycles": 3}}
    scene["excitation"] |= {"frequency": 1.2}
    assert describe(load_scene(rescaled_scene(scene))) == describe(load_scene(scene))


# --- the parts of the physics, where damping couples the modes too ------------------------------------


def test_the_dimensionless_system_is_the_same() -> None:
    models = [moving(pad(0.5, 2.0, 3.0, 1.0), coupled=coupled) for coupled in (False, True)]
    models += [generated_model(seed, 4, 3) for seed in range(4)]
    for model in models:
        for reduction in (None, reduction_of(model, [0.2])):
            one = system_of(model, 0.2, 0.3, reduction)
            other = system_of(rescaled(model), 0.2, 0.3, reduction and reduction_of(rescaled(model), [0.2]))
            units = [scales_of(item, 0.2).mode for item in (model, rescaled(model))]
            assert_same(*units, "units", ROOTS[: model.structure.num_modes])
            for name in ("stiffness", "damping", "cosine", "sine", "constant"):
                assert_same(getattr(one, name), getattr(other, name), name)
            for here, there in zip(one.shape, other.shape, strict=True):
                assert_same(here, there, "shape")
        assert rescaled(model).stuck_rate == pytest.approx(model.stuck_rate, rel=1e-12)


def test_stuck_contacts_stiffen_the_same_system() -> None:
    model = moving(pad(0.5, 2.0, 3.0, 1e3))
    reduction = [reduction_of(item, [0.2]) for item in (model, rescaled(model))]
    assert reduction[0].stuck.tolist() == [0]
    one, other = (system_of(item.model, 0.2, 0.0, item) for item in reduction)
    assert reduction[0].natural[1] is not None
    for name in ("stiffness", "damping", "constant"):
        assert_same(getattr(one, name), getattr(other, name), name)


def test_stored_energy_is_the_same() -> None:
    model = moving(pad(0.5, 2.0, 3.0, 1.0))
    rng = np.random.default_rng(1)
    q, p, w, state = rng.normal(size=(5, 3)), rng.normal(size=(5, 3)), rng.normal(size=(5, 1, 2)), np.zeros((5, 1), int)
    root = ROOTS[:3]
    assert_same(stored_energy(model, q, p, w, state), stored_energy(rescaled(model), q / root, p / root, w, state))


def test_the_equilibrium_is_the_same() -> None:
    for preload in (1.0, -0.01):
        model = moving(pad(0.9, 2.0, 3.0, preload), still=True)
        one, other = static_start(model), static_start(rescaled(model))
        assert_same(one.displacement, other.displacement, roots=ROOTS[:3])
        assert_same(one.slip, other.slip)
        np.testing.assert_array_equal(one.state, other.state)


def free(model: Model) -> Model:
    """Its first mode held by nothing but its contacts."""
    body = model.structure
    return replace(model, structure=replace(body, frequency=body.frequency * [0.0, 1.0]))


COUPLED = damped_together(oscillator(1.0, 1.1))


def test_a_run_with_coupled_damping() -> None:
    one, other = simulate(COUPLED, 6), simulate(rescaled(COUPLED), 6)
    assert other.sequence == one.sequence
    assert {state for event in one.sequence for state in event[1:]} == {0, 1, 2}
    assert_same(one.motion, other.motion, roots=np.tile(ROOTS[:2], 2))
    assert_same(np.array(one.totals.work), np.array(other.totals.work))


@pytest.mark.parametrize("model", [COUPLED, free(oscillator(1.0, 1.1))], ids=["coupled", "free"])
def test_the_balance_with_coupled_damping(model: Model) -> None:
    scheme = Scheme(3, 64)
    one, other = (hbm_curve(item, 1.3, 1.15, scheme=scheme) for item in (model, rescaled(model)))
    assert one.complete
    assert one.slip_share.max() > 0.05
    for name in ("frequency", "amplitude", "harmonic_cos", "harmonic_sin", "slip_share", "floquet_max", "stable"):
        assert_same(getattr(one, name), getattr(other, name), name)


# --- a scene with masses of its own ------------------------------------


@pytest.mark.slow
def test_both_methods_agree_on_the_bolted_beam() -> None:
    """Modal masses of 1.84 and 0.73 kg: the two methods take the masses in at different places."""
    few = {"study.frequency": {"values": [93.0, 98.0]}, "study.over": {"contacts.joint.preload": [400.0]}}
    result = timesim.run(CONFIGS / "bolted_beam.yaml", few)
    assert result.attrs["complete"] == 1
    share = result["sweep"]["slip_share"].values
    assert share.min() > 0.2
    difference = result["relative_difference"].sel(axis="z").values
    assert 0 < np.abs(difference).max() < 1e-3
