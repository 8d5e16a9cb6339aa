"""JAX as the package needs it: versions that compute right, what importing the package leaves alone, the cache."""

import dataclasses
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float, TypeCheckError

from timesim import runtime
from timesim.engine.system import Work


@runtime.tree_class
class Lever:
    """Of its parts one may be missing, and one is of its structure."""

    arm: Float[Array, ""]
    load: Float[Array, ""] | None
    name: str = dataclasses.field(default="lever", metadata={"static": True})


OPTIONS = "xla_cpu_small_while_loop_byte_threshold=8388608,xla_cpu_disable_new_fusion_emitters=true"
LOOP_FLAG = f"--xla_backend_extra_options={OPTIONS}"
COMPUTE = "import jax, jax.numpy as jnp; assert (jnp.zeros(3) + 1).sum() == 3"
EAGER = "jax.config.update('jax_persistent_cache_min_compile_time_secs', 0.0)"


def python(code, **environment):
    """Standard output and error of a Python process of its own."""
    clean = {key: value for key, value in os.environ.items() if key not in {"XLA_FLAGS", "TF_CPP_MIN_LOG_LEVEL"}}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=clean | environment, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


@pytest.fixture(autouse=True)
def _flags_of_the_host_are_away(monkeypatch):
    """The names of folders hold the instructions that these flags allow; the processes of `python` have none."""
    monkeypatch.delenv("XLA_FLAGS", raising=False)


def test_a_tree_is_taken_apart_into_its_parts_and_put_together_again():
    lever = Lever(jnp.asarray(2.0), None)
    leaves, tree = jax.tree.flatten(lever)
    assert leaves == [2.0]
    assert jax.tree.unflatten(tree, ["no array"]).arm == "no array"
    assert tree != jax.tree.structure(dataclasses.replace(lever, name="another"))
    assert jax.jit(lambda own: own.arm * len(own.name))(lever) == 10.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        lever.arm = jnp.asarray(3.0)


def test_parts_of_many_trees_at_once_are_changed():
    """The constructor refuses what its annotations are not of."""
    many = jax.tree.map(lambda leaf: leaf[None], Work.none(contacts=2))
    with pytest.raises(TypeCheckError):
        dataclasses.replace(many, input=np.ones(1))
    changed = runtime.with_parts(many, input=np.ones(1))
    assert (changed.input, many.input) == (1.0, 0.0)
    assert changed.friction is many.friction
    with pytest.raises(AssertionError):
        runtime.with_parts(many, imput=np.ones(1))


def test_this_jax_multiplies_many_vectors_right():
    """0.10.2 gives some rows of a batch, from 16,385 on, the values of others (jax-ml/jax#39103)."""
    x = np.random.default_rng(0).normal(size=(16_385, 3))
    matrix = np.array([[2.0, -1.0, 0.5], [0.0, 3.0, 1.0], [1.0, 0.0, -2.0]])

    def largest(x):
        return jax.vmap(lambda row: jnp.max(matrix @ row))(x)

    np.testing.assert_allclose(jax.jit(largest)(x), (x @ matrix.T).max(axis=1), rtol=1e-12, atol=1e-12)


def test_this_jax_writes_into_a_record_at_the_cost_of_what_it_writes():
    """0.11.1 copies the whole record at each write inside a loop (jax-ml/jax#40101)."""
    num_writes = 20_000

    @jax.jit
    def write(record):
        return jax.lax.fori_loop(0, num_writes, lambda i, r: r.at[i % r.size].set(r[i % r.size] + i), record)

    def seconds(size):
        record, taken = jnp.zeros(size), []
        write(record).block_until_ready()
        for _ in range(5):
            start = time.perf_counter()
            write(record).block_until_ready()
            taken.append(time.perf_counter() - start)
        return min(taken)

    assert seconds(num_writes) < 20 * seconds(64)


def test_importing_the_package_changes_nothing():
    out, err = python(
        """
import os, sys, warnings
before, filters = dict(os.environ), list(warnings.filters)
import timesim
print(dict(os.environ) == before, warnings.filters == filters, sorted({"jax", "pydantic", "xarray"} & set(sys.modules)))
print([name for name in dir(timesim) if name[0] != "_"] == sorted(timesim.__all__))
print(timesim.load_scene.__name__, "jax" in sys.modules)
try:
    timesim.nothing
except AttributeError as error:
    print(error)
"""
    )
    assert out.splitlines() == [
        "True True []",
        "True",
        "load_scene False",
        "module 'timesim' has no attribute 'nothing'",
    ]
    assert not err


@pytest.mark.long
def test_jax_that_runs_already_is_warned_about_once(tmp_path):
    code = "; import timesim.runtime; from timesim.engine.law import cone; assert jax.config.jax_enable_x64"
    _, err = python(COMPUTE + code, TIMESIM_CACHE=str(tmp_path))
    assert [len(re.findall(text, err)) for text in ("single precision", "15 times longer")] == [1, 1]
    double = f"import jax; jax.config.update('jax_enable_x64', True); {COMPUTE}"
    _, err = python(double + code, TIMESIM_CACHE=str(tmp_path))
    assert "single precision" not in err
    assert LOOP_FLAG in err
    _, err = python(double + code, TIMESIM_CACHE=str(tmp_path), XLA_FLAGS=LOOP_FLAG, TF_CPP_MIN_LOG_LEVEL="3")
    assert not err
    _, err = python("import jax" + code, TIMESIM_CACHE=str(tmp_path), JAX_ENABLE_X64="1", TF_CPP_MIN_LOG_LEVEL="3")
    assert not err


def test_a_command_computes_on_the_processor(tmp_path):
    told = "; import timesim.runtime, jax; print(jax.config.jax_platforms, os.environ.get('JAX_PLATFORMS'))"
    unset = f"import os; os.environ.pop('JAX_PLATFORMS', None){told}"
    assert python(unset, TIMESIM_CACHE=str(tmp_path), **{runtime.KEEP: "1"})[0] == "cpu cpu\n"
    assert python(unset, TIMESIM_CACHE=str(tmp_path)) == ("None None\n", "")


def test_a_graphics_card_that_nobody_named_is_warned_about(monkeypatch, recwarn):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(runtime, "_SETTINGS", SimpleNamespace(jax_platforms="cuda"))
    runtime._check_platform()
    assert not recwarn
    monkeypatch.setattr(runtime, "_SETTINGS", SimpleNamespace(jax_platforms=None))
    with pytest.warns(RuntimeWarning, match="computes on 'gpu'.*JAX_PLATFORMS=cpu"):
        runtime._check_platform()


@pytest.mark.long
def test_compiled_programs_are_met_again_by_the_next_process(tmp_path):
    count = (
        "; hits = []; jax.monitoring.register_event_listener(lambda e, **_: hits.append(e) if 'hits' in e else None)"
    )
    code = f"import timesim.runtime, jax{count}; {EAGER}; {COMPUTE}; print(len(hits) > 0)"
    found = [python(code, TIMESIM_CACHE=str(tmp_path)) for _ in range(2)]
    assert found == [("False\n", ""), ("True\n", "")]
    assert [path.name for path in tmp_path.iterdir()] == [runtime.processor()]


def test_programs_of_another_processor_lie_apart(monkeypatch):
    here = runtime.processor()
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_max_isa=SSE4_2")
    assert runtime.processor() == "-".join(np.insert(here.split("-"), 1, "SSE4_2"))
    monkeypatch.setenv("XLA_FLAGS", "")
    described = "processor : 0\nmodel name : A\ncpu MHz : {}\nflags : sse {}\n\nprocessor : 1\nmodel name : B\n"
    names = []
    for clock, flag in [(1, "avx"), (2, "avx"), (1, "avx2")]:
        text = described.format(clock, flag)
        monkeypatch.setattr("builtins.open", lambda *_, text=text: __import__("io").StringIO(text))
        names.append(runtime.processor())
    assert names[0] == names[1] != names[2]


@pytest.mark.long
@pytest.mark.parametrize("trouble", ["cannot be written", "keeps nothing", "meets nothing again"])
def test_a_folder_that_is_of_no_use_is_reported_once(tmp_path, trouble):
    folder = tmp_path / runtime.processor()
    if trouble == "cannot be written":
        folder.write_text("a file")
        expected = "File exists"
    elif trouble == "keeps nothing":  # JAX reads the time of last use of every entry before it adds one
        folder.mkdir()
        (folder / "jit_other-cache").write_text("")
        expected = "jit_other-atime"
    else:
        folder.mkdir()
        for number in range(10):
            name = f"jit_probe_{jax.__version__.replace('.', '_')}-{number}"
            (folder / f"{name}-cache").write_text("")
            (folder / f"{name}-atime").write_bytes(bytes(8))
        expected = "11 entries of one program"
    _, err = python("import timesim.runtime; import timesim.engine.law.cone", TIMESIM_CACHE=str(tmp_path))
    if trouble == "keeps nothing" and any(folder.glob("jit_probe*-cache")):  # JAX 0.12 goes on without that time
        assert "RuntimeWarning" not in err
        return
    assert err.count("RuntimeWarning") == 1
    assert f"compiled programs are not kept in {folder}: " in err
    assert expected in err
    assert "TIMESIM_CACHE" in err


def test_the_choice_of_the_host_is_kept(tmp_path):
    code = (
        f"import jax; jax.config.update('jax_compilation_cache_dir', {str(tmp_path / 'own')!r}); import timesim.runtime"
    )
    _, err = python(f"{code}; {EAGER}; {COMPUTE}", TIMESIM_CACHE=str(tmp_path / "other"), JAX_ENABLE_X64="1")
    assert not err
    assert [path.name for path in tmp_path.iterdir()] == ["own"]
    assert Path(tmp_path / "own").is_dir()


def test_diffrax_is_imported_where_one_of_its_methods_runs_and_nowhere_else():
    code = (
        "import sys; import timesim.study.transient, timesim.study.sweep;"
        "from timesim.engine.method import step_method; from timesim.model.solver import Solver;"
        "loaded = lambda name: (step_method(Solver(name, 1e-7, 1e-9)).order, 'diffrax' in sys.modules)[1];"
        "print(*map(loaded, ('exponential', 'rk4', 'tsit5')))"
    )
    assert python(code)[0].split() == ["False", "False", "True"]
