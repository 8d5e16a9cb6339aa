"""Compiled programs that are kept ready to run: met again untraced, and never in the place of another."""

import os
import subprocess
import sys
from pathlib import Path
from uuid import uuid4

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from timesim import program as module
from timesim import runtime
from timesim.program import program

ROOT = Path(__file__).parents[2]


class Pair(eqx.Module):
    """Two arrays, something that is none, and a name that is part of the structure."""

    first: Array
    second: tuple[Array | None, ...]
    name: str = eqx.field(static=True)


PAIR = Pair(np.arange(3.0), (None, np.asarray(2)), "a")


class Start:
    """What a process does that begins anew, with what it traces on the way."""

    def __init__(self):
        self.traced, self.name = [], f"scaled_{uuid4().hex}"  # JAX's own cache has met no program of this name

    def __call__(self, pair, by=2):
        def scaled(pair, by):
            self.traced.append(pair.name)
            times = by if isinstance(by, int) else by(1)
            return Pair(times * pair.first, (pair.second[1] + 1, None), f"{pair.name} scaled")

        scaled.__name__ = self.name
        return program(scaled)(pair, by)


SECONDS = "jax_persistent_cache_min_compile_time_secs"


@pytest.fixture
def start(tmp_path, monkeypatch):
    """Beginning anew where programs are kept in `tmp_path`, and JAX keeps none of its own."""
    monkeypatch.setattr(runtime, "READY", tmp_path)
    before = getattr(jax.config, SECONDS)
    jax.config.update(SECONDS, 1e9)
    yield Start()
    jax.config.update(SECONDS, before)


def programs(folder):
    return {path for path in folder.glob("*") if not path.is_symlink()}


def names(folder):
    """Of what they depend on: links to the programs."""
    return set(folder.glob("*")) - programs(folder)


def test_a_program_is_met_again_and_not_traced(start, tmp_path):
    ends = [start(PAIR) for _ in range(3)]
    assert len(programs(tmp_path)) == len(names(tmp_path)) == len(start.traced) == 1
    for end in ends:
        np.testing.assert_array_equal(end.first, [0.0, 2.0, 4.0])
        assert (int(end.second[0]), end.second[1], end.name) == (3, None, "a scaled")


def test_what_it_is_asked_for_tells_it_from_others(start, tmp_path):
    others = [
        (PAIR, 3),
        (PAIR, True),
        (Pair(PAIR.first, PAIR.second, "b"), 3),
        (Pair(np.arange(4.0), PAIR.second, "a"), 2),
        (Pair(np.arange(3), PAIR.second, "a"), 2),
        (Pair(jnp.asarray(1.0), PAIR.second, "a"), 2),
        (Pair(jnp.asarray(1.0, dtype=float), PAIR.second, "a"), 2),
    ]
    for number, (pair, by) in enumerate(others, start=1):
        for _ in range(2):
            end = start(pair, by)
            np.testing.assert_array_equal(end.first, by * pair.first)
            assert end.name == f"{pair.name} scaled"
        assert len(names(tmp_path)) == len(start.traced) == number


def test_one_that_leaves_out_another_argument_is_another(start):
    def one_of(which, *numbers):
        return numbers[which] + 1

    for which in (0, 1):
        assert program(one_of)(which, np.asarray(1.0), np.asarray(2.0)) == which + 2


def test_other_sources_are_traced_and_other_versions_are_compiled(start, tmp_path, monkeypatch):
    start(PAIR)
    monkeypatch.setattr(module, "_sources", lambda: "others")
    np.testing.assert_array_equal(start(PAIR).first, [0.0, 2.0, 4.0])
    assert (len(start.traced), len(names(tmp_path)), len(programs(tmp_path))) == (2, 2, 1)
    monkeypatch.setattr(module, "_settings", lambda: "others")
    np.testing.assert_array_equal(start(PAIR).first, [0.0, 2.0, 4.0])
    assert (len(start.traced), len(names(tmp_path)), len(programs(tmp_path))) == (3, 3, 2)


def test_every_source_version_and_setting_counts(tmp_path, monkeypatch):
    (tmp_path / "sub").mkdir()
    source = tmp_path / "sub" / "law.py"
    monkeypatch.setattr(module, "__file__", str(tmp_path / "program.py"))
    found = []
    for text, number, setting in [("1", "1", "a"), ("2", "1", "a"), ("2", "2", "a"), ("2", "2", "b"), ("2", "2", "b")]:
        source.write_text(text)
        monkeypatch.setattr(module, "version", lambda name, number=number: number)
        monkeypatch.setenv("XLA_FLAGS", setting)
        found.append((module._sources.__wrapped__(), module._settings.__wrapped__()))
    assert len(set(found)) == 4
    assert found[3] == found[4]


@pytest.mark.parametrize("damage", ["empty", "other content", "cut off", "gone"])
def test_what_is_damaged_is_compiled_and_mended(start, tmp_path, damage):
    start(PAIR)
    (path,) = programs(tmp_path)
    content = {"empty": b"", "other content": b"no program", "cut off": path.read_bytes()[:-9]}
    path.write_bytes(content[damage]) if damage in content else path.unlink()
    for _ in range(2):
        np.testing.assert_array_equal(start(PAIR).first, [0.0, 2.0, 4.0])
    assert len(start.traced) == 2


def test_a_folder_that_cannot_be_written_is_no_trouble(start, tmp_path, monkeypatch):
    (tmp_path / "ready").write_text("a file")
    monkeypatch.setattr(runtime, "READY", tmp_path / "ready")
    np.testing.assert_array_equal(start(PAIR).first, [0.0, 2.0, 4.0])


def test_what_only_this_process_knows_is_traced_each_time(start, tmp_path):
    np.testing.assert_array_equal(start(PAIR, lambda x: x + 4).first, [0.0, 5.0, 10.0])
    assert not names(tmp_path)


def test_inside_a_program_it_is_a_part_of_that(start, tmp_path):
    slope = jax.grad(lambda first: start(Pair(first, PAIR.second, "a")).first.sum())(jnp.arange(3.0))
    np.testing.assert_array_equal(slope, [2.0, 2.0, 2.0])
    assert not programs(tmp_path)


def test_what_jax_has_kept_itself_is_not_kept_again(start, tmp_path, monkeypatch):
    """XLA 0.10 writes a program that it has loaded without some of its kernels."""
    monkeypatch.setattr(runtime, "READY", None)
    jax.config.update(SECONDS, 0.0)
    start(PAIR)
    monkeypatch.setattr(runtime, "READY", tmp_path)
    for _ in range(2):
        np.testing.assert_array_equal(start(PAIR).first, [0.0, 2.0, 4.0])
    assert not list(tmp_path.glob("*"))
    assert len(start.traced) == 3


def test_what_does_not_run_is_compiled(start, monkeypatch):
    def broken(*arrays):
        raise jax.errors.JaxRuntimeError("NOT_FOUND: Function broadcast_multiply_fusion not found")

    start(PAIR)
    monkeypatch.setattr(module, "deserialize_and_load", lambda *_: broken)
    np.testing.assert_array_equal(start(PAIR).first, [0.0, 2.0, 4.0])
    assert len(start.traced) == 2


def test_what_was_not_used_for_the_longest_time_goes_first(start, tmp_path, monkeypatch):
    seen = set()
    for number, by in enumerate((1, 2, 3)):
        start(PAIR, by)
        (new,) = programs(tmp_path) - seen
        os.utime(new, (number, number))
        seen.add(new)
    start(PAIR, 1)
    monkeypatch.setattr(module, "MOST_BYTES", int(2.5 * max(path.stat().st_size for path in seen)))
    start(PAIR, 4)
    assert len(programs(tmp_path)) == 2
    traced = len(start.traced)
    start(PAIR, 1)
    assert len(start.traced) == traced


def in_a_process(code, **environment):
    """What a Python process of its own prints."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("XLA_", "JAX_", runtime.KEEP))}
    return subprocess.run(
        [sys.executable, "-c", code], env=clean | environment, capture_output=True, text=True, check=True
    ).stdout


@pytest.mark.long
def test_only_commands_keep_programs_unless_the_host_has_chosen(tmp_path, monkeypatch):
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    code = "from timesim import runtime; print(runtime.READY)"
    cache = {"TIMESIM_CACHE": str(tmp_path)}
    assert in_a_process(code, **cache).strip() == "None"
    kept = cache | {runtime.KEEP: "1"}
    assert in_a_process(code, **kept).strip() == str(tmp_path / runtime.processor() / "ready")
    assert in_a_process(code, **kept, JAX_COMPILATION_CACHE_DIR=str(tmp_path / "own")).strip() == "None"


@pytest.mark.long
def test_a_second_run_imports_only_what_it_needs(tmp_path):
    scene = ROOT / "configs" / "oscillator.yaml"
    arguments = ["timesim", "run", str(scene), "--no-plots", "--force", "-o", str(tmp_path / "run")]
    arguments += ["--set", "study.cycles=2", "--set", "study.record_last=1"]
    code = (
        "import sys\n"
        f"sys.argv = {arguments!r}\n"
        "from timesim.cli import main\n"
        "try:\n    main()\nexcept SystemExit as stop:\n    assert not stop.code\n"
        "print([n for n in ('dask', 'scipy', 'matplotlib', 'diffrax') if sys.modules.get(n)])"
    )
    in_a_process(code)
    assert in_a_process(code).splitlines()[-1] == "[]"
