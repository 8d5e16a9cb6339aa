"""Prescribed motions: closed-form roots, exits from the cone, and files."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from timesim.element.cone_exit import trigonometric_roots
from timesim.element.motion import CYCLE, HarmonicMotion, SplineMotion
from timesim.result.motion import read_motion

FULL = np.array([[1.3, 0.4], [0.4, 0.7]])


def sampled(motion, count):
    return motion.evaluate(np.arange(count) * CYCLE / count)[0].T


# Roots -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "roots", [[0.3, 1.0, 2.0, 5.0], [1.0, 1.0, 2.0, 3.0], [1.0, 1.0, 4.0, 4.0], [2.0, 2.0, 2.0, 2.0]]
)
def test_quartic_roots(roots):
    """prod sin((t - r) / 2) over the four roots, whose multiplicity m costs the usual 1 / m of the digits."""
    t = np.arange(8) * np.pi / 4
    value = np.prod(np.sin((t[:, None] - roots) / 2), axis=1)
    spectrum = np.fft.fft(value) / 8
    found = trigonometric_roots(np.array([spectrum[0], 2 * spectrum[1], 2 * spectrum[2]]))
    multiplicity = max(Counter(roots).values())
    np.testing.assert_allclose(found, roots, atol=20 * 1e-16 ** (1 / multiplicity))


def test_quartic_of_lower_degree():
    np.testing.assert_allclose(trigonometric_roots([0.5, 1.0, 0.0]), np.array([2, 4]) * np.pi / 3, atol=1e-14)
    np.testing.assert_allclose(trigonometric_roots([0.5, 1.0, 1e-18j]), np.array([2, 4]) * np.pi / 3, atol=1e-14)
    assert trigonometric_roots([1.0, 0.0, 0.0]).size == 0


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.lists(st.floats(0.05, 6.0), min_size=2, max_size=2), st.floats(0.0, 6.28), st.floats(-1.0, 1.0))
def test_stick_ends_where_the_force_first_leaves_the_cone(amplitudes, phi, psi):
    motion = HarmonicMotion(*amplitudes, 0.6, phi, psi)
    transform, mu = np.zeros((3, 3)), 0.4
    transform[:2, :2], transform[2, 2] = FULL, mu
    start = motion.evaluate(0.0)[0]
    offset = np.array([*(-FULL @ start[:2]), mu])
    exit_ = motion.cone_exit(transform, offset, 0.0, on_cone=False)
    theta = np.linspace(0, min(exit_, CYCLE), 2000)[:-1]
    r = transform @ motion.evaluate(theta)[0] + offset[:, None]
    assert np.all(np.hypot(r[0], r[1]) <= r[2] + 1e-12)
    if np.isfinite(exit_):
        y, dy = motion.evaluate(exit_)
        r, dr = transform @ y + offset, transform @ dy
        assert np.hypot(r[0], r[1]) == pytest.approx(r[2], abs=1e-12)
        assert r[:2] @ dr[:2] > r[2] * dr[2]


# Splines ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [False, True])
def test_crossings_of_spline_and_harmonic_motion_agree(rate):
    rng = np.random.default_rng(2)
    for _ in range(20):
        motion = HarmonicMotion(*rng.normal(size=3), *rng.uniform(0, CYCLE, 2))
        weights, constant = rng.normal(size=3), rng.normal() / 2
        exact, rising = motion.crossings(weights, constant, rate=rate)
        angles, up = SplineMotion(sampled(motion, 400)).crossings(weights, constant, rate=rate)
        np.testing.assert_array_equal(up, rising)
        np.testing.assert_allclose(angles, exact, atol=1e-8)


def test_crossing_at_a_sample_is_found_once():
    motion = SplineMotion(sampled(HarmonicMotion(1.0, 0.0, 1.0, 0.0, np.pi / 2), 32))
    angles, rising = motion.crossings(np.array([1.0, 0.0, 0.0]), 0.0)
    np.testing.assert_allclose(angles, [0.0, np.pi], atol=1e-14)
    assert rising.tolist() == [True, False]


def test_touching_is_no_crossing():
    motion = HarmonicMotion(1.0, 0.0, 1.0)
    assert motion.crossings(np.array([0.0, 0.0, 1.0]), 1.0)[0].size == 0
    assert motion.crossings(np.array([0.0, 0.0, 1.0]), 1.0 - 1e-12)[0].size == 2
    for other in (motion, SplineMotion(sampled(motion, 32))):
        assert other.crossings(np.zeros(3), 0.0)[0].size == 0


@pytest.mark.parametrize("on_cone", [False, True])
def test_exits_of_spline_and_harmonic_motion_agree(on_cone):
    """From the rest of a contact, and from where it has just stuck: f = mu n there, and d|f| = mu dn."""
    rng = np.random.default_rng(4)
    compared = 0
    for _ in range(200 if on_cone else 40):
        motion = HarmonicMotion(*rng.uniform(0.2, 3, 2), 0.6, *rng.uniform(0, CYCLE, 2))
        transform = np.diag([1.0, 1.0, 0.4])
        start = rng.uniform(0, CYCLE)
        y, dy = motion.evaluate(start)
        limit, rate = 0.4 * (1 + y[2]), 0.4 * dy[2]
        if on_cone and np.hypot(*dy[:2]) < abs(rate):
            continue
        angle = np.arctan2(dy[1], dy[0]) + np.arccos(rate / np.hypot(*dy[:2])) if on_cone else 0.0
        force = limit * np.array([np.cos(angle), np.sin(angle)]) * on_cone
        bend = dy[:2] @ dy[:2] - force @ y[:2] - rate**2 + limit * 0.4 * y[2]
        if on_cone and (bend > 0 or limit <= 0):
            continue
        offset = np.array([*(force - y[:2]), 0.4])
        exact = motion.cone_exit(transform, offset, start, on_cone=on_cone)
        found = SplineMotion(sampled(motion, 300)).cone_exit(transform, offset, start, on_cone=on_cone)
        if np.isfinite(exact) and start + 1e-3 < exact < start + CYCLE - 1e-3:
            assert found == pytest.approx(exact, abs=1e-6)
            compared += 1
    assert compared > 8


# Files -----------------------------------------------------------------------------------------------------


def write_csv(path, rows, header="u1,u2,v"):
    path.write_text(header + "\n" + "\n".join(",".join(repr(float(x)) for x in row) for row in rows))
    return path


def test_files(tmp_path):
    rows = sampled(HarmonicMotion(1.0, 0.4, 0.9, 1.1, 0.3), 64)
    expected = read_motion(write_csv(tmp_path / "a.csv", rows)).samples
    np.testing.assert_array_equal(expected, rows)
    closed = read_motion(write_csv(tmp_path / "b.csv", np.vstack([rows, rows[:1]])))
    np.testing.assert_array_equal(closed.samples, rows)
    np.savez(tmp_path / "c.npz", u=rows[:, :2], v=rows[:, 2])
    np.testing.assert_array_equal(read_motion(tmp_path / "c.npz").samples, rows)
    np.savez(tmp_path / "d.npz", u1=rows[:, 0], v=rows[:, 2])
    np.testing.assert_array_equal(read_motion(tmp_path / "d.npz").samples, rows * [1, 0, 1])
    only = read_motion(write_csv(tmp_path / "e.csv", rows[:, 1:2], "u2"))
    np.testing.assert_array_equal(only.samples, rows * [0, 1, 0])


@pytest.mark.parametrize("shift", [0.0, 0.5, 0.25])
def test_cycle_that_starts_beside_its_turning_point_keeps_its_samples(tmp_path, shift):
    """Half a step off the turning point the first and the last sample agree, yet none is repeated."""
    theta = (np.arange(40) + shift) * CYCLE / 40
    rows = np.cos(theta)[:, None]
    assert len(read_motion(write_csv(tmp_path / "a.csv", rows, "u1")).samples) == 40
    closed = np.vstack([rows, rows[:1]])
    assert len(read_motion(write_csv(tmp_path / "b.csv", closed, "u1")).samples) == 40


def test_a_motion_written_with_few_digits_is_smooth(tmp_path):
    """Near its turning points it moves on by the last digit now and then, which is no jump."""
    rows = np.round(np.cos((np.arange(32) + 0.25) * CYCLE / 32), 1)[:, None]
    np.testing.assert_array_equal(read_motion(write_csv(tmp_path / "a.csv", rows, "u1")).samples, rows * [1, 0, 0])


def test_bad_files_are_refused(tmp_path):
    rows = sampled(HarmonicMotion(1.0, 0.4, 0.9, 1.1, 0.3), 64)
    ramp = np.linspace(0, 1, 64, endpoint=False)[:, None] * [1, 0, 0]
    bad = rows.copy()
    bad[7, 1] = np.nan
    spike = rows.copy()
    spike[30:, 0] += 3.0
    cases = [
        (rows[:15], "u1,u2,v", "at least 16"),
        (rows[:, :2], "u1,w", "u1, u2 and v"),
        (rows[:, :2], "u1,u1", "at most once"),
        (rows[:, :2], "u1,u2,v", "line 2: 3 values expected"),
        (bad, "u1,u2,v", "sample 8 of 64 is not finite"),
        (ramp, "u1,u2,v", "u1 jumps by 0.984 from sample 64 to 1"),
        (spike, "u1,u2,v", "u1 jumps by .* from sample 30 to 31"),
    ]
    for values, header, message in cases:
        with pytest.raises(ValueError, match=message):
            read_motion(write_csv(tmp_path / "bad.csv", values, header))
    (tmp_path / "bad.csv").write_text("u1,v\n" + "1,2\n" * 20 + "1,x\n")
    with pytest.raises(ValueError, match="line 22: not a number"):
        read_motion(tmp_path / "bad.csv")
    (tmp_path / "bad.csv").write_text("")
    with pytest.raises(ValueError, match="empty"):
        read_motion(tmp_path / "bad.csv")
    np.savez(tmp_path / "bad.npz", u=rows)
    with pytest.raises(ValueError, match=r"shape \(N, 2\)"):
        read_motion(tmp_path / "bad.npz")
    np.savez(tmp_path / "bad.npz", u1=rows[:, 0], v=rows[:20, 0])
    with pytest.raises(ValueError, match="one length"):
        read_motion(tmp_path / "bad.npz")
    np.savez_compressed(tmp_path / "bad.npz", u1=rows[:, 0], v=rows[:, 2])
    packed = bytearray((tmp_path / "bad.npz").read_bytes())
    packed[60:80] = b"\xff" * 20
    (tmp_path / "bad.npz").write_bytes(packed)
    with pytest.raises(ValueError, match="cannot be read"):
        read_motion(tmp_path / "bad.npz")
    (tmp_path / "bad.npz").write_bytes(b"PK nonsense")
    with pytest.raises(ValueError, match="cannot be read"):
        read_motion(tmp_path / "bad.npz")
    with pytest.raises(ValueError, match=r"end in \.csv or \.npz"):
        read_motion(tmp_path / "motion.txt")
