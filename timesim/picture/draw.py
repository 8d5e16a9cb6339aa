"""Pictures of a run, drawn into its folder."""

import io
import warnings
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from timesim.picture.figure import DPI, plain_ticks, wrapped
from timesim.picture.style import Dataset, DataTree, Figure, Picture
from timesim.result.argument import list_of, shown
from timesim.result.file import StoreError, write_whole

KINDS = ("png", "pdf", "svg")
LOGARITHMIC = ("amplitude", "frequency")
SMALLEST = 1e-6  # share of the largest value down to which a logarithmic axis goes
ROUNDING = 1e-10  # share of a value over which no axis goes
BEYOND = 0.15  # inch by which the label of an ordinate may be longer than its axes
MARGIN = 9  # pixels of white around what is drawn
LEAST = {"time": 2, "angle": 2, "solution": 1}
"""Least length along these dimensions for which there is anything to draw."""


@contextmanager
def _boxes_for_missing_letters() -> Iterator[None]:
    """Letters that the font lacks are drawn as boxes, without a warning of each."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        yield


@_boxes_for_missing_letters()
def write(
    data: Dataset | DataTree,
    folder: Path | str,
    pictures: Mapping[str, Picture],
    *,
    kind: str = "png",
    log: Collection[str] = (),
) -> list[Path]:
    """Write the pictures of a result into an existing folder, replacing earlier ones.

    Args:
        pictures: those of the kind of study, by the name of their file.
        kind: format of the files, one of `KINDS`.
        log: quantities among `LOGARITHMIC` whose axes are logarithmic.

    Returns:
        The files written, in order; none for a study without pictures, or a run that has recorded nothing.

    Raises:
        StoreError: a file cannot be written, or the result lacks a variable that a picture shows.
        ValueError: the format or a quantity is unknown, or no picture has an axis of the quantity.
    """
    quantities = list_of("log", log, f"a list of {' and '.join(LOGARITHMIC)}")
    for name, given, known in (("format", [kind], KINDS), ("log", quantities, LOGARITHMIC)):
        named = [item if isinstance(item, str) else shown(item) for item in given]
        unknown = [item for item in named if item not in known]
        if unknown:
            raise ValueError(f"{name} must be one of {', '.join(known)}, not {', '.join(unknown)}")
    if any(data.sizes.get(name, least) < least for name, least in LEAST.items()) or not _begun(data):
        return []
    figures = _figures(data, pictures)
    met = set().union(*(make_logarithmic(figure, quantities) for figure in figures.values()))
    if figures and (unmet := [name for name in quantities if name not in met]):
        raise ValueError(f"log: no picture of this result has an axis of {' or '.join(unmet)} that can be logarithmic")
    written: list[Path] = []
    for name, figure in figures.items():
        widen_rounding(figure)
        put_factors_in_labels(figure)
        fit_ordinate_labels(figure)
        written.append(Path(folder) / f"{name}.{kind}")
        write_whole(written[-1], _png(figure) if kind == "png" else _vectors(figure, kind))
    return written


def _figures(data: Dataset | DataTree, pictures: Mapping[str, Picture]) -> dict[str, Figure]:
    """Those pictures that show something of the result, by their names."""
    figures: dict[str, Figure] = {}
    for name, picture in pictures.items():
        try:
            figure = picture(data)
        except Exception as error:  # xarray has several for a variable that a Dataset lacks, numpy for a wrong one
            why = ": ".join(filter(None, (type(error).__name__, " ".join(f"{error}".split()))))
            lacks = f"the result lacks what picture {name} shows ({why})"
            raise StoreError(f"{lacks}: draw a whole result, of this version") from error
        if figure is not None:
            figures[name] = figure
    return figures


def _begun(data: Dataset | DataTree) -> bool:
    """Whether any point or solution was computed, or failed, in any group of a result that has them."""
    parts = [part for part in getattr(data, "subtree", (data,)) if "amplitude" in part.variables]
    known = [np.isfinite(part["amplitude"].to_numpy()).any() for part in parts]
    failed = [(part["failure"].to_numpy() != "").any() for part in parts if "failure" in part.variables]
    return not parts or any(known + failed)


def make_logarithmic(figure: Figure, quantities: Collection[str]) -> set[str]:
    """Make those axes of a figure logarithmic whose labels name one of the quantities; returns those it did so for."""
    met: set[str] = set()
    for ax in figure.axes:
        words = (set(label.partition("[")[0].split()) for label in (ax.get_xlabel(), ax.get_ylabel()))  # without units
        along, up = (set(quantities) & named for named in words)
        if along:
            met |= along
            ax.set_xscale("log")
            plain_ticks(ax.xaxis, *ax.get_xlim())
        least, top = ax.dataLim.minposy, ax.dataLim.y1
        if up and 0 < least <= top < np.inf:
            met |= up
            low = ax.get_ylim()[0]
            ax.set_yscale("log")
            if low <= 0:
                ax.set_ylim(max(0.8 * least, SMALLEST * top), 1.25 * top)
            plain_ticks(ax.yaxis, *ax.get_ylim())
    return met


def widen_rounding(figure: Figure) -> None:
    """Wider limits about a value that is constant but for rounding, whose ticks would need all of their digits."""
    for ax in figure.axes:
        for get, put in ((ax.get_xlim, ax.set_xlim), (ax.get_ylim, ax.set_ylim)):
            low, high = get()
            if 0 < high - low < ROUNDING * max(abs(low), abs(high)):
                middle = (low + high) / 2
                put(middle - 0.1 * abs(middle), middle + 0.1 * abs(middle))


def put_factors_in_labels(figure: Figure) -> None:
    """Write the power of ten that all ticks of an axis share into the unit of its label: ``tip x [1e-6 m]``.

    Powers are those of SI prefixes, multiples of three.
    """
    from matplotlib.ticker import ScalarFormatter

    for axis in (axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)):
        before, bracket, unit = axis.get_label_text().rpartition("[")
        formatter = axis.get_major_formatter()
        if not (bracket and isinstance(formatter, ScalarFormatter)):
            continue
        formatter.set_locs(axis.get_majorticklocs().tolist())
        factor = formatter.get_offset().replace("\N{MINUS SIGN}", "-")  # 1e-5, or nothing
        power = 3 * (int(factor.partition("e")[2] or 0) // 3)
        if power:
            formatter.set_powerlimits((power, power))
            axis.get_offset_text().set_visible(False)
            axis.set_label_text(f"{before}[1e{power}{']' if unit == '1]' else f' {unit}'}")


def fit_ordinate_labels(figure: Figure) -> None:
    """Write the label of an ordinate that is longer than its axes on two lines, or smaller if ticks leave no room."""
    for ax in figure.axes:
        label, room, text = ax.yaxis.label, ax.bbox.height + BEYOND * figure.dpi, ax.get_ylabel()
        if label.get_window_extent().height > room:
            label.set(text=wrapped(text, len(text) // 2 + 6), linespacing=1.0)
            extent = ax.yaxis.get_tightbbox()
            if extent is not None and extent.x0 < 0:
                label.set_text(text)
            label.set_fontsize(float(label.get_fontsize()) * min(1.0, room / label.get_window_extent().height))


def _vectors(figure: Figure, kind: str) -> bytes:
    """A figure as vectors, cut to what is drawn; the same figure gives the same file."""
    from matplotlib import rc_context

    image, undated = io.BytesIO(), {"Date" if kind == "svg" else "CreationDate": None}
    with rc_context({"svg.hashsalt": "timesim"}):
        figure.savefig(image, format=kind, bbox_inches="tight", pad_inches=MARGIN / DPI, metadata=undated)
    return image.getvalue()


def _png(figure: Figure) -> bytes:
    """A figure as an image, cut to what is drawn, since the room for a legend or a note may be empty."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.image import imsave

    canvas = FigureCanvasAgg(figure)
    # Where the faces of a surface differ in size, matplotlib also projects uninitialised memory.
    with np.errstate(over="ignore"):
        canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())
    drawn = pixels[..., :3].min(axis=2) < 255
    cut = []
    for filled in (drawn.any(axis=1), drawn.any(axis=0)):
        places = np.flatnonzero(filled)
        cut.append(slice(max(0, places[0] - MARGIN), places[-1] + 1 + MARGIN))
    image = io.BytesIO()
    imsave(image, pixels[cut[0], cut[1]], format="png", dpi=DPI)
    return image.getvalue()
