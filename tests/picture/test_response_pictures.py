"""Pictures of curves and of ranges with two motions, of results put together by hand: nothing is hidden or covered."""

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from matplotlib.colors import to_rgb
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.markers import MarkerStyle

from timesim.picture import bistable, compare, draw, element, hbm, optimum

pytestmark = pytest.mark.long

PRELOAD = "contacts.pad.preload"
FREQUENCY = np.linspace(0.9, 1.1, 21)
SPOT, PLACES = ("point", "axis"), {"point": ["tip"], "axis": list("xyz"), "contact": ["pad"]}
ATTRS = {"complete": 1, "title": "An oscillator with a rather long title"}


def _amplitude(values: np.ndarray) -> np.ndarray:
    """Along x, of one point."""
    return np.asarray(values)[..., None, None] * np.array([1.0, 0.5, 0.0])


def _balance(preloads: list[float], height: float = 1.0) -> xarray.Dataset:
    """An S-shaped curve for each preload, its folds at 0.98 and 1.02."""
    s = np.linspace(-1.0, 1.0, 41)
    frequency = 1.0 + 0.1 * np.where(np.abs(s) < 0.4, -0.5 * s, np.sign(s) * (np.abs(s) - 0.6))
    fold = np.isclose(np.abs(s), 0.4)
    number = len(preloads)
    columns: dict[str, Any] = {
        PRELOAD: np.repeat(preloads, s.size),
        "frequency": np.tile(frequency, number),
        "stable": np.tile(np.abs(s) > 0.4, number).astype(int),
        "fold": np.tile(fold, number).astype(int),
        "curve": np.repeat(np.arange(number), s.size),
    }
    shape = (number * s.size,)
    variables = {name: ("solution", values) for name, values in columns.items()} | {
        "amplitude": (("solution", *SPOT), _amplitude(np.tile(height * (0.6 + 0.4 * s), number))),
        "slip_share": (("solution", "contact"), np.full((*shape, 1), 0.4)),
        "separation_share": (("solution", "contact"), np.zeros((*shape, 1))),
    }
    return xarray.Dataset(variables, {name: list(values) for name, values in PLACES.items()}, ATTRS)


def _sweep(preloads: list[float], height: float = 1.0) -> xarray.Dataset:
    shape = (len(preloads), 2, FREQUENCY.size)
    dims = (PRELOAD, "direction", "frequency")
    variables = {
        "amplitude": ((*dims, *SPOT), _amplitude(np.full(shape, height))),
        "settled": (dims, np.ones(shape, int)),
        "period": (dims, np.ones(shape, int)),
        "slip_share": ((*dims, "contact"), np.full((*shape, 1), 0.4)),
        "separation_share": ((*dims, "contact"), np.zeros((*shape, 1))),
    }
    coords = {PRELOAD: preloads, "direction": ["up", "down"], "frequency": FREQUENCY, **PLACES}
    return xarray.Dataset(variables, coords, ATTRS)


def two_motions(preloads: list[float]) -> xarray.DataTree:
    """The result of a `bistable` study: a range for each preload."""
    dims, shape = (PRELOAD, "jump"), (len(preloads), 1)
    ends = np.broadcast_to([0.98, 1.02], (*shape, 2))
    side = ("share_lower", "share_upper")
    variables = {
        "range": ((*dims, "end"), ends),
        "jump_from": ((*dims, "end", *SPOT), _amplitude(np.broadcast_to([0.44, 0.76], (*shape, 2)))),
        "jump_to": ((*dims, "end", *SPOT), _amplitude(np.broadcast_to([0.9, 0.3], (*shape, 2)))),
        "amplitude_lower": ((*dims, *SPOT), _amplitude(np.full(shape, 0.36))),
        "amplitude_upper": ((*dims, *SPOT), _amplitude(np.full(shape, 0.84))),
        "range_irregular": ((*dims, "end"), np.zeros((*shape, 2), int)),
        "start_branch": ((*dims, *side), np.broadcast_to([[0, 1], [1, 1]], (*shape, 2, 2))),
        "start_cycles": ((*dims, *side), np.full((*shape, 2, 2), 40)),
    }
    shares = {name: [0.0, 1.0] for name in side}
    root = xarray.Dataset(variables, {PRELOAD: preloads, **PLACES, **shares}, ATTRS | {"study": "bistable"})
    balance = _balance(preloads).drop_vars([*SPOT, "contact"])
    return xarray.DataTree.from_dict({"/": root, "/sweep": _sweep(preloads), "/hbm": balance})


def _covered(fig: Figure) -> list[tuple[str, str]]:
    """Pairs of titles, axis labels and legends of a figure that lie over each other."""
    fig.canvas.draw()
    boxes = {}
    for i, ax in enumerate(fig.axes):
        for text in (ax.title, ax._left_title, ax._right_title, ax.xaxis.label, ax.yaxis.label):  # type: ignore[attr-defined]
            if text.get_text() and text.get_visible():
                boxes[f"{i}: {text.get_text()}"] = text.get_window_extent()
        if legend := ax.get_legend():
            boxes[f"{i}: legend"] = legend.get_window_extent()
        boxes[f"{i}: axes"] = ax.get_window_extent()
    if fig.get_suptitle():
        boxes["heading"] = fig._suptitle.get_window_extent()  # type: ignore[attr-defined]
    return [(a, b) for a, b in combinations(boxes, 2) if boxes[a].padded(-1).overlaps(boxes[b].padded(-1))]


def test_two_motions_are_shown_where_the_summary_quotes_them() -> None:
    """Along y the sweeps are larger, and the motion with the larger amplitude of all the smaller of the two."""
    data = two_motions([2.0])
    data["amplitude_lower"][..., 1] = 0.8
    data["sweep"]["amplitude"][..., 1] = 2.0
    (place,) = bistable.ranges(data)
    for ax in (bistable.response(data), bistable.response(data, near=place)):
        assert " x " in ax.get_ylabel()
        stars = {
            str(line.get_label()): float(line.get_ydata()[0]) for line in ax.get_lines() if line.get_marker() == "*"
        }  # type: ignore[arg-type,index]
        assert stars == {"smaller motion": 0.36, "larger motion": 0.84}
    along = bistable.response(data, near=place, axis="y")
    assert " y " in along.get_ylabel()
    assert not [line for line in along.get_lines() if line.get_marker() == "*"]


@pytest.mark.parametrize("preloads", [[2.0], [1.8, 2.0], [1.8, 2.0, 2.2, 2.4, 2.6]])
def test_nothing_covers_a_label_of_two_motions(preloads: list[float], tmp_path: Path) -> None:
    data = two_motions(preloads)
    drawn = []
    for name, picture in bistable.PICTURES.items():
        fig = picture(data)
        if fig is not None:
            drawn.append(name)
            assert not _covered(fig), name
    assert drawn == ["response", "ranges", "starts", "existence"][: 3 + (len(preloads) > 1)]
    figure = bistable.PICTURES["ranges"](data)
    notes = [text.get_text() for text in figure.texts]
    assert ("1 of 5 ranges not shown" in notes) == (len(preloads) > 4)


def test_a_legend_names_what_is_drawn_and_nothing_else() -> None:
    def named(data: xarray.DataTree, picture: str) -> set[str]:
        legend = bistable.PICTURES[picture](data).axes[0].get_legend()
        return {text.get_text() for text in legend.get_texts()}

    whole = two_motions([2.0])
    swept = {"sweep up", "sweep down", "two motions", "jump", "smaller motion", "larger motion"}
    assert named(whole, "response") == swept | {"harmonic balance", "unstable", "fold"}
    assert named(two_motions([2.0]).drop_nodes("hbm"), "response") == swept
    whole["sweep"]["settled"][:] = 0
    assert "not settled" in named(whole, "response")


def test_a_legend_speaks_of_stability_where_some_solutions_are_unstable() -> None:
    for part, words in ((slice(None), ["2", "stable", "unstable", "fold"]), (slice(10), ["2"])):
        legend = hbm.PICTURES["response"](_balance([2.0]).isel(solution=part)).axes[0].get_legend()  # type: ignore[union-attr]
        assert [text.get_text() for text in legend.get_texts()] == words


def test_lines_of_both_sweeps_end_at_the_jumps_and_are_told_apart() -> None:
    """Up is wide and pale beneath down, which is dashed; the ranges are shaded behind amplitudes and phases alike."""
    data = two_motions([2.0])
    swept = data["sweep"].to_dataset().assign(jump_low=((PRELOAD, "direction", "jump"), [[[1.0149], [0.9751]]]))
    swept = swept.assign(jump_high=swept.jump_low + 2e-4, phase_deg=-90.0 * swept.amplitude)
    data["sweep"] = xarray.DataTree(swept)
    for ax in (bistable.response(data), bistable.phase(data)):
        up, down = (line for line in ax.get_lines() if str(line.get_label()).startswith("sweep"))
        for line, jump in ((up, 1.015), (down, 0.975)):
            x = np.asarray(line.get_xdata())
            (gap,) = np.flatnonzero(np.isnan(x))
            assert x[gap - 1] < jump < x[gap + 1]
            assert x[line.get_markevery()].tolist() == FREQUENCY.tolist()  # type: ignore[index]
        assert (up.get_linestyle(), down.get_linestyle()) == ("-", "--")
        assert up.get_linewidth() > 2 * down.get_linewidth()
        assert up.get_zorder() < down.get_zorder()
        (span,) = [patch for patch in ax.patches if patch.get_label() == "two motions"]
        assert (span.get_x(), span.get_width()) == pytest.approx((0.98, 0.04))  # type: ignore[attr-defined]


def test_a_window_without_points_of_a_sweep_does_not_name_it() -> None:
    data = two_motions([2.0])
    (place,) = bistable.ranges(data)
    assert "sweep up" in {line.get_label() for line in bistable.response(data, near=place).get_lines()}
    few = data["sweep"].to_dataset().isel(frequency=[0, 1, -1])
    data = xarray.DataTree.from_dict({"/": data.to_dataset(), "/sweep": few, "/hbm": data["hbm"].to_dataset(False)})
    assert "sweep up" not in {line.get_label() for line in bistable.response(data, near=place).get_lines()}


def test_ends_of_starts_are_told_apart_by_hatching() -> None:
    data = two_motions([2.0]).copy(deep=True)
    data["start_branch"][:] = np.array([[0, 1], [2, 3]])
    ax = bistable.starts(data)
    hatched = {str(patch.get_hatch()): patch.get_path().get_extents().bounds for patch in ax.patches}
    assert len(hatched) == 3
    for kind, (x, y) in {0: (-0.5, -0.5), 2: (-0.5, 0.5), 3: (0.5, 0.5)}.items():
        assert hatched[bistable.LED_TO[kind][2]] == pytest.approx((x, y, 1.0, 1.0))
    assert len({hatch for _, _, hatch in bistable.LED_TO.values()}) == 4
    figure = bistable.PICTURES["starts"](data)
    assert figure is not None
    patches = figure.axes[0].get_legend().get_patches()  # type: ignore[union-attr]
    assert [patch.get_hatch() or "" for patch in patches] == [bistable.LED_TO[kind][2] for kind in range(4)]


def test_starts_that_were_not_run_are_not_drawn() -> None:
    """They lead nowhere as those do that were run and did not settle."""
    data = two_motions([1.8, 2.0]).copy(deep=True)
    data["start_branch"][0], data["start_cycles"][0] = -1, -1
    figure = bistable.PICTURES["starts"](data)
    assert figure is not None
    assert len([ax for ax in figure.axes if ax.get_xlabel()]) == 1
    data["start_cycles"][:] = -1
    assert bistable.PICTURES["starts"](data) is None


def test_a_motion_that_loses_its_period_is_drawn_without_a_jump() -> None:
    data = two_motions([1.8, 2.0]).copy(deep=True)
    data["range_irregular"][0, 0, 1] = 1
    count = {line.get_label(): 0 for line in bistable.existence(data).get_lines()}
    for line in bistable.existence(data).get_lines():
        count[line.get_label()] += 1
    assert (count["the sweep down jumps"], count["the sweep up jumps"]) == (2, 1)
    first, second = bistable.ranges(data)
    arrows = [len(bistable.response(data, near=one).texts) for one in (first, second)]
    assert arrows == [1, 2]


def test_curves_of_nearly_the_same_value_are_told_apart() -> None:
    data = two_motions([2.0, 2.000001])
    lines = [
        line for line in bistable.response(data, at={PRELOAD: 0}).get_lines() if "balance" in str(line.get_label())
    ]
    alone = two_motions([2.0])
    assert len(lines) == len([x for x in bistable.response(alone).get_lines() if "balance" in str(x.get_label())])


def test_an_end_of_the_search_is_no_jump() -> None:
    """The response has no arrow there, and the picture of all ranges no marker."""
    data = two_motions([1.8, 2.0])
    data["jump_from"][1, 0, 1] = np.nan
    lines = bistable.existence(data).get_lines()
    for name, count in (("the sweep down jumps", 2), ("the sweep up jumps", 1)):
        assert sum(line.get_label() == name for line in lines) == count


def _lightness(colour: Any) -> float:
    return float(np.dot(to_rgb(colour), (0.3, 0.6, 0.1)))


def test_values_are_told_apart_without_colours() -> None:
    """Curves differ in lightness, since their lines tell stable parts; points of independent starts also by marker."""
    preloads = [1.8, 2.0, 2.2]
    lightness = [_lightness(family.style.colour) for family in hbm.families(_balance(preloads))]
    assert np.all(np.diff(lightness) > 0.15)
    swept = _sweep(preloads).isel(direction=[0]).assign_coords(direction=["independent"])
    tree = xarray.DataTree.from_dict({"/": xarray.Dataset(attrs=ATTRS), "/sweep": swept, "/hbm": _balance(preloads)})
    figure = compare.PICTURES["overlay"](tree)
    assert figure is not None
    drawn = [line.get_marker() for line in figure.axes[0].get_lines() if line.get_label() == "_time integration"]
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["1.8", "2", "2.2", "stable", "unstable", "fold"]
    assert drawn == [line.get_marker() for line in legend.get_lines()[:3]]
    tree["hbm"] = tree["hbm"].to_dataset().isel(solution=slice(3))
    legend = compare.PICTURES["overlay"](tree).axes[0].get_legend()  # type: ignore[union-attr]
    assert "harmonic balance" in [text.get_text() for text in legend.get_texts()]
    assert len({*drawn, "D"}) == 4


def test_harmonics_that_are_rounding_are_not_drawn() -> None:
    """A line from one that is would run out of the axes."""
    data = _balance([2.0])
    content = np.array([1e-17, 1.0, 1e-16, 1e-2])
    shape = (data.sizes["solution"], content.size, 1, 3)
    dims = ("solution", "harmonic", *SPOT)
    data["harmonic_amplitude"] = dims, np.broadcast_to(content[None, :, None, None], shape).copy()
    ax = hbm.harmonics(data.assign_coords(harmonic=np.arange(4)))
    assert ax.get_xlim() == (-0.5, 3.5)
    (line,) = ax.get_lines()
    assert np.isfinite(line.get_ydata()).tolist() == [False, True, False, True]


def _two_methods() -> xarray.DataTree:
    """A cycle in which both methods agree."""
    angle = np.arange(0, 360, 5.0)
    x = np.cos(np.deg2rad(angle)) * np.array([1.0, 0.5, 0.0])[:, None]
    spot = ("found_by", *SPOT)
    variables: dict[str, Any] = {
        "displacement": ((*spot, "excitation_angle"), np.broadcast_to(x, (2, 1, *x.shape))),
        "harmonic_amplitude": ((*spot, "harmonic"), np.broadcast_to([1e-14, 1.0, 1e-3], (2, 1, 3, 3))),
    }
    coords = {"found_by": ["sweep", "hbm"], "excitation_angle": angle, "harmonic": [0, 1, 2], **PLACES}
    return xarray.DataTree.from_dict({"/cycle": xarray.Dataset(variables, coords)})


def test_both_methods_are_seen_where_they_agree() -> None:
    march, balance = compare.waveform(_two_methods()).get_lines()
    assert march.get_linewidth() > 2 * balance.get_linewidth()
    assert (march.get_linestyle(), balance.get_linestyle()) == ("-", "--")
    assert march.get_zorder() < balance.get_zorder()
    ax = compare.harmonics(_two_methods())
    assert ax.get_xlabel() == "harmonic (circles: time integration, squares: harmonic balance)"
    assert [line.get_marker() for line in ax.get_lines()] == ["o", "s"]
    assert all(np.isnan(line.get_ydata()).tolist() == [True, False, False] for line in ax.get_lines())


def test_points_above_the_curves_are_shown() -> None:
    tree = xarray.DataTree.from_dict({"/sweep": _sweep([2.0], height=3.0), "/hbm": _balance([2.0])})
    assert hbm.response(tree["hbm"].to_dataset()).get_ylim()[1] < 1.2
    assert compare.overlay(tree).get_ylim()[1] > 3.0


def test_the_point_and_the_axis_that_are_compared_may_be_chosen() -> None:
    tree = xarray.DataTree.from_dict({"/sweep": _sweep([2.0]), "/hbm": _balance([2.0])})
    for axis in "xy":
        assert f" {axis}" in compare.overlay(tree, point="tip", axis=axis).get_ylabel()


def test_a_sweep_of_which_every_point_failed_has_no_place_in_the_legend() -> None:
    tree = xarray.DataTree.from_dict({"/sweep": _sweep([2.0], height=np.nan), "/hbm": _balance([2.0])})
    assert not [line for line in compare.overlay(tree).get_lines() if "time integration" in str(line.get_label())]


def test_up_and_down_are_told_apart_where_they_coincide() -> None:
    """Each marker lies on its own side of the point."""
    tree = xarray.DataTree.from_dict({"/sweep": _sweep([2.0]), "/hbm": _balance([2.0])})
    looks = {str(line.get_label()): line.get_marker() for line in compare.overlay(tree).get_lines()}
    up, down = (MarkerStyle(looks[f"time integration, {name}"]) for name in ("up", "down"))
    extents = [mark.get_path().transformed(mark.get_transform()).get_extents() for mark in (up, down)]
    assert extents[0].y0 > -1e-9 > extents[1].y0
    assert extents[1].y1 < 1e-9 < extents[0].y1
    two = bistable.response(two_motions([2.0]))
    marks = {str(line.get_label()): line.get_marker() for line in two.get_lines()}
    assert [marks[f"sweep {name}"] for name in ("up", "down")] == [up.get_marker(), down.get_marker()]


def test_a_motion_of_several_cycles_is_ringed() -> None:
    """The balance has no such motion: a difference from it is none of the methods."""
    swept = _sweep([2.0])
    off = xarray.Dataset({"relative_difference": swept.amplitude * 1e-5})
    tree = xarray.DataTree.from_dict(
        {"/": off.drop_vars(["frequency", PRELOAD]), "/sweep": swept, "/hbm": _balance([2.0])}
    )
    for period, ringed in ((1, []), (2, [FREQUENCY[3]])):
        tree["sweep"].period[0, 1, 3] = period
        for picture in (compare.overlay, compare.difference, compare.share):
            rings = [line for line in picture(tree).get_lines() if line.get_label() == "period of several cycles"]
            assert [x for ring in rings for x in ring.get_xdata()] == ringed
    tree["relative_difference"][0, 1, 3] = np.nan
    labels = [line.get_label() for line in compare.difference(tree).get_lines()]
    assert "period of several cycles" not in labels, "it is not shown there"


def test_a_difference_by_another_offset_is_crossed_out() -> None:
    """The verdict leaves it out: it is none of the methods."""
    swept = _sweep([2.0])
    off = xarray.Dataset({"relative_difference": swept.amplitude * 1e-5, "other_offset": 0 * swept.settled})
    tree = xarray.DataTree.from_dict(
        {"/": off.drop_vars(["frequency", PRELOAD]), "/sweep": swept, "/hbm": _balance([2.0])}
    )
    for other, crossed in ((0, []), (1, [FREQUENCY[3]])):
        tree["other_offset"][0, 1, 3] = other
        lines = [line for line in compare.difference(tree).get_lines() if "another offset" in str(line.get_label())]
        assert [x for line in lines for x in line.get_xdata()] == crossed


def test_differences_of_one_size_are_shown_over_two_decades() -> None:
    """Below that every tick has a label, which pushes that of the axis out of the picture."""
    swept = _sweep([2.0])
    off = xarray.Dataset({"relative_difference": 1e-6 * (1 + 0.0 * swept.amplitude)})
    tree = xarray.DataTree.from_dict(
        {"/": off.drop_vars(["frequency", PRELOAD]), "/sweep": swept, "/hbm": _balance([2.0])}
    )
    low, high = compare.difference(tree).get_ylim()
    assert low < 1e-6 < high
    assert high > 100 * low


@pytest.mark.parametrize(("friction", "rows"), [(0.3, ["slip", "separation"]), (0.0, ["separation"])])
def test_a_difference_shows_the_slip_of_contacts_with_friction(friction: float, rows: list[str]) -> None:
    balance, swept = (data.assign_coords(friction=("contact", [friction])) for data in (_balance([2.0]), _sweep([2.0])))
    off = xarray.Dataset({"relative_difference": swept.amplitude * 1e-5}, attrs=ATTRS)
    groups = {"/": off.drop_vars(["frequency", PRELOAD, "friction"], errors="ignore"), "/sweep": swept, "/hbm": balance}
    figure = compare.PICTURES["difference"](xarray.DataTree.from_dict(groups))
    assert figure is not None
    assert [ax.get_ylabel() for ax in figure.axes[1:]] == [f"share in {state} [1]" for state in rows]


def test_phases_by_both_methods_below_the_amplitudes() -> None:
    balance, swept = _balance([2.0]), _sweep([2.0])
    balance["phase_deg"] = balance.amplitude.dims, -90.0 * balance.amplitude.values
    swept["phase_deg"] = swept.amplitude.dims, -90.0 * swept.amplitude.values
    tree = xarray.DataTree.from_dict({"/": xarray.Dataset(attrs=ATTRS), "/sweep": swept, "/hbm": balance})
    figure = compare.PICTURES["overlay"](tree)
    assert figure is not None
    above, below = figure.axes
    assert (above.get_ylabel(), below.get_ylabel()) == ("amplitude of tip x [length]", "phase [degree]")
    assert sum(str(line.get_label()).startswith("time integration") for line in below.get_lines()) == 2
    assert below.get_ylim()[0] < -90


@pytest.mark.parametrize("followed", [[2.0], []])
def test_points_without_a_curve_are_shown_and_named(followed: list[float]) -> None:
    tree = xarray.DataTree.from_dict({"/": xarray.Dataset(attrs=ATTRS), "/sweep": _sweep([1.8, 2.0])})
    tree["hbm"] = xarray.DataTree(_balance([2.0]).isel(solution=slice(None if followed else 0)))
    alone = 2 - len(followed)
    lines = [line for line in compare.overlay(tree).get_lines() if line.get_label() == "time integration, up, no curve"]
    assert [line.get_xdata().size for line in lines] == [FREQUENCY.size] * alone
    assert all(line.get_fillstyle() == "none" for line in lines)  # in the legend, too, unlike those of a curve
    fig = compare.PICTURES["overlay"](tree)
    named = {text.get_text() for text in fig.axes[0].get_legend().get_texts()}
    assert {f"time integration, {way}, no curve" for way in ("up", "down")} <= named
    assert ("time integration, up" in named) == bool(followed)


def _optimum(values: list[float], peaks: list[float]) -> xarray.Dataset:
    """The result of an `optimum` study, with resonances of these peaks at 1 Hz."""
    shape = 1 / (1 + ((FREQUENCY - 1.0) / 0.05) ** 2)
    best, columns = int(np.argmin(peaks)), {"peak": peaks, "peak_frequency": np.ones(len(peaks))}
    dims = (PRELOAD, "direction", "frequency", *SPOT)
    amplitude = _amplitude(np.array(peaks)[:, None, None] * np.stack([shape, shape]))
    least = {"optimum": values[best], "optimum_peak": peaks[best], "optimum_frequency": 1.0}
    variables = {name: (PRELOAD, column) for name, column in columns.items()} | {"amplitude": (dims, amplitude)}
    variables |= {"phase_deg": (dims, -90.0 * amplitude), "peak_at_end": (PRELOAD, np.zeros(len(peaks), int))}
    coords = {PRELOAD: values, "direction": ["up", "down"], "frequency": FREQUENCY, **PLACES}
    return xarray.Dataset(variables | {name: ((), value) for name, value in least.items()}, coords, ATTRS)


def test_the_scale_shows_the_optimum() -> None:
    """On a linear axis a peak of a hundredth of the others would lie at its foot."""
    wide, narrow = _optimum([0.1, 1.0, 10.0], [40.0, 0.4, 20.0]), _optimum([1.0, 2.0, 3.0], [4.0, 0.4, 2.0])
    for data, scale in ((wide, "log"), (narrow, "linear")):
        for picture in (optimum.peak, optimum.responses):
            ax = picture(data)
            assert ax.get_yscale() == scale
            foot = ax.transData.transform((1.0, float(data.optimum_peak)))[1]
            assert foot > ax.bbox.y0 + 0.05 * ax.bbox.height
        near = optimum.magnified(data)
        assert (near.get_xscale(), near.get_yscale()) == ("linear", "linear")
        assert near.get_ylim()[1] < 3 * float(data.optimum_peak)
        assert near.get_xlim()[0] > 0


def test_a_least_peak_without_neighbours_is_not_magnified() -> None:
    """As where a search has hardly begun: the panel would hold one star."""
    for values, panels in (([1.0, 20.0, 40.0], 1), ([1.0, 20.0, 21.0, 22.0, 40.0], 2)):
        figure = optimum.PICTURES["peak"](_optimum(values, [4.0, *(0.4 + 0.1 * np.arange(len(values) - 2)), 2.0]))
        assert figure is not None
        assert len(figure.axes) == panels


def test_peaks_of_several_axes_lie_on_curves_of_them_all() -> None:
    """Of one axis alone the dots of the others would float above the curves, and no phase is that of all."""
    data = _optimum([1.0, 2.0, 3.0], [4.0, 0.4, 2.0]).assign(peak_of=(PRELOAD, ["tip y", "tip x", "tip x"]))
    data["amplitude"].loc[{PRELOAD: 1.0, "axis": "y"}] = data["amplitude"].loc[{PRELOAD: 1.0, "axis": "x"}].values
    data["amplitude"].loc[{PRELOAD: 1.0, "axis": "x"}] *= 0.1
    for picture, said in (
        (optimum.responses, "amplitude of tip, any axis"),
        (optimum.peak, "peak amplitude of tip, any"),
    ):
        assert picture(data).get_ylabel().startswith(said)
    assert max(line.get_ydata().max() for line in optimum.responses(data).get_lines() if len(line.get_xdata()) > 1) == 4
    figure = optimum.PICTURES["response"](data)
    assert figure is not None
    assert len(figure.axes) == 1
    assert optimum.peak(data.isel({PRELOAD: [1, 2]})).get_ylabel().startswith("peak amplitude of tip x")


def test_where_no_phase_is_known_there_are_no_axes_for_it() -> None:
    """A force of higher harmonics alone has no first one to compare with."""
    data = _optimum([1.0, 2.0, 3.0], [4.0, 0.4, 2.0])
    for known, panels in ((data, 2), (data.assign(phase_deg=np.nan * data["phase_deg"]), 1)):
        figure = optimum.PICTURES["response"](known)
        assert figure is not None
        assert len(figure.axes) == panels


def test_an_optimum_of_which_every_point_failed() -> None:
    data = _optimum([1.0, 2.0, 3.0], [4.0, 0.4, 2.0])
    for name in ("peak", "optimum_peak", "optimum_frequency", "amplitude"):
        data[name][...] = np.nan
    for picture in (optimum.peak, optimum.responses):
        assert not [line for line in picture(data).get_lines() if line.get_marker() == "*"]
    assert optimum.PICTURES["peak"](data) is optimum.PICTURES["response"](data) is None


def test_the_best_point_has_a_star_whose_value_the_legend_names() -> None:
    data = _optimum([1.0, 2.0, 3.0], [4.0, 0.4, 2.0])
    for name, place, words in (
        ("peak", (2.0, 0.4), "least: 0.4\nat 2"),
        ("response", (1.0, 0.4), "least peak: 0.4\nat 1 Hz"),
    ):
        figure = optimum.PICTURES[name](data)
        assert figure is not None
        (star,) = [line for line in figure.axes[0].get_lines() if line.get_marker() == "*"]
        assert np.ravel(star.get_xydata()).tolist() == list(place)
        legend = figure.axes[0].get_legend()
        assert legend is not None
        assert words in [text.get_text() for text in legend.get_texts()]


def test_the_value_of_the_best_point_fits_beside_the_axes() -> None:
    data = _optimum([1.2345e-5, 2.0, 3.0], [4.3922e-4, 0.4, 2.0])
    data["peak"].attrs["units"] = "mm"
    figure = optimum.PICTURES["peak"](data)
    assert figure is not None
    figure.canvas.draw()
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert "an end" in legend.get_texts()[-1].get_text()
    assert legend.get_window_extent().x1 < figure.bbox.x1


def test_responses_of_both_sweeps_are_told_apart() -> None:
    figure = optimum.PICTURES["response"](_optimum([1.0, 2.0, 3.0], [4.0, 0.4, 2.0]))
    assert figure is not None
    for ax in figure.axes:
        lines = [line for line in ax.get_lines() if line.get_xydata().shape[0] == FREQUENCY.size]
        assert [line.get_linestyle() for line in lines] == 3 * ["-", "--"]
        assert all(
            up.get_linewidth() > 2 * down.get_linewidth() for up, down in zip(lines[::2], lines[1::2], strict=True)
        )
    named = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]  # type: ignore[union-attr]
    assert named[:5] == ["1", "3", "2, the least", "up", "down"]


def _map(values: np.ndarray) -> xarray.Dataset:
    a = np.linspace(0, 4, values.shape[0])
    coefficient = (("a", "b", "tangent"), np.stack([values, 0.5 * values], axis=-1))
    variables = dict.fromkeys(("f_b", "f_s", "f_c"), coefficient) | {"dissipation": (("a", "b"), values)}
    variables["settled"] = ("a", "b"), np.isfinite(values).astype(np.int8)
    coords = {"a": a, "b": np.linspace(0, 4, values.shape[1]), "tangent": ["t1", "t2"]}
    return xarray.Dataset(variables, coords, ATTRS | {"study": "element_map"})


def test_surfaces_whatever_is_in_memory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Faces of a surface are smaller at its end if the stride leaves a rest: matplotlib pads them with unset memory."""
    empty = np.empty

    def garbage(shape: Any, dtype: Any = float, *args: Any, **options: Any) -> np.ndarray:
        array = empty(shape, dtype, *args, **options)
        if array.dtype.kind == "f" and array.ndim == 3:
            array.fill(1e308)
        return array

    data = _map(1e-3 * np.add.outer(np.arange(56.0), np.arange(56.0)))
    monkeypatch.setattr(np, "empty", garbage)
    assert [path.stem for path in draw.write(data, tmp_path, element.MAP_PICTURES)] == ["surfaces", "contours"]


@pytest.mark.parametrize("varied", ["a", "b"])
def test_a_map_of_which_one_parameter_varies_is_drawn_over_that(varied: str, tmp_path: Path) -> None:
    data = _map(1e-3 * np.arange(9.0).reshape((9, 1) if varied == "a" else (1, 9)))
    assert [path.stem for path in draw.write(data, tmp_path, element.MAP_PICTURES)] == ["coefficients"]
    (line,) = element.profile(data).lines
    np.testing.assert_array_equal(line.get_xydata(), np.stack([data[varied], data.f_s[..., 0].values.ravel()], axis=1))
    assert not draw.write(_map(np.ones((1, 1))), tmp_path, element.MAP_PICTURES)


def test_surfaces_and_contours_have_colour_bars() -> None:
    data = _map(1e-3 * np.add.outer(np.arange(8.0), np.arange(8.0)))
    for name in ("surfaces", "contours"):
        figure = element.MAP_PICTURES[name](data)
        assert figure is not None
        assert sum(ax.get_label() == "<colorbar>" for ax in figure.axes) == 6


def test_a_coefficient_that_is_the_same_everywhere_is_a_number() -> None:
    ax = element.contour(_map(np.full((4, 5), 0.25)))
    assert [text.get_text() for text in ax.texts] == ["0.25 everywhere"]
    assert ax.get_xlim() == (0, 4)


def test_what_is_not_computed_of_a_map_is_left_blank(tmp_path: Path) -> None:
    """Not drawn as zero, of which it could not be told: in part, all but a constant, and everywhere."""
    values = 1.0 + np.add.outer(np.arange(8.0), np.arange(8.0))
    values[:, 4:] = np.nan
    (shades, *_) = element.contour(_map(values)).collections
    assert shades.get_array().min() >= 0.5
    assert shades.get_datalim(shades.axes.transData).y1 <= 4 * 3 / 7 + 1e-9
    (faces,) = element.surface(_map(values)).collections
    assert np.nanmin(faces.get_array()) >= 1
    some = np.where(np.isnan(values), np.nan, 2.0)
    for field, said in ((some, "2 wherever it is computed"), (np.full_like(values, np.nan), "nothing is computed")):
        assert [text.get_text() for text in element.contour(_map(field)).texts] == [said]
        draw.write(_map(field), tmp_path, element.MAP_PICTURES)
    assert [text.get_text() for text in element.surface(_map(field)).texts] == [said]


def test_what_has_not_settled_of_a_map_is_left_blank() -> None:
    """As where a run was interrupted; and the colour bar spans what is shown, not the means of its faces."""
    data = _map(np.add.outer(np.arange(5.0), np.arange(5.0)))
    data["settled"][3:] = 0
    begun = data.assign(dissipation=data.dissipation.where(data.a < data.a[4]))
    notes = [text.get_text() for text in element.MAP_PICTURES["contours"](begun).texts]
    assert "blank: 5 points that had not settled; blank: 5 points not computed" in notes
    shades = element.contour(data).collections[0]
    assert shades.get_datalim(shades.axes.transData).x1 <= 2 + 1e-9
    (faces,) = element.surface(data).collections
    assert faces.get_clim() == (0, 6)
    for name in ("surfaces", "contours"):
        drawn = element.MAP_PICTURES[name](data)
        assert drawn is not None
        assert "blank: 10 points that had not settled" in [text.get_text() for text in drawn.texts]


def test_a_surface_hides_no_point() -> None:
    """Over equal amplitudes too: the half b > a has coefficients of its own."""
    square = _map(np.add.outer(np.arange(5.0), np.arange(5.0)))
    for data in (square, square.assign_coords(b=square.b + 3)):
        assert len(element.surface(data).collections[0].get_array()) == 16


def test_noise_of_the_steps_is_no_landscape() -> None:
    """A coefficient that is zero by symmetry is drawn as zero, beside those that are not."""
    data = _map(np.add.outer(np.arange(8.0), np.arange(8.0)))
    data["f_b"] = 1e-9 * data["f_b"]
    ax = element.contour(data, name="f_b")
    assert [text.get_text() for text in ax.texts] == ["0 everywhere"]
    (faces,) = element.surface(data, name="f_b").collections
    assert not faces.get_array().any()
    assert not element.contour(data, name="f_s").texts[0].get_text().endswith("everywhere")


def test_noise_beside_a_landscape_is_zero() -> None:
    """Where the contact sticks a coefficient is zero: no contour lines run through its rounding."""
    values = np.add.outer(np.arange(16.0), np.arange(16.0)) - 12
    noise = 1e-9 * np.where((np.arange(256) % 2).reshape(16, 16), 1.0, -1.0)
    ax = element.contour(_map(np.where(values > 0, values, noise)))
    (lines,) = [shown for shown in ax.collections if isinstance(shown, ContourSet) and not shown.filled]
    assert lines.levels[0] == 0
    assert all(np.sum(line, axis=1).min() > 4 * 11 / 15 for line in lines.allsegs[0] if len(line))


def test_labels_of_contour_lines_do_not_cover_each_other() -> None:
    """Near a corner lines are too dense for all of them."""
    x = np.linspace(0, 1, 61)
    radius = np.hypot(*np.meshgrid(x, x))
    ax = element.contour(_map(1 / (0.15 + radius)))
    ax.figure.canvas.draw()
    boxes = [text.get_window_extent() for text in ax.texts]
    assert len(boxes) >= 2
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    assert all(ax.bbox.contains(*box.min) and ax.bbox.contains(*box.max) for box in boxes)


def _element() -> xarray.Dataset:
    theta = np.deg2rad(np.arange(0, 360, 5.0))
    force = np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    angles = np.arange(10.0, 360, 60)
    there = np.deg2rad(angles)
    variables = {
        "force": (("angle", "tangent"), force),
        "first_force": (("angle", "tangent"), force),
        "state": ("angle", np.ones(theta.size, int)),
        "normal_load": ("angle", np.full(theta.size, 2.0)),
        "transition_angle_deg": ("event", angles),
        "transition_force": (("event", "tangent"), np.stack([np.cos(there), np.sin(there)], axis=-1)),
    }
    return xarray.Dataset(variables, {"angle": np.rad2deg(theta), "tangent": ["t1", "t2"]}, ATTRS | {"friction": 0.5})


def test_limit_and_force_are_seen_where_they_agree() -> None:
    data = _element().assign(transition_to=("event", np.ones(6, int)))
    limit, force = element.friction_limit(data).get_lines()[:2]
    assert limit.get_linewidth() > 2 * force.get_linewidth()
    assert limit.get_zorder() < force.get_zorder()
    assert (limit.get_linestyle(), force.get_linestyle()) == ("-", "--")


def test_the_picture_of_hysteresis_has_the_loss_and_its_unit() -> None:
    data = _element()
    figure = element.PICTURES["hysteresis"](data.assign(u=data.force, dissipation=((), 0.25)))
    assert figure is not None
    assert figure.get_suptitle().endswith("hysteresis, steady cycle, which dissipates 0.25 force·length")


def test_a_contact_without_a_force_says_so() -> None:
    """And the loss of one that sticks is zero, not what rounding leaves of it."""
    data = _element()
    figure = element.PICTURES["hysteresis"](data.assign(u=data.force, dissipation=((), -3.7e-19)))
    assert figure is not None
    assert figure.get_suptitle().endswith("which dissipates 0 force·length")
    apart = data.drop_dims("event").assign(transition_to=("event", []), transition_angle_deg=("event", []))
    apart = apart.assign(transition_force=(("event", "tangent"), np.zeros((0, 2))))
    apart = apart.assign(force=0 * data.force, first_force=0 * data.force)
    for one, said in ((apart, True), (data, False)):
        figure = element.PICTURES["force_path"](one)
        assert figure is not None
        assert ("no friction force at any angle" in [text.get_text() for text in figure.axes[0].texts]) == said


def test_angles_stand_beside_their_transitions() -> None:
    ax = element.force_path(_element())
    ax.figure.canvas.draw()
    dots = [line.get_xydata()[0] for line in ax.get_lines() if line.get_marker() == "o" and len(line.get_xydata()) == 1]
    assert len(dots) == len(ax.texts) == 6
    assert all(text.get_bbox_patch() is not None for text in ax.texts), "readable over a curve"
    for text, dot in zip(ax.texts, dots, strict=True):
        box = text.get_window_extent()
        x, y = ax.transData.transform(dot)
        assert not box.padded(2).contains(x, y), text.get_text()


def test_of_contacts_that_do_alike_the_first_is_shown() -> None:
    """Not the one that rounding makes busiest."""
    both = [_balance([2.0]), _sweep([2.0])]
    hbm_data, swept = (
        xarray.concat([one.assign_coords(contact=[name]) for name in ("a", "b")], "contact", data_vars="minimal")
        for one in both
    )
    hbm_data["slip_share"] = hbm_data.slip_share + 1e-12 * xarray.DataArray([0, 1], dims="contact")
    tree = xarray.DataTree.from_dict({"/": xarray.Dataset(attrs=ATTRS), "/sweep": swept, "/hbm": hbm_data})
    assert compare.share(tree).get_title(loc="right") == "a"
