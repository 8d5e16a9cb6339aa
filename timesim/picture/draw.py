"""Pictures of a run: which a kind of study has, drawn into its folder."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from timesim.picture import bistable, compare, element, element_map, hbm, jump, optimum, sweep, transient
from timesim.picture.style import Picture
from timesim.result.file import write_whole

if TYPE_CHECKING:
    import matplotlib.figure
    import xarray

DPI = 110
MARGIN = 9  # pixels of white around what is drawn


PICTURES: Mapping[str, Mapping[str, Picture]] = {
    "transient": transient.PICTURES,
    "jump": jump.PICTURES,
    "sweep": sweep.PICTURES,
    "element": element.PICTURES,
    "element_map": element_map.PICTURES,
    "hbm": hbm.PICTURES,
    "compare": compare.PICTURES,
    "bistable": bistable.PICTURES,
    "optimum": optimum.PICTURES,
}
"""The pictures of each kind of study, by the name of their file."""


def draw(data: "xarray.Dataset | xarray.DataTree", folder: Path | str) -> list[Path]:
    """Write the pictures of a result into a folder as PNG, replacing earlier ones.

    Args:
        data: the result, a Dataset, or the DataTree of one with groups.
        folder: an existing folder.

    Returns:
        The files written, in order; none for a study that has no pictures, or a run that recorded nothing.

    Raises:
        StoreError: a file cannot be written.
    """
    written: list[Path] = []
    if data.sizes.get("time", 2) < 2:
        return written
    for name, picture in PICTURES.get(str(data.attrs["study"]), {}).items():
        figure = picture(data)
        if figure is not None:
            written.append(Path(folder) / f"{name}.png")
            write_whole(written[-1], _png(figure))
    return written


def _png(made: "matplotlib.figure.Figure") -> memoryview:
    """A figure as an image, cut to what is drawn: room that was kept for a legend or a note may be empty."""
    from matplotlib.image import imsave

    made.set_dpi(DPI)
    # Where the faces of a surface differ in size, matplotlib projects memory too that it has never set.
    with np.errstate(over="ignore"):
        made.canvas.draw()
    pixels = np.asarray(made.canvas.buffer_rgba())  # type: ignore[attr-defined]
    drawn = pixels[..., :3].min(axis=2) < 255
    cut = []
    for filled in (drawn.any(axis=1), drawn.any(axis=0)):
        found = np.flatnonzero(filled)
        cut.append(slice(max(0, found[0] - MARGIN), found[-1] + 1 + MARGIN))
    image = io.BytesIO()
    imsave(image, pixels[cut[0], cut[1]], format="png", dpi=DPI)
    return image.getbuffer()


def picture_names(study: str) -> list[str]:
    """Names of the files that `draw` may write for a kind of study."""
    return [f"{name}.png" for name in PICTURES.get(study, {})]
