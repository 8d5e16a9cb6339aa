"""Pictures of a run, drawn into its folder."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from timesim.picture.style import Picture
from timesim.result.file import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset, DataTree

DPI = 110
MARGIN = 9  # pixels of white around what is drawn
LEAST = {"time": 2, "angle": 2, "solution": 1}
"""Length along these dimensions below which there is nothing to draw."""


def write(data: "Dataset | DataTree", folder: Path | str, pictures: Mapping[str, Picture]) -> list[Path]:
    """Write the pictures of a result into a folder as PNG, replacing earlier ones.

    Args:
        data: the result, a Dataset, or the DataTree of one with groups.
        folder: an existing folder.
        pictures: those of the kind of study, by the name of their file.

    Returns:
        The files written, in order; none for a study that has no pictures, or a run that recorded nothing.

    Raises:
        StoreError: a file cannot be written.
    """
    written: list[Path] = []
    if any(data.sizes.get(name, least) < least for name, least in LEAST.items()):
        return written
    for name, picture in pictures.items():
        figure = picture(data)
        if figure is not None:
            written.append(Path(folder) / f"{name}.png")
            write_whole(written[-1], _png(figure))
    return written


def _png(figure: "Figure") -> memoryview:
    """A figure as an image, cut to what is drawn: room that was kept for a legend or a note may be empty."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.image import imsave

    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    # Where the faces of a surface differ in size, matplotlib projects memory too that it has never set.
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
    return image.getbuffer()
