"""Pictures of a sweep of a hardening spring whose response is known: what they show, not merely that there are any."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
import xarray
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D

from timesim.picture import style
from timesim.picture import sweep as plot_sweep
from timesim.picture.choice import MAX_CURVES, main_axes, motion
from timesim.picture.draw import make_logarithmic, write
from timesim.picture.response import LINES, PAIRED, key_words, values_labels
from timesim.result.dataset import dataset
from timesim.result.label import told_apart
from timesim.result.netcdf import REQUIRED_ATTRIBUTES
from timesim.study import registry as plot

pytestmark = pytest.mark.long

PRELOAD, FRICTION = "contacts.pad.preload", "contacts.pad.friction"
FREQUENCY = np.linspace(0.8, 1.4, 31)
HARDENING, DAMPING = 0.1, 0.15
POINTS, CONTACTS = ("tip", "root"), ("pad", "stop")


def spring_amplitude(frequency: float, load: float, *, largest: bool) -> float:
    """Amplitude a of ``((1 - f^2 + h a^2)^2 + (c f)^2) a^2 = load^2``, the largest or smallest solution."""
    linear = 1 - frequency**2
    roots = np.roots([HARDENING**2, 2 * HARDENING * linear, linear**2 + (DAMPING * frequency) ** 2, -(load**2)])
    real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
    return float(np.sqrt(real[-1 if largest else 0]))


def sweep(
    over: Mapping[str, Sequence[float]] | None = None,
    directions: Sequence[str] = ("independent",),
    frequency: np.ndarray = FREQUENCY,
    **attrs: object,
) -> xarray.Dataset:
    """A result as a sweep leaves it: the load grows with the sum of the values of the further axes."""
    over = over or {}
    shape = (*map(len, over.values()), len(directions), frequency.size)
    load = sum(np.meshgrid(*over.values(), indexing="ij"), np.zeros(shape[:-2])) if over else np.zeros(())
    x = np.empty(shape)
    for place in np.ndindex(*shape):
        largest = directions[place[-2]] != "down"
        x[place] = spring_amplitude(frequency[place[-1]], 0.2 + load[place[:-2]], largest=largest)
    scale = np.array([[0.5, 1.0, 0.0], [0.0, 0.0, 0.25]])
    slip = np.clip(np.stack([x, 0.5 * x], axis=-1), 0, 0.6)
    dims = (*over, "direction", "frequency")
    variables = {
        "amplitude": ((*dims, "point", "axis"), x[..., None, None] * scale),
        "settled": (dims, np.ones(shape, int)),
        "cycles": (dims, np.full(shape, 100)),
        "period": (dims, np.ones(shape, int)),
        "floquet_max": (dims, np.full(shape, 0.8)),
        "slip_share": ((*dims, "contact"), slip),
        "separation_share": ((*dims, "contact"), 0.5 * slip),
        "failure": (dims, np.full(shape, "", object)),
    }
    coords = {"direction": list(directions), "frequency": frequency, "point": POINTS, "axis": list("xyz")}
    base = dict.fromkeys(REQUIRED_ATTRIBUTES, "") | {"study": "sweep", "complete": 1, "title": "A spring"}
    return dataset(variables, coords | {"contact": CONTACTS} | {k: list(v) for k, v in over.items()}, base | attrs)


def spoilt(data: xarray.Dataset) -> xarray.Dataset:
    """The same with a point that has not settled, one of period 2, and one that failed."""
    made = data.copy(deep=True)
    made.settled[..., 5] = 0
    made.period[..., 8] = 2
    made.settled[..., 20] = 0
    made["failure"] = made.failure.where(made.frequency != made.frequency[20], "the budget of steps is spent")
    for name in ("amplitude", "slip_share", "separation_share", "floquet_max"):
        made[name].loc[{"frequency": made.frequency[20]}] = np.nan
    return made


def _lines(ax: Axes, label: str) -> list[Line2D]:
    return [line for line in ax.get_lines() if line.get_label() == label]


def _drawn(line: Line2D) -> np.ndarray:
    """Points of a curve without the gaps in its line, shape (N, 2)."""
    points = np.asarray(line.get_xydata())
    return points[np.isfinite(points).all(axis=1)]


def _marked(line: Line2D) -> list[float]:
    """Frequencies at which a curve bears a marker."""
    return np.asarray(line.get_xdata())[line.get_markevery()].tolist()


def _legend(ax: Axes) -> list[str]:
    legend = ax.get_legend()
    assert legend is not None
    return [text.get_text() for text in legend.get_texts()]


@pytest.fixture(scope="module")
def both() -> xarray.Dataset:
    made = sweep({PRELOAD: [0.3]}, ("up", "down"))
    at = np.array([[[1.39], [1.21]]])
    dims = (PRELOAD, "direction", "jump")
    return made.assign(jump_low=(dims, at - 1e-4), jump_high=(dims, at + 1e-4))


def test_the_response_of_the_point_along_its_main_axis() -> None:
    data = sweep()
    ax = plot_sweep.response(data)
    (line,) = _lines(ax, "_")
    assert np.array_equal(line.get_xdata(), FREQUENCY)
    assert np.array_equal(line.get_ydata(), data.amplitude.sel(point="tip", axis="y").values[0])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("frequency [Hz]", "amplitude of tip y [length]")
    assert plot_sweep.response(data, point="root").get_ylabel() == "amplitude of root z [length]"
    assert plot_sweep.response(data, axis="x").get_ylabel() == "amplitude of tip x [length]"
    assert list(main_axes(data)) == ["tip", "root"]


def test_the_point_that_moves_most_along_an_axis() -> None:
    """Not the one that moves most along any: its amplitudes along the axis have another peak."""
    data = sweep()
    assert motion(data, None, None) == ("tip", "y")
    assert motion(data, None, "z") == ("root", "z")
    assert motion(data, "tip", None) == ("tip", "y")


def test_up_and_down_differ_by_marker_and_show_both_branches(
    both: xarray.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    ax = plot_sweep.response(both)
    up, down = _lines(ax, "_0.3")
    assert up.get_markerfacecolor() == down.get_markerfacecolor() == down.get_color()
    assert [line.get_marker() for line in (up, down)] == [PAIRED["up"], PAIRED["down"]]
    assert _marked(up) == _marked(down) == FREQUENCY.tolist(), "no point looks as if one direction had left it out"
    monkeypatch.setattr(plot_sweep, "MARKED", 10)
    up, down = _lines(plot_sweep.response(both), "_0.3")
    assert [line.get_marker() for line in (up, down)] == ["^", "v"]
    assert not set(_marked(up)) & set(_marked(down))
    gap = _drawn(up)[:, 1] - _drawn(down)[:, 1]
    several = FREQUENCY[gap > 0.1]
    assert several.size >= 3
    for frequency in several:
        pair = [spring_amplitude(frequency, 0.5, largest=largest) for largest in (True, False)]
        place = np.flatnonzero(frequency == FREQUENCY)[0]
        assert [_drawn(line)[place, 1] for line in (up, down)] == pytest.approx(pair)
    assert [line.get_xdata()[0] for line in _lines(ax, "jump")] == [1.39, 1.21]
    plot_sweep.legend([ax], both)
    assert _legend(ax) == ["0.3", "up", "down", "jump"]
    assert ax.get_legend().get_title().get_text() == "pad preload [force]"


def test_without_further_axes_the_directions_have_colours() -> None:
    data = sweep(directions=("up", "down"))
    ax = plot_sweep.response(data)
    assert [line.get_markerfacecolor() for line in _lines(ax, "_")] == [style.BLUE, style.VERMILION]
    plot_sweep.legend([ax], data)
    assert _legend(ax) == ["up", "down"]


def test_a_line_is_broken_where_the_motion_is_known_to_jump(both: xarray.Dataset) -> None:
    """In all pictures; not where only steep steps are known, of which some are slopes."""
    both = both.assign(phase_deg=(both.amplitude.dims, np.full(both.amplitude.shape, -30.0)))
    drawn = [draw(both) for draw in (plot_sweep.response, plot_sweep.phase, plot_sweep.share, plot_sweep.floquet)]
    for ax in drawn:
        for line, jump in zip(_lines(ax, "_0.3"), (1.39, 1.21), strict=True):
            x = np.asarray(line.get_xdata())
            (gap,) = np.flatnonzero(np.isnan(x))
            assert x[gap - 1] < jump < x[gap + 1]
            assert _drawn(line)[:, 0].tolist() == _marked(line) == FREQUENCY.tolist()
    for line in _lines(plot_sweep.response(both.assign_attrs(jumps_bisected=0)), "_0.3"):
        assert np.isfinite(line.get_xdata()).all()


@pytest.mark.parametrize("over", [{}, {PRELOAD: [0.0, 0.1, 0.2]}])
def test_up_is_wide_and_pale_and_down_dashed_on_top(over: Mapping[str, Sequence[float]]) -> None:
    """So that both are seen where they coincide, in print without colours too."""

    def lightness(line: Line2D) -> float:
        return float(np.dot(to_rgb(line.get_color()), (0.3, 0.6, 0.1)))

    data = sweep(over, ("up", "down"))
    figures = [plot_sweep.PICTURES[name](data) for name in ("response", "contact_states", "stability")]
    lines = [line for figure in figures for ax in figure.axes for line in ax.get_lines() if line.get_label()[0] == "_"]  # type: ignore[union-attr]
    assert len(lines) == 2 * 7 * max(1, len(over) and 3)
    for up, down in zip(lines[::2], lines[1::2], strict=True):
        assert (up.get_linestyle(), down.get_linestyle()) == ("-", "--")
        assert up.get_linewidth() > 2 * down.get_linewidth()
        assert up.get_zorder() < down.get_zorder()
        assert lightness(up) > lightness(down) + 0.1
    figure = plot_sweep.PICTURES["response"](data)
    assert figure is not None
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert [line.get_linestyle() for line in legend.get_lines()[-2:]] == ["-", "--"]
    alone = _lines(plot_sweep.response(data.isel(direction=[0])), "_0" if over else "_")[0]
    assert alone.get_linewidth() == lines[1].get_linewidth()


def test_up_and_down_do_not_cover_each_other_where_neither_has_settled() -> None:
    data = sweep(directions=("up", "down"))
    data["settled"][:] = 0
    up, down = _lines(plot_sweep.response(data), "not settled")
    assert up.get_xdata().tolist() == down.get_xdata().tolist()
    assert (up.get_marker(), down.get_marker()) == (PAIRED["up"], PAIRED["down"])


def test_what_is_not_settled_is_hollow_and_what_failed_is_marked() -> None:
    data = spoilt(sweep({PRELOAD: [0.0, 0.2]}))
    ax = plot_sweep.response(data)
    for line in _lines(ax, "not settled"):
        assert line.get_fillstyle() == "none"
        assert line.get_xdata().tolist() == [FREQUENCY[5]]
    assert len(_lines(ax, "not settled")) == len(_lines(ax, "failed")) == 2
    assert all(line.get_xdata().tolist() == [FREQUENCY[20]] for line in _lines(ax, "failed"))
    assert all(line.get_xdata().tolist() == [FREQUENCY[8]] for line in _lines(ax, "period of several cycles"))
    for line in (*_lines(ax, "_0"), *_lines(ax, "_0.2")):
        assert FREQUENCY[5] not in _marked(line)
        assert line.get_fillstyle() == "full"
    plot_sweep.legend([ax], data)
    assert _legend(ax) == ["0", "0.2", "not settled", "period of several cycles", "failed"]


def test_a_bar_spans_the_amplitudes_of_the_cycles_of_what_is_not_settled() -> None:
    data = spoilt(sweep({PRELOAD: [0.0, 0.2]}))
    band = xarray.concat([0.7 * data.amplitude, 0.9 * data.amplitude], "band").transpose(..., "band", "point", "axis")
    ax = plot_sweep.response(data.assign(amplitude_band=band))
    bars = [segment for shown in ax.collections for segment in shown.get_segments()]
    assert len(bars) == 2
    for bar, values in zip(bars, data.amplitude.sel(point="tip", axis="y").values[:, 0, 5], strict=True):
        np.testing.assert_allclose(bar, [[FREQUENCY[5], 0.7 * values], [FREQUENCY[5], 0.9 * values]])
    plot_sweep.legend([ax], data)
    assert "range over single cycles" in _legend(ax)


def test_many_points_are_marked_now_and_then_but_unsettled_ones_always() -> None:
    data = sweep(frequency=np.linspace(0.8, 1.4, 200))
    data.settled[0, 1:4] = 0
    ax = plot_sweep.response(data)
    assert 30 <= len(_marked(_lines(ax, "_")[0])) <= plot_sweep.MARKED
    assert len(_lines(ax, "not settled")[0].get_xdata()) == 3
    for of, note in ((data, "markers at one point in 5"), (sweep(), None)):
        figure = plot_sweep.PICTURES["response"](of)
        assert figure is not None
        assert (note in [text.get_text() for text in figure.texts]) == (note is not None)


def test_a_single_curve_needs_no_legend() -> None:
    for data, words in ((sweep(), None), (sweep(directions=("up",)), ["up"]), (sweep({PRELOAD: [0.2]}), ["0.2"])):
        figure = plot_sweep.PICTURES["response"](data)
        assert figure is not None
        legend = figure.axes[0].get_legend()
        assert (legend and [text.get_text() for text in legend.get_texts()]) == words


def test_every_set_of_values_has_its_own_style() -> None:
    nine = plot_sweep.curves(sweep({PRELOAD: list(range(9))}))
    assert [curve.label for curve in nine] == [str(k) for k in range(9)]
    assert len({curve.style.colour for curve in nine}) == len({curve.style.marker for curve in nine}) == 9
    two = plot_sweep.curves(sweep({PRELOAD: [0, 1], FRICTION: [0.1, 0.3]}))
    assert [curve.label for curve in two][:2] == ["0, 0.1", "0, 0.3"]
    assert two[2].where == {PRELOAD: 1, FRICTION: 0, "direction": 0}
    assert len({curve.style for curve in two}) == 4


def test_values_near_each_other_have_labels_of_their_own() -> None:
    assert values_labels([(200_010.0, 0.1 + 0.2)]) == ["200010, 0.3"]
    assert values_labels([(3.0, 0.1), (3.00000001, 0.1), (3.0, 0.2)]) == ["3, 0.1", "3.00000001, 0.1", "3, 0.2"]
    near = plot_sweep.curves(sweep({PRELOAD: [3.0, 3.00000001]}))
    assert [curve.label for curve in near] == ["3", "3.00000001"]
    assert told_apart([1.0, 1.0, np.nextafter(1.0, 2.0)]) == ["1", "1", "1.0000000000000002"]


def test_with_up_and_down_the_values_differ_in_lightness_and_the_directions_in_line() -> None:
    shown = plot_sweep.curves(sweep({PRELOAD: [0.0, 0.1, 0.2]}, ("up", "down")))
    assert [(curve.label, curve.direction) for curve in shown][:3] == [("0", "up"), ("0", "down"), ("0.1", "up")]
    assert [curve.style.line for curve in shown] == 3 * [LINES["up"], LINES["down"]]
    lightness = [np.dot(to_rgb(curve.style.colour), (0.3, 0.6, 0.1)) for curve in shown]
    assert np.diff(lightness)[::2] == pytest.approx(0)
    assert np.all(np.diff(lightness)[1::2] > 0.15)


def test_too_many_curves_are_left_out_and_counted() -> None:
    many = sweep({PRELOAD: np.linspace(0, 0.5, 40).tolist()}, frequency=np.array([0.9, 1.0]))
    shown = plot_sweep.curves(many)
    assert len(shown) == MAX_CURVES
    assert (shown[0].where[PRELOAD], shown[-1].where[PRELOAD]) == (0, 39)
    figure = plot_sweep.PICTURES["response"](many)
    assert figure is not None
    assert "28 of 40 sets of values not shown" in [text.get_text() for text in figure.texts]


def test_shares_of_the_states() -> None:
    data = sweep({PRELOAD: [0.0, 0.3]})
    for state in ("slip", "separation"):
        ax = plot_sweep.share(data, contact="stop", state=state)
        drawn = [line.get_ydata() for line in (*_lines(ax, "_0"), *_lines(ax, "_0.3"))]
        assert np.array_equal(drawn, data[f"{state}_share"].sel(contact="stop").values[:, 0])
        assert ax.get_ylabel() == f"share in {state} [1]"
    figure = plot_sweep.PICTURES["contact_states"](data)
    assert figure is not None
    assert [ax.get_title(loc="right") for ax in figure.axes] == ["pad", "pad", "stop", "stop"]
    assert plot_sweep.PICTURES["contact_states"](data.isel(contact=slice(0, 0))) is None


def test_a_state_that_never_occurs_has_a_note_and_no_axes() -> None:
    data = sweep()
    data.separation_share.loc[{"contact": "stop"}] = 0.0
    figure = plot_sweep.PICTURES["contact_states"](data)
    assert figure is not None
    assert [ax.get_title(loc="right") for ax in figure.axes] == ["pad", "pad", "stop"]
    assert "zero throughout: share in separation of stop" in [text.get_text() for text in figure.texts]
    still = data.assign(slip_share=0 * data.slip_share, separation_share=0 * data.separation_share)
    figure = plot_sweep.PICTURES["contact_states"](still)
    assert figure is not None
    assert len(figure.axes) == 1


def test_peaks_and_whether_they_lie_at_an_end() -> None:
    rows = np.array([[1, 3, 2], [5, 1, 2], [np.nan, 2, 4], [np.nan] * 3])
    largest, at_end = plot_sweep.peaks(rows)
    assert largest == pytest.approx([3, 5, np.nan, np.nan], nan_ok=True)
    assert at_end.tolist() == [False, True, False, False]
    assert not plot_sweep.peaks(rows[:, 1:2])[1].any()


def test_the_peak_against_a_scalar_in_its_order() -> None:
    data = sweep({PRELOAD: [0.2, 0.0, 0.1, 5.0]})
    ax = plot_sweep.peak(data)
    (line,) = _lines(ax, "peak")
    assert line.get_xdata().tolist() == [0.0, 0.1, 0.2, 5.0]
    amplitude = data.amplitude.sel(point="tip", axis="y").max("frequency").values[:, 0]
    assert line.get_ydata().tolist() == amplitude[[1, 2, 0, 3]].tolist()
    assert _lines(ax, "peak at an end of the frequencies")[0].get_xdata().tolist() == [5.0]
    (least,) = [line for line in ax.get_lines() if str(line.get_label()).startswith("least")]
    assert least.get_label() == f"least: {amplitude[1]:.4g} at 0, an end"
    assert ax.get_xlabel() == "pad preload [force]"
    assert ax.get_ylabel() == "peak amplitude of tip y [length]"


def test_one_direction_is_marked_at_every_point() -> None:
    data = sweep({PRELOAD: [0.0, 0.1, 0.2]}, ("up",))
    data.amplitude[..., [0, -1], :, :] = 0.0
    (line,) = _lines(plot_sweep.peak(data), "peak")
    assert _marked(line) == [0.0, 0.1, 0.2]


def _stars(ax: Axes) -> list[str]:
    return [str(line.get_label()) for line in ax.get_lines() if line.get_marker() == "*"]


def test_a_least_peak_in_the_middle_and_one_star_for_both_directions() -> None:
    data = sweep({PRELOAD: [0.0, 0.1, 0.2]}, ("up", "down"))
    data.amplitude[1] *= 0.1
    same = data.copy(deep=True)
    same.amplitude[:, 1] = same.amplitude[:, 0]
    (label,) = _stars(plot_sweep.peak(same))
    assert label.startswith("least of up and down:\n")
    assert label.endswith(" at 0.1")
    data.amplitude[:, 1] = 0.5 * data.amplitude[:, 0]
    assert len(_stars(plot_sweep.peak(data))) == 2
    figure = plot_sweep.PICTURES["peak"](same)
    assert figure is not None
    assert "of tip y, which moves most" in figure.get_suptitle()


def test_least_peaks_that_differ_by_rounding_have_one_star() -> None:
    data = sweep({PRELOAD: [0.0, 0.1, 0.2]}, ("up", "down"))
    # Each direction has its own least, and four digits of one are rounded up, of the other down.
    factor = np.array([[2, 2], [1 - 1e-9, 1 + 1e-9], [1 + 1e-9, 1 - 1e-9]])[..., None, None, None]
    one = data.amplitude.values[0, 0]
    data.amplitude[:] = factor * 0.15005 * one / one.max()
    (label,) = _stars(plot_sweep.peak(data))
    assert label.startswith("least of up and down:\n")
    assert label.endswith(" at 0.1")


def test_points_that_a_run_did_not_come_to_are_neither_failed_nor_judged() -> None:
    data = sweep({PRELOAD: [0.0, 0.1, 0.2]})
    data.amplitude[2, :, 25:] = np.nan
    data.settled[2, :, 25:] = 0
    response = plot_sweep.response(data)
    assert not _lines(response, "failed") + _lines(response, "not settled")
    ax = plot_sweep.peak(data)
    assert np.isfinite(_lines(ax, "peak")[0].get_ydata()).tolist() == [True, True, False]
    assert not _stars(ax)
    figure = plot_sweep.PICTURES["peak"](data.assign_attrs(complete=0))
    assert figure is not None
    assert "1 peak not shown: points are missing" in [text.get_text() for text in figure.texts]


def test_peaks_of_up_and_down_differ_by_marker() -> None:
    ax = plot_sweep.peak(sweep({FRICTION: [0.1, 0.3], PRELOAD: [0.0, 0.1, 0.2]}, ("up", "down")))
    for name in ("up", "down"):
        assert [line.get_marker() for line in _lines(ax, f"0.1, {name}")] == [PAIRED[name]]


def test_the_peak_of_two_scalars_takes_one_along_and_one_by_colour() -> None:
    data = sweep({FRICTION: [0.1, 0.3], PRELOAD: [0.0, 0.1, 0.2]})
    assert plot_sweep.most_valued(data) == PRELOAD
    ax = plot_sweep.peak(data)
    assert [len(line.get_xdata()) for label in ("0.1", "0.3") for line in _lines(ax, label)] == [3, 3]
    figure = plot_sweep.PICTURES["peak"](data)
    assert figure is not None
    assert [ax.get_xlabel() for ax in figure.axes] == ["pad preload [force]"]
    assert figure.axes[0].get_legend().get_title().get_text() == "pad friction [1]"
    assert plot_sweep.PICTURES["peak"](sweep({PRELOAD: [0.0, 0.1]})) is None


def test_stability_beside_its_limit() -> None:
    data = sweep()
    ax = plot_sweep.floquet(data)
    assert _lines(ax, "limit of stability")[0].get_ydata()[0] == 1.0
    assert set(_lines(ax, "_")[0].get_ydata()) == {0.8}
    assert plot_sweep.PICTURES["stability"](data.assign(floquet_max=np.nan * data.floquet_max)) is None


def test_the_limit_of_stability_lies_inside_the_axes_over_all_frequencies() -> None:
    """Multipliers just below 1, and none where the motion has not settled."""
    data = sweep()
    data.floquet_max[:], data.floquet_max[..., -8:] = np.linspace(0.86, 0.9999, FREQUENCY.size), np.nan
    ax = plot_sweep.floquet(data)
    assert ax.transAxes.inverted().transform(ax.transData.transform((1.0, 1.0)))[1] < 0.97
    assert ax.get_xlim()[0] < FREQUENCY[0] < FREQUENCY[-1] < ax.get_xlim()[1]


def test_all_pictures_of_a_sweep(both: xarray.Dataset, tmp_path: Path) -> None:
    assert plot.picture_names("sweep") == ["response.png", "peak.png", "contact_states.png", "stability.png"]
    data = sweep({PRELOAD: [0.0, 0.1, 0.2]})
    names = [file.stem for file in plot.draw(data, tmp_path)]
    assert names == ["response", "peak", "contact_states", "stability"]
    assert len(plot.draw(spoilt(data), tmp_path)) == 3
    assert len(plot.draw(both, tmp_path)) == 3


def test_pictures_with_logarithmic_axes_and_of_other_kinds(both: xarray.Dataset, tmp_path: Path) -> None:
    figure = plot_sweep.PICTURES["response"](both)
    assert figure is not None
    make_logarithmic(figure, ["amplitude"])
    ax = figure.axes[0]
    assert (ax.get_xscale(), ax.get_yscale()) == ("linear", "log")
    low, high = ax.get_ylim()
    known = both.amplitude.values[both.amplitude.values > 0]
    assert 0 < low < high
    assert high > known.max()
    make_logarithmic(figure, ["frequency"])
    assert ax.get_xscale() == "log"
    for kind, start in (("pdf", b"%PDF"), ("svg", b"<?xml")):
        first = plot.draw(both, tmp_path, kind=kind, log=["frequency"])[0]
        assert first.name == f"response.{kind}"
        written = first.read_bytes()
        assert written.startswith(start)
        plot.draw(both, tmp_path, kind=kind, log=["frequency"])
        assert first.read_bytes() == written
    with pytest.raises(ValueError, match="format must be one of png, pdf, svg, not eps"):
        plot.draw(both, tmp_path, kind="eps")
    with pytest.raises(ValueError, match="log must be one of amplitude, frequency, not phase"):
        plot.draw(both, tmp_path, log=["phase"])
    alone = {"stability": plot_sweep.PICTURES["stability"]}
    assert write(both, tmp_path, alone, log=["frequency"])
    with pytest.raises(ValueError, match="log: no picture of this result has an axis of amplitude that can be"):
        write(both, tmp_path, alone, log=["frequency", "amplitude"])


def test_the_phase_stands_below_its_amplitude() -> None:
    """It leaves its turn at the lower end and comes back at the upper one, with no line across."""
    data = sweep({PRELOAD: [0.0, 0.1]}, ("up", "down"))
    phase = np.linspace(-90, -270, data.sizes["frequency"])
    wrapped = np.where(phase <= -180, phase + 360, phase)
    data["phase_deg"] = data.amplitude.dims, np.broadcast_to(wrapped[:, None, None], data.amplitude.shape).copy()
    figure = plot_sweep.PICTURES["response"](data)
    assert figure is not None
    assert [ax.get_ylabel().split()[0] for ax in figure.axes] == ["amplitude", "phase"] * 2
    for line in figure.axes[1].get_lines():
        if line.get_linestyle() != "None":
            y = np.asarray(line.get_ydata(), dtype=float)
            assert np.isnan(y).sum() == 1
            assert np.nanmax(np.abs(np.diff(y))) < 90
    assert figure.axes[1].get_yticks().tolist() == [-180, -90, 0, 90, 180]


def test_a_phase_of_zero_but_for_rounding_needs_no_quarter_above_it() -> None:
    data = sweep()
    data["phase_deg"] = data.amplitude.dims, np.full(data.amplitude.shape, -30.0)
    data.phase_deg[0, :3] = 1e-9
    assert plot_sweep.phase(data).get_yticks().tolist() == [-90, 0]


def test_keys_are_words() -> None:
    assert key_words("contacts.left_pad.tangential_stiffness") == "left_pad tangential stiffness"
    assert key_words("contacts.*.tangential_stiffness") == "tangential stiffness"


def test_a_stop_without_friction_has_a_share_closed() -> None:
    data = sweep().assign_coords(friction=("contact", [0.0, 0.3]))
    labels = [plot_sweep.share(data, contact=name).get_ylabel() for name in CONTACTS]
    assert labels == ["share closed [1]", "share in slip [1]"]
    assert plot_sweep.share(data, contact=CONTACTS[0], state="separation").get_ylabel() == "share in separation [1]"


def test_a_stop_without_friction_has_no_slip_among_the_shares() -> None:
    """It is closed where it is not apart, which the share in separation says already."""
    data = sweep()
    for friction, shown, words in (
        ([0.0, 0.3], ["pad", "stop", "stop"], "in slip and in separation"),
        ([0.3, 0.0], ["pad", "pad", "stop"], "in slip and in separation"),
        ([0.0, 0.0], ["pad", "stop"], "in separation"),
    ):
        figure = plot_sweep.PICTURES["contact_states"](data.assign_coords(friction=("contact", friction)))
        assert figure is not None
        assert [ax.get_title(loc="right") for ax in figure.axes] == shown
        assert not any("closed" in ax.get_ylabel() for ax in figure.axes)
        assert figure.get_suptitle().endswith(f"shares of a period {words}")
    never = data.assign(separation_share=0 * data.separation_share)
    figure = plot_sweep.PICTURES["contact_states"](never.assign_coords(friction=("contact", [0.0, 0.0])))
    assert figure is not None
    assert "zero throughout: share in separation of pad, share in separation of stop" in [
        t.get_text() for t in figure.texts
    ]


def test_a_long_note_is_within_its_picture() -> None:
    data = sweep()
    apart = data.assign(separation_share=0 * data.separation_share)
    figure = plot_sweep.PICTURES["contact_states"](apart.assign_coords(contact=["W" * 30, "M" * 30]))
    assert figure is not None
    _, note = figure.texts
    assert note.get_text().startswith("zero throughout: share in separation of WWW")
    assert note.get_window_extent().x0 > 0
    assert note.get_window_extent().y0 > 0


def test_units_of_the_scene_are_those_of_the_labels() -> None:
    data = sweep({PRELOAD: [0.0, 0.1]})
    data.amplitude.attrs["units"], data[PRELOAD].attrs["units"] = "mm", "kN"
    assert plot_sweep.response(data).get_ylabel() == "amplitude of tip y [mm]"
    figure = plot_sweep.PICTURES["response"](data)
    assert figure is not None
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert "[kN]" in legend.get_title().get_text()
    (label,) = _stars(plot_sweep.peak(data))
    assert re.fullmatch(r"least: \S+ mm at 0 kN, an end", label)


def test_a_sweep_of_which_every_point_failed(tmp_path: Path) -> None:
    data = sweep({PRELOAD: [0.0, 0.1, 0.2]})
    for name in ("amplitude", "slip_share", "separation_share", "floquet_max"):
        data[name][:] = np.nan
    data.settled[:] = 0
    data["failure"] = data.failure.where(data.settled > 0, "no motion")
    assert [file.stem for file in plot.draw(data, tmp_path)] == ["response", "contact_states"]
    figure = plot_sweep.PICTURES["response"](data.assign_attrs(complete=0))
    assert figure is not None
    assert figure.get_suptitle().endswith("(incomplete run)")
    assert "failed" in _legend(figure.axes[0])


def test_a_run_that_came_to_no_point_has_no_picture(tmp_path: Path) -> None:
    """Its axes would have no scale; also one of a result with groups."""
    data = sweep({PRELOAD: [0.0, 0.1, 0.2]}).assign_attrs(complete=0)
    data.amplitude[:] = np.nan
    data.settled[:] = 0
    tree = xarray.DataTree.from_dict({"/": xarray.Dataset(attrs=data.attrs | {"study": "bistable"}), "/sweep": data})
    assert plot.draw(data, tmp_path) == plot.draw(tree, tmp_path) == []


def test_a_sweep_of_one_frequency(tmp_path: Path) -> None:
    data = sweep({PRELOAD: [0.0, 0.1, 0.2]}, frequency=np.array([1.0]))
    assert len(plot.draw(data, tmp_path)) == 4
    assert not _lines(plot_sweep.peak(data), "peak at an end of the frequencies")


def test_many_points_of_the_structure_are_left_out_and_counted() -> None:
    data = sweep()
    amplitude = data.amplitude.values[..., :1, :] * np.arange(1, 6)[:, None]
    many = data.drop_vars(["amplitude", "point"]).assign(amplitude=(data.amplitude.dims, amplitude))
    many = many.assign_coords(point=[f"p{k}" for k in range(5)])
    figure = plot_sweep.PICTURES["response"](many)
    assert figure is not None
    assert [ax.get_ylabel() for ax in figure.axes] == [f"amplitude of p{k} y [length]" for k in (4, 3, 2)]
    assert "2 of 5 points not shown" in [text.get_text() for text in figure.texts]


@pytest.mark.parametrize(
    "name", ["between disk and blade, lower edge, pressure side", "between_disk_and_blade_" * 3, "$a$ b" * 12]
)
def test_a_long_name_above_a_legend_leaves_its_entries_in_the_picture(name: str) -> None:
    figure = plot_sweep.PICTURES["response"](sweep({f"contacts.{name}.preload": [-1, 0.5]}))
    (legend,) = [ax.get_legend() for ax in figure.axes if ax.get_legend()]
    figure.canvas.draw()
    assert legend.get_window_extent().x1 <= figure.bbox.width
    assert "".join(legend.get_title().get_text().replace("\\", "").split()).startswith("".join(name.split()))
