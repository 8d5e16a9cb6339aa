"""The study of response curves by harmonic balance: what it computes, what it writes, and how it fails."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from systems import oscillator_scene

import timesim
from timesim.fault import SceneError
from timesim.hbm import branches, first_guess
from timesim.hbm import convergence as hbm_convergence
from timesim.hbm import scheme as hbm_scheme
from timesim.hbm.branches import SettledMotion, solutions_at
from timesim.hbm.continuation import Controls, Ending, part_of, solve
from timesim.hbm.convergence import (
    SAMPLED,
    Known,
    convergence,
    neglected,
    order_of,
    sampling_error,
    with_more_samples,
)
from timesim.hbm.curve import HbmCurve, hbm_curve
from timesim.hbm.scheme import NEGLECTED, NOTED, Scheme, most_harmonics
from timesim.model.model import Model
from timesim.picture import hbm as plot_hbm
from timesim.picture.response import stable_parts
from timesim.result.netcdf import save
from timesim.scene import hbm as scene_hbm
from timesim.scene.report import describe
from timesim.study import registry as plot
from timesim.study.curves import collection
from timesim.study.curves.collection import Curves
from timesim.study.execution.campaign import Execution
from timesim.study.hbm import study as followed_study
from timesim.study.registry import carry_out, load_scene
from timesim.study.summary import curve
from timesim.study.summary.curve import changes_of_stability, convergence_lines, curve_lines, peak

pytestmark = pytest.mark.long

CONFIGS = Path(__file__).parents[2] / "configs"
BASE = oscillator_scene(preload=-4.0)


def scene(**study: Any) -> dict[str, Any]:
    given = {"kind": "hbm", "frequency": {"from": 1.0, "to": 0.92}, "harmonics": 5, "time_samples": 512}
    return BASE | {"study": given | study}


@pytest.fixture(scope="module")
def curves():
    return timesim.run(scene(over={"contacts.pad.preload": [-4, -3]}))


def test_the_result_has_its_variables(curves):
    assert curves.attrs["complete"] == 1
    assert "5 harmonics" in curves.attrs["method"]
    dims = {
        "frequency": ("solution",),
        "stable": ("solution",),
        "fold": ("solution",),
        "branch": ("solution",),
        "curve": ("solution",),
        "floquet_max": ("solution",),
        "contacts.pad.preload": ("solution",),
        "amplitude": ("solution", "point", "axis"),
        "harmonic_amplitude": ("solution", "harmonic", "point", "axis"),
        "harmonic_cos": ("solution", "harmonic", "point", "axis"),
        "harmonic_sin": ("solution", "harmonic", "point", "axis"),
        "slip_share": ("solution", "contact"),
        "separation_share": ("solution", "contact"),
    }
    for name, expected in dims.items():
        assert curves[name].dims == expected, name
        assert curves[name].attrs["long_name"], name
    assert curves.harmonic.values.tolist() == [0, 1, 2, 3, 4, 5]
    assert set(np.unique(curves.stable)) <= {0, 1}
    assert np.all(curves.closure.values <= 1)


def test_each_value_has_its_curve(curves):
    assert set(curves["contacts.pad.preload"].values) == {-4.0, -3.0}
    for number, preload in ((0, -4.0), (1, -3.0)):
        part = curves.isel(solution=curves.curve.values == number)
        assert set(part["contacts.pad.preload"].values) == {preload}
        assert part.frequency.values[0] == 1.0
        assert part.frequency.values[-1] == pytest.approx(0.92)
    part = curves.isel(solution=curves.curve.values == 0)
    folds = part.frequency.values[part.fold.values == 1]
    np.testing.assert_allclose(np.sort(folds), [0.9416, 0.9472], atol=2e-4)
    assert part.slip_share.values.max() > 0.1
    inner = part.fold.values == 0
    np.testing.assert_array_equal(part.stable.values[inner] == 0, (part.branch.values == 1)[inner])


def test_each_curve_is_said_in_a_line(curves):
    """Its folds in the order of the curve, and its unstable solutions, of which a fold is none."""
    _, *lines = curve_lines(curves, ())
    assert len(lines) == 2
    for number, (preload, line) in enumerate(zip((-4, -3), lines, strict=True)):
        part = curves.isel(solution=curves.curve.values == number)
        unstable = np.sum((part.stable.values == 0) & (part.fold.values == 0))
        folds = ", ".join(f"{place:.6g}" for place in part.frequency.values[part.fold.values == 1])
        assert line.startswith(f"contacts.pad.preload {preload}: peak ")
        assert f" Hz; folds at {folds} Hz; {unstable} unstable solutions; at most" in line
        assert f"{part.slip_share.values.max():.2f} of a period in slip" in line


def test_of_many_folds_the_first_are_listed(curves, monkeypatch):
    monkeypatch.setattr(curve, "MOST", 1)
    line = next(line for line in curve_lines(curves, ()) if "folds at" in line)
    assert re.search(r"; folds at 0\.\d+ Hz, and 1 more; ", line)


def test_one_fold_is_a_fold(curves):
    first = int(np.flatnonzero(curves.fold.values)[0])
    _, line = curve_lines(curves.isel(solution=slice(0, first + 2)), ())
    assert f"; a fold at {curves.frequency.values[first]:.6g} Hz; " in line


def test_a_contact_that_sticks_beside_one_that_works_is_named(curves):
    """Its mean force is free; where nothing works, or no contact sticks, or it has no friction, nothing is said."""
    data = curves.isel(solution=slice(0, 3), contact=[0, 0]).copy(deep=True)
    data = data.assign_coords(contact=["pad", "stop"], friction=("contact", [0.5, 0.5]))
    data["slip_share"].values[:] = [[0.0, 0.0], [0.0, 0.3], [0.0, 0.0]]
    data["separation_share"].values[:] = [[0.0, 0.0], [0.0, 0.0], [0.0, 0.4]]

    def said(data):
        return [line for line in curve_lines(data, ()) if "all the time" in line]

    (line,) = said(data)
    assert line.startswith("contacts.pad.preload -4: contact pad sticks all the time at 2 solutions at which others")
    more = data.isel(contact=[0]).assign_coords(contact=["more"])
    three = xarray.concat([data, more], "contact", data_vars="minimal")
    (line,) = said(three)
    assert ": contacts pad, more stick all the time at up to 2 solutions at which others work: their mean" in line
    assert not said(data.isel(solution=[0]))
    assert not said(data.assign_coords(friction=("contact", [0.0, 0.5])))
    data["slip_share"].values[:] = 0.1
    assert not said(data)


def test_harmonics_make_the_amplitude(curves):
    """The amplitude is that of the motion of the Fourier coefficients."""
    angle = np.linspace(0, 2 * np.pi, 2001)[:, None, None]
    for i in (0, 30, curves.sizes["solution"] - 1):
        cos, sin = (curves[f"harmonic_{name}"].values[i, :, 0] for name in ("cos", "sin"))
        order = np.arange(6)[:, None]
        x = (cos * np.cos(order * angle) + sin * np.sin(order * angle)).sum(axis=1)
        np.testing.assert_allclose(np.ptp(x, axis=0) / 2, curves.amplitude.values[i, 0], rtol=1e-5)


def test_a_curve_followed_from_both_ends_is_kept_once(curves):
    both = timesim.run(scene(start="both_ends"))
    assert both.attrs["complete"] == 1
    assert both.sizes["solution"] == np.sum(curves.curve.values == 0)
    assert set(both.curve.values) == {0}


def test_a_curve_that_turns_back_to_where_it_began_leaves_the_range_to_the_one_from_the_other_end():
    """Between the folds the lower motion goes down to one, and back as an unstable one; the upper one passes."""
    found = timesim.run(scene(frequency={"from": 0.945, "to": 0.92}, stability=False))
    assert found.attrs["complete"] == 1
    first, second = (found.frequency.values[found.curve.values == i] for i in (0, 1))
    assert first[[0, -1]] == pytest.approx(0.945)
    assert first.min() == pytest.approx(0.94158, abs=1e-5)
    assert second[[0, -1]] == pytest.approx([0.92, 0.945])


def test_both_ends_reach_what_one_end_does_not():
    """Few points, so that neither end reaches the other: both pieces are there, and the run says so."""
    outcome = carry_out(load_scene(scene(start="both_ends", continuation={"max_points": 12})))
    assert outcome.reason is not None
    assert outcome.reason.count("max_points") == 2
    record = outcome.groups[""]
    frequency, curve = record["frequency"].values, record["curve"].values
    assert np.bincount(curve).tolist() == [12, 12]
    assert frequency[0] == 1.0
    assert frequency[12] == pytest.approx(0.92)
    assert record.attrs["complete"] == 0


def test_from_the_result_of_a_transient(tmp_path: Path):
    """The upper motion at 0.947 Hz, to which a sweep up leads; the curve goes to both sides of it and is the same."""
    from typer.testing import CliRunner

    from timesim.cli import app

    run_up = BASE | {
        "excitation": BASE["excitation"] | {"frequency": 0.945},
        "study": {"kind": "transient", "cycles": 150, "record_last": 2, "samples_per_cycle": 128},
    }
    upper = tmp_path / "scene.yaml"
    upper.write_text(load_scene(run_up).resolved_yaml())
    assert CliRunner().invoke(app, ["run", str(upper), "-o", str(tmp_path / "run"), "--no-plots"]).exit_code == 0
    transient = timesim.open_result(tmp_path / "run")
    settled = float(transient.cycle_amplitude.sel(point="tip", axis="x")[-1])
    found = timesim.run(scene(start={"from": str(tmp_path / "run" / "result.nc")}))
    assert found.attrs["complete"] == 1
    np.testing.assert_allclose(np.sort(found.frequency.values[[0, -1]]), [0.92, 1.0], rtol=1e-9)
    begin = np.flatnonzero(np.isclose(found.frequency.values, 0.945, rtol=1e-9))
    errors = np.abs(found.amplitude.values[begin, 0, 0] / settled - 1)
    assert errors.min() < 3e-3
    assert found.fold.values.sum() == 2
    start, along = {"from": str(tmp_path / "run" / "result.nc")}, {"contacts.pad.preload": {"from": -4, "to": -3}}
    with pytest.raises(SceneError, match=r"must be at a frequency from 0\.96 to 1 Hz \(it is at 0\.945 Hz\)"):
        load_scene(scene(start=start, frequency={"from": 0.96, "to": 1.0}))
    with pytest.raises(SceneError, match=r"must be at a frequency of 0\.96 Hz \(it is at 0\.945 Hz\)"):
        load_scene(scene(start=start, frequency=0.96, along=along))


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep up inside the range of two motions, begun on the larger one."""
    folder = tmp_path_factory.mktemp("swept")
    frequency = {"values": [0.930, 0.936, 0.940, 0.9425, 0.944, 0.946]}
    study = {"kind": "sweep", "frequency": frequency, "direction": "up", "over": {"contacts.pad.preload": [-4, -3.9]}}
    return save(timesim.run(BASE | {"study": study}), folder / "result.nc")


INSIDE = {"frequency": {"from": 0.9425, "to": 0.946}}


def test_a_branch_of_its_own_is_begun_from_a_sweep(swept: Path):
    """From 0.9425 to 0.946 Hz both motions live: no fold joins them, so either end leads to one of them only."""
    alone = timesim.run(scene(start="both_ends", **INSIDE))
    assert set(alone.curve.values) == {0}
    outcome = carry_out(load_scene(scene(start={"from": str(swept), "at": {"contacts.pad.preload": -4}}, **INSIDE)))
    (said,) = [line for line in outcome.summary if "a curve of its own" in line]
    assert "0.9425 to 0.946 Hz" in said
    found = outcome.groups[""]
    assert found.attrs["complete"] == 1
    assert set(found.curve.values) == {0, 1}
    upper, lower = sorted((found.isel(solution=found.curve.values == number) for number in (0, 1)), key=_height)[::-1]
    assert _height(upper) > 1.3 * _height(lower)
    np.testing.assert_allclose(np.sort(upper.frequency.values[[0, -1]]), [0.9425, 0.946], rtol=1e-12)
    sweep = timesim.open_result(swept).sel({"contacts.pad.preload": -4, "direction": "up"})
    for frequency in (0.9425, 0.944, 0.946):
        expected = float(sweep.amplitude.sel(frequency=frequency, point="tip", axis="x"))
        order = np.argsort(upper.frequency.values)
        here = np.interp(frequency, upper.frequency.values[order], upper.amplitude.values[order, 0, 0])
        assert here == pytest.approx(expected, rel=3e-3)


def test_a_motion_that_few_harmonics_do_not_have_begins_a_branch_with_more(swept: Path, monkeypatch):
    def solved(balance, *given, near=False):
        return None if balance.scheme.harmonics < 13 and not near else solve(balance, *given, near=near)

    monkeypatch.setattr(branches, "solve", solved)
    start = {"from": str(swept), "at": {"contacts.pad.preload": -4}}
    found = timesim.run(scene(start=start, harmonics="auto", **INSIDE))
    assert set(found.curve.values) == {0, 1}


def _height(curve: xarray.Dataset) -> float:
    return float(curve.amplitude.max())


def test_what_the_curve_passes_begins_no_other(swept: Path):
    found = timesim.run(scene(start={"from": str(swept)}, over={"contacts.pad.preload": [-4, -3.9]}))
    assert np.unique(found.curve.values).tolist() == [0, 1]
    assert np.unique(found["contacts.pad.preload"].values).tolist() == [-4, -3.9]


@pytest.mark.parametrize(
    ("at", "study", "said"),
    [
        ({"contacts.pad.preload": -2}, {}, "must be a contacts.pad.preload of the result (it has -4, -3.9)"),
        ({}, {}, "must name the contacts.pad.preload"),
        ({"frequencey": 0.944}, {}, "is no axis of the result (did you mean frequency?)"),
        (
            {"contacts.pad.preload": -4},
            {"frequency": 0.944, "along": {"structure.modes.0.mass": {"from": 1.0, "to": 1.1}}},
            "must be the result of a transient",
        ),
    ],
)
def test_a_point_that_the_sweep_has_not(swept: Path, at: dict, study: dict, said: str):
    with pytest.raises(SceneError, match=re.escape(said)):
        load_scene(scene(start={"from": str(swept), "at": at}, **study))


def test_a_sweep_of_another_structure(swept: Path):
    other = scene(start={"from": str(swept), "at": {"contacts.pad.preload": -4}})
    with pytest.raises(
        SceneError, match=re.escape("must have the contacts of the scene, not pad (the scene has lining)")
    ):
        load_scene(other | {"contacts": [BASE["contacts"][0] | {"name": "lining"}]})
    modes = [*BASE["structure"]["modes"], BASE["structure"]["modes"][1] | {"frequency": 2.0}]
    force = {"modal_force": [{"amplitude": 1.0}] * 3}
    more = other | {"structure": {"modes": modes}, "excitation": force}
    outcome = carry_out(load_scene(more | {"study": more["study"] | INSIDE}))
    assert outcome.reason is None
    assert any("no curve is begun" in line and "has 2 modes, the scene has 3" in line for line in outcome.summary)


def test_points_from_which_no_curve_can_begin_are_one_note(swept: Path, monkeypatch: pytest.MonkeyPatch):
    """For a reason and the points of a set of values: also where each of several sets meets the same points."""

    def asked(model: Model, known: Any, motions: Sequence[SettledMotion], *_: Any, **__: Any) -> Iterator[HbmCurve]:
        assert [motion.coefficients() for motion in motions] == [None] * 6
        yield from ()

    monkeypatch.setattr(collection, "isolated_curves", asked)
    modes = [*BASE["structure"]["modes"], BASE["structure"]["modes"][1] | {"frequency": 2.0}]
    more = {"structure": {"modes": modes}, "excitation": {"modal_force": [{"amplitude": 1.0}] * 3}}
    start = {"from": str(swept), "at": {"contacts.pad.preload": -4}}
    given = {"start": start, "over": {"structure.modes.2.mass": [1, 2]}, "stability": False, **INSIDE}
    outcome = carry_out(load_scene(scene(**given) | more))
    (line,) = (line for line in outcome.summary if "no curve is begun" in line)
    said = "no curve is begun from 6 points of the sweep from 0.93 to 0.946 Hz: the result has 2 modes, the scene has 3"
    assert line.startswith(said)


def test_a_transient_of_another_structure(tmp_path: Path):
    own = BASE | {"excitation": BASE["excitation"] | {"frequency": 0.945}, "study": {"kind": "transient", "cycles": 1}}
    place = save(timesim.run(own), tmp_path / "result.nc")
    modes, force = [*BASE["structure"]["modes"]], {"modal_force": [{"amplitude": 1.0}] * 3}
    modes.append(modes[1] | {"frequency": 2.0})
    more = {"structure": {"modes": modes}, "excitation": force}
    with pytest.raises(SceneError, match=r"study\.start\.from: .* must have 3 modes, as the scene, not 2"):
        load_scene(scene(start={"from": str(place)}) | more)
    stiffness = [[2, -1, 0], [-1, 2, -1], [0, -1, 2]]
    matrices = {"mass": np.eye(3).tolist(), "stiffness": stiffness, "damping_ratio": 0.02, "points": {"tip": {"x": 2}}}
    load = [{"point": "tip", "direction": [1, 0, 0], "amplitude": 1.0}]
    fewer = {"structure": {"matrices": matrices, "keep_modes": 2}, "excitation": {"forces": load}}
    for values in ([1, 2], [1]):
        with pytest.raises(SceneError, match=r"keep_modes: must not change .* as study\.start has 2"):
            load_scene(scene(start={"from": str(place)}, over={"structure.keep_modes": values}) | fewer)


def test_a_start_that_has_changed_is_other_data(tmp_path: Path):
    """A whole run is not taken for that of a scene whose start is another motion; the same one may be saved again."""
    frequency = {"frequency": 0.945}
    own = BASE | {"excitation": BASE["excitation"] | frequency, "study": {"kind": "transient", "cycles": 2}}
    path, found = tmp_path / "result.nc", []
    for cycles in (2, 2, 3):
        save(timesim.run(own | {"study": own["study"] | {"cycles": cycles}}), path)
        found.append(load_scene(scene(start={"from": str(path)})).data_fingerprint)
    assert found[0] == found[1] != found[2]


def test_along_a_scalar_that_must_be_whole_is_refused():
    """Both its ends are valid; a curve goes between them."""
    load = [{"point": "tip", "direction": [1, 0, 0], "amplitude": 1.0, "harmonic": 1}]
    own = scene(frequency=0.95, along={"excitation.forces.0.harmonic": {"from": 1, "to": 3}})
    with pytest.raises(SceneError, match=r"along\.excitation\.forces\.0\.harmonic: .*must be a whole number"):
        load_scene(own | {"excitation": {"forces": load}})


def test_along_a_scalar():
    """The preload at 0.947 Hz, from the open gap to the fold and back on the unstable branch; points solved anew."""
    given = scene(frequency=0.947, along={"contacts.pad.preload": {"from": 0, "to": -4}}, start="linear")
    found = timesim.run(given)
    assert found.attrs["complete"] == 1
    preload = found["contacts.pad.preload"].values
    assert preload[0] == 0
    assert preload[-1] == pytest.approx(-4)
    assert set(found.frequency.values) == {0.947}
    plain = load_scene(scene())
    for i in np.linspace(0, preload.size - 1, 3).astype(int):
        if found.fold.values[i]:
            continue
        model = plain.variant({"contacts.pad.preload": float(preload[i])})
        curve = hbm_curve(model, 0.955, 0.935, scheme=Scheme(5, 512), stability=False)
        same = solutions_at(model, curve, 0.947, scheme=Scheme(5, 512)).amplitude[:, 0, 0]
        assert np.min(np.abs(same / found.amplitude.values[i, 0, 0] - 1)) < 1e-6
    assert found.slip_share.values.max() > 0.2
    (line,) = (line for line in curve_lines(found.isel(solution=slice(3)), ()) if "peak" in line)
    assert ", an end of the curve; no fold" in line
    assert f"{preload.size} solutions on 1 curve at 0.947 Hz by " in next(curve_lines(found, ()))
    assert "response by harmonic balance at 0.947 Hz, " in plot_hbm.PICTURES["response"](found).get_suptitle()
    assert re.search(
        r"peak \S+ of tip y at contacts\.pad\.preload = -3\.9\d+; no fold", "\n".join(curve_lines(found, ()))
    )


@pytest.mark.long
@pytest.mark.parametrize(("first", "last"), [(-200, 200), (1000, -1000)])
def test_a_curve_along_a_scalar_shows_what_happens_in_a_small_part_of_its_range(first, last):
    given = scene(frequency=0.95, along={"contacts.pad.preload": {"from": first, "to": last}}, stability=False)
    found = timesim.run(given)
    assert found.attrs["complete"] == 1
    preload, places = found["contacts.pad.preload"].values, found.fold.values == 1
    known = timesim.run(given | {"study": given["study"] | {"along": {"contacts.pad.preload": {"from": -6, "to": 4}}}})
    folds = known["contacts.pad.preload"].values[known.fold.values == 1]
    assert sorted(preload[places]) == pytest.approx(sorted(folds), abs=1e-4)
    assert found.amplitude.max() == pytest.approx(known.amplitude.max().item(), rel=1e-3)
    assert preload.size < 400


def test_a_curve_along_a_scalar_that_turns_back_says_so():
    given = scene(frequency=0.947, along={"contacts.pad.preload": {"from": -4, "to": 3}})
    said = r"continuation at contacts\.pad\.preload = -4, after \d+ points: the curve turned back and left the range"
    with pytest.warns(RuntimeWarning, match=said):
        found = timesim.run(given)
    assert found.attrs["complete"] == 0
    assert found.fold.values.sum() == 1
    assert found["contacts.pad.preload"].values[-1] == pytest.approx(-4)
    assert found.amplitude.values[0, 0, 0] == pytest.approx(0.2052, abs=1e-4)


def test_points_that_run_out_leave_a_partial_result():
    with pytest.warns(RuntimeWarning, match=r"contacts.pad.preload -3.*max_points"):
        found = timesim.run(scene(over={"contacts.pad.preload": [-4, -3]}, continuation={"max_points": 30}))
    assert found.attrs["complete"] == 0
    assert np.bincount(found.curve.values).tolist() == [30, 30]


@pytest.mark.parametrize("marches", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_curve_without_a_start_is_reported_and_the_others_stay(marches: bool, monkeypatch: pytest.MonkeyPatch):
    """Undamped and free at its natural frequency the structure has no periodic response; damped it has.

    From the other end the curve is followed to where it goes to infinity.
    The march of a structure without contacts is a program of its own.
    """
    if not marches:
        words = "time integration, which does not settle"
        monkeypatch.setattr(first_guess, "_settled", lambda *_: (words, None))
    mode = {"frequency": 1.0, "damping_ratio": 0.0, "mass": 1.0, "shape": {"tip": [1, 0, 0]}}
    free = scene(frequency={"from": 1.0, "to": 1.2}, over={"structure.modes.0.damping_ratio": [0.0, 0.01]})
    free |= {"structure": {"modes": [mode]}, "excitation": {"modal_force": [{"amplitude": 1.0}]}}
    free["contacts"] = [BASE["contacts"][0] | {"preload": -1e6}]
    with np.errstate(all="ignore"):
        outcome = carry_out(load_scene(free))
    assert outcome.reason is not None
    assert "structure.modes.0.damping_ratio 0: continuation at 1 Hz" in outcome.reason
    assert "no solution at the start; tried: the linear response" in outcome.reason
    assert "damping leaves, 99% of the way, time integration, which does not settle" in outcome.reason
    assert "the motion grows without bound" in outcome.reason
    curves = outcome.groups[""].set_coords("structure.modes.0.damping_ratio").groupby("structure.modes.0.damping_ratio")
    assert curves[0.0].frequency.values[0] == 1.2
    assert curves[0.01].frequency.values[[0, -1]].tolist() == [1.0, 1.2]


def test_a_curve_that_is_whole_from_the_other_end_alone_says_why(monkeypatch: pytest.MonkeyPatch):
    def fails_upwards(model, start, stop, **options):
        whole = hbm_curve(model, start, stop, **options)
        if start > stop:
            return whole
        message = f"continuation at {start:g}, after 0 points: {Ending.START.value}; tried: nothing"
        return replace(part_of(whole, slice(0)), ending=Ending.START, message=message)

    monkeypatch.setattr(branches, "hbm_curve", fails_upwards)
    outcome = carry_out(load_scene(scene(frequency={"from": 0.9, "to": 1.0})))
    assert outcome.reason is None
    assert outcome.groups[""].frequency.values[[0, -1]].tolist() == [1.0, 0.9]
    (said,) = [line for line in outcome.summary if "other end" in line]
    assert said.startswith("continuation at 0.9 Hz, after")
    assert said.endswith(
        "from the first one: continuation at 0.9, after 0 points: no solution at the start; tried: nothing"
    )
    assert said in outcome.groups[""].attrs["notes"]


@pytest.mark.slow
def test_points_of_a_sweep_begin_curves_where_the_first_has_no_solution(tmp_path: Path):
    """Undamped, the balance is singular where the first curve begins; the sweep's motions lead to another."""
    mode = {"frequency": 1.0, "damping_ratio": 0.0, "mass": 1.0, "shape": {"tip": [1, 0, 0]}}
    base = BASE | {"structure": {"modes": [mode]}, "excitation": {"modal_force": [{"amplitude": 1.0}]}}
    base["contacts"] = [BASE["contacts"][0] | {"preload": 1.0}]
    over = {"structure.modes.0.damping_ratio": [0.0, 0.01]}
    sweep = timesim.run(base | {"study": {"kind": "sweep", "frequency": {"values": [1.15, 1.2, 1.25]}, "over": over}})
    assert sweep.slip_share.values.min() > 0.02
    start = {"from": str(save(sweep, tmp_path / "result.nc"))}
    # Nor does the curve from the other end, cut short, come as far as all points of the sweep.
    steps = {"max_points": 15}
    study = scene(frequency={"from": 1.0, "to": 1.3}, over=over, start=start, continuation=steps)["study"]
    with np.errstate(all="ignore"):
        outcome = carry_out(load_scene(base | {"study": study}))
    assert outcome.reason is not None
    assert "structure.modes.0.damping_ratio 0: continuation at 1 Hz, after 0 points: no solution" in outcome.reason
    found = outcome.groups[""]
    assert set(found["structure.modes.0.damping_ratio"].values) == {0.0, 0.01}
    assert any("damping_ratio 0: a curve of its own" in line for line in outcome.summary)
    for damping in (0.0, 0.01):
        part = found.isel(solution=found["structure.modes.0.damping_ratio"].values == damping)
        order = np.argsort(part.frequency.values)
        here = np.interp(1.2, part.frequency.values[order], part.amplitude.values[order, 0, 0])
        expected = sweep.amplitude.sel({"frequency": 1.2, "structure.modes.0.damping_ratio": damping}).values
        assert here == pytest.approx(expected[..., 0].item(), rel=2e-2)


@pytest.mark.parametrize(
    ("study", "said"),
    [
        ({"harmonics": 0}, "study.harmonics: 0: must be >= 1"),
        ({"time_samples": 19, "harmonics": 5}, "study.time_samples: 19: must be at least 20 for 5 harmonics"),
        ({"frequency": 1.0}, "must be a mapping with from and to"),
        ({"frequency": {"from": 1, "to": 1}}, "must differ from `from`"),
        ({"along": {"contacts.pad.preload": {"from": 1, "to": 2}}}, "must be a number where the curve runs along"),
        ({"frequency": 1, "along": {"pad.preload": {"from": 1, "to": 2}}}, "must be the key of a scalar of the scene"),
        ({"frequency": 1, "along": {"contacts.pod.preload": {"from": 1, "to": 2}}}, "pod is no item of the list"),
        ({"frequency": 1, "along": {"contacts.pad.friction": {"from": 1, "to": -2}}}, "must be >= 0"),
        ({"start": "left"}, "must be 'linear' or 'both_ends'"),
        ({"start": {"from": "no/result.nc"}}, "does not exist"),
        ({"continuation": {"max_step": 1e-8}}, "must be at most first_step"),
        ({"continuation": {"max_points": 1}}, "must be >= 2"),
    ],
)
def test_what_cannot_be_balanced_is_refused(study, said):
    with pytest.raises(SceneError, match=re.escape(said)):
        load_scene(scene(**study))


def test_a_scene_with_nothing_periodic_is_refused():
    still = scene() | {"excitation": {"constant_forces": [{"point": "tip", "direction": [1, 0, 0], "amplitude": 1}]}}
    with pytest.raises(SceneError, match=r"excitation.*moves no mode periodically"):
        load_scene(still)


def test_a_scene_without_contacts_is_refused():
    with pytest.raises(SceneError, match="contacts: must hold at least one contact"):
        load_scene(scene() | {"contacts": []})


def test_a_harmonic_that_is_excited_must_be_balanced():
    force = {"point": "tip", "direction": [1, 0, 0], "amplitude": 1, "harmonic": 7}
    with pytest.raises(SceneError, match="must be at least 7, since harmonic 7 is excited"):
        load_scene(scene() | {"excitation": {"forces": [force]}})


def test_convergence_gives_the_orders_and_what_is_enough(monkeypatch: pytest.MonkeyPatch):
    """Harmonics and samples at two solutions; the samples are of third order."""
    model = load_scene(scene()).model()
    curve = hbm_curve(model, 0.93, 0.9, scheme=Scheme(9, 256), stability=False)
    places = [Known(model, float(curve.frequency[i]), curve.contact_motion[i], curve.amplitude[i]) for i in (0, -1)]
    monkeypatch.setattr(hbm_convergence, "HARMONICS", (1, 5))
    monkeypatch.setattr(hbm_convergence, "MAX_DOUBLINGS", 11)
    found = convergence(places, Scheme(9, 256))
    changes = dict(zip(found.harmonics[:-1], found.with_harmonics[:-1], strict=True))
    assert changes[1] > 5 * changes[5] > 0
    assert found.harmonics.tolist() == [1, 5, 9]
    assert found.time_samples.tolist() == [64, 128, 256, 512]
    assert order_of(found.time_samples, found.with_samples) > 2.5
    assert found.with_samples[-1] < 1e-4
    for moved in (found.with_harmonics, found.with_samples):
        assert moved[-1] == moved[-2] > 0  # between the finest and the last but one, whichever is named
    text = "\n".join(convergence_lines(found))
    assert "harmonics 1: " in text
    assert "time samples 64: " in text
    assert re.search(r"order \d\.\d", text)


def test_samples_that_prove_too_few_are_taken_finer(monkeypatch: pytest.MonkeyPatch):
    """A contact is closed for a quarter of the cycle: 24 samples are too few for its motion, and 96 enough."""
    monkeypatch.setattr(hbm_scheme, "ENOUGH_SAMPLES", 24)
    monkeypatch.setattr(hbm_scheme, "SAMPLES_PER_WAVE", 4)
    narrow: dict[str, Any] = {"frequency": {"from": 0.93, "to": 0.9302}, "stability": False}
    chosen = timesim.run(scene(time_samples="auto", **narrow))
    assert "96 time samples" in chosen.attrs["method"]
    few, enough = (timesim.run(scene(time_samples=count, **narrow)) for count in (24, 96))
    assert "24 time samples" in few.attrs["method"]
    np.testing.assert_array_equal(chosen.amplitude, enough.amplitude)
    model, errors = load_scene(scene()).model(), []
    for count in (24, 96):
        curve = hbm_curve(model, 0.93, 0.9302, scheme=Scheme(5, count), stability=False)
        errors.append(sampling_error(lambda _: model, curve, [Scheme(5, count)], np.array([0, -1])))
    assert errors[0] > 2 * SAMPLED
    assert 0 < errors[1] < SAMPLED / 2


def test_a_curve_whose_samples_prove_too_few_is_given_up_on_its_way(monkeypatch: pytest.MonkeyPatch):
    """It would be followed again anyway. Solutions are looked at as they come; the answer is that of more samples."""
    monkeypatch.setattr(hbm_scheme, "ENOUGH_SAMPLES", 24)
    monkeypatch.setattr(hbm_scheme, "SAMPLES_PER_WAVE", 4)
    narrow: dict[str, Any] = {"frequency": {"from": 0.93, "to": 0.935}, "stability": False}
    enough = timesim.run(scene(time_samples=96, **narrow))
    looked_at = []

    def counted(model_at: Any, curve: HbmCurve, schemes: Any) -> Any:
        looked_at.append((curve.frequency.size, float(curve.frequency[-1])))
        return with_more_samples(model_at, curve, schemes)

    monkeypatch.setattr(hbm_convergence, "CHECKED", 3)
    monkeypatch.setattr(hbm_convergence, "with_more_samples", counted)
    chosen = timesim.run(scene(time_samples="auto", **narrow))
    np.testing.assert_array_equal(chosen.amplitude, enough.amplitude)
    sizes, frequencies = zip(*looked_at, strict=True)
    number = enough.sizes["solution"]
    assert number >= 6
    # One of the first pass, every third of the second, and in the end the whole of it.
    assert sizes == (1,) * (1 + number // 3) + (number,)
    np.testing.assert_array_equal(frequencies[1:-1], enough.frequency[2::3])


def test_harmonics_are_as_many_as_the_answer_needs(monkeypatch: pytest.MonkeyPatch):
    """By the tail of the residual three are too few; the first set of values, which needs no more, has zeros there."""
    monkeypatch.setattr(hbm_scheme, "FIRST_HARMONICS", 3)
    narrow: dict[str, Any] = {"frequency": {"from": 0.93, "to": 0.935}, "stability": False, "time_samples": "auto"}
    chosen = timesim.run(scene(harmonics="auto", over={"contacts.pad.preload": [-100, -4]}, **narrow))
    count = chosen.sizes["harmonic"] - 1
    assert f"{count} harmonics, {hbm_scheme.enough_samples(count)} time samples" in chosen.attrs["method"]
    assert 4 < count < most_harmonics(1)
    apart = chosen["contacts.pad.preload"].values == -100
    assert apart.any()
    assert not chosen.harmonic_cos.values[apart, 4:].any()
    same = timesim.run(scene(harmonics=count, **narrow))
    np.testing.assert_allclose(chosen.amplitude.values[~apart], same.amplitude, rtol=1e-8)  # Newton's tolerance: 1e-9
    model, tails = load_scene(scene()).model(), []
    for number in (3, count):
        scheme = Scheme(number, 512)
        curve = hbm_curve(model, 0.93, 0.935, scheme=scheme, stability=False)
        tails.append(neglected(lambda _: model, curve, [scheme]))
    assert tails[0] > NEGLECTED > tails[1]


def test_what_the_most_harmonics_leave_out_is_said(monkeypatch: pytest.MonkeyPatch):
    """In the result and on the console, with what is reached and what is wanted."""
    monkeypatch.setattr(hbm_scheme, "FIRST_HARMONICS", 3)
    monkeypatch.setattr(hbm_scheme, "most_harmonics", lambda num_contacts: 4)
    narrow: dict[str, Any] = {"frequency": {"from": 0.93, "to": 0.935}, "stability": False}
    loaded = load_scene(scene(harmonics="auto", time_samples=256, **narrow))
    outcome = followed_study(loaded, Execution())
    (said,) = re.findall(
        r"auto took up to 4 harmonics: .* or change it by, up to (\S+) of it, where 0.0001 is wanted",
        outcome.groups[""].attrs["notes"],
    )
    assert float(said) > NOTED
    assert outcome.groups[""].attrs["notes"] in outcome.summary


@pytest.mark.parametrize(("harmonics", "says"), [(3, True), (27, False)])
def test_harmonics_that_are_given_and_leave_out_much_are_said(harmonics: int, says: bool):
    narrow: dict[str, Any] = {"frequency": {"from": 0.93, "to": 0.935}, "stability": False}
    outcome = followed_study(load_scene(scene(harmonics=harmonics, time_samples=512, **narrow)), Execution())
    said = [
        line
        for line in outcome.summary
        if line.startswith("warning: 3 harmonics may be too few: those above would add ")
    ]
    assert [line.endswith("; set harmonics to auto, or to more") for line in said] == ([True] if says else [])


def test_what_the_most_samples_leave_out_is_said(monkeypatch: pytest.MonkeyPatch):
    """24 samples are too few, and the program may take no more; with as many as it may take, 96, nothing is said."""
    monkeypatch.setattr(hbm_scheme, "ENOUGH_SAMPLES", 24)
    monkeypatch.setattr(hbm_scheme, "SAMPLES_PER_WAVE", 4)
    narrow: dict[str, Any] = {"frequency": {"from": 0.93, "to": 0.9302}, "stability": False}
    for most, count in ((96, 0), (64, 1)):
        monkeypatch.setattr(hbm_convergence, "MOST_SAMPLES", most)
        outcome = followed_study(load_scene(scene(time_samples="auto", **narrow)), Execution())
        notes = outcome.groups[""].attrs.get("notes", "")
        said = re.findall(r"auto took 24 time samples: .* by up to (\S+), where 0.001 is wanted", notes)
        assert len(said) == count
    assert float(said[0]) > SAMPLED
    assert any("auto took 24 time samples" in line and said[0] in line for line in outcome.summary)


def test_a_scene_has_the_steps_of_the_continuation():
    steps = scene_hbm.Continuation.model_validate({}).model_dump()
    assert Controls(**steps) == Controls()
    assert set(steps) == {"first_step", "min_step", "max_step", "max_points", "tolerance"}


@pytest.mark.parametrize("harmonics", ["auto", 12])
def test_an_excited_harmonic_is_among_those_chosen(harmonics):
    load = [{"point": "tip", "direction": [1, 0, 0], "amplitude": 0.5, "harmonic": 12}]
    excited = BASE | {"excitation": BASE["excitation"] | {"forces": load}}
    study = scene(harmonics=harmonics, time_samples="auto")["study"]
    plan, model = (loaded := load_scene(excited | {"study": study})).plan, loaded.model()
    assert plan.schemes_for(model)[0] == Scheme(12, 256)
    if harmonics == "auto":
        assert f"up to {most_harmonics(1)} harmonics" in " ".join(
            line for part in describe(loaded).values() for line in part
        )


@pytest.mark.parametrize(
    ("base", "study"),
    [
        ((1, 1.0), {"over": {"excitation.forces.0.harmonic": [1, 12]}}),
        ((12, 0.0), {"over": {"excitation.forces.0.amplitude": [0.5, 1.0]}}),
        ((12, 0.0), {"frequency": 1.0, "along": {"excitation.forces.0.amplitude": {"from": 0.0, "to": 1.0}}}),
    ],
)
def test_an_excited_harmonic_of_any_curve_is_among_those_chosen(base: tuple[int, float], study: dict[str, Any]):
    """With those of the scene alone, all was computed but the first curve that has more: it could not be balanced."""
    harmonic, amplitude = base
    load = [{"point": "tip", "direction": [1, 0, 0], "amplitude": amplitude, "harmonic": harmonic}]
    forces = BASE["excitation"] | {"forces": load}
    own = scene(harmonics="auto", time_samples="auto")["study"] | study
    loaded = load_scene(BASE | {"excitation": forces, "study": own})
    assert Curves(loaded, loaded.plan).schemes[0] == Scheme(12, 256)


def test_the_name_of_a_contact_may_hold_braces():
    named = BASE | {"contacts": [BASE["contacts"][0] | {"name": "pad{a}"}]}
    own = scene()["study"] | {"frequency": 1.0, "along": {"contacts.pad{a}.preload": {"from": 1.0, "to": 2.0}}}
    loaded = load_scene(named | {"study": own})
    place = Curves(loaded, loaded.plan)._options(lambda *_: None)["controls"].place
    assert place.format(1.5) == "contacts.pad{a}.preload = 1.5"


def test_an_interrupt_while_harmonics_are_refined_keeps_the_curves(monkeypatch: pytest.MonkeyPatch):
    def interrupted(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr("timesim.study.hbm.convergence", interrupted)
    outcome = carry_out(load_scene(scene(convergence=True, frequency={"from": 1.0, "to": 0.98})))
    assert outcome.reason == "interrupted while harmonics and time samples were refined"
    assert outcome.groups[""].attrs["complete"] == 0
    assert outcome.groups[""].sizes["solution"] > 1


def test_convergence_of_full_stick_says_that_it_says_nothing():
    assert "nothing" in convergence_lines(convergence([], Scheme(3, 64)))[0]


def test_a_peak_lies_between_solutions_however_far_apart_they_are():
    """A parabola along the curve is met; without one the largest height is at an end."""
    place = np.array([0.0, 0.1, 0.15, 0.3, 0.35])
    assert peak(place, 1 - (place - 0.17) ** 2, np.ones((5, 2))) == pytest.approx((0.17, 1.0))
    assert peak(place, place, np.ones((5, 2))) == (0.35, 0.35)
    motion, height = np.random.default_rng(2).normal(size=(5, 2)), np.array([0.1, 0.5, 0.9, 0.8, 0.3])
    at, top = peak(place, height, motion)
    assert peak(1e6 * place, height, 1e-3 * motion) == pytest.approx((1e6 * at, top))  # in any units


def test_stability_that_changes_at_a_fold_is_no_change_without_one():
    """Folds count as unstable themselves."""
    stable = np.array([True, True, False, False, False, True, True, False, True])
    fold = np.array([False, False, True, False, True, False, False, False, False])
    assert np.flatnonzero(changes_of_stability(stable, fold)).tolist() == [6, 7]


def test_a_curve_ends_where_a_constant_force_drives_on_what_friction_holds():
    """80 |q_b| + 0.3 = 2 at 1.688188 Hz, in closed form; towards that no fold, and no mean that runs away."""
    matrices = {"mass": [[1, 0], [0, 2]], "stiffness": [[50, -50], [-50, 50]], "damping": [[0.3, -0.3], [-0.3, 0.3]]}
    pad = {"name": "c", "point": "b", "friction": 0.5, "tangential_stiffness": 80, "normal_stiffness": 0, "preload": 4}
    force = {"point": "a", "direction": [1, 0, 0]}
    scene = {
        "structure": {"matrices": matrices | {"points": {"a": {"x": 0}, "b": {"x": 1}}}},
        "contacts": [pad],
        "excitation": {
            "forces": [force | {"amplitude": 1.5}],
            "constant_forces": [force | {"amplitude": 0.3}],
        },
        "study": {"kind": "hbm", "frequency": {"from": 2.5, "to": 1.6}, "harmonics": 5, "time_samples": 128},
    }
    outcome = followed_study(load_scene(scene), Execution())
    data = outcome.groups[""]
    first = data.isel(solution=data["curve"] == 0)
    assert first["frequency"].values[-1] == pytest.approx(1.688188, rel=5e-3)
    assert np.all(np.diff(first["frequency"]) < 0)
    assert not first["fold"].any()
    assert first["stable"].all()
    assert np.abs(first["harmonic_cos"].sel(harmonic=0)).max() < 10
    assert "unless what friction alone holds moves on from cycle to cycle" in str(outcome.reason)


@pytest.mark.parametrize(
    ("size", "phase", "what"),
    [
        (1.2, 180.0, " (the period doubles)"),
        (1.2, 40.0, " (a second frequency joins)"),
        (1.2, 0.0, " (a real multiplier passes 1)"),
        (0.9, 180.0, ""),
    ],
)
def test_a_change_of_stability_is_between_two_solutions(curves, size, phase, what):
    """Between them a pair of multipliers may become real, so that no straight line tells where one passes 1."""
    frequency, stable = curves["frequency"].values, np.arange(curves.sizes["solution"]) < 3
    size, phase = np.where(stable, 0.5, size), np.where(stable, 90.0, phase)
    new = {"stable": stable.astype(int), "fold": 0 * stable, "floquet_max": size, "floquet_phase_deg": phase}
    changed = curves.assign({name: ("solution", values) for name, values in new.items()})
    line = next(line for line in curve_lines(changed, ()) if "stability changes" in line)
    assert f"; stability changes without a fold between {frequency[2]:.6g} and {frequency[3]:.6g} Hz{what}; " in line


def test_order_of_changes_with_a_known_order():
    numbers = 2.0 ** np.arange(3, 9)
    changes = numbers**-1.5
    changes[-1] = 1e-9
    assert order_of(numbers, changes) == pytest.approx(1.5)
    assert np.isnan(order_of(numbers, np.zeros(6)))


def test_pictures(curves, tmp_path: Path):
    written = plot.draw(curves, tmp_path)
    assert [path.name for path in written] == plot.picture_names("hbm")
    ax = plot_hbm.response(curves)
    lines = [(line.get_linestyle(), line.get_xdata().size) for line in ax.get_lines()]
    assert sum(style == "--" for style, _ in lines) == int(np.unique(curves.curve.values[curves.fold.values == 1]).size)
    drawn = sum(size for style, size in lines if style != "None")
    assert drawn >= curves.sizes["solution"]
    marks = [line for line in ax.get_lines() if line.get_marker() == "D"]
    folds = np.concatenate([line.get_xdata() for line in marks])
    np.testing.assert_array_equal(folds, curves.frequency.values[curves.fold.values == 1])


def test_pictures_of_an_empty_result(curves, tmp_path: Path):
    assert plot.draw(curves.isel(solution=slice(0)), tmp_path) == []


def test_stable_and_unstable_parts_overlap_at_the_fold():
    stable, fold = np.array([1, 1, 0, 0, 0, 1], bool), np.array([0, 0, 1, 0, 1, 0], bool)
    parts = stable_parts(stable, fold)
    assert [(part.start, part.stop, firm) for part, firm in parts] == [(0, 3, True), (2, 5, False), (4, 6, True)]


@pytest.mark.parametrize("harmonics", [1, 3, 9, 15])
@pytest.mark.parametrize(
    ("preload", "span", "folds"), [(-4.0, (1.0, 0.92), (0.9416, 0.9472)), (2.0, (1.32, 1.2), (1.2511, 1.2560))]
)
@pytest.mark.slow
def test_folds_against_sweeps_in_time(harmonics, preload, span, folds):
    """The jumps of time-domain sweeps, 800 cycles a step of 1e-4 Hz: with 3 harmonics and more within their step."""
    given = scene(frequency={"from": span[0], "to": span[1]}, harmonics=harmonics, time_samples=1024)
    found = timesim.run(given, {"contacts.pad.preload": preload})
    places = np.sort(found.frequency.values[found.fold.values == 1])
    print(f"preload {preload:g}, {harmonics} harmonics: folds {places}, {found.slip_share.values.max():.2f} slip")
    assert places.size == 2
    assert found.slip_share.values.max() > 0.2
    np.testing.assert_allclose(places, folds, atol={1: 8e-3, 3: 1e-3}.get(harmonics, 1.5e-4))


def test_the_model_of_the_sections_is_the_plain_one(curves):
    """A scene's own curve and that of the model in Python."""
    model = load_scene(scene()).model()
    curve = hbm_curve(model, 1.0, 0.92, scheme=Scheme(5, 512))
    found = curves.isel(solution=curves.curve.values == 0)
    np.testing.assert_allclose(found.amplitude.values, curve.amplitude, rtol=1e-9)
    assert replace(curve, message="").complete
