"""Pictures of a transient: what they show, not merely that there are any."""

import gc
import subprocess
import sys
import weakref
from itertools import pairwise
from pathlib import Path

import matplotlib.colors
import numpy as np
import pytest
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread

from timesim.model.model import SEPARATION, SLIP, STICK
from timesim.picture import contact as plot_contact
from timesim.picture import style
from timesim.picture import transient as plot_transient
from timesim.picture.draw import BEYOND, MARGIN, fit_ordinate_labels, write
from timesim.picture.figure import DPI, axes, stacked
from timesim.picture.style import STATE_STYLE
from timesim.result.dataset import dataset
from timesim.result.file import StoreError
from timesim.result.netcdf import REQUIRED_ATTRIBUTES
from timesim.study import registry as plot

FREQUENCY, CYCLES, STEPS, EVERY = 2.0, 12, 1000, 5
STIFFNESS, NORMAL_STIFFNESS, FRICTION = 20.0, 25.0, 0.5
NAMES = ("pad", "stop", "shroud", "rim", "ring")


def _motion(theta: np.ndarray, num_contacts: int) -> np.ndarray:
    """Prescribed (u1, u2, v) of each contact, shape (T, C, 3), growing to a steady motion."""
    grown = 1 - np.exp(-theta / 8)
    columns = []
    for i in range(num_contacts):
        u = 0.15 * np.cos(theta) / (1 + i), 0.10 * np.sin(theta + 0.4 * i) / (1 + i)
        columns.append(np.stack([*u, 0.12 * np.cos(theta + 0.5) + 0.02 * np.cos(3 * theta)], axis=1))
    return np.stack(columns, axis=1) * grown[:, None, None]


def _friction(motion: np.ndarray, preload: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Force (f1, f2, n), slip w and state by return mapping from sample to sample."""
    u, n = motion[..., :2], np.maximum(0, preload + NORMAL_STIFFNESS * motion[..., 2])
    slip, state, w = np.zeros_like(u), np.zeros(n.shape, np.int8), np.zeros(u.shape[1:])
    for k in range(len(u)):
        trial = STIFFNESS * (u[k] - w)
        size, limit = np.hypot(*trial.T), FRICTION * n[k]
        slides = size > limit
        scale = np.where(slides, limit / np.where(slides, size, 1), 1)
        w = u[k] - scale[:, None] * trial / STIFFNESS
        slip[k], state[k] = w, np.where(n[k] <= 0, SEPARATION, np.where(slides, SLIP, STICK))
    return np.concatenate([STIFFNESS * (u - slip), n[..., None]], axis=2), slip, state


def friction_run(num_contacts: int = 2, record_last: int = CYCLES, **attrs: object) -> xarray.Dataset:
    """A result as a run of timesim leaves it, of contacts under prescribed motion."""
    time = np.arange(CYCLES * STEPS + 1) / (FREQUENCY * STEPS)
    motion = _motion(2 * np.pi * FREQUENCY * time, num_contacts)
    force, slip, state = _friction(motion, np.linspace(1.0, 4.0, num_contacts))
    changes = [(k, c) for k, c in np.argwhere(np.diff(state, axis=0))]
    x = np.stack([0.05 * motion[:, 0], motion[:, 0]], axis=1)
    by_cycle = [slice(k * STEPS, (k + 1) * STEPS + 1) for k in range(CYCLES)]
    work = [np.sum(force[p, :, :2][1:] * np.diff(slip[p], axis=0), axis=(0, 2)) for p in by_cycle]
    damping = 0.05 * np.array([np.sum(np.gradient(x[p, 1, 0]) ** 2) * STEPS for p in by_cycle])
    stored = np.diff([10 * np.sum(x[p.start, 1] ** 2) for p in by_cycle] + [10 * np.sum(x[-1, 1] ** 2)])
    kept = slice((CYCLES - record_last) * STEPS, None, EVERY)
    variables = {
        "displacement": (("time", "point", "axis"), x[kept]),
        "contact_displacement": (("time", "contact", "component"), motion[kept]),
        "contact_force": (("time", "contact", "component"), force[kept]),
        "contact_state": (("time", "contact"), state[kept]),
        "slip": (("time", "contact", "tangent"), slip[kept]),
        "event_time": (("event",), np.array([time[k + 1] for k, _ in changes])),
        "event_contact": (("event",), np.array([c for _, c in changes], int)),
        "event_from": (("event",), np.array([state[k, c] for k, c in changes], int)),
        "event_to": (("event",), np.array([state[k + 1, c] for k, c in changes], int)),
        "cycle_amplitude": (
            ("cycle", "point", "axis"),
            np.array([np.ptp(x[p], axis=0) / 2 for p in by_cycle]),
        ),
        "cycle_start": (("cycle",), np.arange(CYCLES) / FREQUENCY),
        "cycle_period": (("cycle",), np.full(CYCLES, 1 / FREQUENCY)),
        "energy_input": (("cycle",), np.sum(work, axis=1) + damping + stored),
        "energy_damping": (("cycle",), damping),
        "energy_stored_change": (("cycle",), stored),
        "energy_residual": (("cycle",), 1e-11 * np.cos(np.arange(CYCLES)) * damping),
        "energy_friction": (("cycle", "contact"), np.array(work)),
    }
    coords = {
        "time": time[kept],
        "point": ["root", "tip"],
        "axis": ["x", "y", "z"],
        "contact": list(NAMES[:num_contacts]),
        "component": ["t1", "t2", "n"],
        "tangent": ["t1", "t2"],
        "cycle": np.arange(1, CYCLES + 1),
    }
    base = dict.fromkeys(REQUIRED_ATTRIBUTES, "") | {
        "study": "transient",
        "complete": 1,
        "title": "Two pads",
    }
    return dataset(variables, coords, base | attrs)


@pytest.fixture(scope="module")
def run() -> xarray.Dataset:
    return friction_run()


def _labels(ax: Axes) -> list[str]:
    return ax.get_legend_handles_labels()[1]


def _curve(ax: Axes, label: str) -> tuple[np.ndarray, np.ndarray]:
    (line,) = [line for line in ax.get_lines() if line.get_label() == label]
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


def test_displacement_within_its_envelope(run: xarray.Dataset) -> None:
    ax = plot_transient.displacement(run, point="tip", axis="z")
    time, x = _curve(ax, "displacement")
    assert (time == run.time.values).all()
    assert (x == run.displacement.sel(point="tip", axis="z").values).all()
    assert ax.get_xlabel() == "time [s]"
    assert ax.get_ylabel() == "tip z [length]"
    upper, lower = (patch.get_data() for patch in ax.patches)
    assert ax.patches[0].get_label() == "middle ± amplitude of the cycle", "which need not be about 0"
    assert len(upper.values) == CYCLES
    assert upper.edges[-1] == pytest.approx(CYCLES / FREQUENCY)
    assert [patch.get_edgecolor()[:3] for patch in ax.patches] == 2 * [(0, 0, 0)], (
        "seen around the curve without colours"
    )
    assert [patch.get_snap() for patch in ax.patches] == 2 * [False], "a step is one of amplitudes, not of pixels"
    middle = (upper.values + lower.values) / 2
    amplitude = run.cycle_amplitude.sel(point="tip", axis="z").values
    assert (upper.values - middle) == pytest.approx(amplitude)
    for k in range(CYCLES):
        inside = x[k * STEPS // EVERY : (k + 1) * STEPS // EVERY + 1]
        assert inside.max() == pytest.approx(upper.values[k], abs=1e-4)
        assert inside.min() == pytest.approx(lower.values[k], abs=1e-4)


def test_the_envelope_covers_cycles_that_were_not_recorded() -> None:
    short = friction_run(1, record_last=2)
    ax = plot_transient.displacement(short, point="tip", axis="x")
    assert _curve(ax, "displacement")[0][0] == pytest.approx((CYCLES - 2) / FREQUENCY)
    known, _, unknown, _ = (patch.get_data() for patch in ax.patches)
    assert unknown.edges[0] == 0
    assert unknown.edges[-1] == known.edges[0] == pytest.approx((CYCLES - 2) / FREQUENCY)
    assert (known.values.size, unknown.values.size) == (2, CYCLES - 2)
    assert unknown.values[0] < known.values[-1]
    assert "about the middle of the samples" in ax.patches[2].get_label()


def test_the_last_cycles_of_a_displacement(run: xarray.Dataset) -> None:
    ax = plot_transient.displacement(run, point="tip", axis="x", cycles=2)
    time = _curve(ax, "displacement")[0]
    assert (time[0], time[-1]) == pytest.approx((5.0, 6.0))
    assert not ax.patches


@pytest.mark.parametrize(
    ("point", "axis", "drawn"), [("root", None, "root x"), (None, "y", "tip y"), ("root", "z", "root z")]
)
def test_a_displacement_of_the_point_or_axis_that_is_asked_for(
    run: xarray.Dataset, point: str | None, axis: str | None, drawn: str
) -> None:
    """Not that of what moves most, although only one of the two is named."""
    assert plot_transient.displacement(run, point=point, axis=axis).get_ylabel().startswith(drawn)


def test_an_orbit_wears_the_colours_of_its_states(run: xarray.Dataset) -> None:
    ax = plot_contact.orbit(run, contact="stop")
    assert set(_labels(ax)) == {"stick", "slip", "slider w"}
    lines = {line.get_label(): line for line in ax.get_lines()}
    assert lines["stick"].get_color() == STATE_STYLE[STICK].colour
    assert lines["slip"].get_color() == STATE_STYLE[SLIP].colour
    assert lines["slip"].get_linestyle() == "--"
    last = run.isel(time=slice(-STEPS // EVERY - 1, None)).sel(contact="stop")
    u = last.contact_displacement.values
    drawn = np.unique(np.round(np.concatenate([lines[name].get_xydata() for name in ("stick", "slip")]), 12), axis=0)
    drawn = drawn[np.isfinite(drawn).all(axis=1)]
    assert len(drawn) == pytest.approx(len(u), abs=2)
    stuck = lines["stick"].get_xydata()[:-1]
    places = [np.argmin(np.hypot(*(u[:, :2] - place).T)) for place in stuck if np.isfinite(place).all()]
    shares = np.mean(last.contact_state.values[places] == STICK)
    assert shares > 0.95
    assert ax.get_aspect() == 1
    assert ax.get_title(loc="right") == "stop"


def test_a_slider_is_not_drawn_in_separation(run: xarray.Dataset) -> None:
    ax = plot_contact.orbit(run, contact="pad")
    assert set(_labels(ax)) == {"slip", "separation", "slider w"}
    last = run.contact_state.sel(contact="pad").values[-STEPS // EVERY - 1 :]
    assert np.isnan(_curve(ax, "slider w")[0]).sum() == (last == SEPARATION).sum() > 10


def test_curves_of_states_join_and_do_not_cross_other_states() -> None:
    ax = axes()
    x = np.arange(8.0)
    style.state_curves(ax, x, 10 * x, np.array([0, 0, 1, 0, 2, 2, 0, 1]))
    pieces = {line.get_label(): np.asarray(line.get_xdata()) for line in ax.get_lines()}
    gap = np.nan
    assert pieces["stick"] == pytest.approx([0, 1, 2, gap, 3, 4, gap, 6, 7, gap], nan_ok=True)
    assert pieces["slip"] == pytest.approx([2, 3, gap, 7, gap], nan_ok=True)
    assert pieces["separation"] == pytest.approx([4, 5, 6, gap], nan_ok=True)


@pytest.mark.parametrize("tangent", ["t1", "t2"])
def test_hysteresis_encloses_the_friction_energy(run: xarray.Dataset, tangent: str) -> None:
    ax = plot_contact.hysteresis(run, contact="pad", tangent=tangent)
    number = tangent[1]
    assert ax.get_xlabel() == f"u{number} [length]"
    assert ax.get_ylabel() == f"f{number} [force]"
    u, f = _curve(ax, "_cycles before")
    assert f.max() == run.contact_force.sel(contact="pad", component=tangent).values[-3 * STEPS // EVERY - 1 :].max()
    assert len(u) == 3 * STEPS // EVERY + 1


def test_both_loops_together_enclose_the_friction_energy(run: xarray.Dataset) -> None:
    area = 0.0
    for tangent in ("t1", "t2"):
        u, f = _curve(plot_contact.hysteresis(run, contact="pad", tangent=tangent), "_cycles before")
        area += np.trapezoid(f, u) / 3
    assert area == pytest.approx(float(run.energy_friction.sel(contact="pad")[-1]), rel=1e-2)


def test_normal_load_with_its_separations(run: xarray.Dataset) -> None:
    ax = plot_contact.normal_load(run, contact="pad")
    assert _labels(ax) == ["separation", "n = 0", "normal load n", "friction force |f|"]
    time, n = _curve(ax, "normal load n")
    shaded = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in ax.patches]
    assert len(shaded) == 3
    for start, end in shaded:
        inside = (time > start + 1e-9) & (time < end - 1e-9)
        assert inside.any()
        assert (n[inside] == 0).all()
    outside = np.all([(time < start - 0.01) | (time > end + 0.01) for start, end in shaded], axis=0)
    assert (n[outside] > 0).all()
    assert (_curve(ax, "friction force |f|")[1] <= FRICTION * n + 1e-12).all()
    assert not plot_contact.normal_load(run, contact="stop").patches


def with_friction(run: xarray.Dataset, *values: float) -> xarray.Dataset:
    return run.assign_coords(friction=("contact", list(values)))


def test_normal_load_of_a_contact_that_never_touches(run: xarray.Dataset) -> None:
    apart = run.assign(contact_force=run.contact_force * 0.0, contact_state=run.contact_state * 0 + SEPARATION)
    low, high = plot_contact.normal_load(apart, contact="pad").get_ylim()
    assert low < 0 < 0.5 < high


def test_normal_load_beside_the_limit_of_the_cone(run: xarray.Dataset) -> None:
    ax = plot_contact.normal_load(with_friction(run, FRICTION, 0.0), contact="pad")
    limit, force = (_curve(ax, name)[1] for name in ("limit of the cone μn", "friction force |f|"))
    np.testing.assert_allclose(limit, FRICTION * _curve(ax, "normal load n")[1])
    assert (force <= limit + 1e-12).all()
    assert ax.get_ylabel() == "n, μn, |f| [force]"
    assert _labels(plot_contact.normal_load(with_friction(run, FRICTION, 0.0), contact="stop")) == [
        "n = 0",
        "normal load n",
    ]


def test_a_stop_without_friction_is_closed_where_others_slip(run: xarray.Dataset) -> None:
    data = with_friction(run, FRICTION, 0.0)
    names = {bar.get_label() for bar in plot_contact.contact_states(data, contacts=["stop"]).collections}
    assert "closed" in names
    assert "slip" not in names
    assert "slip" in _labels(plot_contact.orbit(data, contact="pad"))
    assert "closed" in _labels(plot_contact.orbit(data, contact="stop"))
    figure = plot_contact.PICTURES["contact_states"](data)
    assert figure is not None
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()][:3] == ["stick", "slip", "separation"]
    assert "closed" in [text.get_text() for text in legend.get_texts()]


def test_orbits_and_hysteresis_are_of_contacts_with_friction(run: xarray.Dataset) -> None:
    """A stop slides freely: it has no slider, and a loop of zero force."""
    for values, orbits, loops in (
        ((FRICTION, 0.0), ["pad"], ["pad, t1", "pad, t2"]),
        ((0.0, FRICTION), ["stop"], ["stop, t1", "stop, t2"]),
        ((0.0, 0.0), None, None),
    ):
        for name, titles in (("orbit", orbits), ("hysteresis", loops)):
            figure = plot_contact.PICTURES[name](with_friction(run, *values))
            assert (figure and [ax.get_title("right") for ax in figure.axes]) == titles
    for name in ("normal_load", "contact_states"):
        assert plot_contact.PICTURES[name](with_friction(run, 0.0, 0.0)) is not None


def test_contacts_with_friction_are_counted_among_themselves() -> None:
    many = friction_run(5).assign_coords(friction=("contact", [0.0, 0.3, 0.3, 0.3, 0.3]))
    figure = plot_contact.PICTURES["hysteresis"](many)
    assert figure is not None
    assert "1 of 4 contacts with friction not shown (the least active)" in _texts(figure)
    energy = plot_transient.PICTURES["energy"](many)
    assert energy is not None
    assert "1 of 4 contacts shown in the sum only" in _texts(energy)
    assert "friction, all contacts" not in _labels(plot_transient.energy(many.isel(contact=slice(0, 4))))


def test_bars_stand_at_the_times_of_the_events(run: xarray.Dataset) -> None:
    ax = plot_contact.contact_states(run)
    start, end = ax.get_xlim()
    edges = {path.get_extents().x0 for bar in ax.collections for path in bar.get_paths()}
    inside = run.event_time.values[(run.event_time.values > start) & (run.event_time.values < end)]
    assert len(inside) > 10
    assert edges == {start, *inside}
    assert [text.get_text() for text in ax.get_yticklabels()] == ["pad", "stop"]
    assert ax.get_xlabel() == "time [s], dotted: start of a cycle"
    one = run.assign(cycle_start=run.cycle_start.where(run.cycle == run.cycle[0]))
    assert plot_contact.contact_states(one).get_xlabel() == "time [s]"
    styles = {bar.get_label(): (bar.get_facecolor()[0], bar.get_hatch()) for bar in ax.collections}
    assert set(styles) == {"stick", "slip", "separation"}
    for number, name in enumerate(("stick", "slip", "separation")):
        colour, hatch = styles[name]
        assert colour == pytest.approx(matplotlib.colors.to_rgba(STATE_STYLE[number].colour))
        assert (hatch or "") == STATE_STYLE[number].hatch
    starts = [line.get_xdata()[0] for line in ax.get_lines()]
    assert starts == pytest.approx([5.0, 5.5])


def test_intervals_fill_the_window_and_agree_with_the_samples(run: xarray.Dataset) -> None:
    time = run.time.values
    for index, contact in enumerate(run.contact.values):
        found = plot_contact.intervals(run, contact, 0.25, 5.75)
        assert found[0][0] == 0.25
        assert found[-1][1] == 5.75
        assert all(a[1] == b[0] and a[2] != b[2] for a, b in pairwise(found))
        for start, end, state in found:
            inside = (time > start + 1e-9) & (time < end - 1e-9)
            assert (run.contact_state.values[inside, index] == state).all()


def test_a_contact_without_events_keeps_its_state(run: xarray.Dataset) -> None:
    calm = run.isel(event=slice(0, 0))
    state = int(run.contact_state.values[0, 0])
    assert plot_contact.intervals(calm, "pad", 1.0, 2.0) == [(1.0, 2.0, state)]


def test_the_spectrum_shows_the_harmonics(run: xarray.Dataset) -> None:
    ax = plot_transient.spectrum(run)
    assert ax.get_yscale() == "log"
    assert _labels(ax) == ["tip x", "tip z", "tip y"]
    order, amplitude = _curve(ax, "tip z")
    assert order == pytest.approx(np.arange(31))
    grown = 1 - 8 * (np.exp(-4 * np.pi / 8) - np.exp(-24 * np.pi / 8)) / (20 * np.pi)
    assert amplitude[[1, 3]] == pytest.approx([0.12 * grown, 0.02 * grown], rel=0.01)


def test_harmonics_are_exact_for_samples_of_a_known_motion(run: xarray.Dataset) -> None:
    theta = 2 * np.pi * FREQUENCY * run.time.values
    x = -0.25 + 2 * np.cos(theta + 1) + 0.5 * np.sin(3 * theta) + 1e-3 * np.cos(0.5 * theta)
    order, amplitude = plot_transient.harmonics(run, x)
    found = dict(zip(np.round(order, 6), amplitude, strict=True))
    assert [found[k] for k in (0, 0.5, 1, 3)] == pytest.approx([0.25, 1e-3, 2.0, 0.5], rel=1e-12)
    assert found[2] < 1e-12


def test_a_spectrum_says_that_the_motion_has_not_settled(run: xarray.Dataset) -> None:
    """A motion that repeats after two cycles has; the axis ends below the smallest harmonic."""
    theta = 2 * np.pi * FREQUENCY * run.time.values
    unit = xarray.ones_like(run.displacement)

    def drawn(x: np.ndarray) -> tuple[str, float]:
        ax = plot_transient.spectrum(run.assign(displacement=unit * x[:, None, None]))
        return ax.get_title("right"), ax.get_ylim()[0]

    label, low = drawn(np.cos(theta) * (1 + 1e-3 * theta / theta[-1]))
    assert label.startswith("not settled, by 4e-05 of the range of a cycle")
    assert 1e-7 < low < 1e-5
    assert drawn(np.cos(theta) + 0.1 * np.cos(theta / 2))[0] == ""
    x = np.where(theta < theta[-1] - 2 * np.pi, 0.0, np.sin(theta))
    assert plot_transient.unsettled(run, x) == pytest.approx(0.5, rel=1e-3)
    assert plot_transient.unsettled(run, 0 * theta) == 0.0


def test_the_harmonic_at_half_the_rate_of_samples_counts_once() -> None:
    coords = {"time": np.arange(17) / 8}
    data = xarray.Dataset({"cycle_start": ("cycle", [0.0, 1.0]), "cycle_period": ("cycle", [1.0, 1.0])}, coords)
    x = np.cos(2 * np.pi * data.time.values) + 0.25 * np.cos(8 * np.pi * data.time.values)
    order, amplitude = plot_transient.harmonics(data, x)
    assert order.tolist() == np.arange(0, 4.5, 0.5).tolist()
    assert amplitude[[2, 8]] == pytest.approx([1.0, 0.25])


def test_harmonics_use_the_cycles_of_the_last_frequency(run: xarray.Dataset) -> None:
    period = np.where(np.arange(CYCLES) < 8, 0.25, 0.5)
    start = np.cumsum(period) - period
    jump = run.assign(cycle_start=("cycle", start), cycle_period=("cycle", period))
    jump = jump.assign_coords(time=np.linspace(0, 4.0, run.sizes["time"]))
    x = np.where(jump.time.values < 2.0, 7.0, np.cos(4 * np.pi * jump.time.values))
    order, amplitude = plot_transient.harmonics(jump, x)
    assert order[1] == pytest.approx(1 / 4)
    assert amplitude[4] == pytest.approx(1.0)
    assert amplitude[:4] == pytest.approx(0, abs=1e-12)


def test_energy_balance(run: xarray.Dataset) -> None:
    ax = plot_transient.energy(run)
    assert _labels(ax) == ["input", "structural damping", "friction pad", "friction stop", "change of stored"]
    terms = {name: _curve(ax, name)[1] for name in _labels(ax)}
    assert terms.pop("input") == pytest.approx(sum(terms.values()))
    assert ax.get_ylabel() == "energy a cycle [force·length]"
    residual = plot_transient.energy_residual(run)
    assert residual.get_ylabel() == "energy [force·length]"
    assert residual.get_yscale() == "log"
    assert _curve(residual, "|residual|")[1] == pytest.approx(np.abs(run.energy_residual.values))


def test_a_residual_without_input_stands_alone(run: xarray.Dataset) -> None:
    """As of a free decay: a legend names no line that a logarithmic axis does not show."""
    free = run.assign(energy_input=0 * run.energy_input)
    assert _labels(plot_transient.energy_residual(free)) == ["|residual|"]


def test_a_stop_without_friction_has_no_line_of_friction(run: xarray.Dataset) -> None:
    smooth = run.assign_coords(friction=("contact", [0.3, 0.0]))
    assert _labels(plot_transient.energy(smooth)) == ["input", "structural damping", "friction pad", "change of stored"]


def test_many_cycles_are_marked_now_and_then(run: xarray.Dataset) -> None:
    many = run.isel(cycle=np.arange(600) % CYCLES).assign_coords(cycle=np.arange(1, 601))
    for ax in (plot_transient.energy(many), plot_transient.energy_residual(many)):
        assert all(600 / line.get_markevery() <= plot_transient.MARKED for line in ax.get_lines())


def test_an_exact_balance_needs_no_logarithm(run: xarray.Dataset) -> None:
    zero = xarray.zeros_like(run.energy_residual)
    ax = plot_transient.energy_residual(run.assign(energy_residual=zero, energy_input=zero))
    assert ax.get_yscale() == "linear"
    ax.figure.canvas.draw()


def test_all_pictures_of_a_run(run: xarray.Dataset, tmp_path: Path) -> None:
    files = plot.draw(run, tmp_path)
    names = ["displacement", "orbit", "hysteresis", "normal_load", "contact_states", "spectrum", "energy"]
    assert [file.name for file in files] == [f"{name}.png" for name in names] == plot.picture_names("transient")
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in files)
    assert plot.draw(run.assign_attrs(study="unknown"), tmp_path / "missing") == []


def _texts(figure: object) -> list[str]:
    return [text.get_text() for text in figure.texts]  # type: ignore[attr-defined]


def test_many_contacts_are_left_out_and_counted() -> None:
    many = friction_run(5, complete=0)
    figure = plot_transient.PICTURES["hysteresis"](many)
    assert figure is not None
    assert len(figure.axes) == 6
    assert "2 of 5 contacts not shown (the least active)" in _texts(figure)
    assert figure.get_suptitle() == "Two pads\nfriction force against displacement, last cycles (incomplete run)"
    work = many.energy_friction.sum("cycle")
    shown = {ax.get_title(loc="right").split(",")[0] for ax in figure.axes}
    assert shown == set(many.contact.values[np.argsort(-work.values)[:3]])
    assert "friction, all contacts" in _labels(plot_transient.energy(many))
    assert len(plot_contact.contact_states(many).get_yticklabels()) == 5


def test_a_title_is_one_line_of_plain_text(run: xarray.Dataset, tmp_path: Path) -> None:
    """Of dollars matplotlib makes formulas, and of what is none an error."""
    data = run.assign_attrs(title="from $5\nto $6, $\\nonsense$")
    figure = plot_transient.PICTURES["spectrum"](data)
    assert figure is not None
    assert figure.get_suptitle() == "from $5 to $6, $\\nonsense$\nharmonics of the last cycles"
    figure.canvas.draw()


@pytest.mark.long
def test_dollars_in_names_make_no_formula(run: xarray.Dataset, tmp_path: Path) -> None:
    names = {dim: [f"$\\{name}$" for name in run[dim].values] for dim in ("point", "contact")}
    assert plot.draw(run.assign_coords(names), tmp_path)


def test_long_names_are_cut_where_there_is_no_room(run: xarray.Dataset) -> None:
    named = run.assign_coords(contact=["underplatform damper of blade 12", "b"]).assign_attrs(title="t" * 200)
    assert "friction underplatform d…" in _labels(plot_transient.energy(named))
    ticks = plot_contact.contact_states(named).get_yticklabels()
    assert [text.get_text() for text in ticks] == ["underplatform damper of…", "b"]
    figure = plot_transient.PICTURES["spectrum"](named)
    assert figure is not None
    assert figure.get_suptitle() == "t" * 89 + "…\nharmonics of the last cycles"


@pytest.mark.parametrize("name", ["orbit", "hysteresis", "displacement"])
def test_a_long_title_fits_the_figure(run: xarray.Dataset, name: str) -> None:
    """That of a point of a sweep names its values too, and the orbit's figure is narrow."""
    figure = plot_transient.PICTURES[name](run.assign_attrs(title="W" * 85))
    assert figure is not None
    heading = figure._suptitle.get_window_extent()  # type: ignore[attr-defined]
    assert 0 <= heading.x0 < heading.x1 <= figure.bbox.width


@pytest.mark.parametrize("name", ["energy", "hysteresis", "displacement"])
def test_the_title_stands_over_the_middle_of_the_axes(run: xarray.Dataset, name: str) -> None:
    """Not of the figure, whose room for a legend beside the axes may be empty and is cut off then."""
    figure = plot_transient.PICTURES[name](run)
    assert figure is not None
    heading = figure._suptitle.get_window_extent()  # type: ignore[attr-defined]
    boxes = [ax.bbox for ax in figure.axes]
    middle = (min(box.x0 for box in boxes) + max(box.x1 for box in boxes)) / 2
    assert (heading.x0 + heading.x1) / 2 == pytest.approx(middle, abs=1.0)


@pytest.mark.parametrize("name", ["energy", "hysteresis", "displacement"])
def test_the_title_stands_just_above_the_axes_and_what_is_written_above_them(run: xarray.Dataset, name: str) -> None:
    figure = plot_transient.PICTURES[name](run)
    assert figure is not None
    figure.canvas.draw()
    ax = figure.axes[0]
    label = ax._right_title.get_window_extent()  # type: ignore[attr-defined]
    below = max(ax.bbox.y1, label.y1 if ax.get_title("right") else 0.0)
    assert 0 < figure._suptitle.get_window_extent().y0 - below < 0.2 * figure.dpi  # type: ignore[attr-defined]


def test_a_power_of_ten_stands_with_the_unit(run: xarray.Dataset, tmp_path: Path) -> None:
    """In steps of three, unless an axis is logarithmic; ticks are numbers of that unit."""
    small = run.assign(displacement=1e-5 * run.displacement, cycle_amplitude=1e-5 * run.cycle_amplitude)
    drawn: list[Figure] = []

    def picture(data: xarray.Dataset) -> Figure | None:
        drawn.append(plot_transient.PICTURES["displacement"](data))  # type: ignore[arg-type]
        return drawn[-1]

    write(small, tmp_path, {"displacement": picture})
    write(run, tmp_path, {"displacement": picture})
    first, plain = drawn[0].axes[0], drawn[1].axes[0]
    assert first.get_ylabel() == "tip x [1e-6 length]"
    assert plain.get_ylabel() == "tip x [length]"
    assert "1" in [text.get_text() for text in first.get_yticklabels()]
    assert not first.yaxis.get_offset_text().get_visible()


def test_a_contact_that_moves_along_one_axis_of_its_plane_or_none_has_no_orbit(run: xarray.Dataset) -> None:
    def orbits(contacts: list[str], still: list[str]) -> list[str] | None:
        motion = run.contact_displacement.copy()
        motion.loc[{"contact": contacts, "component": still}] = 0.0
        figure = plot_transient.PICTURES["orbit"](run.assign(contact_displacement=motion))
        return figure and [ax.get_title("right") for ax in figure.axes]

    assert orbits([], []) == ["pad", "stop"]
    assert orbits(["stop"], ["t1", "t2"]) == orbits(["stop"], ["t2"]) == ["pad"]
    assert orbits(["pad", "stop"], ["t1"]) is None


def test_the_last_cycles_are_drawn_apart_where_they_are_not_all(run: xarray.Dataset) -> None:
    for cycles, panels in ((CYCLES, 2), (3, 1)):
        figure = plot_transient.PICTURES["displacement"](run.isel(cycle=slice(cycles)))
        assert len({round(ax.get_position().x0, 3) for ax in figure.axes}) == panels


def test_one_legend_names_every_state_once(run: xarray.Dataset) -> None:
    figure = plot_transient.PICTURES["orbit"](run)
    assert figure is not None
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names[:3] == ["stick", "slip", "separation"]
    assert names[3:] == ["slider w"]


def test_cycles_before_are_in_the_legend_where_they_are_seen(run: xarray.Dataset) -> None:
    growing = run.contact_displacement.copy()
    growing[:] = growing * np.linspace(0.5, 1.0, run.sizes["time"])[:, None, None]
    for draw in (plot_contact.orbit, plot_contact.hysteresis):
        assert "cycles before" in _labels(draw(run.assign(contact_displacement=growing)))
        assert "cycles before" not in _labels(draw(run))


def test_a_slider_that_stays_is_a_dot(run: xarray.Dataset) -> None:
    stuck = run.assign(slip=0.0 * run.slip, contact_state=0 * run.contact_state)
    (slider,) = [line for line in plot_contact.orbit(stuck).get_lines() if line.get_label() == "slider w"]
    assert slider.get_marker() == "o"
    assert np.asarray(slider.get_xdata()).tolist() == [0.0]
    apart = run.assign(contact_state=0 * run.contact_state + SEPARATION)
    assert "slider w" not in _labels(plot_contact.orbit(apart))


def test_directions_that_do_not_move_have_no_hysteresis(run: xarray.Dataset) -> None:
    still = {name: run[name].copy() for name in ("contact_displacement", "contact_force")}
    still["contact_displacement"][:, 0, 1] = 0.1
    still["contact_force"][:, 0, 1] = 0.0
    draw = plot_transient.PICTURES["hysteresis"]
    figure = draw(run.assign(still))
    assert figure is not None
    assert [ax.get_title(loc="right") for ax in figure.axes] == ["pad, t1", "stop, t1", "stop, t2"]
    one = friction_run(1)
    for name in still:
        one[name][:, 0, 1] = 0.0
    alone = draw(one)
    assert alone is not None
    assert len(alone.axes) == 1
    frictionless = run.assign(still)
    frictionless["contact_force"][:, 0, :2] = 0.0
    figure = draw(frictionless)
    assert figure is not None
    assert [ax.get_title(loc="right") for ax in figure.axes] == ["stop, t1", "stop, t2"]


@pytest.mark.long
def test_pictures_are_cut_to_what_is_drawn(run: xarray.Dataset, tmp_path: Path) -> None:
    for file in plot.draw(run, tmp_path):
        white = (imread(file)[..., :3] == 1).all(axis=2)
        for edge in (white.all(axis=1), white.all(axis=0)):
            ink = np.flatnonzero(~edge)
            assert max(ink[0], edge.size - 1 - ink[-1]) <= MARGIN


def test_a_run_without_contacts(run: xarray.Dataset, tmp_path: Path) -> None:
    free = run.isel(contact=slice(0, 0), event=slice(0, 0))
    assert [file.stem for file in plot.draw(free, tmp_path)] == ["displacement", "spectrum", "energy"]


def test_a_run_that_failed_early(run: xarray.Dataset, tmp_path: Path) -> None:
    begun = run.isel(cycle=slice(0, 0), time=slice(0, 40)).assign_attrs(complete=0)
    shown = ["displacement", "orbit", "hysteresis", "normal_load", "contact_states"]
    assert [file.stem for file in plot.draw(begun, tmp_path)] == shown
    assert plot.draw(begun.isel(time=slice(0, 0)), tmp_path) == []


@pytest.mark.long
@pytest.mark.parametrize("samples", [8 * STEPS // EVERY, 8 * STEPS // EVERY + 31, 20, 1])
def test_a_part_of_a_run_ends_before_its_last_cycles(run: xarray.Dataset, samples: int) -> None:
    part = run.isel(time=slice(samples + 1))
    cycles = samples * EVERY // STEPS
    first = plot_contact.last_cycles(part).start or 0
    assert first == max(cycles - plot_contact.LAST_CYCLES, 0) * STEPS // EVERY
    order, _ = plot_transient.harmonics(part, part.displacement.sel(point="tip", axis="x").values)
    assert order.size == (0 if not cycles else 1 + plot_transient.HIGHEST_ORDER * cycles)
    assert all(picture(part) is not None for picture in plot_transient.PICTURES.values())


def test_a_run_that_never_moved(run: xarray.Dataset, tmp_path: Path) -> None:
    names = ("displacement", "contact_displacement", "cycle_amplitude", "energy_input", "energy_friction")
    still = run.assign({name: xarray.zeros_like(run[name]) for name in names})
    assert plot_transient.moving(still) == [("root", "x")]
    shown = ["displacement", "hysteresis", "normal_load", "contact_states", "spectrum", "energy"]
    assert [file.stem for file in plot.draw(still, tmp_path)] == shown


def test_pictures_need_no_pyplot(tmp_path: Path) -> None:
    code = (
        "import sys\nimport timesim.picture.draw, timesim.picture.figure\nassert 'matplotlib' not in sys.modules\n"
        "timesim.picture.figure.axes().figure.savefig(sys.argv[1])\n"
        "assert not {'matplotlib.pyplot', 'jax', 'xarray'} & set(sys.modules)\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "a.png")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_figures_go_with_their_last_reference(run: xarray.Dataset, tmp_path: Path) -> None:
    drawn = []

    def kept(picture: style.Picture) -> style.Picture:
        def draw(data: xarray.Dataset) -> Figure | None:
            figure = picture(data)
            drawn.append(weakref.ref(figure))
            return figure

        return draw

    write(run, tmp_path, {name: kept(picture) for name, picture in plot_transient.PICTURES.items()})
    gc.collect()
    assert len(drawn) == 7
    assert not any(figure() for figure in drawn)


@pytest.mark.parametrize(("height", "ticks"), [(1.6, "7"), (3.0, "7"), (1.6, "0.000394")])
def test_long_labels_of_ordinates_do_not_reach_over_others(height: float, ticks: str) -> None:
    fig, axs = stacked(3, height)
    for ax in axs:
        ax.set_yticks([0, 1], [ticks, ticks])
        ax.set_ylabel(r"amplitude of a \$beta\$ blade, long tip of it [1e-3 mm]")
    fit_ordinate_labels(fig)
    fig.canvas.draw()
    for ax in axs:
        extent = ax.yaxis.label.get_window_extent()
        assert extent.x0 > 0
        assert extent.height <= ax.bbox.height + BEYOND * fig.dpi
        *_, last = ax.get_ylabel().splitlines()
        assert last.endswith("[1e-3\xa0mm]" if "\n" in ax.get_ylabel() else "[1e-3 mm]")


def test_a_narrow_picture_leaves_no_letter_of_its_title_out() -> None:
    """As hinted letters are wider in small than in proportion, and of other widths at another resolution."""
    title = r"100% $\Omega$ of blade_1 ^ & # \test ~ ümlaut — a title that is very long, so long that it does not fit"
    figure = plot_transient.PICTURES["orbit"](friction_run(1, title=title))
    figure.set_dpi(DPI)
    figure.canvas.draw()
    heading = figure._suptitle.get_window_extent()
    assert 0 <= heading.x0 < heading.x1 <= figure.bbox.width


def test_letters_that_the_font_lacks_are_boxes_without_a_warning(run: xarray.Dataset, tmp_path: Path) -> None:
    assert plot.draw(run.assign_coords(point=["tip", "\N{CJK UNIFIED IDEOGRAPH-975E}"]), tmp_path)


def test_a_run_without_motion_has_no_empty_axes(run: xarray.Dataset) -> None:
    still = run.assign({name: 0 * run[name] for name in run.data_vars if run[name].dtype.kind == "f"})
    assert plot_transient.PICTURES["hysteresis"](still) is None
    assert len(plot_transient.PICTURES["energy"](still).axes) == 1
    assert all(ax.has_data() for name in ("displacement", "normal_load") for ax in _axes_of(still, name))


def test_a_displacement_that_a_static_load_holds_has_short_ticks(run: xarray.Dataset, tmp_path: Path) -> None:
    """Not those of the rounding about it."""
    noise = 1e-17 * np.sin(np.arange(run.time.size))[:, None, None]
    held = run.assign(displacement=0 * run.displacement + 1.23e-5 + noise, cycle_amplitude=0 * run.cycle_amplitude)
    drawn: list[Figure] = []

    def picture(data: xarray.Dataset) -> Figure:
        drawn.append(plot_transient.PICTURES["displacement"](data))
        return drawn[-1]

    write(held, tmp_path, {"displacement": picture})
    for ax in drawn[0].axes:
        low, high = ax.get_ylim()
        assert low < 1.2e-5 < 1.3e-5 < high
        assert all(len(label.get_text()) < 6 for label in ax.get_yticklabels())


def _axes_of(data: xarray.Dataset, name: str) -> list[Axes]:
    return plot_transient.PICTURES[name](data).axes


def test_a_picture_that_cannot_be_drawn_of_a_result_is_named(run: xarray.Dataset, tmp_path: Path) -> None:
    """With the kind of the error, by which a wrong result is told from a fault in the drawing."""
    text = run.assign(slip=run["slip"].astype(str))
    lacks = r"lacks what picture \w+ shows \(\w*Error: .*\): draw a whole result, of this version"
    with pytest.raises(StoreError, match=lacks):
        plot.draw(text, tmp_path)
    assert not list(tmp_path.iterdir())
