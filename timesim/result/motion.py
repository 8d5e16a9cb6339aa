"""Prescribed motions from files: one cycle of u1, u2 and v at equal angles, as .csv, as .npz, or in a result."""

import zlib
from collections.abc import Mapping
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from timesim.element.motion import MIN_SAMPLES, Array, SplineMotion
from timesim.model.model import GROUND
from timesim.result.label import counted
from timesim.result.last_cycle import last_cycle

COLUMNS = ("u1", "u2", "v")
# A step so many times larger than its neighbours on both sides, and than this share of the range, is a jump.
JUMP, SHARE = 8.0, 1e-6
# Share of its range by which a cycle of a result may end away from where it begins: a cycle still settling would be
# taken for a periodic one with a kink.
CLOSED = 1e-3


def read_motion(path: str | Path) -> SplineMotion:
    """Read one cycle of motion [length] and interpolate it smoothly.

    A .csv file has a header naming its columns, some of u1, u2 and v; an .npz file has arrays of these names,
    or u of shape (N, 2) and v. What is left out is zero. The rows are equally spaced over the cycle; the
    first may be repeated at the end.

    Raises:
        ValueError: the file is of another kind, or is not one smooth cycle of numbers in these columns.
        OSError: it cannot be read.
    """
    path = Path(path)
    readers = {".csv": _read_csv, ".npz": _read_npz}
    if path.suffix.lower() not in readers:
        raise ValueError(f"motion file {path}: its name must end in .csv or .npz, not {path.suffix or 'nothing'}")
    return SplineMotion(_samples(path, readers[path.suffix.lower()](path)))


def read_result_motion(path: str | Path, point: str, against: str, frame: Array) -> SplineMotion:
    """Motion of a point relative to another over the last whole cycle that an earlier transient recorded.

    Args:
        path: result file, or the folder of the run.
        point, against: points of that result; the second may be the ground.
        frame: rows t1, t2 and normal of the contact, shape (3, 3).

    Raises:
        ValueError: there is no such point, or the cycle is not one smooth motion that closes.
        StoreError: the file is no result.
    """
    path = Path(path)
    data, rows = last_cycle(path, "displacement", "point")
    names = data["point"].values.tolist()
    for name in (point, against):
        if name not in names and (name, name) != (against, GROUND):
            raise ValueError(f"result {path}: no point {name}; it has {', '.join(names)}")
    x = data["displacement"].values[rows]
    relative = x[:, names.index(point)] - (0.0 if against == GROUND else x[:, names.index(against)])
    missed, extent = np.abs(relative[-1] - relative[0]).max(), np.ptp(relative, axis=0).max()
    if missed > CLOSED * extent:
        raise ValueError(
            f"result {path}: its last cycle ends {missed / extent:.2g} of the motion's range from where it begins, "
            f"more than {CLOSED:g}: it has not settled, or repeats after more than a cycle; give it more cycles"
        )
    u1, u2, v = frame @ relative[:-1].T
    return SplineMotion(_samples(path, {"u1": u1, "u2": u2, "v": v}))


def _read_csv(path: Path) -> dict[str, Array]:
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    rows = [(number, line) for number, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if not rows:
        raise ValueError(f"motion file {path}: it is empty; write a header such as u1,u2,v and one row an angle")
    names = [name.strip() for name in rows[0][1].split(",")]
    _check_names(path, names)
    values = np.array([_numbers(path, number, line, len(names)) for number, line in rows[1:]])
    return dict(zip(names, values.reshape(-1, len(names)).T, strict=True))


def _numbers(path: Path, number: int, line: str, count: int) -> list[float]:
    cells = line.split(",")
    if len(cells) != count:
        wanted = counted(count, "value")
        raise ValueError(f"motion file {path}, line {number}: {wanted} expected as in the header, not {len(cells)}")
    try:
        return [float(cell) for cell in cells]
    except ValueError as error:
        raise ValueError(f"motion file {path}, line {number}: not a number: {line.strip()!r}") from error


def _read_npz(path: Path) -> dict[str, Array]:
    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = {name: np.asarray(data[name], float) for name in data.files}
    except (ValueError, TypeError, EOFError, BadZipFile, zlib.error) as error:
        raise ValueError(f"motion file {path}: it cannot be read as an .npz file of numbers ({error})") from error
    pair = arrays.pop("u", None)
    if pair is not None:
        if pair.ndim != 2 or pair.shape[1] != 2 or "u1" in arrays or "u2" in arrays:
            raise ValueError(
                f"motion file {path}: u must have shape (N, 2) and stand without u1 and u2, not {pair.shape}"
            )
        arrays |= {"u1": pair[:, 0], "u2": pair[:, 1]}
    _check_names(path, list(arrays))
    return arrays


def _check_names(path: Path, names: list[str]) -> None:
    unknown = [name for name in names if name not in COLUMNS]
    if unknown or not names or len(set(names)) < len(names):
        raise ValueError(f"motion file {path}: columns must be u1, u2 and v, each at most once, not {', '.join(names)}")


def _samples(path: Path, columns: Mapping[str, Array]) -> Array:
    """One cycle as rows (u1, u2, v), checked, without a repeated end."""
    sizes = {name: np.shape(column) for name, column in columns.items()}
    if len(set(sizes.values())) > 1 or any(len(size) != 1 for size in sizes.values()):
        raise ValueError(f"motion file {path}: the columns must be vectors of one length, not {sizes}")
    count = next(iter(sizes.values()))[0]
    samples = np.stack([columns.get(name, np.zeros(count)) for name in COLUMNS], axis=1)
    bad = np.flatnonzero(~np.isfinite(samples).all(1))
    if bad.size:
        raise ValueError(
            f"motion file {path}: sample {bad[0] + 1} of {count} is not finite: {samples[bad[0]].tolist()}"
        )
    if count > MIN_SAMPLES and _end_repeats(samples):
        samples = samples[:-1]
    if len(samples) < MIN_SAMPLES:
        raise ValueError(f"motion file {path}: a cycle needs at least {MIN_SAMPLES} samples, not {len(samples)}")
    _refuse_jump(path, samples)
    return samples


def _end_repeats(samples: Array) -> bool:
    """Whether the last row repeats the first: it lies as near, and the cycle is smoother without it."""
    gap = np.abs(samples[-1] - samples[0]).max()
    steps = np.abs(np.diff(samples, axis=0)).max(1)
    if gap > 1e-3 * max(steps[0], steps[-1]):
        return False
    return _seam(samples[:-1]) < _seam(samples)


def _seam(samples: Array) -> float:
    """Roughness of the closed cycle around its end: the largest fourth difference there."""
    around = np.concatenate([samples[-5:], samples[:5]])
    return float(np.abs(np.diff(around, 4, axis=0)).max())


def _refuse_jump(path: Path, samples: Array) -> None:
    for name, column in zip(COLUMNS, samples.T, strict=True):
        step = np.abs(np.roll(column, -1) - column)
        before = np.maximum(np.roll(step, 1), np.roll(step, 2))
        after = np.maximum(np.roll(step, -1), np.roll(step, -2))
        jump = np.flatnonzero((step > JUMP * np.maximum(before, after)) & (step > SHARE * np.ptp(column)))
        if jump.size:
            first, second = jump[0] + 1, (jump[0] + 1) % len(column) + 1
            raise ValueError(
                f"motion file {path}: {name} jumps by {step[jump[0]]:.3g} from sample {first} to {second}, "
                f"more than {JUMP:g} times the steps beside it; give one whole cycle of a smooth motion"
            )
