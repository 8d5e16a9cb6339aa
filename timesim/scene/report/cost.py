"""About how long a study takes, in words."""

from collections.abc import Iterator
from dataclasses import replace
from math import prod

from timesim.hbm.scheme import NOTED
from timesim.model import cost
from timesim.model.model import Model
from timesim.model.solver import NEVER, SHOOT, Solver
from timesim.result.label import counted
from timesim.scene.hbm import balance_of
from timesim.scene.resolution import Scene
from timesim.scene.study import SteadySection, SweepPlan
from timesim.scene.sweep import BistablePlan
from timesim.scene.transient import Schedule, TradeoffPlan

# Times, and seconds, from which on another way to settle is named, and times from which on a budget that is spent is.
FASTER, NOTICED, FAR = 1.5, 3.0, 2.0


def cost_lines(scene: Scene, model: Model) -> Iterator[str]:
    """Roughly how long each phase of the study takes, and where the figures come from; empty if none is known."""
    study, plan, solver = scene.file.study, scene.plan, scene.solver()
    lines = []
    if isinstance(plan, Schedule):
        cycles = sum(cycles for _, cycles in plan.phases)
        total = cost.seconds(model, solver, cost.Work.of_run(plan.phases, estimated=False))
        lines.append(f"{counted(cycles, 'cycle')} of {duration(total / cycles)}: {duration(total)}")
    elif isinstance(plan, TradeoffPlan):
        finest = plan.preset("reference", model, solver.budget)
        own = cost.seconds_a_cycle(model, finest, plan.frequency)
        each = f"{counted(plan.cycles, 'cycle')} of {duration(own)}: {duration(plan.cycles * own)} a run at reference"
        lines.append(f"{each}, of {duration(plan.budget)} for all runs and their compilation")
    elif isinstance(study, SteadySection):
        sweep = study.sweep()
        cycles, own, beside, total = sweep_cost(model, solver, sweep)
        each = f"{counted(cycles, 'cycle')} of {duration(own)} and {duration(beside)} beside them"
        most = sweep.size * sweep.criterion.max_cycles * own
        if most > max(FAR * total, NOTICED):
            each += f" ({duration(most)} in all if none settles in settle.max_cycles = {sweep.criterion.max_cycles})"
        lines.append(f"{counted(sweep.size, 'point')} of {each}: {duration(total)}{study.search()}")
        if isinstance(plan, BistablePlan) and plan.starts:
            lines.append(_of_starts(model, solver, plan))
        shot = replace(sweep, criterion=replace(sweep.criterion, first_shot=SHOOT))
        fewer, _, _, less = sweep_cost(model, solver, shot)
        if total > max(FASTER * less, NOTICED):
            why = "vibrations decay slowly; of several motions it may find another"
            few = f"{counted(fewer, 'cycle')} a point, Newton's method and {duration(less)}"
            lines.append(f"{few} with study.periodic: shoot, as {why}")
    balance = balance_of(plan)
    if balance is not None:
        curves = prod(map(len, balance.over.values())) * (1 + balance.both_ends)
        scheme, *finer = balance.schemes_for(model)
        if "harmonics" in balance.chosen:
            more = f", and up to {finer[-1].harmonics} harmonics where they are needed" if finer else ""
            yield f"{scheme}{more}; if those above make more than {NOTED:g} of the amplitude, the run says so"
        own = cost.seconds_a_solution(model, scheme.harmonics, scheme.time_samples, stability=balance.stability)
        work = f"{cost.SOLUTIONS} solutions of {duration(own)}"
        which = counted(curves, "curve")
        more = f", or up to {cost.MANY_SOLUTIONS} if it takes many harmonics" if "harmonics" in balance.chosen else ""
        lines.append(f"{which} of harmonic balance of {work}: {duration(curves * cost.SOLUTIONS * own)}{more}")
    yield from (f"about {line}" for line in lines)
    if lines:
        yield "as measured on one core of a server (timesim/model/cost.py); a first run compiles before that"


def _of_starts(model: Model, solver: Solver, plan: BistablePlan) -> str:
    """The cost of the starts within a range: all march until they settle."""
    sweep, number = plan.sweep, plan.starts**2
    marched = replace(sweep, directions=("independent",), criterion=replace(sweep.criterion, first_shot=NEVER))
    cycles, own, *_ = sweep_cost(model, solver, marched)
    each = f"{counted(cycles, 'cycle')} of {duration(own)}"
    return f"{counted(number, 'start')} of {each} within each range that is found: {duration(number * cycles * own)}"


def sweep_cost(model: Model, solver: Solver, sweep: SweepPlan) -> tuple[int, float, float, float]:
    """The cycles that a point of a sweep marches, the seconds of one, those beside them, and those of all points.

    Cycles of Newton's method, and the one that is measured, take longer, by their derivatives.
    """
    whole = sweep.work(model)
    ((frequency, every),) = whole.phases
    cycles, own = round(every / sweep.size), cost.seconds_a_cycle(model, solver, frequency, marched=True)
    marched = int(min(cycles, sweep.criterion.first_shot))
    beside = cost.SETTLING + (1 + cycles - marched) * cost.seconds_a_derivative(model, solver, frequency)
    return marched, own, beside, sweep.size * (marched * own + beside)


DURATIONS = (
    ("years", 3.156e7, 6.3e7),
    ("days", 86400.0, 1.8e5),
    ("h", 3600.0, 7200.0),
    ("min", 60.0, 120.0),
    ("s", 1.0, 1.0),
    ("ms", 1e-3, 1e-3),
    ("µs", 1e-6, 0.0),
)
"""Units of time: the seconds in one, and from how many seconds on it is used."""


def duration(seconds: float) -> str:
    """A time with about two digits, in the unit that suits it."""
    unit, size = next((unit, size) for unit, size, least in DURATIONS if seconds >= least)
    number = seconds / size
    return f"{number:.{0 if number >= 10 else 1}f} {unit}" if number < 1e4 else f"{number:.0e} {unit}"
