"""How fast is a map of Fourier coefficients, and how much faster than scipy point by point?

Run `python benchmarks/element_map.py`. The map is that of `configs/figure7.yaml`, 81 x 81 motions of one
contact, until every cycle repeats. The opponent is what a user would write: `solve_ivp` with the slip w as the
state, an event for each way that a state may end, restarted in Python after each; the same march to the steady
cycle (two cycles alike to 1e-5, as far as its drift lets it), then the Fourier integrals by Simpson's rule on
400 dense samples. It runs on some points of the same map, spread at random; both rates are points a second of
wall-clock time. The errors are those of f_s and f_c against the closed-form march from state to state, the
largest over these points, relative to the largest mu n.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np
from scipy.integrate import simpson, solve_ivp

from timesim.element.motion import HarmonicMotion
from timesim.element.state_by_state import steady_cycle
from timesim.study.element_map import MapMarch, elements_of
from timesim.study.registry import load_scene

SCENE = Path(__file__).parents[1] / "configs/figure7.yaml"
STICK, SLIP, APART = 0, 1, 2
CYCLE = 2 * np.pi


class Pad:
    """One contact with isotropic stiffness under u = [A sin t, B sin(t + phi)], v = D sin(t + psi)."""

    def __init__(self, mu, k, kv, n0, motion):
        self.mu, self.k, self.kv, self.n0 = mu, k, kv, n0
        self.A, self.B, self.D, self.phi, self.psi = motion

    def u(self, t):
        return np.array([self.A * np.sin(t), self.B * np.sin(t + self.phi)])

    def du(self, t):
        return np.array([self.A * np.cos(t), self.B * np.cos(t + self.phi)])

    def n(self, t):
        return self.n0 + self.kv * self.D * np.sin(t + self.psi)

    def dn(self, t):
        return self.kv * self.D * np.cos(t + self.psi)

    def speed(self, t, w):
        f = self.k * (self.u(t) - w)
        size = np.hypot(f[0], f[1])
        return f, (f @ self.du(t)) / size - self.mu * self.dn(t) / self.k, size

    def slip(self, t, w):
        f, speed, size = self.speed(t, w)
        return speed * f / size


def terminal(function, direction):
    function.terminal, function.direction = True, direction
    return function


def leg(pad, state, t, w, end, rtol):
    """Until the state ends: its solution, the time, w, and the next state."""
    cone = terminal(lambda t, w: pad.mu * pad.n(t) - np.hypot(*(pad.k * (pad.u(t) - w))), -1)
    stop = terminal(lambda t, w: pad.speed(t, w)[1], -1)
    open_ = terminal(lambda t, w: pad.n(t), -1)
    close = terminal(lambda t, w: pad.n(t), 1)
    rate = pad.slip if state == SLIP else lambda t, w: np.zeros(2)
    events = {STICK: [cone, open_], SLIP: [stop, open_], APART: [close]}[state]
    found = solve_ivp(rate, (t, end), w, events=events, rtol=rtol, atol=1e-3 * rtol, dense_output=True, max_step=0.5)
    t, w = found.t[-1], found.y[:, -1]
    if found.status == 0:
        return found, t, w, state
    if state == APART:
        sticks = pad.k * np.hypot(*pad.du(t)) < pad.mu * pad.dn(t)
        return found, t, pad.u(t), STICK if sticks else SLIP
    if len(found.t_events[1]):
        return found, t, w, APART
    return found, t, w, SLIP if state == STICK else STICK


def cycle(pad, state, w, rtol):
    """One cycle from t = 0: its legs, and where it leads."""
    t, legs = 0.0, []
    while t < CYCLE:
        before, start = state, t
        if state == SLIP and np.hypot(*(pad.u(t) - w)) < 1e-12:
            w = w - 1e-9 * pad.du(t)
        found, t, w, state = leg(pad, state, t, w, CYCLE, rtol)
        if t - start < 1e-12:
            t = start + 1e-9
        legs.append((before, start, t, found))
    return legs, state, w


def coefficients(pad, rtol=1e-7, max_cycles=200):
    """First harmonic of the friction force, complex, of the steady cycle."""
    state = STICK if pad.n(0.0) > 0 else APART
    w = pad.u(0.0)
    for _ in range(max_cycles):
        before = w
        legs, state, w = cycle(pad, state, w, rtol)
        if np.hypot(*(w - before)) < 1e-5:
            break
    t = np.linspace(0.0, CYCLE, 401)
    f = np.zeros((2, t.size))
    for kind, start, end, found in legs:
        inside = (t >= start) & (t <= end)
        if kind != APART and inside.any():
            f[:, inside] = pad.k * (pad.u(t[inside]) - found.sol(t[inside]))
    return simpson(f * np.exp(-1j * t), x=t, axis=1) / np.pi


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=60, help="points that scipy computes")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    scene = load_scene(SCENE)
    elements, phase = elements_of(scene.plan)
    solver = scene.solver()
    contact = scene.plan.contact
    clock = time.perf_counter()
    MapMarch(elements.pick(np.arange(1)), phase[:1], solver).run(max_cycles=1)
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; compilation {time.perf_counter() - clock:.1f} s")
    rows = np.random.default_rng(0).permutation(elements.size)[: options.points]
    phasor = (elements.start * 1j + elements.rate) * elements.length[:, None]
    motions = [(abs(p[0]), abs(p[1]), abs(p[2]), np.angle(p[1]), np.angle(p[2])) for p in phasor[rows]]
    ours, theirs = [], []
    for _ in range(options.repeats):
        clock = time.perf_counter()
        found = MapMarch(elements, phase, solver).run()
        ours.append(time.perf_counter() - clock)
        clock = time.perf_counter()
        law = (contact.friction, contact.tangential_stiffness[0, 0], contact.normal_stiffness, contact.preload)
        values = np.array([coefficients(Pad(*law, motion)) for motion in motions])
        theirs.append(time.perf_counter() - clock)
    exact = []
    for motion in motions:
        cosine, sine = steady_cycle(contact, HarmonicMotion(*motion)).harmonics(1)
        exact.append(cosine[1] - 1j * sine[1])
    turned = (found["f_c"] - 1j * found["f_s"]) * np.exp(1j * phase)
    scale = elements.force[rows, None]
    errors = [np.abs((x - np.array(exact)) / scale).max() for x in (turned[rows], values)]
    rates = elements.size / np.median(ours), len(rows) / np.median(theirs)
    print("\n| who | points | seconds | points a second | error |\n|---|---|---|---|---|")
    print(f"| timesim, {solver} | {elements.size} | {np.median(ours):.2f} | {rates[0]:.0f} | {errors[0]:.1e} |")
    print(f"| scipy RK45, rtol 1e-7 | {len(rows)} | {np.median(theirs):.2f} | {rates[1]:.1f} | {errors[1]:.1e} |")
    print(f"\n{rates[0] / rates[1]:.0f} times the rate; {np.sum(~found['settled'])} points not settled")


if __name__ == "__main__":
    main()
