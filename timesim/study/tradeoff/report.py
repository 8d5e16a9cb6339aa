"""The summary of a tradeoff in words: its runs, those that are worth their time, the blocks to paste."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from xarray import Dataset

from timesim.engine.status import Status
from timesim.model.solver import CLOSED_FORM
from timesim.scene.text import flow
from timesim.study.tradeoff.bench import NO_TIME

KEPT = "solver_kept"
"""Attribute of the result: the keys of the scene's own section `solver` that belong in every block, as JSON."""


def lines(data: Dataset) -> Iterator[str]:
    """The table of a tradeoff, and what follows from it."""
    attrs = data.attrs
    if data.sizes["trial"]:
        yield from table(data)
        yield from _verdict(data)
    yield from (f"left out, {line}" for line in attrs["left_out"].splitlines())


def more_runs(left_out: str) -> list[str]:
    """What to do for more runs to come to their end, by the lines of those that were left out."""
    causes = {
        Status.BUDGET.reason.partition("{")[0]: "raise solver.max_steps",
        NO_TIME: "give it a larger study.budget",
    }
    return [what for cause, what in causes.items() if any(line.startswith(cause) for line in left_out.splitlines())]


def _verdict(data: Dataset) -> Iterator[str]:
    """How well the errors are known, and what follows from them."""
    attrs = data.attrs
    known, truth = attrs["error_known_to"], attrs["truth"]
    more = " and ".join(more_runs(attrs["left_out"])) or "give it a larger study.budget"
    by = f"by two methods, {truth}" if truth else f"by no second method: {more}"
    what = "of the settled amplitude" if attrs["judged_by_amplitude"] else "of the state at the end"
    if not np.isfinite(known):
        yield f"one run says nothing of its error: {more}"
        return
    yield "* no other run of the whole scene is both faster and better"
    yield f"errors are those {what}, relative to its size, known to {known:.1e} {by}"
    if attrs["settled_to"] > attrs["error_wanted"]:
        yield f"before the runs the amplitude still changed by {attrs['settled_to']:.1e}: it had not settled"
    if attrs["cycles"] > attrs["cycles_asked"]:
        fewer = f"in {attrs['cycles_asked']} it would not have come from the accurate motion that it begins with"
        yield f"each run has {attrs['cycles']} cycles: {fewer} to its own"
    yield from _advice(data)
    yield from _modes(data)
    yield from _reductions(data)


def table(data: Dataset) -> Iterator[str]:
    """A line a run, from the largest error to the smallest; a star where none is both faster and better."""
    cycles = data.attrs["cycles"]
    yield f"  {'error':>8} {'seconds':>9} {'steps/cycle':>11} {'transitions':>11} {'compiled in':>11}  solver"
    for i in np.argsort(-data["error"].values, kind="stable"):
        one = data.isel(trial=i)
        star, whole = "*" if one.pareto else " ", int(one.modes_kept) == data.attrs["num_modes"]
        words = [words_of(one)] + ([] if whole else [f"{int(one.modes_kept)} of {data.attrs['num_modes']} modes"])
        words += [] if one.reduced else ["nothing left out"]
        words += [f"({one.preset.item()})"] if one.preset.item() else []
        compiled = f"{float(one.compile_seconds_before):.1f} s" if one.compile_seconds_before > 0 else ""
        seconds = float(one.seconds_a_cycle) * cycles
        yield (
            f"{star} {float(one.error):8.1e} {seconds:9.2g} {float(one.steps_a_cycle):11.0f} "
            f"{int(one.transitions):11d} {compiled:>11}  {' '.join(words)}"
        )


def words_of(one: Dataset) -> str:
    """Method and tolerance of a run."""
    steps = "" if np.isfinite(one.rtol) else f", {int(one.steps_asked)} steps a cycle"
    return f"{one.method.item()}{steps or f' {float(one.rtol):.2g}'}"


def _advice(data: Dataset) -> Iterator[str]:
    """The block for the wanted error, and blocks of the front for other times."""
    attrs, chosen = data.attrs, json.loads(data.attrs["recommended"])
    if not chosen:
        return
    section = f"solver: {flow(chosen)}"
    row = data.isel(trial=int(attrs["recommended_trial"]))
    error, seconds = float(row.error), float(row.seconds_a_cycle) * attrs["cycles"]
    wanted = attrs["error_wanted"]
    if error <= wanted:
        yield f"for an error of {wanted:.0e}: {section}, {error:.1e} in {seconds:.2g} s"
    else:
        yield f"no run keeps an error of {wanted:.0e}; the best: {section}, {error:.1e} in {seconds:.2g} s"
    yield from _as_quick(data)
    front = data.isel(trial=np.flatnonzero(data["pareto"].values)).sortby("seconds_a_cycle")
    yield "for other times:"
    for i in np.unique(np.linspace(0, front.sizes["trial"] - 1, 5).astype(int)):
        one = front.isel(trial=i)
        seconds = float(one.seconds_a_cycle) * attrs["cycles"]
        yield f"  {seconds:.3g} s, error {float(one.error):.0e}: solver: {flow(block(one))}"


def _as_quick(data: Dataset) -> Iterator[str]:
    """Runs that keep the wanted error too, and whose times the scatter does not tell from that of the chosen one."""
    attrs, seconds = data.attrs, data["seconds_a_cycle"].values
    scatter, chosen = _scatter(data), attrs["recommended_trial"]
    alike = (data["error"].values <= attrs["error_wanted"]) & (seconds <= (1 + scatter) * seconds[chosen])
    alike &= (data["modes_kept"].values == attrs["num_modes"]) & (data["reduced"].values == 1)
    alike &= np.arange(seconds.size) != chosen
    if alike.any():
        names = "; ".join(words_of(data.isel(trial=i)) for i in np.flatnonzero(alike))
        yield f"times of one run scatter by {100 * scatter:.2g} %: they do not tell which is quicker, that or {names}"


def _scatter(data: Dataset) -> float:
    """How much longer than the least the times of one run are, the median over the runs."""
    known = data["seconds_scatter"].values
    return float(np.nanmedian(known)) if np.isfinite(known).any() else 0.0


def block(one: Dataset) -> dict[str, Any]:
    """The section `solver` of a scene file by which a run is made, with what the scene itself sets there."""
    rtol, kept = float(one.rtol), json.loads(one.attrs.get(KEPT, "{}"))
    if one.method.item() == CLOSED_FORM:
        return {"accuracy": one.preset.item()} | kept
    if np.isfinite(rtol):
        return {"method": one.method.item(), "rtol": rtol, "atol": float(f"{rtol / 100:.2g}")} | kept
    return {"method": one.method.item(), "steps_per_cycle": int(one.steps_asked)} | kept


def _modes(data: Dataset) -> Iterator[str]:
    """How many modes the answer needs."""
    count, wanted = data.attrs["num_modes"], data.attrs["error_wanted"]
    few = data.isel(trial=np.flatnonzero(data["modes_kept"].values < count))
    if data.attrs["modes_not_tried"]:
        yield f"no time left to try the lowest {data.attrs['modes_not_tried']} of {count} modes"
    if not few.sizes["trial"]:
        return
    pairs = zip(few.modes_kept.values, few.error.values, strict=True)
    each = ", ".join(f"{kept}: {error:.1e}" for kept, error in pairs)
    enough = few.modes_kept.values[few.error.values <= wanted]
    verdict = f"the lowest {enough.min()} do" if enough.size else f"all {count} are needed"
    yield f"error by the number of lowest modes kept: {each}; for {wanted:.0e} {verdict}"


def _reductions(data: Dataset) -> Iterator[str]:
    """How much the reductions gain."""
    for i in np.flatnonzero(data["reduced"].values == 0):
        one = data.isel(trial=i)
        same = (data.method == one.method) & (data.rtol == one.rtol) & (data.reduced == 1)
        same &= data.modes_kept == one.modes_kept
        if same.any():
            gain = float(one.seconds_a_cycle / data.seconds_a_cycle[same].min())
            longer = f"a run takes {gain:.2g} times as long"
            if max(gain, 1 / gain) <= (1 + _scatter(data)) ** 2:  # both times scatter
                longer = "a run takes as long, as far as the scatter of the times tells"
            yield f"with nothing left out (solver.reduce: false) {longer}"
