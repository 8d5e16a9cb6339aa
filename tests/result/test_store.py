"""Result files: what is written comes back, in xarray too; what cannot be written or read says so."""

import os
import re
import resource
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray

from timesim.result import label, store
from timesim.result.store import StoreError

ATTRS = {
    "timesim_version": "0.1.0",
    "scene": "title: ein Schlüssel\nstudy: {kind: transient}\n",
    "study": "transient",
    "complete": True,
    "method": "tsit5",
    "compile_seconds": 1.5,
    "run_seconds": 0.25,
}
COORDS = {
    "time": np.linspace(0.0, 1.0, 5),
    "point": ["root", "tip"],
    "axis": ["x", "y", "z"],
    "contact": ["pad"],
    "component": ["t1", "t2", "n"],
    "contacts.pad.preload": [3.0, -1.0],
}


def _record(num_events: int = 2, **attrs: object) -> store.Record:
    rng = np.random.default_rng(3)
    variables = {
        "displacement": (("time", "point", "axis"), rng.normal(size=(5, 2, 3))),
        "contact_force": (("time", "contact", "component"), rng.normal(size=(5, 1, 3))),
        "contact_state": (("time", "contact"), np.array([[0], [0], [1], [2], [0]], np.int8)),
        "event_time": (("event",), np.linspace(0.1, 0.2, num_events)),
        "amplitude": (("contacts.pad.preload", "point", "axis"), np.full((2, 2, 3), np.nan)),
        "settled": (("contacts.pad.preload",), np.array([True, False])),
        "final_phase_deg": ((), np.float64(12.5)),
    }
    return store.record(variables, COORDS, ATTRS | attrs)


def test_xarray_reads_what_was_written(tmp_path: Path) -> None:
    made = _record()
    file = store.save(made, tmp_path / "result.nc")
    with xarray.open_dataset(file) as opened:
        xarray.testing.assert_identical(opened.load(), store.open_result(tmp_path))
        xarray.testing.assert_equal(opened, made.dataset())
        assert list(opened.point.values) == ["root", "tip"]
        assert set(opened.indexes) == set(COORDS)
        assert opened.sel(point="tip", axis="z").displacement.values == pytest.approx(
            made.variables["displacement"][1][:, 1, 2], abs=0
        )
        assert opened.displacement.attrs == {"long_name": "displacement", "units": "length"}
        assert opened.time.attrs["units"] == "s"
        assert opened["contacts.pad.preload"].attrs["units"] == "force"
        assert opened.contact_state.attrs["flag_meanings"].split()[2] == "separation"
        assert opened.settled.values.tolist() == [1, 0]
        assert opened.settled.dtype.kind == "i"
        assert opened.attrs == {**ATTRS, "complete": 1}


def test_a_dataset_can_be_saved_again(tmp_path: Path) -> None:
    first = store.open_result(store.save(_record(), tmp_path / "a.nc"))
    again = store.open_result(store.save(first, tmp_path / "b.nc"))
    xarray.testing.assert_identical(first, again)


def test_the_file_is_closed_after_reading(tmp_path: Path) -> None:
    file = store.save(_record(), tmp_path / "result.nc")
    opened = store.open_result(file)
    file.unlink()
    assert np.isfinite(opened.displacement.values).all()
    assert not [link for link in Path("/proc/self/fd").iterdir() if "result.nc" in str(link.resolve())]


def test_a_run_without_events_or_contacts(tmp_path: Path) -> None:
    variables = {
        "event_time": (("event",), np.zeros(0)),
        "event_contact": (("event",), np.zeros(0, int)),
        "contact_force": (("time", "contact", "component"), np.zeros((5, 0, 3))),
    }
    coords = COORDS | {"contact": np.array([], str)}
    file = store.save(store.record(variables, coords, ATTRS), tmp_path / "result.nc")
    with xarray.open_dataset(file) as opened:
        assert opened.sizes["event"] == 0
        assert opened.contact_force.shape == (5, 0, 3)
        assert opened.contact.dtype.kind == "U"


def test_a_long_scene_is_kept_whole(tmp_path: Path) -> None:
    scene = "mass: [1.0, 0.5]  # Maß\n" * 20_000
    opened = store.open_result(store.save(_record(scene=scene), tmp_path / "result.nc"))
    assert opened.attrs["scene"] == scene


def test_big_arrays_are_packed_and_exact(tmp_path: Path) -> None:
    time = np.linspace(0, 1, 40_000)
    wave = np.round(np.sin(7 * time), 3)
    made = store.record({"energy_input": (("time",), wave)}, {"time": time}, ATTRS)
    file = store.save(made, tmp_path / "result.nc")
    assert file.stat().st_size < 0.7 * (time.nbytes + wave.nbytes)
    assert (store.open_result(file).energy_input.values == wave).all()


def test_groups(tmp_path: Path) -> None:
    sweep = store.record(
        {"amplitude": (("frequency", "point"), np.ones((3, 2)))},
        {"frequency": [1.0, 2.0, 3.0], "point": ["root", "tip"]},
        {},
    )
    hbm = store.record({"frequency": (("solution",), np.arange(7.0))}, {}, {})
    difference = {"relative_difference": (("frequency", "point"), np.zeros((3, 2)))}
    root = store.record(difference, {"point": ["root", "tip"]}, ATTRS)
    file = store.save_groups({"": root, "sweep": sweep, "hbm": hbm}, tmp_path / "result.nc")
    tree = store.open_groups(tmp_path)
    with xarray.open_datatree(file, engine="h5netcdf") as opened:
        assert set(opened.children) == set(tree.children) == {"sweep", "hbm"}
        assert opened["hbm"]["frequency"].dims == tree["hbm"]["frequency"].dims == ("solution",)
        assert opened["sweep"]["amplitude"].shape == (3, 2)
    with xarray.open_dataset(file, group="sweep") as group:
        assert group.frequency.values.tolist() == [1.0, 2.0, 3.0]
    assert set(store.open_result(file).data_vars) == {"relative_difference"}


@pytest.mark.parametrize("name", store.REQUIRED_ATTRIBUTES)
def test_a_missing_attribute_is_refused(tmp_path: Path, name: str) -> None:
    made = _record()
    attrs = {key: value for key, value in made.attrs.items() if key != name}
    with pytest.raises(StoreError, match=name):
        store.save(store.Record(made.variables, made.coords, attrs), tmp_path / "result.nc")
    assert not list(tmp_path.iterdir())


def test_wrong_arrays_are_refused() -> None:
    with pytest.raises(StoreError, match=r"'displacment'.*timesim\.result\.label"):
        store.record({"displacment": (("time",), np.zeros(5))}, COORDS, ATTRS)
    with pytest.raises(StoreError, match=r"4 values along 'time', elsewhere 5"):
        store.record({"energy_input": (("time",), np.zeros(4))}, COORDS, ATTRS)
    with pytest.raises(StoreError, match=r"shape \(5, 2\) does not fit"):
        store.record({"energy_input": (("time",), np.zeros((5, 2)))}, COORDS, ATTRS)


def test_every_name_has_a_meaning_and_units_are_known() -> None:
    texts = [label.attributes(name) for name in label.LABELS]
    assert all(text["long_name"] for text in texts)
    allowed = {"1", "s", "Hz", "degree", "length", "length/s", "modal length", "modal length/s", "force"}
    allowed |= {"force*length", "force/length"}
    assert {text["units"] for text in texts if "units" in text} == allowed
    assert label.attributes("structure.modes.0.mass") == {"long_name": "scene value structure.modes.0.mass"}


def test_flags_say_what_they_mean_and_are_of_the_type_of_their_variable(tmp_path: Path) -> None:
    flags = {"settled": np.int32, "stable": np.int8, "range_cut": np.int32, "start_branch": np.int32}
    variables = {name: (("jump",), np.array([-1, 0, 1], dtype=kind)) for name, kind in flags.items()}
    result = store.record(variables, {}, ATTRS)
    for data in (result.dataset(), store.open_result(store.save(result, tmp_path / "result.nc"))):
        for name, kind in flags.items():
            attrs = data[name].attrs
            assert attrs["flag_values"].dtype == kind
            assert len(attrs["flag_meanings"].split()) == len(attrs["flag_values"])
        assert data.start_branch.attrs["flag_meanings"] == "none smaller larger another"
        assert data.range_cut.attrs["flag_values"].tolist() == [-1, 0, 1]


@pytest.mark.parametrize("keep", [0, 10, 0.5, 0.98])
def test_a_cut_off_file_is_refused(tmp_path: Path, keep: float) -> None:
    file = store.save(_record(), tmp_path / "result.nc")
    content = file.read_bytes()
    file.write_bytes(content[: int(keep * len(content)) if keep < 1 else int(keep)])
    with pytest.raises(StoreError, match=re.escape(str(file))):
        store.open_result(tmp_path)


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="no result file at"):
        store.open_result(tmp_path)
    (tmp_path / "text.nc").write_text("not a result")
    with pytest.raises(StoreError, match="cannot be read as a result file"):
        store.open_result(tmp_path / "text.nc")
    xarray.Dataset({"a": ("x", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(StoreError, match=r"not a result of timesim.*timesim_version"):
        store.open_result(tmp_path / "other.nc")


def test_a_full_disk_leaves_the_old_result(tmp_path: Path) -> None:
    file = store.save(_record(), tmp_path / "result.nc")
    before = file.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        with pytest.raises(StoreError, match=r"cannot be written: File too large; what was there is unchanged"):
            store.save(_record(method="rk4"), file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert file.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["result.nc"]


def test_an_interrupt_while_writing_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(store.os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        store.save(_record(), tmp_path / "result.nc")
    assert not list(tmp_path.iterdir())


def test_saving_into_no_folder(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="No such file"):
        store.save(_record(), tmp_path / "missing" / "result.nc")


def test_a_new_folder_gets_the_scene(tmp_path: Path) -> None:
    folder = store.prepare_folder(tmp_path / "runs" / "first", "title: a\n")
    assert (folder / "scene.yaml").read_text() == "title: a\n"
    assert [path.name for path in folder.iterdir()] == ["scene.yaml"]


def test_checking_a_folder_makes_nothing(tmp_path: Path) -> None:
    store.check_folder(tmp_path / "runs" / "first")
    assert not list(tmp_path.iterdir())


def test_an_existing_result_needs_force(tmp_path: Path) -> None:
    store.prepare_folder(tmp_path, "title: a\n")
    file = store.save(_record(), tmp_path / "result.nc")
    (tmp_path / "energy.png").write_bytes(b"old")
    (tmp_path / "mine.png").write_bytes(b"own")
    with pytest.raises(StoreError, match="exists; choose another folder or give --force"):
        store.prepare_folder(tmp_path, "title: b\n")
    assert (tmp_path / "scene.yaml").read_text() == "title: a\n"
    store.prepare_folder(tmp_path, "title: b\n", force=True, stale=["energy.png", "orbit.png"])
    assert (tmp_path / "scene.yaml").read_text() == "title: b\n"
    assert file.exists()
    assert {path.name for path in tmp_path.iterdir()} == {"scene.yaml", "result.nc", "mine.png"}


def test_the_users_own_scene_is_never_overwritten(tmp_path: Path) -> None:
    own = tmp_path / "scene.yaml"
    own.write_text("title: a  # a comment\n")
    with pytest.raises(StoreError, match="is another scene"):
        store.prepare_folder(tmp_path, "title: a\n")
    with pytest.raises(StoreError, match="overwrite its own scene file"):
        store.prepare_folder(tmp_path, "title: a\n", force=True, source=own)
    assert own.read_text() == "title: a  # a comment\n"
    store.prepare_folder(tmp_path, own.read_text(), source=own)


def test_a_file_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("")
    with pytest.raises(StoreError, match="runs is a file"):
        store.prepare_folder(tmp_path / "runs" / "first", "title: a\n")


def test_a_file_system_that_is_read_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store.os, "access", lambda *_: False)
    with pytest.raises(StoreError, match="no permission in"):
        store.check_folder(tmp_path)
    flags = SimpleNamespace(f_flag=os.ST_RDONLY)
    monkeypatch.setattr(store.os, "statvfs", lambda _: flags)
    with pytest.raises(StoreError, match=f"the file system of {tmp_path} is read-only"):
        store.check_folder(tmp_path)


def test_a_folder_that_cannot_be_made() -> None:
    with pytest.raises(StoreError, match="/proc/timesim"):
        store.prepare_folder("/proc/timesim", "title: a\n")


def test_writing_loads_neither_xarray_nor_pandas(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom timesim.result import store\n"
        "assert 'h5netcdf' not in sys.modules\n"
        f"attrs = dict.fromkeys(store.REQUIRED_ATTRIBUTES, 'x')\n"
        f"store.save(store.record({{}}, {{'axis': ['x']}}, attrs), {str(tmp_path / 'result.nc')!r})\n"
        "assert not {'xarray', 'pandas', 'jax'} & set(sys.modules)\n"
        f"assert list(store.read({str(tmp_path)!r})[''].coords['axis']) == ['x']\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
